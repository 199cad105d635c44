//! A robot as points in the world, for drawings.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::Pose;
use crate::robot::Robot;

/// Where the parts of a robot are (m, world).
#[derive(Debug, Clone, PartialEq)]
pub struct Skeleton {
    /// Corners of the base's first box; bits 0, 1, 2 of an index say whether x, y, z are on the far side.
    pub corners: [[f64; 3]; 8],
    /// Of every arm its foot on the base, its joints in their order, and its hand.
    pub arms: Vec<Vec<[f64; 3]>>,
}

impl Skeleton {
    /// Of a robot that stands like this.
    ///
    /// # Panics
    /// If the pose is of a robot with other joints.
    pub fn of(robot: &Robot, pose: &Pose) -> Self {
        assert_eq!(pose.joints.len(), robot.n_joints(), "joints of robot and pose");
        let [w, x, y, z] = pose.base_quaternion.map(f64::from);
        let attitude = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let base = *attitude.to_rotation_matrix().matrix();
        let origin = Vector3::from(pose.base_position.map(f64::from));
        let cube = &robot.boxes[0];
        let corner = |index: usize| {
            let signs = [0, 1, 2].map(|bit| if index >> bit & 1 == 1 { 1.0 } else { -1.0 });
            let corner = Vector3::from(signs).component_mul(&cube.half);
            (origin + base * (cube.centre + cube.rotation * corner)).into()
        };
        let arms = robot.arms.iter().enumerate().map(|(index, arm)| {
            let (kind, joints) = (robot.type_of(index), &pose.joints[robot.joints.of_arm(index)]);
            let (mut r, mut o) = (base * arm.rotation, origin + base * arm.position);
            // The foot is where the mount's far side meets the base.
            let foot = arm.mount.centre - arm.mount.rotation.column(2) * arm.mount.half.z;
            let mut points = vec![(origin + base * foot).into(), o.into()];
            for (index, (link, &q)) in kind.links.iter().zip(joints).enumerate() {
                let (sin, cos) = libm::sincos(f64::from(q));
                r *= Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
                if index + 1 == kind.links.len() {
                    points.push((o + r * kind.tool_position).into());
                } else {
                    o += r * link.shift;
                    r *= link.twist;
                    points.push(o.into());
                }
            }
            points
        });
        Self { corners: std::array::from_fn(corner), arms: arms.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hands at home as the reference measured them in MuJoCo, on the released robot.
    #[test]
    fn a_skeleton_at_home_is_where_mujoco_has_it() {
        let robot = Robot::builtin("release").expect("built in");
        let pose = Pose {
            base_position: [0.0, 0.0, 4.0],
            base_quaternion: [1.0, 0.0, 0.0, 0.0],
            joints: robot.home_q().iter().map(|&q| q as f32).collect(),
        };
        let skeleton = Skeleton::of(&robot, &pose);
        let close = |a: [f64; 3], b: [f64; 3]| {
            for i in 0..3 {
                assert!((a[i] - b[i]).abs() < 1e-5, "{a:?} {b:?}");
            }
        };
        let hands = [
            [0.298824, 1.553659, 4.315298],
            [0.300802, -1.553659, 4.315300],
            [0.300802, 0.235300, 5.553659],
            [0.298824, 0.235298, 2.446341],
        ];
        for (arm, hand) in skeleton.arms.iter().zip(hands) {
            assert_eq!(arm.len(), 8, "foot, six joints, hand");
            close(arm[7], hand);
        }
        close(skeleton.arms[2][0], [0.3, 0.0, 4.4726]);
        close(skeleton.corners[0], [-0.4726, -0.4726, 3.5274]);
        close(skeleton.corners[5], [0.4726, -0.4726, 4.4726]);
    }
}
