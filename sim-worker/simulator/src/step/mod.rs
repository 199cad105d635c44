//! One control period: the equations of motion integrated, with what touches and what disturbs.
//!
//! * [`step`] advances one control period; [`StepOptions`] chooses the integrator, its step, and whether contacts push.
//! * [`step_disturbed`] does so while something acts on the robot from outside, or fails in it: a [`Disturbance`].

mod disturbance;
mod integrate;

pub use disturbance::Disturbance;
pub use integrate::{Integrator, StepOptions, step, step_disturbed};
