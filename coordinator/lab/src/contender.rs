//! What an evaluation or an experiment is made with: a trained policy, or a controller that is not learned.

use std::path::PathBuf;

use proto::config::{Layers, Preset, TaskName};
use proto::{Digest, ExitCode, ExitError};
use simulator::controller::JacobianController;
use simulator::experiment::Player;
use simulator::policy::{Policy, initial_parameters};
use simulator::robot::Robot;
use simulator::rollout::World;
use store::checkpoint::Checkpoint;

use crate::identity::{ControllerName, Identity};
use crate::trained::Trained;

#[derive(Debug)]
enum Driver {
    Policy {
        policy: Policy,
        checkpoint: Box<Checkpoint>,
    },
    Jacobian(Box<JacobianController>),
    /// A policy that says zero, whatever it sees.
    Postures(Policy),
}

/// A policy, or a controller, in the world that it was made for.
#[derive(Debug)]
pub struct Contender {
    /// Its world.
    pub world: World,
    driver: Driver,
    identity: Identity,
}

impl From<Trained> for Contender {
    fn from(trained: Trained) -> Self {
        let identity = trained.identity();
        let Trained { checkpoint, world, policy } = trained;
        Self { world, driver: Driver::Policy { policy, checkpoint: checkpoint.into() }, identity }
    }
}

impl Contender {
    /// A controller of a task on a robot, within the limits that presets `tuned` and `guided` give actions.
    ///
    /// # Errors
    /// If it is none of such a task, or the robot has too few arms for it.
    pub fn controller(name: ControllerName, task: TaskName, robot: &Robot) -> anyhow::Result<Self> {
        if !name.controls(task) {
            let message = format!(
                "controller {}: is for tasks in which all hands have goals, and none for `{}`",
                name.as_str(),
                task.as_str()
            );
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
        task.check_arms(&robot.name, robot.n_arms).map_err(|refused| {
            let message = format!("{refused}; take another robot (--robot) or another task");
            ExitError::new(ExitCode::BadInput, message)
        })?;
        let (world, driver) = match name {
            ControllerName::Jacobian => {
                let config = Layers::new(Preset::Tuned, Some(task)).resolve()?;
                let world = World::new(&config, robot);
                let driver = Driver::Jacobian(JacobianController::new(&world).into());
                (world, driver)
            }
            ControllerName::Postures => {
                let layers = Layers::new(Preset::Guided, Some(task));
                let config =
                    layers.set("network.hidden=[8]")?.set("network.head_gain=0")?.resolve()?;
                let world = World::new(&config, robot);
                let zero = initial_parameters(&world.config, &world.dimensions, 0);
                let driver = Driver::Postures(world.policy(&zero)?);
                (world, driver)
            }
        };
        let identity = Identity {
            task,
            controller: Some(name),
            checkpoint: PathBuf::new(),
            iteration: 0,
            env_steps: 0,
            digest: Digest::default(),
            policy_blake3: None,
            seed: 0,
            action_scale: world.task.action_scale,
        };
        Ok(Self { world, driver, identity })
    }

    /// Its task.
    pub fn task(&self) -> TaskName {
        self.identity.task
    }

    /// As it takes part in trials.
    pub fn player(&self) -> Player<'_> {
        match &self.driver {
            Driver::Policy { policy, .. } | Driver::Postures(policy) => {
                Player::new(&self.world, policy)
            }
            Driver::Jacobian(controller) => Player::controlled(&self.world, controller),
        }
    }

    /// The checkpoint of a policy.
    pub fn checkpoint(&self) -> Option<&Checkpoint> {
        match &self.driver {
            Driver::Policy { checkpoint, .. } => Some(checkpoint),
            Driver::Jacobian(_) | Driver::Postures(_) => None,
        }
    }

    /// Which one it is.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// What messages call it.
    pub fn shown(&self) -> String {
        self.identity.shown()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_for_two_arms_has_no_controller_on_a_robot_with_one() {
        let text = Robot::builtin("paper").expect("built in").to_toml();
        let second = text.match_indices("[[arms]]").nth(1).expect("four arms").0;
        let one = Robot::from_toml(&text[..second], "one.toml".as_ref()).expect("a robot");
        let of = |task| Contender::controller(ControllerName::Jacobian, task, &one);
        let refused = of(TaskName::Mixed).expect_err("one arm").to_string();
        assert!(refused.contains("has 1 arm, and task `mixed` needs 2"), "{refused}");
        of(TaskName::Trajectory).expect("one arm is enough");
    }
}
