//! What a trial led to, step by step.

use serde::{Deserialize, Serialize};

use super::group::Group;
use crate::collision::Touching;
use crate::model::ContactKind;
use crate::robot::Joints;
use crate::scalar::Real;

/// Control steps that the mean over an episode's tail takes.
pub const TAIL_STEPS: usize = 20;
/// Most control steps that evaluations record, those of all episodes together: 13 GB for the robot of the paper.
pub const MOST_RECORDED: usize = 50_000_000;

/// Where a robot stands: enough to draw it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Origin of the base frame in the world (m).
    pub base_position: [f32; 3],
    /// Attitude of the base: unit quaternion (w, x, y, z), base to world.
    pub base_quaternion: [f32; 4],
    /// Joint angles (rad), arm-major.
    pub joints: Vec<f32>,
}

/// Errors, base rates, contacts and poses after every control step of every episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    joints: Joints,
    episodes: usize,
    steps: usize,
    /// `[episode][step][6 errors a hand, 3 errors of the base, 3 rates of the base, contacts by kind, 3 + 4 of the base's pose, all joint
    /// angles]`.
    series: Vec<f32>,
}

/// Numbers of a step besides the arms'.
const REST: usize = POSE + 7;
/// Where the pose of the base stands, behind the hands.
const POSE: usize = 6 + ContactKind::COUNT;

/// Numbers of a step.
fn width(joints: &Joints) -> usize {
    6 * joints.n_arms() + joints.n_joints() + REST
}

impl Recording {
    /// Zeros.
    pub(crate) fn new(joints: Joints, episodes: usize, steps: usize) -> Self {
        Self { joints, episodes, steps, series: vec![0.0; episodes * steps * width(&joints)] }
    }

    /// Everything, flat.
    pub(crate) fn series_mut(&mut self) -> &mut [f32] {
        &mut self.series
    }

    /// Parts of `episodes` episodes.
    pub(super) fn chunks_mut(&mut self, episodes: usize) -> impl Iterator<Item = &mut [f32]> {
        let len = episodes * self.steps * width(&self.joints);
        self.series.chunks_mut(len.max(1))
    }

    /// Arms of the robot.
    pub fn n_arms(&self) -> usize {
        self.joints.n_arms()
    }

    /// Which joints are whose.
    pub fn joints(&self) -> &Joints {
        &self.joints
    }

    /// E: episodes.
    pub fn episodes(&self) -> usize {
        self.episodes
    }

    /// Control steps of an episode.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// All numbers after `step`.
    pub(super) fn row(&self, episode: usize, step: usize) -> &[f32] {
        assert!(episode < self.episodes && step < self.steps, "episode {episode}, step {step}");
        let width = width(&self.joints);
        let at = (episode * self.steps + step) * width;
        &self.series[at..at + width]
    }

    /// Position (m, world) and Euler-angle (rad) errors of a hand after `step`, goal − actual.
    pub fn hand(&self, episode: usize, step: usize, arm: usize) -> [f32; 6] {
        let row = self.row(episode, step);
        std::array::from_fn(|i| row[6 * arm + i])
    }

    /// Attitude errors of the base after `step` (rad), goal − actual.
    pub fn base(&self, episode: usize, step: usize) -> [f32; 3] {
        let row = self.row(episode, step);
        std::array::from_fn(|i| row[6 * self.joints.n_arms() + i])
    }

    /// Angular velocity of the base after `step`, base axes (rad/s).
    pub fn base_rate(&self, episode: usize, step: usize) -> [f32; 3] {
        let row = self.row(episode, step);
        std::array::from_fn(|i| row[6 * self.joints.n_arms() + 3 + i])
    }

    /// Touching pairs after `step`, by [`ContactKind`].
    pub fn contacts(&self, episode: usize, step: usize) -> [u32; ContactKind::COUNT] {
        let row = self.row(episode, step);
        std::array::from_fn(|i| row[6 * self.joints.n_arms() + 6 + i] as u32)
    }

    /// Where the robot stands after `step`.
    pub fn pose(&self, episode: usize, step: usize) -> Pose {
        let rest = &self.row(episode, step)[6 * self.joints.n_arms() + POSE..];
        Pose {
            base_position: std::array::from_fn(|i| rest[i]),
            base_quaternion: std::array::from_fn(|i| rest[3 + i]),
            joints: rest[7..].to_vec(),
        }
    }

    /// ‖position error‖ of a hand after `step` (m).
    pub fn position(&self, episode: usize, step: usize, arm: usize) -> f32 {
        let [x, y, z, ..] = self.hand(episode, step, arm);
        norm([x, y, z])
    }

    /// ‖Euler-angle difference‖ of a hand after `step` (rad).
    pub fn orientation(&self, episode: usize, step: usize, arm: usize) -> f32 {
        let [.., a, b, c] = self.hand(episode, step, arm);
        norm([a, b, c])
    }

    /// ‖Euler-angle difference‖ of the base after `step` (rad).
    pub fn attitude(&self, episode: usize, step: usize) -> f32 {
        norm(self.base(episode, step))
    }
}

/// Euclidean norm, with the roundings of the rewards'.
pub(crate) fn norm([x, y, z]: [f32; 3]) -> f32 {
    x.mul_add(x, y.mul_add(y, z * z)).sqrt()
}

/// Writes what `step` led to in the lanes of a group that was read; `group` is its first episode in `series`, which holds `n_envs`.
#[inline(always)]
pub(super) fn record<S: Real>(
    series: &mut [f32],
    (group, n_envs): (usize, usize),
    (step, steps): (usize, usize),
    read: &Group<S>,
) {
    let Group { state, errors, touching, .. } = read;
    let Some(Touching { by_kind: contacts, .. }) = touching else { return };
    let n_arms = errors.hands.len();
    let width = 6 * n_arms + state.q.len() + REST;
    for lane in 0..S::LANES.min(n_envs - group) {
        let at = ((group + lane) * steps + step) * width;
        let (hands, rest) = series[at..at + width].split_at_mut(6 * n_arms);
        for arm in 0..n_arms {
            for i in 0..6 {
                hands[6 * arm + i] = errors.hands[arm][i].lane(lane) as f32;
            }
        }
        for i in 0..3 {
            rest[i] = errors.base[i].lane(lane) as f32;
            rest[3 + i] = state.base_angular_velocity[i].lane(lane) as f32;
            rest[POSE + i] = state.base_position[i].lane(lane) as f32;
        }
        for i in 0..4 {
            rest[POSE + 3 + i] = state.base_quaternion[i].lane(lane) as f32;
        }
        for (to, joint) in rest[POSE + 7..].iter_mut().zip(&state.q) {
            *to = joint.lane(lane) as f32;
        }
        for i in 0..ContactKind::COUNT {
            rest[6 + i] = contacts[i].lane(lane) as f32;
        }
    }
}
