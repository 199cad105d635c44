//! Motion of the robot: forward dynamics, its integration, kinematics.
//!
//! * [`step`] advances one control period; [`StepOptions`] chooses the integrator, its step, and whether contacts push.
//! * [`step_disturbed`] does so while something acts on the robot from outside, or fails in it: a [`Disturbance`].
//! * [`forward_dynamics`] is the articulated-body algorithm; [`hands`] the forward kinematics.
//! * [`twin`] holds the textbook forms in `f64` with nalgebra (inverse dynamics, inertia matrix, momentum, energy), against which the
//!   tests hold the fast ones.
//!
//! There is no gravity. Generalised velocity: base linear velocity (world axes), base angular velocity (base axes), joint rates.
//!
//! [Featherstone 2008] R. Featherstone, Rigid Body Dynamics Algorithms, Springer.

pub(crate) mod aba;
pub(crate) mod articulated;
mod disturbance;
mod fk;
mod integrate;
mod invariants;
pub(crate) mod kinematics;
mod servo;
pub mod twin;
mod workspace;

pub use aba::{Acceleration, forward_dynamics};
pub use disturbance::Disturbance;
pub(crate) use fk::kinematics as kinematics_of;
pub use fk::{Hand, hands};
pub use integrate::{Integrator, StepOptions, step, step_disturbed};
pub(crate) use servo::stop_interval;
pub use workspace::Workspace;

#[cfg(test)]
mod tests;
