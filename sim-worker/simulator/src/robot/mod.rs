//! The robot: described in a file ([`description`]), checked and completed ([`Robot`]), laid out for the dynamics ([`Model`](crate::model::Model)).
//!
//! Frames. Standard Denavit–Hartenberg puts frame i at the far end of link i, behind joint i. The dynamics work in **link frames** at the near
//! end: link frame i is frame i−1 turned by the joint angle about its z axis, so every joint turns about its own link frame's z axis, and the step to
//! the next link frame is the constant shift (a, 0, d) and twist α. [`Link`] holds inertials and shapes moved there.

mod assembly;
pub mod description;
mod error;
pub mod mjcf;
mod parts;
mod resolve;
mod rigid_body;
mod shape;
pub mod urdf;
mod wording;
mod xml;

pub use assembly::Robot;
pub use description::RobotDescription;
pub use error::RobotError;
pub use mjcf::MjcfOptions;
pub use parts::{
    AngleContact, Arm, ArmBody, ArmType, Joints, Link, MAX_ARMS, MAX_JOINTS_PER_ARM,
    MIN_JOINTS_PER_ARM,
};
pub use resolve::FARTHEST_HOME;
pub use rigid_body::RigidBody;
pub(crate) use rigid_body::is_rotation;
pub use shape::{BaseBox, Shape};

#[cfg(test)]
mod tests;
