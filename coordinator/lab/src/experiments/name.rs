//! What experiments are called.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What an experiment is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Name {
    /// How near hands and base come to held-out goals.
    Precision,
    /// What a disturbance does, and how soon it is over.
    Disturbance,
    /// Turning the base with an arm held or limp.
    ArmFailure,
    /// Turning bases of other masses.
    BaseMass,
    /// Some arms reach while the others hold the base.
    Reassembly,
    /// Errors against noise, disturbing torques, delay and mass of the arms.
    Noise,
}

impl Name {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Precision,
        Self::Disturbance,
        Self::ArmFailure,
        Self::BaseMass,
        Self::Reassembly,
        Self::Noise,
    ];

    /// As on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Precision => "precision",
            Self::Disturbance => "disturbance",
            Self::ArmFailure => "arm-failure",
            Self::BaseMass => "base-mass",
            Self::Reassembly => "reassembly",
            Self::Noise => "noise",
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
