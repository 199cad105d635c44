//! The groups of a configuration, one struct each, and the rules that values must meet.

use serde::{Deserialize, Serialize};

use crate::ConfigError;

/// Everything that determines a run. Two runs with equal configurations on the same build and
/// processor type end with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What is to be learned.
    pub task: Task,
    /// Who learns it.
    pub robot: RobotSection,
    /// How it is simulated.
    pub env: Env,
    /// The networks.
    pub network: Network,
    /// The learning algorithm.
    pub algorithm: Algorithm,
    /// Adam and its schedule.
    pub optimizer: Optimizer,
    /// Seeds, budgets, processes.
    pub run: Run,
}

/// The two tasks of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaskName {
    /// Every hand to a target pose.
    Trajectory,
    /// The base to a target attitude.
    Reorientation,
}

impl TaskName {
    /// The name as it is written in configurations and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Trajectory => "trajectory",
            Self::Reorientation => "reorientation",
        }
    }
}

/// Which numbers an agent sees; the layouts stand in `sim-worker`'s `task::observation`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Observation {
    /// The paper's text: 28 numbers (25 for reorientation).
    Paper,
    /// The released code: 31 numbers (25 for reorientation).
    Release,
    /// The whole arm, pose errors at three scales, the last action; vectors in the arm's frame, which moves
    /// with the base, so that all arms see alike wherever it is.
    Arm,
}

/// How agents see a joint angle. Joints have no stops: angles that differ by 2π are one pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointAngles {
    /// The angle relative to home (rad), with all turns that the joint has made.
    #[default]
    Unwound,
    /// Its sine and cosine: the same in every turn.
    SinCos,
}

impl JointAngles {
    /// Numbers that say one angle.
    pub fn numbers(self) -> usize {
        match self {
            Self::Unwound => 1,
            Self::SinCos => 2,
        }
    }
}

/// The box that trajectory goals are drawn from, as offsets to the hand's home position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GoalBox {
    /// A cube of 0.3 m, as the paper says.
    Paper,
    /// The released code: 0.25 m.
    Release,
    /// The authors' working repository: 0.20 m.
    Narrow,
}

/// Weights of one agent kind's reward,
/// r = −(`quadratic`·e² + `log`·log₁₀(e² + ε) + `smoothness`·‖u − u⁻‖² + `effort`·‖u‖² + `collision`·co),
/// with e = `scale` × the norm of the task error and u the clipped action before scaling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardWeights {
    /// Factor on the error norm before it enters the reward.
    pub scale: f64,
    /// Weight of the squared error.
    pub quadratic: f64,
    /// Weight of the logarithm of the squared error.
    pub log: f64,
    /// Weight of the squared change of the action.
    pub smoothness: f64,
    /// Weight of the squared action.
    pub effort: f64,
    /// Weight of the collision term.
    pub collision: f64,
}

/// The reward of a task.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// ε inside the logarithm.
    pub epsilon: f64,
    /// Whether the collision term counts touching pairs (`true`) or only says whether any touch.
    pub count_collisions: bool,
    /// Whether an agent answers for contacts of its own arm alone, instead of the whole robot's (trajectory).
    #[serde(default)]
    pub own_collisions: bool,
    /// Share of the mean of its arm's two rewards in an agent's (trajectory); the rest is its own reward.
    #[serde(default)]
    pub team_spirit: f64,
    /// Agents of shoulder joints, who care for the hand's position (trajectory).
    pub position: RewardWeights,
    /// Agents of wrist joints, who care for the hand's orientation (trajectory).
    pub orientation: RewardWeights,
    /// The one reward that all agents share (reorientation).
    pub base: RewardWeights,
}

/// Table `task.start`: where training episodes begin. Evaluations and experiments begin at home.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Share of the episodes that begin at rest away from home.
    pub share: f64,
    /// There, joint angles are off home by up to this (rad), small offsets being more frequent.
    pub joints: f64,
    /// There, the base is turned by up to this about each axis (rad), likewise.
    pub attitude: f64,
    /// There, share of the arms that stand anywhere: every joint angle uniform in ±π of home.
    #[serde(default)]
    pub anywhere: f64,
}

/// Group `task`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Which task.
    pub name: TaskName,
    /// What the agents see.
    pub observation: Observation,
    /// How they see joint angles (layout `arm`), and critics (`compact`).
    #[serde(default)]
    pub joint_angles: JointAngles,
    /// Control steps of an episode; its end is a truncation, never a termination.
    pub episode_steps: usize,
    /// Factor from a clipped action to a joint velocity command in rad/s.
    pub action_scale: f64,
    /// Where hand goals are drawn from.
    pub goal_box: GoalBox,
    /// Base goals are Euler angles uniform in ± this, per axis (rad).
    pub base_goal_range: f64,
    /// Where training episodes begin; at home if nothing is said.
    #[serde(default)]
    pub start: Start,
    /// The reward.
    pub reward: Reward,
}

/// Group `robot`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSection {
    /// `paper`, `release`, or the path of a robot file.
    pub description: String,
}

/// How the equations of motion are integrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// Classical Runge and Kutta, fourth order.
    Rk4,
    /// Runge–Kutta of third order: fewer evaluations for contacts as stiff.
    Rk3,
    /// Semi-implicit Euler, the scheme of the authors' simulator.
    Euler,
}

/// Group `env`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// Environments of the whole run; every one plays one episode an iteration.
    pub n_envs: usize,
    /// Shards that the environments are split into; the unit of work and of accounting.
    pub n_shards: usize,
    /// Duration of a control step (s).
    pub control_period: f64,
    /// Duration of an integration step (s); divides the control period.
    pub substep: f64,
    /// Integration scheme.
    pub integrator: Integrator,
    /// Whether touching bodies push each other.
    pub contacts: bool,
}

/// The non-linearity of hidden layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// max(0, x).
    Relu,
    /// x for x > 0, eˣ − 1 otherwise.
    Elu,
    /// Hyperbolic tangent.
    Tanh,
}

/// What happens to observations before the first layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputNorm {
    /// Nothing.
    None,
    /// LayerNorm with learned gain and bias over the features of a sample.
    LayerNorm,
    /// Running mean and variance per feature, clipped at ± `input_clip`.
    Running,
}

/// Precision of the policies' products in workers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inference {
    /// Single precision.
    F32,
    /// Hidden layers after the first multiply bfloat16 and sum in single precision: the same bits on every processor.
    Bf16,
}

/// What critics see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CriticState {
    /// All agents' observations, one after the other.
    Concatenated,
    /// Every quantity of the environment once.
    Compact,
    /// What its actor sees: the agent's own observation (independent learners), or all of them
    /// (centralised PPO).
    Own,
}

/// Which agents are one network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ParameterSharing {
    /// Every agent has its own actor and critic.
    None,
    /// Agents of the same role, which move the same joints of different arms, are one actor; and one
    /// critic if critics see what actors see. A critic that sees the whole robot stays its agent's own:
    /// what it sees does not say whose arm is meant.
    Roles,
    /// All agents are one actor and one critic.
    All,
}

/// Group `network`. Actors and critics are multi-layer perceptrons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// Width of each hidden layer.
    pub hidden: Vec<usize>,
    /// Likewise, of critics; none if they have the actors' widths.
    #[serde(default)]
    pub critic_hidden: Vec<usize>,
    /// Non-linearity.
    pub activation: Activation,
    /// LayerNorm after each hidden activation.
    pub layer_norm: bool,
    /// Treatment of the input.
    pub input_norm: InputNorm,
    /// Limit of running-normalised inputs, in standard deviations.
    pub input_clip: f64,
    /// Precision of the policies' products in workers.
    pub inference: Inference,
    /// What critics see.
    pub critic_state: CriticState,
    /// Which agents are one network, told apart by a learned first-layer bias an agent.
    pub parameter_sharing: ParameterSharing,
    /// Squashes the mean action with tanh.
    pub squash_mean: bool,
    /// Initial logarithm of the action's standard deviation.
    pub initial_log_std: f64,
    /// Floor of the logarithm of the action's standard deviation.
    pub min_log_std: f64,
    /// Gain of the orthogonal initialisation of the action head.
    pub head_gain: f64,
}

impl Network {
    /// Width of each hidden layer of critics.
    pub fn hidden_of_critics(&self) -> &[usize] {
        if self.critic_hidden.is_empty() { &self.hidden } else { &self.critic_hidden }
    }
}

/// The learning algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlgorithmName {
    /// Multi-agent PPO with centralised critics (Yu et al. 2022).
    Mappo,
    /// Independent PPO: each critic sees its own agent's observation only.
    Ippo,
    /// Centralised PPO (Schulman et al. 2017): one actor and one critic, which see all agents'
    /// observations one after the other and are paid the sum of all rewards.
    Ppo,
    /// Multi-agent deep deterministic policy gradient (Lowe et al. 2017): deterministic actors, critics
    /// that see everything and all actions, and a replay.
    Maddpg,
}

impl AlgorithmName {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Mappo, Self::Ippo, Self::Ppo, Self::Maddpg];

    /// Whether actors give the parameters of a distribution that actions are drawn from.
    pub fn is_stochastic(self) -> bool {
        match self {
            Self::Mappo | Self::Ippo | Self::Ppo => true,
            Self::Maddpg => false,
        }
    }

    /// What kind of actor it trains: policies of one kind are exchangeable.
    pub fn actor(self) -> &'static str {
        match self {
            Self::Mappo | Self::Ippo => "stochastic, one an agent",
            Self::Ppo => "stochastic, one for all agents",
            Self::Maddpg => "deterministic, one an agent",
        }
    }

    /// The name as it is written in configurations and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mappo => "mappo",
            Self::Ippo => "ippo",
            Self::Ppo => "ppo",
            Self::Maddpg => "maddpg",
        }
    }
}

/// Group `algorithm`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Algorithm {
    /// Which algorithm.
    pub name: AlgorithmName,
    /// Discount γ per control step.
    pub gamma: f64,
    /// λ of generalised advantage estimation (Schulman et al. 2016).
    pub gae_lambda: f64,
    /// Clip range of the probability ratio.
    pub clip: f64,
    /// Where the advantage is negative, a ratio beyond this moves nothing either (dual clip); 0 turns that off.
    #[serde(default)]
    pub dual_clip: f64,
    /// Clip range of the value prediction around the old one; 0 turns value clipping off.
    pub value_clip: f64,
    /// Passes over the samples of an iteration.
    pub epochs: usize,
    /// Parts that each pass is split into, one optimiser step each.
    pub mini_batches: usize,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Weight of the value loss.
    pub value_coefficient: f64,
    /// δ of the Huber value loss; 0 means the plain squared error.
    pub huber_delta: f64,
    /// Normalises value targets by running moments (ValueNorm of Yu et al. 2022).
    pub value_norm: bool,
    /// Decay β of the moments of the value normaliser.
    pub value_norm_beta: f64,
    /// Standardises advantages, per agent, over the samples of an iteration.
    pub normalize_advantage: bool,
    /// Factor on the surrogate; the released code's broadcasting makes it 3.
    pub surrogate_multiplier: f64,
    /// Bootstraps with the value of the last observation where an episode was cut by time.
    pub bootstrap_truncated: bool,
    /// Limit of the gradient's global norm, actor and critic apart, per agent; 0 turns it off.
    pub max_grad_norm: f64,
    /// Ends an iteration's steps of an actor when its KL divergence passes this, the mean over its agents; the critic goes on. 0 turns it off.
    pub max_kl: f64,
    /// What only MADDPG uses. Of the keys above it uses `gamma`, `bootstrap_truncated` and
    /// `max_grad_norm`. Configurations from before MADDPG go on without.
    #[serde(default)]
    pub maddpg: Maddpg,
}

/// Group `algorithm.maddpg`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Maddpg {
    /// L: actions are L times the hyperbolic tangent of an actor's output, before the environment clips
    /// and scales them; critics see them in units of L.
    pub action_limit: f64,
    /// τ: how far targets move towards their networks after an update.
    pub soft_update: f64,
    /// Env-steps that the replay holds, rounded down to whole episodes. It is part of every checkpoint,
    /// with four bytes for each number that agents see, do and get in a step.
    pub replay_steps: usize,
    /// Samples of an update.
    pub batch_size: usize,
    /// Updates of all networks for an env-step.
    pub updates_per_step: f64,
    /// Env-steps before the first update.
    pub learning_starts: u64,
    /// Standard deviation of the normal exploration noise at first, in units of L.
    pub noise: f64,
    /// Likewise from `noise_steps` on; it falls linearly until then.
    pub noise_final: f64,
    /// Probability at first that an agent's action is uniform in ± L instead.
    pub random: f64,
    /// Likewise from `noise_steps` on; it falls linearly until then.
    pub random_final: f64,
    /// Env-steps over which both fall.
    pub noise_steps: u64,
}

/// The numbers of the released code.
impl Default for Maddpg {
    fn default() -> Self {
        Self {
            action_limit: 10.0,
            soft_update: 0.01,
            replay_steps: 500_000,
            batch_size: 256,
            updates_per_step: 1.0,
            learning_starts: 256,
            noise: 0.1,
            noise_final: 0.05,
            random: 0.05,
            random_final: 0.05,
            noise_steps: 100_000,
        }
    }
}

/// How actions of a deterministic actor depart from its output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exploration {
    /// Actions stay in ± this.
    pub limit: f64,
    /// Standard deviation of the normal noise, in the actions' own units.
    pub std: f64,
    /// Probability of a uniform action.
    pub random: f64,
}

impl Maddpg {
    /// Exploration after `env_steps`.
    pub fn exploration(&self, env_steps: u64) -> Exploration {
        let progress = (env_steps as f64 / self.noise_steps.max(1) as f64).min(1.0);
        let between = |first: f64, last: f64| first + (last - first) * progress;
        Exploration {
            limit: self.action_limit,
            std: self.action_limit * between(self.noise, self.noise_final),
            random: between(self.random, self.random_final),
        }
    }

    /// Updates that are to be made by the time that `env_steps` have been collected.
    pub fn updates_until(&self, env_steps: u64) -> u64 {
        let counted = env_steps.saturating_sub(self.learning_starts);
        (counted as f64 * self.updates_per_step).floor() as u64
    }
}

/// How the learning rate moves over the planned env-steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Stays.
    Constant,
    /// Falls linearly to zero at the last planned env-step.
    Linear,
}

/// Group `optimizer`: Adam (Kingma and Ba 2015).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optimizer {
    /// Initial learning rate of actors.
    pub actor_lr: f64,
    /// Initial learning rate of critics.
    pub critic_lr: f64,
    /// Its course.
    pub schedule: Schedule,
    /// KL divergence (nats) of an iteration that actors' learning rates aim at; 0 leaves them to the schedule. An
    /// actor that went twice as far learns 1.5 times slower from then on, one that went less than half as far 1.5
    /// times faster, though never faster than scheduled. MADDPG does not use it.
    #[serde(default)]
    pub target_kl: f64,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// ε of the denominator.
    pub epsilon: f64,
}

/// Arithmetic of the learner's matrix products.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// `bf16` where the processor multiplies it natively, `f32` elsewhere.
    Auto,
    /// Single precision throughout.
    F32,
    /// Products of bfloat16 with single-precision parameters, sums and moments.
    Bf16,
}

/// Group `run`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Seed of every random number of the run.
    pub seed: u64,
    /// Budget in env-steps (control steps × environments); schedules run over it.
    pub env_steps: u64,
    /// Wall-clock limit in seconds; only stops, never changes what is learned. 0 means none.
    pub time_limit_s: f64,
    /// Simulator processes at the start; a live run can be scaled.
    pub workers: usize,
    /// Fixes worker i to the i-th processor that the run may use.
    pub pin: bool,
    /// 1 lets workers roll out the next iteration while the learner trains on this one.
    pub overlap: usize,
    /// `cpu` or `cuda:N`, of the learner.
    pub device: String,
    /// Arithmetic of the learner's products.
    pub precision: Precision,
    /// Threads of libtorch; part of the configuration because they change sums.
    pub learner_threads: usize,
    /// Commits a checkpoint every so many iterations; 0 means only at the end.
    pub checkpoint_every: u64,
    /// Commits one when the newest is this old (s); 0 turns it off.
    pub checkpoint_every_s: f64,
    /// Newest checkpoints kept. The best, pinned and tagged ones and milestones are kept beside them.
    pub checkpoints_kept: usize,
    /// Keeps every checkpoint whose iteration is a multiple of this; 0 turns it off.
    pub keep_every: u64,
    /// Keeps one checkpoint in every such stretch of time, as a milestone (s); 0 turns it off.
    pub milestone_every_s: f64,
    /// Evaluates the policy on held-out goals every so many iterations, on the workers, and commits
    /// a checkpoint when it is the best so far; 0 turns it off.
    pub evaluate_every: u64,
    /// Episodes of such an evaluation.
    pub evaluation_episodes: u32,
    /// Control steps of its episodes.
    pub evaluation_steps: u32,
    /// A policy trained on fewer env-steps is never the best: early luck is no merit.
    pub best_after: u64,
    /// A process that is silent this long is replaced and its work is ordered again (s).
    pub order_deadline_s: f64,
}

impl Run {
    /// The keys of the group that change nothing that is learned: how many processes work and how
    /// they are watched, when the run stops, and what is measured and kept beside the training.
    ///
    /// Two runs that differ in nothing else end with the same bits, and a run may change them when
    /// it is resumed. All other keys matter, new ones too until they are listed here; `env_steps`
    /// does where the learning rate falls over it.
    pub const HARMLESS: [&str; 13] = [
        "best_after",
        "checkpoint_every",
        "checkpoint_every_s",
        "checkpoints_kept",
        "evaluate_every",
        "evaluation_episodes",
        "evaluation_steps",
        "keep_every",
        "milestone_every_s",
        "order_deadline_s",
        "pin",
        "time_limit_s",
        "workers",
    ];

    /// The keys that matter and may be changed all the same when a run is resumed: another budget
    /// and another device.
    pub const CHANGEABLE: [&str; 2] = ["env_steps", "device"];

    /// Whether a run that was made with `other` may go on with this.
    pub fn continues(&self, other: &Self) -> bool {
        let fixed = |run: &Self| {
            let mut keys = toml::Table::try_from(run).expect("a typed group has a TOML form");
            keys.retain(|key, _| {
                !Self::HARMLESS.contains(&key) && !Self::CHANGEABLE.contains(&key)
            });
            keys
        };
        fixed(self) == fixed(other)
    }

    /// The same without those [harmless](Self::HARMLESS) things that only cost time: checkpoints and
    /// evaluations on the way, and a time limit.
    #[must_use]
    pub fn without_housekeeping(self) -> Self {
        Self {
            time_limit_s: 0.0,
            checkpoint_every: 0,
            checkpoint_every_s: 0.0,
            evaluate_every: 0,
            keep_every: 0,
            milestone_every_s: 0.0,
            ..self
        }
    }

    /// Whether the learner sends a snapshot after `iterations` iterations without being asked.
    pub fn plans_snapshot(&self, iterations: u64) -> bool {
        self.plans_checkpoint(iterations) || self.plans_evaluation(iterations)
    }

    /// Whether the state after `iterations` iterations is committed whatever it is worth.
    pub fn plans_checkpoint(&self, iterations: u64) -> bool {
        self.checkpoint_every > 0 && iterations.is_multiple_of(self.checkpoint_every)
    }

    /// Whether the policy after `iterations` iterations is evaluated.
    pub fn plans_evaluation(&self, iterations: u64) -> bool {
        self.evaluate_every > 0 && iterations.is_multiple_of(self.evaluate_every)
    }

    /// The wall-clock limit, if there is one.
    pub fn time_limit(&self) -> Option<std::time::Duration> {
        (self.time_limit_s > 0.0).then(|| std::time::Duration::from_secs_f64(self.time_limit_s))
    }
}

impl Config {
    /// How workers explore in `iteration`, if actors are deterministic.
    pub fn exploration(&self, iteration: u64) -> Option<Exploration> {
        let steps = iteration.saturating_mul(self.steps_per_iteration());
        match self.algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Ppo => None,
            AlgorithmName::Maddpg => Some(self.algorithm.maddpg.exploration(steps)),
        }
    }

    /// Env-steps that one iteration collects.
    pub fn steps_per_iteration(&self) -> u64 {
        (self.env.n_envs * self.task.episode_steps) as u64
    }

    /// Iterations that the budget plans, rounded up.
    pub fn planned_iterations(&self) -> u64 {
        self.run.env_steps.div_ceil(self.steps_per_iteration())
    }

    /// Environments of one shard.
    pub fn envs_per_shard(&self) -> usize {
        self.env.n_envs / self.env.n_shards
    }

    /// Reads a resolved configuration, as `config.toml` of a run directory holds it.
    pub fn from_resolved_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text).map_err(|error| ConfigError::Syntax {
            origin: origin.to_owned(),
            message: error.to_string(),
        })?;
        config.validate()?;
        Ok(config)
    }

    /// The resolved configuration as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a typed configuration has a TOML form")
    }

    /// Checks ranges and what must fit together.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self { task, env, network, algorithm, optimizer, run, robot } = self;

        within("task.episode_steps", task.episode_steps as f64, 1.0, 10_000.0)?;
        within("task.action_scale", task.action_scale, 1e-6, 100.0)?;
        within("task.base_goal_range", task.base_goal_range, 0.0, 1.5)?;
        within("task.start.share", task.start.share, 0.0, 1.0)?;
        within("task.start.joints", task.start.joints, 0.0, 3.0)?;
        within("task.start.attitude", task.start.attitude, 0.0, 1.5)?;
        within("task.start.anywhere", task.start.anywhere, 0.0, 1.0)?;
        within("task.reward.epsilon", task.reward.epsilon, 1e-30, 1.0)?;
        within("task.reward.team_spirit", task.reward.team_spirit, 0.0, 1.0)?;
        let Reward { position, orientation, base, .. } = &task.reward;
        for (key, weights) in [
            ("task.reward.position", position),
            ("task.reward.orientation", orientation),
            ("task.reward.base", base),
        ] {
            let RewardWeights { scale, quadratic, log, smoothness, effort, collision } = *weights;
            for weight in [scale, quadratic, log, smoothness, effort, collision] {
                within(key, weight, 0.0, 1e6)?;
            }
        }

        if robot.description.is_empty() {
            return Err(ConfigError::Invalid {
                key: "robot.description",
                problem: "is empty".to_owned(),
                cure: "write `paper`, `release`, or the path of a robot file".to_owned(),
            });
        }

        within("env.n_envs", env.n_envs as f64, 1.0, 1e6)?;
        within("env.n_shards", env.n_shards as f64, 1.0, 4096.0)?;
        if env.n_shards > env.n_envs || env.n_envs % env.n_shards != 0 {
            return Err(ConfigError::Invalid {
                key: "env.n_shards",
                problem: format!(
                    "{} environments cannot be split into {} equal shards",
                    env.n_envs, env.n_shards
                ),
                cure: "choose a number of shards that divides env.n_envs".to_owned(),
            });
        }
        within("env.control_period", env.control_period, 1e-4, 10.0)?;
        within("env.substep", env.substep, 1e-5, env.control_period)?;
        let substeps = env.control_period / env.substep;
        if (substeps - substeps.round()).abs() > 1e-6 * substeps {
            return Err(ConfigError::Invalid {
                key: "env.substep",
                problem: format!(
                    "{} s does not divide the control period of {} s",
                    env.substep, env.control_period
                ),
                cure: "choose a whole fraction of the control period".to_owned(),
            });
        }

        within("network.hidden", network.hidden.len() as f64, 1.0, 16.0)?;
        within("network.critic_hidden", network.critic_hidden.len() as f64, 0.0, 16.0)?;
        let widths = network.hidden.iter().map(|width| ("network.hidden", width));
        let of_critics = network.critic_hidden.iter().map(|width| ("network.critic_hidden", width));
        for (key, &width) in widths.chain(of_critics) {
            within(key, width as f64, 1.0, 16_384.0)?;
        }
        within("network.input_clip", network.input_clip, 0.1, 1e6)?;
        within("network.initial_log_std", network.initial_log_std, -10.0, 5.0)?;
        within("network.min_log_std", network.min_log_std, -20.0, network.initial_log_std)?;
        within("network.head_gain", network.head_gain, 0.0, 100.0)?;

        let name = algorithm.name.as_str();
        let sees_its_actors_input = match algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Maddpg => false,
            AlgorithmName::Ippo | AlgorithmName::Ppo => true,
        };
        if sees_its_actors_input != (network.critic_state == CriticState::Own) {
            return Err(ConfigError::Invalid {
                key: "network.critic_state",
                problem: format!("{:?} does not fit algorithm.name {name}", network.critic_state),
                cure: "set it to own with ippo and ppo, to compact or concatenated with mappo and maddpg"
                    .to_owned(),
            });
        }
        let unshared = match algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Ippo => None,
            AlgorithmName::Ppo => Some("has one network that acts for all agents"),
            AlgorithmName::Maddpg => Some("has a critic for each agent's own return"),
        };
        if let Some(reason) = unshared
            && network.parameter_sharing != ParameterSharing::None
        {
            return Err(ConfigError::Invalid {
                key: "network.parameter_sharing",
                problem: format!("{name} {reason}"),
                cure: "set it to none, or choose another algorithm.name".to_owned(),
            });
        }
        if algorithm.name == AlgorithmName::Maddpg && !network.squash_mean {
            return Err(ConfigError::Invalid {
                key: "network.squash_mean",
                problem: format!("{name} bounds its actions by algorithm.maddpg.action_limit"),
                cure: "set it to true".to_owned(),
            });
        }
        self.validate_maddpg()?;
        within("algorithm.gamma", algorithm.gamma, 0.0, 1.0)?;
        within("algorithm.gae_lambda", algorithm.gae_lambda, 0.0, 1.0)?;
        within("algorithm.clip", algorithm.clip, 1e-6, 10.0)?;
        if algorithm.dual_clip != 0.0 {
            within("algorithm.dual_clip", algorithm.dual_clip, 1.0 + algorithm.clip, 1e6)?;
        }
        within("algorithm.value_clip", algorithm.value_clip, 0.0, 1e6)?;
        within("algorithm.epochs", algorithm.epochs as f64, 1.0, 1000.0)?;
        let samples = self.steps_per_iteration() as f64;
        within("algorithm.mini_batches", algorithm.mini_batches as f64, 1.0, samples)?;
        within("algorithm.entropy_coefficient", algorithm.entropy_coefficient, 0.0, 100.0)?;
        within("algorithm.value_coefficient", algorithm.value_coefficient, 0.0, 1e6)?;
        within("algorithm.huber_delta", algorithm.huber_delta, 0.0, 1e9)?;
        // Beyond, the normaliser would not begin within an update (its average of ones has a floor of 1e-5).
        within("algorithm.value_norm_beta", algorithm.value_norm_beta, 0.0, 0.99999)?;
        within("algorithm.surrogate_multiplier", algorithm.surrogate_multiplier, 0.0, 1e6)?;
        within("algorithm.max_grad_norm", algorithm.max_grad_norm, 0.0, 1e9)?;
        within("algorithm.max_kl", algorithm.max_kl, 0.0, 1e9)?;

        within("optimizer.actor_lr", optimizer.actor_lr, 0.0, 10.0)?;
        within("optimizer.critic_lr", optimizer.critic_lr, 0.0, 10.0)?;
        within("optimizer.target_kl", optimizer.target_kl, 0.0, 1e9)?;
        within("optimizer.beta1", optimizer.beta1, 0.0, 0.999_999)?;
        within("optimizer.beta2", optimizer.beta2, 0.0, 0.999_999_9)?;
        within("optimizer.epsilon", optimizer.epsilon, 1e-30, 1.0)?;

        within("run.env_steps", run.env_steps as f64, 1.0, 1e15)?;
        within("run.time_limit_s", run.time_limit_s, 0.0, 1e9)?;
        within("run.workers", run.workers as f64, 1.0, 256.0)?;
        within("run.overlap", run.overlap as f64, 0.0, 1.0)?;
        within("run.learner_threads", run.learner_threads as f64, 1.0, 1024.0)?;
        within("run.checkpoint_every_s", run.checkpoint_every_s, 0.0, 1e9)?;
        within("run.checkpoints_kept", run.checkpoints_kept as f64, 1.0, 1e6)?;
        within("run.milestone_every_s", run.milestone_every_s, 0.0, 1e9)?;
        within("run.evaluation_episodes", f64::from(run.evaluation_episodes), 1.0, 10_000.0)?;
        within("run.evaluation_steps", f64::from(run.evaluation_steps), 1.0, 10_000.0)?;
        within("run.order_deadline_s", run.order_deadline_s, 0.1, 1e6)?;
        let device_index = run.device.strip_prefix("cuda:").map(str::parse::<u8>);
        if run.device != "cpu" && !matches!(device_index, Some(Ok(_))) {
            return Err(ConfigError::Invalid {
                key: "run.device",
                problem: format!("`{}` is no device", run.device),
                cure: "write `cpu` or `cuda:0`".to_owned(),
            });
        }
        Ok(())
    }
}

impl Config {
    fn validate_maddpg(&self) -> Result<(), ConfigError> {
        let Maddpg {
            action_limit,
            soft_update,
            replay_steps,
            batch_size,
            updates_per_step,
            learning_starts,
            noise,
            noise_final,
            random,
            random_final,
            noise_steps,
        } = self.algorithm.maddpg;
        within("algorithm.maddpg.action_limit", action_limit, 1e-6, 1e6)?;
        within("algorithm.maddpg.soft_update", soft_update, 0.0, 1.0)?;
        within("algorithm.maddpg.batch_size", batch_size as f64, 1.0, 1e6)?;
        within("algorithm.maddpg.updates_per_step", updates_per_step, 0.0, 1000.0)?;
        within("algorithm.maddpg.learning_starts", learning_starts as f64, 0.0, 1e15)?;
        within("algorithm.maddpg.noise", noise, 0.0, 1e3)?;
        within("algorithm.maddpg.noise_final", noise_final, 0.0, 1e3)?;
        within("algorithm.maddpg.random", random, 0.0, 1.0)?;
        within("algorithm.maddpg.random_final", random_final, 0.0, 1.0)?;
        within("algorithm.maddpg.noise_steps", noise_steps as f64, 0.0, 1e15)?;
        // An episode is the least that a ring of episodes can hold.
        let episode = match self.algorithm.name {
            AlgorithmName::Maddpg => self.task.episode_steps as f64,
            AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Ppo => 0.0,
        };
        within("algorithm.maddpg.replay_steps", replay_steps as f64, episode, 1e8)
    }
}

/// Refuses NaN and what lies outside `[low, high]`.
fn within(key: &'static str, value: f64, low: f64, high: f64) -> Result<(), ConfigError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ConfigError::Invalid {
        key,
        problem: format!("{value} is out of range"),
        cure: format!("choose a value from {low} to {high}"),
    })
}
