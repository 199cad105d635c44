//! Policies inside of one file that is page and simulator, too.

use anyhow::Context as _;
use service::page::Enclosed;
use simulator::policy::file::compact;
use store::checkpoint::{CONFIG, Checkpoint, POLICY, ROBOT};

use crate::trained::Trained;

/// What the simulator needs of a checkpoint; its networks as small as they become without another bit of an action.
pub fn enclosed(checkpoint: &Checkpoint, name: &str) -> anyhow::Result<[Enclosed; 3]> {
    let trained = Trained::new(checkpoint.clone(), None)?;
    let dimensions = &trained.world.dimensions;
    let tensors = compact(&checkpoint.config, dimensions, &checkpoint.actors(dimensions.joints)?);
    let config = std::fs::read(checkpoint.dir.join(CONFIG))
        .with_context(|| format!("{}: cannot be read", checkpoint.dir.join(CONFIG).display()))?;
    let file = |file, bytes| Enclosed { policy: name.to_owned(), file, bytes };
    Ok([
        file(CONFIG, config),
        file(ROBOT, checkpoint.robot_toml.clone().into_bytes()),
        file(POLICY, tensors),
    ])
}
