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
//! Layout `arm`, the same for both agents of an arm, 48 numbers for `trajectory`, 39 for
//! `reorientation`, 57 for `mixed`, 54 for `capture`, all vectors in the arm's frame (see `task::frame`), which moves with the base:
//!
//! | trajectory | reorientation | numbers |
//! |---|---|---|
//! | 0–2 | 0–2 | base linear velocity (m/s) |
//! | 3–5 | 3–5 | base angular velocity (rad/s) |
//! | 6–11 | 6–11 | sines of the arm's joint angles relative to home |
//! | 12–17 | 12–17 | their cosines |
//! | 18–23 | 18–23 | the arm's joint rates (rad/s) |
//! | 24–29 | 24–26 | error, goal − actual: position (m) and rotation (rad) of the hand; rotation of the base |
//! | 30–41 | 27–32 | the errors squashed at two widths, see [`Errors`] |
//! | 42–47 | 33–38 | the arm's last action: clipped, before scaling (rad/s) |
//!
//! Where hands and base have goals, the errors of the hand come first, zeros for an arm that turns the base, and all arms see those of the
//! base. Where goals move, how fast follows the hand's errors: linear (m/s), angular (rad/s).
//!
//! With `task.posture.seen` 14 numbers of the arm's goal posture stand before the last action (see `posture`): whether it brings the hand to
//! its goal, whether it is free of stops, what is left to it (rad), plain and squashed.
//!
//! Joints have no stops, so a turn more or less is the same pose, and looks it. With
//! `task.joint_angles = "unwound"` the angles themselves (rad) stand in the place of sines and cosines,
//! and what follows moves up by six.
//!
//! Numbers of joints are those of arms of six. Where arms differ, what is told of joints has room for the longest arm (in the layouts `paper` and `release` for the
//! agent with most joints), and what a shorter one leaves of it is zero.
//!
//! Nothing in it tells where the base is or how it is turned: see [`Errors`].

use proto::config::{JointAngles, Observation};
use proto::layout::AGENTS_PER_ARM;

use super::frame::ArmFrame;
use super::{Aim, Errors, Goals, Readings, Task};
use crate::robot::MAX_JOINTS_PER_ARM;
use crate::scalar::{Kernel, Real};
use crate::spatial::{mat_t_vec, quaternion_to_rotation};

/// Factor on velocities in the released layout.
pub const RELEASE_VELOCITY_SCALE: f64 = 0.02;

/// Width of the squashed way to the goal posture (rad): tanh(e / width).
pub const POSTURE_WIDTH: f64 = 0.1;

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

    /// What belongs to the joints of an arm, or of an agent, and zeros up to `room`.
    #[inline(always)]
    fn put_of_joints(&mut self, values: &[S], room: usize) {
        self.put(values);
        for _ in values.len()..room {
            self.put(&[S::zero()]);
        }
    }

    /// Asserts that everything was filled.
    #[inline(always)]
    pub(super) fn finish(self) {
        assert_eq!(self.at, self.out.len(), "layout and size in proto differ");
    }

    /// Base as all arms see it: 13 numbers; position, attitude and linear velocity in the world's axes, angular velocity in its own.
    #[inline(always)]
    pub(super) fn put_base(&mut self, task: &Task, readings: &Readings<S>) {
        self.put(&base_offset(task, readings));
        self.put(&readings.base_quaternion);
        self.put(&readings.base_linear);
        self.put(&readings.base_angular);
    }

    /// How the base moves, as one arm sees it: 6 numbers.
    #[inline(always)]
    fn put_base_seen_from(&mut self, frame: &ArmFrame, readings: &Readings<S>) {
        let base = quaternion_to_rotation(&readings.base_quaternion);
        self.put(&frame.vector(mat_t_vec(&base, readings.base_linear)));
        self.put(&frame.vector(readings.base_angular));
    }

    /// Joints of `arm` in the layout `arm`: angles relative to home, or their sines and then their
    /// cosines; rates.
    #[inline(always)]
    pub(super) fn put_joints(&mut self, task: &Task, readings: &Readings<S>, arm: usize) {
        let (joints, room) = (task.joints.of_arm(arm), task.joints.longest_arm());
        let mut angles = [S::default(); MAX_JOINTS_PER_ARM];
        let angles = &mut angles[..joints.len()];
        let home = &task.goals.home.arms[arm].q;
        for ((angle, &home), &q) in angles.iter_mut().zip(home).zip(&readings.q[joints.clone()]) {
            *angle = q - S::splat(home);
        }
        match task.joint_angles {
            JointAngles::Unwound => self.put_of_joints(angles, room),
            JointAngles::SinCos => {
                let mut cosines = [S::default(); MAX_JOINTS_PER_ARM];
                let cosines = &mut cosines[..joints.len()];
                for (sine, cosine) in angles.iter_mut().zip(&mut *cosines) {
                    (*sine, *cosine) = sine.sin_cos();
                }
                self.put_of_joints(angles, room);
                self.put_of_joints(cosines, room);
            }
        }
        self.put_of_joints(&readings.qd[joints], room);
    }

    /// Errors of the hand of `arm`, plain and squashed, and how its goal moves; zeros where it has no goal.
    #[inline(always)]
    pub(super) fn put_hand(&mut self, task: &Task, errors: &Errors<S>, arm: usize) {
        if task.aims[arm] != Aim::Hand {
            self.put(&[S::zero(); 6 + 12]);
            if task.name.moves() {
                self.put(&[S::zero(); 6]);
            }
            return;
        }
        self.put(&errors.seen_hands[arm]);
        self.put(&errors.squashed_hands[arm]);
        if task.name.moves() {
            self.put(&errors.seen_motion[arm]);
        }
    }

    /// Likewise, as the arm sees them.
    #[inline(always)]
    fn put_hand_seen_from(
        &mut self,
        frame: &ArmFrame,
        task: &Task,
        errors: &Errors<S>,
        arm: usize,
    ) {
        if task.aims[arm] != Aim::Hand {
            return self.put_hand(task, errors, arm);
        }
        // On the paper's robot arm frames have the base's axes but for order and sign, so a
        // squashed vector turns like a plain one.
        for at in [0, 3] {
            self.put(&frame.vector(three(&errors.seen_hands[arm], at)));
        }
        for at in [0, 3, 6, 9] {
            self.put(&frame.vector(three(&errors.squashed_hands[arm], at)));
        }
        if task.name.moves() {
            for at in [0, 3] {
                self.put(&frame.vector(three(&errors.seen_motion[arm], at)));
            }
        }
    }

    /// What is left to the goal posture of `arm`, plain and squashed, where the task tells it.
    #[inline(always)]
    pub(super) fn put_posture(&mut self, task: &Task, errors: &Errors<S>, arm: usize) {
        if !task.posture.seen {
            return;
        }
        let postures = errors.postures.as_ref().expect("a task that tells them has them");
        let posture = &postures.arms[arm];
        self.put(&[posture.good, posture.free]);
        let room = task.joints.longest_arm();
        let mut squashed = [S::default(); MAX_JOINTS_PER_ARM];
        let squashed = &mut squashed[..posture.left().len()];
        for (squashed, &left) in squashed.iter_mut().zip(posture.left()) {
            *squashed = (left * S::splat(1.0 / POSTURE_WIDTH)).tanh();
        }
        self.put_of_joints(posture.left(), room);
        self.put_of_joints(squashed, room);
    }

    /// Last action of `arm`.
    #[inline(always)]
    pub(super) fn put_action(&mut self, task: &Task, readings: &Readings<S>, arm: usize) {
        let joints = task.joints.of_arm(arm);
        self.put_of_joints(&readings.last_action[joints], task.joints.longest_arm());
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
    S::compiled(Observe { task, readings, goals, errors, agent, out });
}

struct Observe<'a, S: Real> {
    task: &'a Task,
    readings: &'a Readings<S>,
    goals: &'a Goals<S>,
    errors: &'a Errors<S>,
    agent: usize,
    out: &'a mut [S],
}

impl<S: Real> Kernel<S> for Observe<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { task, readings, goals, errors, agent, out } = self;
        let arm = agent / AGENTS_PER_ARM;
        let mut out = Writer::new(out);
        match task.observation {
            Observation::Arm => {
                let frame = &task.frames[arm];
                out.put_base_seen_from(frame, readings);
                out.put_joints(task, readings, arm);
                if task.name.reaches() {
                    out.put_hand_seen_from(frame, task, errors, arm);
                    out.put_posture(task, errors, arm);
                }
                if task.name.turns() {
                    out.put(&frame.vector(errors.seen_base));
                    for at in [0, 3] {
                        out.put(&frame.vector(three(&errors.squashed_base, at)));
                    }
                }
                out.put_action(task, readings, arm);
            }
            Observation::Paper | Observation::Release => {
                let (joints, room) = (task.joints.of_agent(agent), task.joints.per_agent());
                out.put(&readings.base_position);
                out.put(&readings.base_quaternion);
                out.put_of_joints(&readings.q[joints.clone()], room);
                out.put(&readings.base_linear);
                out.put(&readings.base_angular);
                out.put_of_joints(&readings.qd[joints], room);
                // Hands or the base: with these layouts no task has both.
                match task.aims[arm] {
                    Aim::Hand => {
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
                    Aim::Base => {
                        out.put(&readings.base_euler);
                        out.put(&goals.base);
                    }
                }
            }
        }
        out.finish();
    }
}
