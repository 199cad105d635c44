//! What someone may do to an episode while it plays, as values that can be written down and played again.

use serde::{Deserialize, Serialize};

use super::{Effect, SensorNoise};
use crate::robot::{Joints, RobotError};

/// Most control steps between an action and its execution: ten seconds.
pub const LONGEST_DELAY: usize = 25;

/// How an episode begins.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// Seed of the goals and of all noise. A text where it is larger than a JavaScript number can hold.
    #[serde(with = "seed")]
    pub seed: u64,
    /// Which goals.
    pub purpose: GoalPurpose,
    /// Iteration of the goals of a training; 0 in an evaluation.
    pub iteration: u32,
    /// Index of the episode.
    pub episode: u32,
    /// Where the robot begins, at home without: base position (m), quaternion (w, x, y, z), linear velocity (m/s, world), angular velocity (rad/s, base axes),
    /// joint angles (rad), joint rates (rad/s).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Vec<f64>>,
}

/// A seed in JSON that passes through a browser, whose numbers are exact up to 2⁵³ alone.
mod seed {
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serializer};

    const LARGEST_NUMBER: u64 = (1 << 53) - 1;

    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a whole number, or a text that holds one")]
    enum Written {
        Number(u64),
        Text(String),
    }

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde wants a reference")]
    pub(super) fn serialize<S: Serializer>(seed: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        if *seed > LARGEST_NUMBER {
            serializer.serialize_str(&seed.to_string())
        } else {
            serializer.serialize_u64(*seed)
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        match Written::deserialize(deserializer)? {
            Written::Number(seed) => Ok(seed),
            Written::Text(text) => text
                .parse()
                .map_err(|_| D::Error::custom(format!("seed {text:?}: expected a whole number"))),
        }
    }
}

/// Whose goals an episode has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalPurpose {
    /// Those of evaluations, which no training draws.
    #[default]
    Evaluation,
    /// Those of training episodes.
    Training,
}

/// What moves an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Control {
    /// The policy of this index.
    Policy(usize),
    /// Nobody: commands are zero and the servos hold.
    Hold,
    /// Nobody, and the servos give no torque.
    Limp,
}

/// Something that someone does to an episode; it holds from the next control step on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Event {
    /// Another goal of a hand.
    HandGoal {
        /// The arm.
        arm: usize,
        /// Position in the world (m) and Euler angles (rad).
        pose: [f64; 6],
    },
    /// Another goal of the base.
    BaseGoal {
        /// Euler angles (rad).
        attitude: [f64; 3],
    },
    /// Something else moves an arm.
    Arm {
        /// The arm.
        arm: usize,
        /// What moves it.
        control: Control,
    },
    /// Something happens in the coming steps.
    Effect {
        /// What happens.
        effect: Effect,
        /// In how many control steps; until further notice without.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        steps: Option<usize>,
    },
    /// No effect goes on.
    ClearEffects,
    /// Another mass of the base's first box.
    BaseMass {
        /// The mass (kg).
        mass: f64,
    },
    /// Another delay of the commands. Where it grows, the last one holds until something new arrives; where it shrinks, the oldest that wait are left out.
    Delay {
        /// Control steps between an action and its execution, up to [`LONGEST_DELAY`].
        steps: usize,
    },
    /// Sensors err otherwise.
    Sensors(SensorNoise),
}

/// An event and the control step before which it comes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedEvent {
    /// The control step, from 0 on.
    pub step: usize,
    /// What happens.
    pub event: Event,
}

/// An episode with all that was done to it, which plays the same again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// How it begins.
    #[serde(default)]
    pub start: Start,
    /// Control steps.
    pub steps: usize,
    /// What happens, in order.
    #[serde(default)]
    pub events: Vec<TimedEvent>,
}

/// Why something cannot be done to an episode.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EventError {
    /// An index or a length beyond what there is.
    #[error("{what} {found}: there are {limit}")]
    Beyond {
        /// What is counted.
        what: &'static str,
        /// What was asked for.
        found: usize,
        /// How many there are.
        limit: usize,
    },
    /// A number that is none, or of no sense.
    #[error("{what} is {found}; {expected} is wanted")]
    Value {
        /// Which number.
        what: &'static str,
        /// What it is.
        found: f64,
        /// What would do.
        expected: &'static str,
    },
    /// A delay that is too long.
    #[error("a delay of {0} control steps: at most {most}", most = LONGEST_DELAY)]
    Delay(usize),
    /// A number of a state beyond what a simulation may come to.
    #[error(
        "number {index} of the state, {quantity}, is {found}; a number from -{limit} to {limit} is wanted"
    )]
    State {
        /// Its place, from 0 on.
        index: usize,
        /// What it is of.
        quantity: &'static str,
        /// What it is.
        found: f64,
        /// The largest magnitude.
        limit: f64,
    },
    /// A policy for other arms.
    #[error("the policy moves {}, the robot has {}", .0[0], .0[1])]
    Joints(Box<[Joints; 2]>),
    /// A robot that cannot be.
    #[error(transparent)]
    Robot(#[from] RobotError),
}

/// Refuses an index beyond `limit`.
pub(super) fn within(what: &'static str, found: usize, limit: usize) -> Result<(), EventError> {
    if found < limit { Ok(()) } else { Err(EventError::Beyond { what, found, limit }) }
}

/// Refuses what is more than `limit`.
pub(super) fn up_to(what: &'static str, found: usize, limit: usize) -> Result<(), EventError> {
    if found <= limit { Ok(()) } else { Err(EventError::Beyond { what, found, limit }) }
}

/// Refuses what is no number.
pub(super) fn finite(what: &'static str, values: &[f64]) -> Result<(), EventError> {
    let wrong = values.iter().find(|value| value.is_nan() || value.abs() > 1e6);
    wrong.map_or(Ok(()), |&found| {
        Err(EventError::Value { what, found, expected: "a number within a million" })
    })
}

impl Effect {
    /// Refuses what a robot with these joints has not.
    pub(super) fn check(&self, joints: &Joints) -> Result<(), EventError> {
        let (n_arms, n_joints) = (joints.n_arms(), joints.n_joints());
        match self {
            Self::Action { joints, value } => {
                up_to("joints up to", joints.end, n_joints)?;
                if joints.start > joints.end {
                    return Err(EventError::Value {
                        what: "the first joint",
                        found: joints.start as f64,
                        expected: "one up to the end of its range",
                    });
                }
                finite("the action", &[*value])
            }
            Self::HandForce { arm, force } => {
                within("arm", *arm, n_arms)?;
                finite("the force", force)
            }
            Self::BaseTorque(torque) => finite("the torque", torque),
            Self::JointTorque { std } => finite("the deviation", &[*std]),
            Self::Limp { arm } => within("arm", *arm, n_arms),
            Self::Wrench { body, point, force, torque } => {
                within("body", *body, n_joints + 1)?;
                finite("the point", point)?;
                finite("the force", force)?;
                finite("the torque", torque)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_pass_through_a_browser_to_the_last_digit() {
        let largest = (1_u64 << 53) - 1;
        for (seed, written) in [
            (7, "7".to_owned()),
            (largest, largest.to_string()),
            (largest + 1, format!("\"{}\"", largest + 1)),
            (u64::MAX, format!("\"{}\"", u64::MAX)),
        ] {
            let start = Start { seed, ..Start::default() };
            let json = serde_json::to_string(&start).expect("it has a JSON form");
            assert!(json.contains(&format!("\"seed\":{written},")), "{json}");
            assert_eq!(serde_json::from_str::<Start>(&json).expect("a start"), start);
        }
        // Files from before have numbers.
        let large: Start =
            serde_json::from_str(&format!("{{\"seed\":{}}}", u64::MAX)).expect("one");
        assert_eq!(large.seed, u64::MAX);
        for (wrong, said) in [("-1", "whole number"), ("\"1.5\"", "seed \"1.5\""), ("[]", "whole")]
        {
            let error = serde_json::from_str::<Start>(&format!("{{\"seed\":{wrong}}}"));
            let error = error.expect_err("none").to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
