//! What a composition is made from: arms of checkpoints, each given once.

use simulator::robot::Robot;

use super::error::CheckpointError;
use super::file_names::ROBOT;
use super::read::Checkpoint;

/// Arms that come from one checkpoint.
#[derive(Debug, Clone)]
pub struct Part {
    /// The arms, counted from 0; arm i moves with agents 2i and 2i + 1, there and in the composition.
    pub arms: Vec<usize>,
    /// Where they come from.
    pub checkpoint: Checkpoint,
}

impl Part {
    /// The part in messages, with arms counted from 1 as users do.
    pub(super) fn describe(&self) -> String {
        let arms: Vec<String> = self.arms.iter().map(|arm| (arm + 1).to_string()).collect();
        let plural = if arms.len() == 1 { "arm" } else { "arms" };
        format!("{plural} {} ({})", arms.join(","), self.checkpoint.dir.display())
    }
}

/// Parts that give every arm of a robot once.
#[derive(Debug, Clone)]
pub struct Parts {
    /// One at least.
    parts: Vec<Part>,
    /// That of the first part.
    robot: Robot,
}

impl Parts {
    /// Refuses parts that do not give every arm once.
    pub fn new(parts: Vec<Part>) -> Result<Self, CheckpointError> {
        let refuse = |reason: String| Err(CheckpointError::Refused { reason });
        let Some(Part { checkpoint, .. }) = parts.first() else {
            return refuse("a composition has at least one part".to_owned());
        };
        let path = checkpoint.dir.join(ROBOT);
        let robot = Robot::from_toml(&checkpoint.robot_toml, &path)
            .map_err(|error| CheckpointError::damaged(&path, error.to_string()))?;
        let mut is_given = vec![false; robot.n_arms];
        for &arm in parts.iter().flat_map(|part| &part.arms) {
            let (number, n_arms) = (arm + 1, robot.n_arms);
            match is_given.get_mut(arm) {
                None => return refuse(format!("there is no arm {number}: the robot has {n_arms}")),
                Some(true) => return refuse(format!("arm {number} is given twice")),
                Some(slot) => *slot = true,
            }
        }
        let missing: Vec<String> = (1_usize..)
            .zip(&is_given)
            .filter(|(_, is_given)| !**is_given)
            .map(|(number, _)| number.to_string())
            .collect();
        if !missing.is_empty() {
            let missing = missing.join(", ");
            return refuse(format!("no part has arm {missing}; give every arm once"));
        }
        Ok(Self { parts, robot })
    }

    /// The parts, one at least.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The robot that the arms are of: the first part's.
    pub(super) fn robot(&self) -> &Robot {
        &self.robot
    }
}
