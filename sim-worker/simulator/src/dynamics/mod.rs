//! Equations of motion of the robot: forward dynamics, kinematics, servos, invariants.
//!
//! * [`forward_dynamics`] is the articulated-body algorithm; [`hands`] the forward kinematics.
//! * [`reference_dynamics`] holds the textbook forms in `f64` with nalgebra (inverse dynamics, inertia matrix, momentum, energy), against which the
//!   tests hold the fast ones.
//!
//! There is no gravity. Generalised velocity: base linear velocity (world axes), base angular velocity (base axes), joint rates.
//! Time goes on in [`crate::step`].
//!
//! [Featherstone 2008] R. Featherstone, Rigid Body Dynamics Algorithms, Springer.

pub(crate) mod aba;
pub(crate) mod articulated;
mod fk;
pub(crate) mod invariants;
pub(crate) mod kinematics;
pub mod reference_dynamics;
pub(crate) mod servo;

pub use aba::{Acceleration, forward_dynamics};
pub(crate) use fk::kinematics as kinematics_of;
pub use fk::{Hand, hands};
pub(crate) use servo::angle_contact_interval;

#[cfg(test)]
pub(crate) mod tests;
