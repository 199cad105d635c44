//! One control period: the equations of motion integrated, with what touches and what disturbs.
//!
//! * [`step`] advances one control period; [`StepOptions`] chooses the integrator, its step, and whether contacts push.
//! * [`step_disturbed`] does so while something acts on the robot from outside, or fails in it: a [`Disturbance`].

mod control_period;
mod derivative;
mod disturbance;
mod flat_state;
mod options;

pub use control_period::{step, step_disturbed};
pub use disturbance::{Disturbance, Wrench};
pub use options::{Integrator, StepOptions};
