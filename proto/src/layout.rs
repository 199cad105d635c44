//! Sizes and memory layouts that worker and learner share.
//!
//! Two kinds of memory cross a process border, both as flat `f32`:
//!
//! * a **block**, one shard's rollout of one iteration ([`BlockLayout`], described by a
//!   [`BlockHeader`]);
//! * the **actor parameters** of one policy version ([`ActorLayout`], described by a
//!   [`PolicyHeader`]).
//!
//! Agents belong to the robot, two an arm, and blocks are written by agent. Who chooses their actions is
//! an **actor**: one an agent, or one for all of them (centralised PPO), which then sees their
//! observations one after the other. So a block has the same layout whatever the algorithm.
//!
//! Letters: `A` agents, `P` actors, `T` steps, `N` environments of a shard, `O` observation, `S` critic
//! state, `U` actions of an agent (3 where arms have six joints), `K` episode metrics. All arrays are row-major.

pub use crate::agents::{AGENTS_PER_ARM, Joints};
use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use crate::config::{AlgorithmName, Config, CriticState, InputNorm, Observation};

/// The sizes of a run's arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dimensions {
    /// Which joints are whose.
    pub joints: Joints,
    /// Arms of the robot.
    pub n_arms: usize,
    /// A: agents, two an arm.
    pub n_agents: usize,
    /// P: actors, and as many critics: one an agent, or one for all agents.
    pub n_actors: usize,
    /// T: control steps of an episode.
    pub n_steps: usize,
    /// N: environments of a shard.
    pub n_envs: usize,
    /// Shards of an iteration.
    pub n_shards: usize,
    /// U: actions of an agent, as many as the joints of the agent that moves most.
    pub n_actions: usize,
    /// O: numbers that an agent sees.
    pub observation: usize,
    /// S: numbers of the critic state that a block holds; 0 if critics see what actors see.
    pub state: usize,
    /// Actions that a critic sees beside: those of all agents, or none.
    pub critic_actions: usize,
    /// K: metrics of an episode.
    pub n_metrics: usize,
}

impl Dimensions {
    /// The sizes that follow from a configuration and the robot's joints.
    pub fn new(config: &Config, of_robot: Joints) -> Self {
        let (n_arms, n_agents) = (of_robot.n_arms(), of_robot.n_agents());
        let n_actions = of_robot.per_agent();
        // What is told of an arm's joints has room for those of the longest arm.
        let longest = of_robot.longest_arm();
        // The angles of an arm and as many rates.
        let joints = longest * config.task.joint_angles.numbers() + longest;
        // Whether the goal posture brings the hand to its goal and whether it is free of stops, what is left to it, plain and squashed.
        let posture = if config.task.posture.seen { 2 + 2 * longest } else { 0 };
        let task = config.task.name;
        // Errors of a hand, 6 plain and 12 squashed, and how its goal moves; those of the base, 3 plain and 6 squashed.
        let moves = if task.moves() { 6 } else { 0 };
        let hand = if task.reaches() { 6 + 12 + moves + posture } else { 0 };
        let base = if task.turns() { 3 + 6 } else { 0 };
        let observation = match (config.task.observation, task.reaches()) {
            // The base 13, the agent's own q and q̇, a pose 3 (and its velocity 3), a goal 6 or 3.
            (Observation::Paper, true) => 13 + 2 * n_actions + 9,
            (Observation::Release, true) => 13 + 2 * n_actions + 12,
            (Observation::Paper | Observation::Release, false) => 13 + 2 * n_actions + 6,
            // Base's velocity 6, own arm's q and q̇, errors, last action.
            (Observation::Arm, _) => 6 + joints + hand + base + longest,
        };
        let state = match config.network.critic_state {
            CriticState::Own => 0,
            CriticState::Concatenated => n_agents * observation,
            // Base 13 and its errors; each arm's q and q̇, its hand's errors and last action.
            CriticState::Compact => 13 + base + n_arms * (joints + hand + longest),
        };
        Self {
            joints: of_robot,
            n_arms,
            n_agents,
            n_actions,
            n_actors: match config.algorithm.name {
                AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Maddpg => n_agents,
                AlgorithmName::Ppo => 1,
            },
            n_steps: config.task.episode_steps,
            n_envs: config.envs_per_shard(),
            n_shards: config.env.n_shards,
            observation,
            state,
            critic_actions: match config.algorithm.name {
                AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Ppo => 0,
                AlgorithmName::Maddpg => n_agents * n_actions,
            },
            n_metrics: EpisodeMetrics::count(n_arms),
        }
    }

    /// Agents that one actor moves; actor p moves those from p times this on.
    pub fn agents_per_actor(&self) -> usize {
        self.n_agents / self.n_actors
    }

    /// Numbers that an actor's first layer takes: the observations of its agents.
    pub fn actor_input(&self) -> usize {
        self.agents_per_actor() * self.observation
    }

    /// Actions that an actor chooses: those of its agents.
    pub fn actor_output(&self) -> usize {
        self.agents_per_actor() * self.n_actions
    }

    /// `[P, actor_output]`: one where an action moves a joint, zero where the agent has no joint for it; nothing where all do.
    pub fn actions_with_joint(&self) -> Option<Vec<f32>> {
        let of_agent = |agent: usize| {
            let own = self.joints.of_agent(agent).len();
            (0..self.n_actions).map(move |action| f32::from(u8::from(action < own)))
        };
        (!self.joints.are_even()).then(|| (0..self.n_agents).flat_map(of_agent).collect())
    }

    /// Numbers that a critic's first layer takes: the critic state, or what its actor sees; then actions.
    pub fn critic_input(&self) -> usize {
        let seen = if self.state == 0 { self.actor_input() } else { self.state };
        seen + self.critic_actions
    }
}

/// What MADDPG's replay takes in memory and in a checkpoint (bytes); 0 for other algorithms.
///
/// It holds whole episodes: T + 1 observations, and critic states unless these are the observations
/// one after the other; T times all actions, rewards, and whether the step has a future.
pub fn replay_bytes(config: &Config, dimensions: &Dimensions) -> u64 {
    if config.algorithm.name != AlgorithmName::Maddpg {
        return 0;
    }
    let Dimensions { n_agents: a, n_steps: t, n_actions: u, observation: o, state, .. } =
        *dimensions;
    let s = if config.network.critic_state == CriticState::Concatenated { 0 } else { state };
    let episode = (t + 1) * (a * o + s) + t * (a * (u + 1) + 1);
    (4 * episode * (config.algorithm.maddpg.replay_steps / t)) as u64
}

/// Where the metrics of an episode stand in its row of K numbers.
///
/// Errors are norms, in m and rad (of the Euler-angle difference), after a control step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpisodeMetrics {
    /// Position error of each hand after the last step.
    pub final_position: Range<usize>,
    /// Orientation error of each hand after the last step.
    pub final_orientation: Range<usize>,
    /// Smallest position error of each hand over the episode.
    pub min_position: Range<usize>,
    /// Smallest orientation error of each hand over the episode.
    pub min_orientation: Range<usize>,
    /// Attitude error of the base after the last step.
    pub final_base: usize,
    /// Smallest attitude error of the base over the episode.
    pub min_base: usize,
    /// Control steps at whose end any two bodies touched.
    pub contact_steps: usize,
    /// Touching pairs, summed over the steps.
    pub contact_pairs: usize,
}

impl EpisodeMetrics {
    /// The layout for a robot with `n_arms` arms. For the task that does not have an error (hands
    /// in `reorientation`, base in `trajectory`) its entries hold the distance from home.
    pub fn new(n_arms: usize) -> Self {
        let group = |i: usize| i * n_arms..(i + 1) * n_arms;
        let after = 4 * n_arms;
        Self {
            final_position: group(0),
            final_orientation: group(1),
            min_position: group(2),
            min_orientation: group(3),
            final_base: after,
            min_base: after + 1,
            contact_steps: after + 2,
            contact_pairs: after + 3,
        }
    }

    /// K for `n_arms` arms.
    pub fn count(n_arms: usize) -> usize {
        4 * n_arms + 4
    }
}

/// Where the arrays of a block stand, in `f32` elements from its start.
///
/// Each array starts on a 64-byte boundary, so a vector load never straddles two cache lines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockLayout {
    /// `[A, T + 1, N, O]`: what each agent saw before each step, and after the last.
    pub observation: Range<usize>,
    /// `[T + 1, N, S]`: what critics see.
    pub state: Range<usize>,
    /// `[A, T, N, U]`: actions with exploration, before clipping and scaling.
    pub action: Range<usize>,
    /// `[A, T, N]`: logarithm of the probability density of the action, summed over U; 0 where actors
    /// are deterministic.
    pub log_prob: Range<usize>,
    /// `[A, T, N]`: reward of the step.
    pub reward: Range<usize>,
    /// `[T, N]`: 1 where the step ended the episode for good (no value afterwards).
    pub terminated: Range<usize>,
    /// `[T, N]`: 1 where a time limit cut the episode (the state afterwards has a value).
    pub truncated: Range<usize>,
    /// `[N, K]`: see [`EpisodeMetrics`].
    pub metrics: Range<usize>,
    /// Length of the whole block.
    pub len: usize,
}

impl BlockLayout {
    /// The layout for `dimensions`.
    pub fn new(dimensions: &Dimensions) -> Self {
        let Dimensions { n_agents: a, n_steps: t, n_envs: n, observation: o, state: s, .. } =
            *dimensions;
        let mut end = 0;
        let mut array = |len: usize| {
            let start = end;
            end = (start + len).next_multiple_of(16);
            start..start + len
        };
        let observation = array(a * (t + 1) * n * o);
        let state = array((t + 1) * n * s);
        let action = array(a * t * n * dimensions.n_actions);
        let log_prob = array(a * t * n);
        let reward = array(a * t * n);
        let terminated = array(t * n);
        let truncated = array(t * n);
        let metrics = array(n * dimensions.n_metrics);
        Self {
            observation,
            state,
            action,
            log_prob,
            reward,
            terminated,
            truncated,
            metrics,
            len: end,
        }
    }
}

/// Name, shape and place of one stacked parameter tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TensorSpec {
    /// Name, as checkpoints write it: `hidden.0.weight`.
    pub name: String,
    /// Shape; the first dimension is P.
    pub shape: Vec<usize>,
    /// First element.
    pub offset: usize,
}

impl TensorSpec {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether the tensor has no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The elements' place in the flat parameters.
    pub fn range(&self) -> Range<usize> {
        self.offset..self.offset + self.len()
    }
}

/// Where the tensors of all actors stand in the flat parameters of a policy version.
///
/// One row an actor: a network that all agents share is published once for each agent, with the
/// agent's own first-layer bias. Weights are `[P, in, out]`, so a batch of row vectors multiplies from
/// the left; the input is [`Dimensions::actor_input`] wide, the output [`Dimensions::actor_output`]. In order: the input's normalisation (`input.mean` and `input.inverse_std`, or
/// `input.gain` and `input.bias`), each hidden layer (`hidden.i.weight`, `.bias`, and with
/// LayerNorm `.gain`, `.shift`), `head.weight`, `head.bias`, and for stochastic actors `log_std` (already floored).
///
/// LayerNorm has ε = 1e-5. A running normalisation is clip((x − mean)·inverse_std, ±input_clip).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActorLayout {
    /// The tensors in order.
    pub tensors: Vec<TensorSpec>,
    /// Length of the whole, in elements.
    pub len: usize,
}

impl ActorLayout {
    /// The layout for a configuration.
    pub fn new(config: &Config, dimensions: &Dimensions) -> Self {
        let network = &config.network;
        let p = dimensions.n_actors;
        let mut tensors = Vec::new();
        let mut len = 0;
        let mut tensor = |name: String, shape: Vec<usize>| {
            let spec = TensorSpec { name, shape, offset: len };
            len = spec.range().end.next_multiple_of(16);
            tensors.push(spec);
        };
        let mut width = dimensions.actor_input();
        let input_names = match network.input_norm {
            InputNorm::None => None,
            InputNorm::LayerNorm => Some(["input.gain", "input.bias"]),
            InputNorm::Running => Some(["input.mean", "input.inverse_std"]),
        };
        for name in input_names.into_iter().flatten() {
            tensor(name.to_owned(), vec![p, width]);
        }
        for (layer, &hidden) in network.hidden.iter().enumerate() {
            tensor(format!("hidden.{layer}.weight"), vec![p, width, hidden]);
            tensor(format!("hidden.{layer}.bias"), vec![p, hidden]);
            if network.layer_norm {
                tensor(format!("hidden.{layer}.gain"), vec![p, hidden]);
                tensor(format!("hidden.{layer}.shift"), vec![p, hidden]);
            }
            width = hidden;
        }
        let actions = dimensions.actor_output();
        tensor("head.weight".to_owned(), vec![p, width, actions]);
        tensor("head.bias".to_owned(), vec![p, actions]);
        if config.algorithm.name.is_stochastic() {
            tensor("log_std".to_owned(), vec![p, actions]);
        }
        Self { tensors, len }
    }

    /// The tensor called `name`, if the configuration has it.
    pub fn get(&self, name: &str) -> Option<&TensorSpec> {
        self.tensors.iter().find(|tensor| tensor.name == name)
    }
}

/// Describes a block; travels as the user header of its sample.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BlockHeader {
    /// The iteration that the block belongs to.
    pub iteration: u64,
    /// The policy version that chose its actions.
    pub policy_version: u64,
    /// The shard.
    pub shard: u32,
    /// Who rolled it out.
    pub worker: u32,
    /// How often that worker had been started before.
    pub incarnation: u32,
    /// N, as a check against a worker of another configuration.
    pub n_envs: u32,
    /// T, likewise.
    pub n_steps: u32,
    /// Keeps the following 64-bit field aligned without padding.
    pub reserved: u32,
    /// Time that the rollout took (ns).
    pub rollout_ns: u64,
}

/// Describes the parameters of a policy version; travels as the user header of its sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PolicyHeader {
    /// The version: 0 is the initial policy, k the one after iteration k − 1 was trained on.
    pub version: u64,
}

/// Describes a piece of a snapshot; travels as the user header of its sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SnapshotHeader {
    /// Iterations trained on when the snapshot was taken.
    pub iteration: u64,
    /// Where the piece belongs in the snapshot (bytes).
    pub offset: u64,
    /// Length of the whole snapshot (bytes).
    pub total: u64,
    /// [`Digest`](crate::Digest) of the training state.
    pub digest: [u8; 16],
}

/// Hash of the text that every layout and message is written in, part of each channel's name:
/// programs of different layouts do not find each other's channels, instead of reading garbage.
pub fn layout_hash() -> String {
    let text = concat!(
        include_str!("layout.rs"),
        include_str!("agents.rs"),
        include_str!("message.rs"),
        include_str!("digest.rs"),
        include_str!("../channels/src/line.rs"),
        env!("CARGO_PKG_VERSION"),
    );
    blake3::hash(text.as_bytes()).to_hex()[..8].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Layers, Preset, TaskName};

    fn dimensions(preset: Preset, task: TaskName) -> Dimensions {
        Dimensions::new(
            &Layers::new(preset, Some(task)).resolve().expect("valid"),
            Joints::of_sixes(4),
        )
    }

    #[test]
    fn observation_and_state_sizes_are_the_papers_and_the_releases() {
        let size = |preset, task| {
            let d = dimensions(preset, task);
            (d.observation, d.state)
        };
        assert_eq!(size(Preset::Paper, TaskName::Trajectory), (28, 224));
        assert_eq!(size(Preset::Paper, TaskName::Reorientation), (25, 200));
        assert_eq!(size(Preset::Release, TaskName::Trajectory), (31, 248));
        assert_eq!(size(Preset::Release, TaskName::Reorientation), (25, 200));
    }

    #[test]
    fn a_centralised_actor_sees_and_moves_what_all_agents_do_and_blocks_stay_the_same() {
        let of = |algorithm: &str| {
            let layers = Layers::new(Preset::Paper, Some(TaskName::Trajectory));
            let config = layers.set(algorithm).and_then(|layers| layers.resolve()).expect("valid");
            (Dimensions::new(&config, Joints::of_sixes(4)), config)
        };
        let (independent, _) = of("algorithm.name=ippo");
        let (central, config) = of("algorithm.name=ppo");
        assert_eq!((independent.n_actors, central.n_actors), (8, 1));
        assert_eq!((central.actor_input(), central.actor_output()), (8 * 28, 24));
        assert_eq!((independent.actor_input(), independent.actor_output()), (28, 3));
        assert_eq!((independent.critic_input(), central.critic_input()), (28, 8 * 28));
        assert_eq!(BlockLayout::new(&central), BlockLayout::new(&independent));
        let layout = ActorLayout::new(&config, &central);
        let shape = |name| layout.get(name).expect("exists").shape.clone();
        assert_eq!(shape("hidden.0.weight"), [1, 224, 512]);
        assert_eq!(shape("head.weight"), [1, 512, 24]);
        assert_eq!(shape("log_std"), [1, 24]);
    }

    #[test]
    fn arrays_of_a_block_are_aligned_and_do_not_overlap() {
        let layout = BlockLayout::new(&dimensions(Preset::Tuned, TaskName::Trajectory));
        let arrays = [
            &layout.observation,
            &layout.state,
            &layout.action,
            &layout.log_prob,
            &layout.reward,
            &layout.terminated,
            &layout.truncated,
            &layout.metrics,
        ];
        let mut end = 0;
        for array in arrays {
            assert!(array.start >= end && array.start % 16 == 0, "{array:?} after {end}");
            assert!(!array.is_empty());
            end = array.end;
        }
        assert!(layout.len >= end && layout.len < end + 16);
    }

    #[test]
    fn actor_of_the_released_preset_has_the_known_number_of_parameters() {
        let config =
            Layers::new(Preset::Release, Some(TaskName::Trajectory)).resolve().expect("valid");
        let layout = ActorLayout::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)));
        let per_agent: usize = layout.tensors.iter().map(|t| t.len() / 8).sum();
        // LN(31), three blocks of Linear and LN, head and log σ: about 0.54 M.
        let blocks = (31 * 512 + 512 + 1024) + 2 * (512 * 512 + 512 + 1024);
        assert_eq!(per_agent, 62 + blocks + 512 * 3 + 3 + 3);
        assert!(layout.get("hidden.2.gain").is_some() && layout.get("input.mean").is_none());
    }
}
