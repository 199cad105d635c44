//! What the loops over episodes have in common ([`crate::rollout`], [`crate::experiment`]): the robot with its sensors, and what can go wrong.
//!
//! Environments stand in lanes, sixteen or eight to a group; everything from the
//! equations of motion to the reward is evaluated for a group at a time, and the policy for all
//! groups. Lanes never mix, so what happens to an environment does not depend on its neighbours; the
//! lanes beyond the last environment repeat it and are never written.

mod checks;
mod error;
mod home;
mod moment;
mod normals;
mod physics;
mod sensors;

pub(crate) use checks::{LIMITS, check_means, check_state};
pub use error::EpisodeError;
pub(crate) use home::home;
pub use moment::Moment;
pub(crate) use normals::draw_normals;
pub(crate) use physics::Physics;
pub use physics::{Push, readings, step_options};
pub(crate) use sensors::Deviations;

#[cfg(test)]
mod tests;
