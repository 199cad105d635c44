//! A policy from a checkpoint, ready to act.

use std::path::Path;

use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use simulator::experiment::Player;
use simulator::policy::Policy;
use simulator::robot::Robot;
use simulator::rollout::World;
use store::checkpoint::{Checkpoint, POLICY, Selector};

use crate::identity::Identity;

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

/// The checkpoint that a path or a text such as `RUN:best` names.
pub fn open_checkpoint(path: &Path) -> anyhow::Result<Checkpoint> {
    let selector = Selector::from_path(path).map_err(|message| {
        ExitError::new(ExitCode::Usage, format!("{}: {message}", path.display()))
    })?;
    Ok(selector.open()?)
}

impl Trained {
    /// The policy of a checkpoint, on its own robot or on another one with as many arms and joints.
    pub fn new(checkpoint: Checkpoint, robot: Option<&Robot>) -> anyhow::Result<Self> {
        let own = Robot::from_toml(&checkpoint.robot_toml, &checkpoint.dir.join("robot.toml"))?;
        let robot = robot.unwrap_or(&own);
        if robot.joints != own.joints {
            let message = format!(
                "{}: the policy moves {}, the robot `{}` has {}",
                checkpoint.dir.display(),
                own.joints,
                robot.name,
                robot.joints
            );
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
        let world = World::new(&checkpoint.config, robot);
        let policy = world.policy(&checkpoint.actors(robot.joints)?).map_err(|error| {
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
    pub fn identity(&self) -> Identity {
        let manifest = &self.checkpoint.manifest;
        Identity {
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
