//! Collisions: which bodies touch, and how they push each other apart.
//!
//! * Geometry is capsules and flat cylinders on the links, boxes on the base (`model::shape`); a few pairs of one arm touch exactly when a joint
//!   stands in an interval (the robot's `angle_contacts`).
//! * [`count_contacts`] counts touching pairs of bodies, as the penalty of the tasks wants them.
//! * Contact forces are compliant, so that no arm passes through the base or another arm, and predictive, so that a fixed substep of
//!   16 ms suffices: with gap g and its rate v,
//!
//!   F = max(0, m (a − ω² g − 2 ζ ω v)), ζ = 0.5, ω as high as the integrator's substep allows, 112 rad/s at 16 ms.
//!
//!   m is the mass the joints show at the contact along its normal, so every contact is a damped oscillator of one and the same frequency, whatever
//!   the lever, and stable for the substep it is made for. a holds against the most part of what torques would accelerate the gap with (`HELD`), so that
//!   an arm that presses on indents by little. The damper pushes from a distance of 2 ζ v / ω on, 9 mm per m/s of
//!   approach, so an arm at full speed is caught about where it touches. Where several contacts work on the same joints their forces are solved for
//!   together, so that each gap accelerates as it would alone.
//!
//! A substep looks for contacts once (`find`), by balls and boxes, then capsules around whole bodies, then closest points; the stages of the integrator
//! carry the points along with their bodies. A pair that is far sleeps for as long as its gap takes to close. All of this is decided lane by lane, and
//! forces are sums of the lane's own pairs in a fixed order: work that another lane asks for leaves a lane's bits alone.

mod clearance;
mod contact_forces;
mod distance;
mod find;
mod touching;

pub use clearance::clearance;
pub(crate) use contact_forces::{push, push_link};
pub(crate) use find::find;
pub use touching::{Touching, count_contacts, touching};

#[cfg(test)]
mod tests;
