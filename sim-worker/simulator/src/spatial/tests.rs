use super::*;

fn rot(axis: usize, angle: f64) -> Mat3<f64> {
    let (s, c) = angle.sin_cos();
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = [[0.0; 3]; 3];
    m[axis][axis] = 1.0;
    m[j][j] = c;
    m[k][k] = c;
    m[j][k] = -s;
    m[k][j] = s;
    m
}

#[test]
fn euler_angles_return_from_the_product_of_rotations() {
    for (a, b, c) in [(0.3, -0.7, 1.1), (-2.9, 1.5, 3.0), (0.0, 0.0, 0.0), (1.0, -1.5, -2.0)] {
        let m = mat_mat(&mat_mat(&rot(0, a), &rot(1, b)), &rot(2, c));
        let direct = euler_xyz_to_rotation([a, b, c]);
        for (x, y) in m.iter().flatten().zip(direct.iter().flatten()) {
            assert!((x - y).abs() < 1e-15, "{m:?} {direct:?}");
        }
        let e = euler_xyz(&m);
        for (x, y) in e.iter().zip([a, b, c]) {
            assert!((x - y).abs() < 1e-14, "{e:?}");
        }
    }
}

#[test]
fn a_rotation_differs_from_another_by_an_axis_and_twice_the_sine_of_half_the_angle() {
    let from = euler_xyz_to_rotation([0.3, -0.7, 1.1]);
    for axis in 0..3 {
        for angle in [0.0, 1e-6, 0.1, -1.5, 2.9] {
            let to = mat_mat(&rot(axis, angle), &from);
            let mut expected = [0.0; 3];
            expected[axis] = 2.0 * (0.5 * angle).sin();
            for (x, y) in rotation_difference(&to, &from).iter().zip(expected) {
                assert!((x - y).abs() < 1e-14, "{angle} about {axis}: {x}, by hand {y}");
            }
        }
        // Half a turn: the axis has no sign, and nothing is divided by zero.
        let to = mat_mat(&rot(axis, std::f64::consts::PI), &from);
        assert!(rotation_difference(&to, &from).iter().all(|x| x.abs() < 1e-14));
    }
}

#[test]
fn exponential_map_is_the_rotation_and_products_compose() {
    for axis in 0..3 {
        for angle in [1e-6, 0.1, 2.5] {
            let mut phi = [0.0; 3];
            phi[axis] = angle;
            let m = quaternion_to_rotation(&quaternion_exp(phi));
            let n = rot(axis, angle);
            for i in 0..3 {
                for j in 0..3 {
                    assert!((m[i][j] - n[i][j]).abs() < 1e-15);
                }
            }
        }
    }
    let (a, b) = (quaternion_exp([0.2, 0.3, -0.4]), quaternion_exp([-1.0, 0.1, 0.5]));
    let product = quaternion_to_rotation(&quaternion_product(&a, &b));
    let matrices = mat_mat(&quaternion_to_rotation(&a), &quaternion_to_rotation(&b));
    for i in 0..3 {
        for j in 0..3 {
            assert!((product[i][j] - matrices[i][j]).abs() < 1e-15);
        }
    }
}
