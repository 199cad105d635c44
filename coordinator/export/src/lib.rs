//! What programs of others take from here: a policy as one directory that needs nothing of ours ([`files`]), a recorded motion
//! ([`Recording`]), a block of a run ([`Block`]). The last two can be played again, bit by bit ([`replay_motion`], [`replay_block`]).
//!
//! The directory of a policy:
//!
//! | file | what |
//! |---|---|
//! | `controller.onnx` | state and goals to joint rates: kinematics, frames, errors, networks, limits |
//! | `policy.onnx` | the actors alone: observations to actions |
//! | `controller.c`, `controller.h` | the same as the first in C99, with the bits of our workers |
//! | `example.c` | a program that uses it |
//! | `contract.toml` | what every number is, and what the controller is not for |
//! | `vectors.json` | 256 states with goals, observations and commands as the simulator computed them |
//! | `check.c`, `check.py` | hold both against them |
//!
//! **Whose arithmetic.** The C code does what workers do, operation by operation, so bits can be compared. The graph leaves sums
//! to its runtime and is held to a tolerance. Both store rows that actors share once.
//!
//! **Goal postures** (`simulator::posture`) are searched for and remembered, which a graph cannot do: for policies that act beside them it has one more
//! input, and the C code a function that gives it.

mod block;
mod c;
mod contract;
mod error;
mod networks;
mod onnx;
mod recording;
mod replay;
mod source;
mod vectors;

pub use block::{Block, BlockAddress};
pub use error::ExportError;
pub use recording::{Commanded, Recorded, RecordedEpisode, Recording};
pub use replay::{BlockStart, Difference, Replay, block_start, replay_block, replay_motion};
pub use source::{HeldOut, HeldOutError, Origin, Source};

use networks::Networks;
use simulator::rollout::World;

/// A file of the directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its name.
    pub name: &'static str,
    /// Its bytes.
    pub content: Vec<u8>,
}

/// Whether controllers can be written for policies of a world.
///
/// # Errors
/// Why not.
pub fn check(world: &World) -> Result<(), ExportError> {
    let actors = world.dimensions.n_actors;
    if actors > 255 {
        return Err(ExportError::Actors(actors));
    }
    Ok(())
}

/// Everything of the directory, in the order of the table above.
///
/// # Errors
/// If there is none for this world ([`check`]), or an episode cannot be played.
pub fn files(source: &Source<'_>) -> Result<Vec<File>, ExportError> {
    check(source.world)?;
    let networks = Networks::new(source.world, source.parameters);
    let vectors = vectors::vectors(source)?;
    let metadata = metadata(source);
    let json = serde_json::to_string(&vectors).expect("plain data");
    // One state a line.
    let json = json.replace("{\"base_position\"", "\n{\"base_position\"") + "\n";
    let text = |name, content: String| File { name, content: content.into_bytes() };
    Ok(vec![
        File { name: "controller.onnx", content: onnx::controller(source, &networks, &metadata) },
        File { name: "policy.onnx", content: onnx::policy(source, &networks, &metadata) },
        text("controller.c", c::controller(source, &networks)),
        text("controller.h", c::header(source)),
        text("example.c", c::EXAMPLE.to_owned()),
        text("contract.toml", contract::contract(source, &vectors)),
        text("vectors.json", json),
        text("check.c", c::CHECK.to_owned()),
        text("check.py", include_str!("check.py").to_owned()),
    ])
}

/// What models say about themselves.
fn metadata(source: &Source<'_>) -> Vec<(String, String)> {
    let config = &source.world.config;
    let entries = [
        ("robot", source.world.robot.name.clone()),
        ("task", source.task().to_owned()),
        ("algorithm", config.algorithm.name.as_str().to_owned()),
        ("digest", source.origin.digest.clone()),
        ("env_steps", source.origin.env_steps.to_string()),
        ("control_period_s", config.env.control_period.to_string()),
        ("action_scale", config.task.action_scale.to_string()),
        ("units", "m, rad, s".to_owned()),
        ("quaternion", "w, x, y, z; base to world".to_owned()),
        ("joint_names", source.joint_names().join(",")),
        ("contract", "contract.toml".to_owned()),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}
