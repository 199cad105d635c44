//! Tasks in lanes: what is aimed at, what agents see, what they are paid. Which tasks there are, and their goals, stands in [`proto::tasks`].
//!
//! * [`goal`]: where hands and base shall go;
//! * `tumbling`: how what carries goals moves;
//! * [`observation`]: the numbers an agent sees, in three layouts;
//! * `frame`: whence an arm sees it, in the layout `arm`;
//! * [`state`]: the numbers a critic sees;
//! * [`reward`]: what a step is worth.
//!
//! All of it is generic over [`Real`](crate::scalar::Real) and reads one [`Readings`], so the same
//! text serves the lanes of a rollout and the `f64` of a test worked by hand.
//!
//! Agents: agent 2i moves the first half of the joints of arm i and cares for its hand's position, agent 2i + 1 moves
//! the others and cares for its orientation. Agents of arms that turn the base share their reward, but for contacts.
//!
//! Attitudes are Euler angles (a, b, c) of R = Rx(a)·Ry(b)·Rz(c). Attitude errors are plain
//! differences, goal − actual, without wrapping: every goal is far from the singular b = ±π/2, also where it
//! moves (`task.target` is checked for it).

pub mod goal;
pub mod observation;
pub mod reward;
pub mod state;

mod definition;
mod frame;
mod readings;
mod tumbling;

pub use definition::Task;
pub use goal::Goals;
pub use proto::tasks::{Aim, ArmGoals, GoalRanges, Home, HomeArm};
pub use readings::{ATTITUDE_WIDTHS, Errors, HandReading, POSITION_WIDTHS, Readings, UNGUIDED};

#[cfg(test)]
mod tests;
