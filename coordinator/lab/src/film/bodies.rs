//! The robot as solids in the world, as it collides.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};
use rendering::{Solid, Vector};
use simulator::experiment::Pose;
use simulator::robot::{BaseBox, Robot, Shape};

/// What a body is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A box of the base.
    Base,
    /// A box between base and arm, or the arm's fixed first link.
    Foot {
        /// Arm, counted from 0.
        arm: usize,
    },
    /// A moving link.
    Link {
        /// Arm, counted from 0.
        arm: usize,
        /// Link of the arm, counted from 0.
        link: usize,
        /// Whether the hand is fixed to it.
        is_last: bool,
    },
}

/// A body and its solids.
#[derive(Debug, Clone)]
pub(super) struct Part {
    pub(super) kind: Kind,
    pub(super) solids: Vec<Solid>,
}

/// A frame in the world: its origin (m), and its axes to the world's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) origin: Vector,
    pub(super) rotation: Matrix3<f64>,
}

/// The robot in the world.
#[derive(Debug, Clone)]
pub(super) struct Posed {
    /// Base, feet, links.
    pub(super) parts: Vec<Part>,
    /// The frame of the base.
    pub(super) base: Frame,
    /// The frame of each hand.
    pub(super) hands: Vec<Frame>,
}

impl Frame {
    /// The solid of a shape that is given in this frame.
    fn placed(&self, shape: &Shape) -> Solid {
        let at = |point: &Vector| self.origin + self.rotation * point;
        match shape {
            Shape::Capsule { from, to, radius } => {
                Solid::Capsule { from: at(from), to: at(to), radius: *radius }
            }
            Shape::Disc { centre, axis, radius, half_height } => Solid::Cylinder {
                from: at(&(centre - axis * *half_height)),
                to: at(&(centre + axis * *half_height)),
                radius: *radius,
            },
        }
    }

    fn placed_box(&self, shape: &BaseBox) -> Solid {
        Solid::Box {
            centre: self.origin + self.rotation * shape.centre,
            rotation: self.rotation * shape.rotation,
            half: shape.half,
        }
    }
}

impl Posed {
    /// The robot that stands like this.
    ///
    /// # Panics
    /// If the pose is of a robot with other joints.
    pub(super) fn new(robot: &Robot, pose: &Pose) -> Self {
        assert_eq!(pose.joints.len(), robot.n_joints(), "joints of robot and pose");
        let [w, x, y, z] = pose.base_quaternion.map(f64::from);
        let attitude = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let base = Frame {
            origin: Vector::from(pose.base_position.map(f64::from)),
            rotation: *attitude.to_rotation_matrix().matrix(),
        };
        let boxes = robot.boxes.iter().map(|shape| base.placed_box(shape)).collect();
        let mut parts = vec![Part { kind: Kind::Base, solids: boxes }];
        let mut hands = Vec::new();
        for (index, arm) in robot.arms.iter().enumerate() {
            let (kind, joints) = (robot.type_of(index), &pose.joints[robot.joints.of_arm(index)]);
            let pedestal = arm.pedestal_shapes.iter().map(|shape| base.placed(shape));
            let solids = [base.placed_box(&arm.mount)].into_iter().chain(pedestal).collect();
            parts.push(Part { kind: Kind::Foot { arm: index }, solids });
            let mut frame = Frame {
                origin: base.origin + base.rotation * arm.position,
                rotation: base.rotation * arm.rotation,
            };
            for (l, (link, q)) in kind.links.iter().zip(joints).enumerate() {
                frame.rotation *=
                    Rotation3::from_axis_angle(&Vector::z_axis(), f64::from(*q)).matrix();
                let solids = link.shapes.iter().map(|shape| frame.placed(shape)).collect();
                let is_last = l + 1 == kind.links.len();
                parts.push(Part { kind: Kind::Link { arm: index, link: l, is_last }, solids });
                if is_last {
                    hands.push(Frame {
                        origin: frame.origin + frame.rotation * kind.tool_position,
                        rotation: frame.rotation * kind.tool_rotation,
                    });
                } else {
                    frame.origin += frame.rotation * link.shift;
                    frame.rotation *= link.twist;
                }
            }
        }
        Self { parts, base, hands }
    }
}

#[cfg(test)]
mod tests {
    use simulator::experiment::Skeleton;

    use super::*;

    /// The skeleton goes another way from joint to joint, and was compared with MuJoCo.
    #[test]
    fn hands_and_base_are_where_the_skeleton_has_them() {
        let robot = Robot::builtin("paper").expect("built in");
        let pose = Pose {
            base_position: [0.1, -0.2, 4.1],
            base_quaternion: [0.9, 0.1, -0.3, 0.3],
            joints: (0..24).map(|joint| 0.3 * joint as f32 - 2.0).collect(),
        };
        let (posed, skeleton) = (Posed::new(&robot, &pose), Skeleton::of(&robot, &pose));
        for (hand, arm) in posed.hands.iter().zip(&skeleton.arms) {
            let wanted = Vector::from(*arm.last().expect("a hand"));
            assert!((hand.origin - wanted).norm() < 1e-9, "{hand:?} {wanted:?}");
            assert!((hand.rotation.determinant() - 1.0).abs() < 1e-9);
        }
        let Solid::Box { centre, half, .. } = &posed.parts[0].solids[0] else {
            panic!("a box");
        };
        let corners = skeleton.corners.map(Vector::from);
        assert!((corners.iter().sum::<Vector>() / 8.0 - centre).norm() < 1e-9);
        assert!(((corners[0] - centre).norm() - half.norm()).abs() < 1e-9);
        // Every shape of the description is there.
        let links: usize = robot.types[0].links.iter().map(|link| link.shapes.len()).sum();
        let feet: usize = robot.arms.iter().map(|arm| 1 + arm.pedestal_shapes.len()).sum();
        let solids: usize = posed.parts.iter().map(|part| part.solids.len()).sum();
        assert_eq!(solids, robot.boxes.len() + feet + 4 * links);
    }

    #[test]
    fn joints_of_an_arm_hold_together() {
        let robot = Robot::builtin("release").expect("built in");
        let pose = Pose {
            base_position: [0.0, 0.0, 4.0],
            base_quaternion: [1.0, 0.0, 0.0, 0.0],
            joints: (0..24).map(|joint| (joint as f32).sin()).collect(),
        };
        let posed = Posed::new(&robot, &pose);
        for pair in posed.parts[1..].windows(2) {
            let (Kind::Link { arm, .. } | Kind::Foot { arm }) = pair[0].kind else { continue };
            let Kind::Link { arm: next, link, .. } = pair[1].kind else { continue };
            assert_eq!(arm, next);
            let gap = |a: &Solid, b: &Solid| {
                let ends = a.balls();
                let (from, to) = (ends[0].0, ends[ends.len() - 1].0);
                let along = (0..=50).map(|i| from + (to - from) * (f64::from(i) / 50.0));
                along.map(|point| b.distance(&point)).fold(f64::INFINITY, f64::min) - ends[0].1
            };
            let least =
                pair[1].solids.iter().flat_map(|a| pair[0].solids.iter().map(move |b| (a, b)));
            let least = least.map(|(a, b)| gap(a, b)).fold(f64::INFINITY, f64::min);
            assert!(least < 0.02, "arm {arm}, link {link}: {least}");
        }
    }
}
