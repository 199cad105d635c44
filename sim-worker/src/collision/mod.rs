//! Collisions: which bodies touch, and how they push each other apart.
//!
//! * Geometry is capsules and flat cylinders on the links, boxes on the base ([`shape`]); a few pairs of one arm touch exactly when a joint stands
//!   in an interval (the robot's `stops`).
//! * [`count_contacts`] counts touching pairs of bodies, as the penalty of the tasks wants them.
//! * Contact forces are compliant, so that no arm passes through the base or another arm, and predictive, so that a fixed substep of
//!   10 ms suffices: with gap g and its rate v,
//!
//!   F = max(0, −m (ω² g + 2 ζ ω v)), ω = 130 rad/s, ζ = 0.7.
//!
//!   m is the mass the joints show at the contact along its normal, so every contact is a damped oscillator of one and the same frequency, whatever
//!   the lever: Runge–Kutta is stable (|λ| h = 1.3 at 10 ms, its limit is 2.7), and a joint at full torque indents by its free acceleration
//!   over ω², below 5 mm. The damper pushes from a distance of 2 ζ v / ω on, 11 mm per m/s of approach, so an arm at full speed is caught
//!   before it touches. Where an arm has several contacts they share the stiffness, because together they are as stiff as their sum.
//!
//! A substep looks for contacts once: [`broad_phase`] by spheres, [`narrow_phase`] for closest points; the stages of the integrator
//! carry the points along with their bodies. Which pairs are looked at is decided lane by lane, and forces are sums of the lane's own pairs in a fixed
//! order: work that another lane asks for leaves a lane's bits alone.

mod distance;
mod model;
mod phases;
pub(crate) mod shape;

pub(crate) use model::CollisionModel;
pub(crate) use phases::{ContactSet, any_contact, broad_phase, clear, narrow_phase, push};

pub use phases::{Touching, count_contacts, touching};

/// Natural frequency of contacts and stops, squared (1/s²).
pub(crate) const STIFFNESS_RATE: f64 = 130.0 * 130.0;

/// Damping of contacts and stops: 2 ζ ω (1/s).
pub(crate) const DAMPING_RATE: f64 = 2.0 * 0.7 * 130.0;

/// Pairs farther apart than this at the start of a substep do not push during it (m): enough for 2.3 m/s of approach over the damper's reach
/// and the substep.
pub(crate) const MARGIN: f64 = 0.05;

/// Contacts never count as heavier than this (kg): near a joint's axis the joint shows a mass without bound.
pub(crate) const HEAVIEST: f64 = 50.0;

#[cfg(test)]
mod tests;
