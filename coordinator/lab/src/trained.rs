//! A policy from a checkpoint, ready to act.

use std::path::{Path, PathBuf};

use proto::config::TaskName;
use proto::{Digest, ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::experiment::Player;
use simulator::policy::Policy;
use simulator::robot::Robot;
use simulator::rollout::World;
use store::checkpoint::{Checkpoint, POLICY, Selector};

/// A checkpoint's policy with the world it acts in.
#[derive(Debug)]
pub struct Trained {
    /// Where it comes from.
    pub checkpoint: Checkpoint,
    /// Its world.
    pub world: World,
    /// Its networks.
    pub policy: Policy,
}

/// Controllers that are not learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ControllerName {
    /// Damped least squares with the generalised Jacobian.
    Jacobian,
}

impl ControllerName {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Jacobian => "jacobian",
        }
    }
}

/// Which policy it was: enough to find it again, and to know it when it is found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyIdentity {
    /// Its task.
    pub task: TaskName,
    /// The controller that it is, if it is no policy: nothing below tells of a training then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<ControllerName>,
    /// Directory of the checkpoint.
    pub checkpoint: PathBuf,
    /// Iterations it was trained on.
    pub iteration: u64,
    /// Env-steps it was trained on.
    pub env_steps: u64,
    /// Digest of the checkpoint: of the training state or, of a composed one, of the actors.
    pub digest: Digest,
    /// BLAKE3 of `policy.safetensors`.
    pub policy_blake3: Option<String>,
    /// Seed of its training.
    pub seed: u64,
    /// Factor from actions to joint velocity commands that it was trained with.
    pub action_scale: f64,
}

impl PolicyIdentity {
    /// What messages call it.
    pub fn shown(&self) -> String {
        match self.controller {
            Some(name) => format!("controller {}", name.as_str()),
            None => self.checkpoint.display().to_string(),
        }
    }
}

/// The checkpoint that a path or a text such as `RUN:best` names.
pub fn open_checkpoint(path: &Path) -> anyhow::Result<Checkpoint> {
    let selector = Selector::from_path(path).map_err(|message| {
        ExitError::new(ExitCode::Usage, format!("{}: {message}", path.display()))
    })?;
    Ok(selector.open()?)
}

impl Trained {
    /// The policy of a checkpoint, on its own robot or on another one with as many arms.
    pub fn new(checkpoint: Checkpoint, robot: Option<&Robot>) -> anyhow::Result<Self> {
        let own = Robot::from_toml(&checkpoint.robot_toml, &checkpoint.dir.join("robot.toml"))?;
        let robot = robot.unwrap_or(&own);
        if robot.n_arms != own.n_arms {
            let message = format!(
                "{}: the policy moves {} arms, the robot `{}` has {}",
                checkpoint.dir.display(),
                own.n_arms,
                robot.name,
                robot.n_arms
            );
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
        let world = World::new(&checkpoint.config, robot);
        let policy = world.policy(&checkpoint.actors(robot.n_arms)?).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("{}: {error}", checkpoint.dir.display()))
        })?;
        Ok(Self { checkpoint, world, policy })
    }

    /// The task that it learned.
    pub fn task(&self) -> TaskName {
        self.checkpoint.config.task.name
    }

    /// As it takes part in trials.
    pub fn player(&self) -> Player<'_> {
        Player::new(&self.world, &self.policy)
    }

    /// Which one it is.
    pub fn identity(&self) -> PolicyIdentity {
        let manifest = &self.checkpoint.manifest;
        PolicyIdentity {
            task: self.task(),
            controller: None,
            checkpoint: self.checkpoint.dir.clone(),
            iteration: manifest.iteration,
            env_steps: manifest.env_steps,
            digest: manifest.digest,
            policy_blake3: manifest.files.get(POLICY).map(|file| file.blake3.clone()),
            seed: self.checkpoint.config.run.seed,
            action_scale: self.world.task.action_scale,
        }
    }
}
