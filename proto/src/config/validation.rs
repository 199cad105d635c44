//! The rules that values must meet, each for itself and together.

use std::time::Duration;

use super::algorithm::{Algorithm, AlgorithmName};
use super::maddpg::Maddpg;
use super::network::{CriticState, ParameterSharing};
use super::resolved::Config;
use super::task::{Observation, Reward, RewardWeights};
use crate::ConfigError;
use crate::bucket_address;
use crate::message::HEARTBEAT;
use crate::tasks::Target;

/// Least of `run.order_deadline_s`: two signs of life in a row may come late.
const SHORTEST_SILENCE: Duration = HEARTBEAT.saturating_mul(3);

/// What a body may turn by while hands follow it (rad): hands at home are turned by up to a quarter turn, and errors are differences of Euler angles.
const FARTHEST_TURN: f64 = 1.2;

impl Config {
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
        within("task.start.turning", task.start.turning, 0.0, 1.0)?;
        within("task.posture.gain", task.posture.gain, 0.0, 1.0)?;
        within("task.posture.trust", task.posture.trust, 1e-3, 1.0)?;
        within("task.posture.fade", task.posture.fade, 0.0, 10.0)?;
        let arm = task.observation == Observation::Arm;
        if (task.name.moves() || task.name.reaches() && task.name.turns()) && !arm {
            return Err(ConfigError::Invalid {
                key: "task.observation",
                problem: format!("must be `arm` for task `{}`", task.name.as_str()),
                cure: "set task.observation=arm, or take preset `tuned`".to_owned(),
            });
        }
        let told = task.name.only_reaches() && arm;
        if (task.posture.seen || task.posture.gain > 0.0) && !told {
            return Err(ConfigError::Invalid {
                key: "task.posture",
                problem: "is for tasks in which all hands have goals, with observation `arm`"
                    .to_owned(),
                cure: "set task.posture.seen=false and task.posture.gain=0".to_owned(),
            });
        }
        if task.posture.gain > 0.0 && !task.posture.seen {
            return Err(ConfigError::Invalid {
                key: "task.posture.gain",
                problem: "adds to actions what agents do not see".to_owned(),
                cure: "set task.posture.seen=true".to_owned(),
            });
        }
        let Target { radius, ahead, offset, tilt, drift, spin, wobble, .. } = task.target;
        let Target { inertia_ratio, position, orientation, hold_steps, .. } = task.target;
        within("task.target.radius", radius, 0.0, 100.0)?;
        within("task.target.ahead", ahead, -100.0, 100.0)?;
        within("task.target.offset", offset, 0.0, 10.0)?;
        within("task.target.tilt", tilt, 0.0, 1.0)?;
        within("task.target.drift", drift, 0.0, 1.0)?;
        within("task.target.spin", spin, 0.0, 1.0)?;
        within("task.target.wobble", wobble, 0.0, 1.0)?;
        // No rigid body is twice as hard to turn about an axis as across it, nor easier than a needle.
        within("task.target.inertia_ratio", inertia_ratio, 0.01, 2.0)?;
        within("task.target.position", position, 1e-6, 1.0)?;
        within("task.target.orientation", orientation, 1e-6, 1.0)?;
        within("task.target.hold_steps", hold_steps as f64, 1.0, 10_000.0)?;
        let longest = task.episode_steps.max(run.evaluation_steps as usize) as f64;
        let turned = tilt + (spin + wobble) * longest * env.control_period;
        if task.name.moves() && turned > FARTHEST_TURN {
            return Err(ConfigError::Invalid {
                key: "task.target",
                problem: format!(
                    "turns by up to {turned:.2} rad in an episode (`tilt`, `spin`, `wobble`), and beyond {FARTHEST_TURN} Euler angles wrap"
                ),
                cure: "set task.target.spin or task.target.wobble to less".to_owned(),
            });
        }
        let erring = &task.randomization;
        within("task.randomization.share", erring.share, 0.0, 1.0)?;
        within("task.randomization.delay", erring.delay, 0.0, 1.0)?;
        within("task.randomization.friction", erring.friction, 0.0, 100.0)?;
        within("task.randomization.gain", erring.gain, 0.0, 0.9)?;
        within("task.randomization.mass", erring.mass, 0.0, 0.9)?;
        within("task.randomization.position", erring.position, 0.0, 1.0)?;
        within("task.randomization.angle", erring.angle, 0.0, 1.0)?;
        within("task.randomization.velocity", erring.velocity, 0.0, 10.0)?;
        within("task.randomization.rate", erring.rate, 0.0, 10.0)?;
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

        for (key, widths, least) in [
            ("network.hidden", &network.hidden, 1),
            ("network.critic_hidden", &network.critic_hidden, 0),
        ] {
            if !(least..=16).contains(&widths.len()) {
                return Err(ConfigError::Invalid {
                    key,
                    problem: match widths.len() {
                        0 => "has no layer".to_owned(),
                        layers => format!("has {layers} layers"),
                    },
                    cure: format!("give {least} to 16 widths, such as [256, 256]"),
                });
            }
        }
        let widths = network.hidden.iter().map(|width| ("network.hidden", width));
        let of_critics = network.critic_hidden.iter().map(|width| ("network.critic_hidden", width));
        for (key, &width) in widths.chain(of_critics) {
            within(key, width as f64, 1.0, 16_384.0)?;
        }
        within("network.input_clip", network.input_clip, 0.1, 1e6)?;
        within("network.initial_log_std", network.initial_log_std, -10.0, 5.0)?;
        within("network.wrist_log_std_offset", network.wrist_log_std_offset, -15.0, 15.0)?;
        let [shoulder, wrist] = [0, 1].map(|agent| network.initial_log_std_of(agent));
        if !(-10.0..=5.0).contains(&wrist) {
            return Err(ConfigError::Invalid {
                key: "network.wrist_log_std_offset",
                problem: format!("wrists would begin at {wrist}, the sum with initial_log_std"),
                cure: "choose a sum from -10 to 5".to_owned(),
            });
        }
        let lowest = shoulder.min(wrist);
        within("network.min_log_std", network.min_log_std, -20.0, lowest)?;
        within("network.head_gain", network.head_gain, 0.0, 100.0)?;

        let name = algorithm.name.as_str();
        let sees_its_actors_input = match algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Maddpg => false,
            AlgorithmName::Ippo | AlgorithmName::Ppo => true,
        };
        if sees_its_actors_input != (network.critic_state == CriticState::Own) {
            return Err(ConfigError::Invalid {
                key: "network.critic_state",
                problem: format!(
                    "{} does not fit algorithm.name {name}",
                    format!("{:?}", network.critic_state).to_lowercase()
                ),
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
        within("run.workers", run.workers as f64, 0.0, 256.0)?;
        within("run.overlap", run.overlap as f64, 0.0, 1.0)?;
        within("run.learner_threads", run.learner_threads as f64, 1.0, 1024.0)?;
        within("run.checkpoint_every_s", run.checkpoint_every_s, 0.0, 1e9)?;
        within("run.checkpoints_kept", run.checkpoints_kept as f64, 1.0, 1e6)?;
        within("run.milestone_every_s", run.milestone_every_s, 0.0, 1e9)?;
        within("run.evaluation_episodes", f64::from(run.evaluation_episodes), 1.0, 10_000.0)?;
        within("run.evaluation_steps", f64::from(run.evaluation_steps), 1.0, 10_000.0)?;
        within("run.audit", run.audit, 0.0, 1.0)?;
        within("run.order_deadline_s", run.order_deadline_s, 0.0, 1e6)?;
        if run.order_deadline_s < SHORTEST_SILENCE.as_secs_f64() {
            return Err(ConfigError::Invalid {
                key: "run.order_deadline_s",
                problem: format!(
                    "{} s is too short: processes say every {} s that they are alive, and healthy \
                     ones would be replaced",
                    run.order_deadline_s,
                    HEARTBEAT.as_secs_f64()
                ),
                cure: format!(
                    "choose {} s or more; the presets have 60",
                    SHORTEST_SILENCE.as_secs_f64()
                ),
            });
        }
        if !run.checkpoints.is_empty()
            && let Some(problem) = bucket_address::problem(&run.checkpoints)
        {
            // What may be a secret in it is not repeated.
            return Err(ConfigError::Invalid {
                key: "run.checkpoints",
                problem: format!("is no address of a bucket: it {problem}"),
                cure: format!("write one as in {}, or nothing", bucket_address::examples()),
            });
        }
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
    /// Refuses what would be ignored without a word. Runs that began with it may go on.
    pub(super) fn refuse_what_has_no_effect(&self) -> Result<(), ConfigError> {
        let Algorithm { name, epochs, mini_batches, .. } = &self.algorithm;
        // How far an actor went is known before each of its steps. Before the first one it has gone nowhere, unless workers act with the policy of an
        // iteration before.
        let is_blind = epochs * mini_batches == 1 && self.run.overlap == 0;
        if is_blind && *name != AlgorithmName::Maddpg && self.optimizer.target_kl > 0.0 {
            return Err(ConfigError::Invalid {
                key: "optimizer.target_kl",
                problem:
                    "is found before each step of the optimiser, and an iteration has one step"
                        .to_owned(),
                cure: "set it to 0, or algorithm.epochs or algorithm.mini_batches to 2 or more"
                    .to_owned(),
            });
        }
        Ok(())
    }

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
