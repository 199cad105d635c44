//! Which policy or controller made some numbers.

use std::path::PathBuf;

use proto::Digest;
use proto::config::TaskName;
use serde::{Deserialize, Serialize};

/// Controllers that are not learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ControllerName {
    /// Damped least squares with the generalised Jacobian.
    Jacobian,
    /// Goal postures as policies of preset `guided` have them, with nothing added to the way there.
    Postures,
}

impl ControllerName {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Jacobian => "jacobian",
            Self::Postures => "postures",
        }
    }

    /// What it does.
    pub fn about(self) -> &'static str {
        match self {
            Self::Jacobian => "Damped least squares with the generalised Jacobian",
            Self::Postures => "Goal postures alone, to which policies of preset `guided` add",
        }
    }

    /// Whether it is one of `task`.
    pub fn controls(self, task: TaskName) -> bool {
        match self {
            Self::Jacobian => true,
            Self::Postures => task.only_reaches(),
        }
    }
}

/// Which policy or controller it was: enough to find it again, and to know it when it is found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
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

impl Identity {
    /// What messages call it.
    pub fn shown(&self) -> String {
        match self.controller {
            Some(name) => format!("controller {}", name.as_str()),
            None => self.checkpoint.display().to_string(),
        }
    }
}
