//! What gateways say: to each other over the network, and to who started them.
//!
//! [`wire`] has the words between hub and host, [`pieces`] how large answers travel. What the gateway of a host and
//! `octopus join`, which starts it, say to each other is here: a line of JSON each.

pub mod pieces;
pub mod wire;

use serde::{Deserialize, Serialize};

use crate::message::{HostId, WorkerId};

/// What a gateway says on its standard output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// It has joined as this host, and `config.toml` and `robot.toml` of the run are there; now it waits for a
    /// [`Place`].
    Joined(HostId),
    /// The run wants so many workers of this machine.
    Scale(u32),
    /// It ends, and why.
    Failed(String),
}

/// What it is told on its standard input when the services are there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Name under which the shared memory lives.
    pub domain: String,
    /// Joints of each arm of the robot.
    pub joints: Vec<usize>,
}

/// What it is told on its standard input from then on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Told {
    /// A worker shall go: it is to be sent home, and is none of the run any more.
    Leave {
        /// Its number on this machine.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
    },
}
