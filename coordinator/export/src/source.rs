//! What is exported: a policy in its world, which one it is, and how good.

use proto::config::{AlgorithmName, Inference};
use serde::Serialize;
use simulator::policy::Policy;
use simulator::rollout::World;
use simulator::task::Aim;

/// Which policy it is, and what it was trained with.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Origin {
    /// Where it comes from.
    pub checkpoint: String,
    /// Digest of the checkpoint.
    pub digest: String,
    /// BLAKE3 of its `policy.safetensors`, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_blake3: Option<String>,
    /// Iterations it was trained on.
    pub iterations: u64,
    /// Env-steps it was trained on.
    pub env_steps: u64,
    /// Seed of its training.
    pub seed: u64,
    /// Version of the program that exports.
    pub program: String,
}

/// An error over held-out episodes, as `octopus eval` has it: the mean over an episode's last 20 steps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOutError {
    /// What it is of: `position`, `orientation` or `base`.
    pub error: String,
    /// `m` or `rad`.
    pub unit: String,
    /// Mean over hands and episodes.
    pub mean: f64,
    /// What nine in ten do not exceed.
    pub p90: f64,
}

/// How good it is on goals it never saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// Episodes.
    pub episodes: usize,
    /// Control steps of each.
    pub steps: usize,
    /// Seed of their goals.
    pub seed: u64,
    /// Episodes in which any two bodies touched.
    pub episodes_with_contact: usize,
    /// The task's errors.
    pub errors: Vec<HeldOutError>,
}

/// What is exported.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// Robot, task, configuration.
    pub world: &'a World,
    /// The networks, packed, for the vectors.
    pub policy: &'a Policy,
    /// Their parameters, flat in the order of [`ActorLayout`](proto::layout::ActorLayout).
    pub parameters: &'a [f32],
    /// Which policy it is.
    pub origin: &'a Origin,
    /// How good it is.
    pub held_out: &'a HeldOut,
}

impl Source<'_> {
    /// Factor on squashed outputs.
    pub(crate) fn squash_limit(&self) -> f64 {
        let algorithm = &self.world.config.algorithm;
        if algorithm.name == AlgorithmName::Maddpg { algorithm.maddpg.action_limit } else { 1.0 }
    }

    /// Difference of commands (rad/s) that another order of sums may make.
    ///
    /// In single precision that is some thousand roundings of 6e-8 of numbers near one. Where activations are rounded to
    /// bfloat16, one that lies between two of them may go the other way and is off by 1/256 of itself: single units, whose
    /// weights are some hundredths. Ten times what was seen.
    pub(crate) fn onnx_tolerance(&self) -> f64 {
        if self.rounds() { 2e-3 } else { 2e-4 }
    }

    /// Whether a layer has bfloat16 weights: hidden ones after the first.
    pub(crate) fn rounds(&self) -> bool {
        let network = &self.world.config.network;
        network.inference == Inference::Bf16 && network.hidden.len() > 1
    }

    /// Joints of the longest arm: what arms tell of theirs has room for so many.
    pub(crate) fn longest_arm(&self) -> usize {
        self.world.robot.joints.longest_arm()
    }

    /// What belongs to joints, arm after arm, with room for those of the longest arm: `none` where a shorter one has no joint.
    pub(crate) fn by_arm<T: Copy>(&self, values: &[T], none: T) -> Vec<T> {
        let (joints, room) = (self.world.robot.joints, self.longest_arm());
        let of_arm = |arm| {
            let values = values[joints.of_arm(arm)].iter().copied();
            values.chain(std::iter::repeat(none)).take(room)
        };
        (0..joints.n_arms()).flat_map(of_arm).collect()
    }

    /// Names of all joints, arm after arm.
    pub(crate) fn joint_names(&self) -> Vec<String> {
        let robot = &self.world.robot;
        let of_arm = |arm: &simulator::robot::Arm| {
            let links = &robot.types[arm.arm_type].links;
            let arm = arm.name.clone();
            links.iter().map(move |link| format!("{arm} {}", link.name))
        };
        robot.arms.iter().flat_map(of_arm).collect()
    }

    /// The task's name.
    pub(crate) fn task(&self) -> &'static str {
        self.world.config.task.name.as_str()
    }

    /// Whether hands have goals.
    pub(crate) fn has_hand_goals(&self) -> bool {
        self.world.config.task.name.reaches()
    }

    /// Whether these move, so that agents see how fast.
    pub(crate) fn has_moving_goals(&self) -> bool {
        self.has_hand_goals() && self.world.config.task.name.moves()
    }

    /// Whether the base has a goal.
    pub(crate) fn has_base_goal(&self) -> bool {
        self.world.config.task.name.turns()
    }

    /// Of each arm whether its hand has a goal.
    pub(crate) fn reaches(&self) -> impl Iterator<Item = bool> + '_ {
        self.world.task.aims.iter().map(|aim| *aim == Aim::Hand)
    }

    /// Whether the policy acts beside goal postures.
    pub(crate) fn has_postures(&self) -> bool {
        self.world.config.task.posture.seen
    }

    /// What stands at the top of a header.
    pub(crate) fn comment(&self) -> String {
        let Origin { digest, env_steps, program, .. } = self.origin;
        format!(
            "/* Task {}, robot {}; policy {digest}, trained on {env_steps} env-steps; exported by SpaceOctopus {program}. */\n",
            self.task(),
            printable(&self.world.robot.name),
        )
    }
}

/// A name in a comment of C.
fn printable(name: &str) -> String {
    name.chars()
        .map(|c| if c.is_ascii_alphanumeric() || " -_.".contains(c) { c } else { '?' })
        .collect()
}
