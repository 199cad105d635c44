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
        let e = euler_xyz(&m);
        for (x, y) in e.iter().zip([a, b, c]) {
            assert!((x - y).abs() < 1e-14, "{e:?}");
        }
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
