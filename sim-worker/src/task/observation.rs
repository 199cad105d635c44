//! The numbers an agent sees.
//!
//! Layout `paper`, 28 numbers for `trajectory` and 25 for `reorientation`; `release`, 31 and 25:
//!
//! | `release` | `paper` | numbers |
//! |---|---|---|
//! | 0–2 | 0–2 | base position, world (m) |
//! | 3–6 | 3–6 | base quaternion, w x y z |
//! | 7–9 | 7–9 | the agent's own joint angles (rad) |
//! | 10–12 | 10–12 | base linear velocity, world (m/s) |
//! | 13–15 | 13–15 | base angular velocity, body (rad/s) |
//! | 16–18 | 16–18 | the agent's own joint rates (rad/s) |
//! | 19–21 | 19–21 | position agent: hand position (m); orientation agent: hand Euler angles (rad); reorientation: base Euler angles |
//! | 22–24 | – | 0.02 × the hand's linear or angular velocity, world (trajectory only) |
//! | 25–30 | 22–27 | the hand's goal, position and Euler angles (reorientation: 22–24, the base's goal) |
//!
//! The factor 0.02 is the released environment's `dt` property, 1 ms × 20.
//!
//! Layout `arm`, the same for both agents of an arm, 49 numbers for `trajectory`, 40 for
//! `reorientation`, all vectors in the arm's frame (see `task::frame`):
//!
//! | trajectory | reorientation | numbers |
//! |---|---|---|
//! | 0–2 | 0–2 | base position relative to its home (m) |
//! | 3–6 | 3–6 | base quaternion, w x y z |
//! | 7–9 | 7–9 | base linear velocity (m/s) |
//! | 10–12 | 10–12 | base angular velocity, in the body (rad/s) |
//! | 13–18 | 13–18 | the arm's joint angles relative to home (rad) |
//! | 19–24 | 19–24 | the arm's joint rates (rad/s) |
//! | 25–30 | 25–27 | error, goal − actual: hand position (m) and Euler angles (rad); base Euler angles |
//! | 31–42 | 28–33 | the errors squashed at two widths, see [`Errors`] |
//! | 43–48 | 34–39 | the arm's last action: clipped, before scaling (rad/s) |

use proto::config::{Observation, TaskName};
use proto::layout::{AGENTS_PER_ARM, JOINTS_PER_AGENT};

use super::frame::ArmFrame;
use super::{Errors, Goals, Readings, Task};
use crate::robot::JOINTS_PER_ARM;
use crate::scalar::Real;

/// Factor on velocities in the released layout.
pub const RELEASE_VELOCITY_SCALE: f64 = 0.02;

/// Fills a slice from its start.
pub(super) struct Writer<'a, S> {
    out: &'a mut [S],
    at: usize,
}

impl<'a, S: Real> Writer<'a, S> {
    #[inline(always)]
    pub(super) fn new(out: &'a mut [S]) -> Self {
        Self { out, at: 0 }
    }

    #[inline(always)]
    pub(super) fn put(&mut self, values: &[S]) {
        self.out[self.at..self.at + values.len()].copy_from_slice(values);
        self.at += values.len();
    }

    /// Asserts that everything was filled.
    #[inline(always)]
    pub(super) fn finish(self) {
        assert_eq!(self.at, self.out.len(), "layout and size in proto differ");
    }

    /// Base as all arms see it, in the world: 13 numbers.
    #[inline(always)]
    pub(super) fn put_base(&mut self, task: &Task, readings: &Readings<S>) {
        self.put(&base_offset(task, readings));
        self.put(&readings.base_quaternion);
        self.put(&readings.base_linear);
        self.put(&readings.base_angular);
    }

    /// The same as one arm sees it.
    #[inline(always)]
    fn put_base_seen_from(&mut self, frame: &ArmFrame, task: &Task, readings: &Readings<S>) {
        self.put(&frame.vector(base_offset(task, readings)));
        self.put(&frame.quaternion(readings.base_quaternion));
        self.put(&frame.vector(readings.base_linear));
        self.put(&frame.vector(readings.base_angular));
    }

    /// Joints of `arm` in the layout `arm`: angles relative to home, rates.
    #[inline(always)]
    pub(super) fn put_joints(&mut self, task: &Task, readings: &Readings<S>, arm: usize) {
        let first = arm * JOINTS_PER_ARM;
        for (j, &home) in task.goals.home.arms[arm].q.iter().enumerate() {
            self.put(&[readings.q[first + j] - S::splat(home)]);
        }
        self.put(&readings.qd[first..first + JOINTS_PER_ARM]);
    }

    /// Last action of `arm`.
    #[inline(always)]
    pub(super) fn put_action(&mut self, readings: &Readings<S>, arm: usize) {
        self.put(&readings.last_action[arm * JOINTS_PER_ARM..(arm + 1) * JOINTS_PER_ARM]);
    }
}

/// Position of the base relative to its home, world (m).
#[inline(always)]
fn base_offset<S: Real>(task: &Task, readings: &Readings<S>) -> [S; 3] {
    let mut position = readings.base_position;
    for (x, &home) in position.iter_mut().zip(&task.goals.home.base_position) {
        *x -= S::splat(home);
    }
    position
}

/// Three numbers of a slice, from `at`.
#[inline(always)]
fn three<S: Copy>(values: &[S], at: usize) -> [S; 3] {
    [values[at], values[at + 1], values[at + 2]]
}

/// Writes what `agent` sees into `out` (length O).
#[inline(always)]
pub fn observe<S: Real>(
    task: &Task,
    readings: &Readings<S>,
    goals: &Goals<S>,
    errors: &Errors<S>,
    agent: usize,
    out: &mut [S],
) {
    let arm = agent / AGENTS_PER_ARM;
    let mut out = Writer::new(out);
    match task.observation {
        Observation::Arm => {
            let frame = &task.frames[arm];
            out.put_base_seen_from(frame, task, readings);
            out.put_joints(task, readings, arm);
            match task.name {
                TaskName::Trajectory => {
                    let (plain, squashed) = (&errors.hands[arm], &errors.squashed_hands[arm]);
                    out.put(&frame.vector(three(plain, 0)));
                    out.put(&frame.euler_difference(three(plain, 3)));
                    // On the paper's robot arm frames have the world's axes but for order and sign, so a
                    // squashed vector turns like a plain one.
                    for at in [0, 3] {
                        out.put(&frame.vector(three(squashed, at)));
                    }
                    for at in [6, 9] {
                        out.put(&frame.euler_difference(three(squashed, at)));
                    }
                }
                // Small differences of Euler angles turn like a vector.
                TaskName::Reorientation => {
                    out.put(&frame.vector(errors.base));
                    for at in [0, 3] {
                        out.put(&frame.vector(three(&errors.squashed_base, at)));
                    }
                }
            }
            out.put_action(readings, arm);
        }
        Observation::Paper | Observation::Release => {
            let first = agent * JOINTS_PER_AGENT;
            out.put(&readings.base_position);
            out.put(&readings.base_quaternion);
            out.put(&readings.q[first..first + JOINTS_PER_AGENT]);
            out.put(&readings.base_linear);
            out.put(&readings.base_angular);
            out.put(&readings.qd[first..first + JOINTS_PER_AGENT]);
            match task.name {
                TaskName::Trajectory => {
                    let hand = &readings.hands[arm];
                    let cares_for_position = agent.is_multiple_of(AGENTS_PER_ARM);
                    let (pose, velocity) = if cares_for_position {
                        (hand.position, hand.linear)
                    } else {
                        (hand.euler, hand.angular)
                    };
                    out.put(&pose);
                    if task.observation == Observation::Release {
                        for v in velocity {
                            out.put(&[v * S::splat(RELEASE_VELOCITY_SCALE)]);
                        }
                    }
                    out.put(&goals.hands[arm]);
                }
                TaskName::Reorientation => {
                    out.put(&readings.base_euler);
                    out.put(&goals.base);
                }
            }
        }
    }
    out.finish();
}
