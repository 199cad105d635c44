//! The two tasks: what is aimed at, what agents see, what they are paid.
//!
//! * [`goal`]: where hands and base shall go, and how goals are drawn;
//! * [`observation`]: the numbers an agent sees, in three layouts;
//! * `frame`: whence an arm sees it, in the layout `arm`;
//! * [`state`]: the numbers a critic sees;
//! * [`reward`]: what a step is worth.
//!
//! All of it is generic over [`Real`](crate::scalar::Real) and reads one [`Readings`], so the same
//! text serves the lanes of a rollout and the `f64` of a test worked by hand.
//!
//! Agents: agent 2i moves joints 1–3 of arm i and cares for its hand's position, agent 2i + 1 moves
//! joints 4–6 and cares for its orientation. In the reorientation task all share one reward.
//!
//! Attitudes are Euler angles (a, b, c) of R = Rx(a)·Ry(b)·Rz(c). Attitude errors are plain
//! differences, goal − actual, without wrapping: every goal is far from the singular b = ±π/2.

pub mod goal;
pub mod observation;
pub mod reward;
pub mod state;

mod definition;
mod frame;
mod home;
mod readings;

pub use definition::Task;
pub use goal::{ArmGoals, GoalRanges, Goals};
pub use home::{Home, HomeArm};
pub use readings::{ATTITUDE_WIDTHS, Errors, HandReading, POSITION_WIDTHS, Readings, UNGUIDED};

#[cfg(test)]
mod tests;
