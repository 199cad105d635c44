//! The thread that makes blocks of other machines a second time, for comparison.
//!
//! It is one of the coordinator's, and not a worker's: so a machine that has left all rollouts to others can still
//! tell whether they make the right bits, and no order of a worker waits behind an audit. It simulates with the code of
//! `sim-worker`, a block at a time, and starts with the first one that is wanted.

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};

use proto::Digest;
use proto::config::Config;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};

use crate::task::ShardAddress;

/// Its stack (bytes): what a program's first thread has, on which workers simulate.
const STACK: usize = 8 << 20;

/// A block to be made.
struct Wanted {
    address: ShardAddress,
    /// Parameters of the policy to act with, which many blocks share.
    policy: Arc<[f32]>,
}

/// What became of one: its digest, or why it cannot be made.
pub(crate) type Made = (ShardAddress, Result<Digest, String>);

/// See the module.
#[derive(Debug)]
pub(crate) struct Auditor {
    wanted: Sender<Wanted>,
    made: Receiver<Made>,
}

impl Auditor {
    /// Starts the thread. It ends when this is dropped, after the block at hand.
    pub(crate) fn start(config: &Config, robot: &Robot) -> std::io::Result<Self> {
        let (wanted, orders) = mpsc::channel::<Wanted>();
        let (results, made) = mpsc::channel();
        let (config, robot) = (config.clone(), robot.clone());
        let work = move || {
            let world = World::new(&config, &robot);
            for Wanted { address, policy } in orders {
                if results.send((address, make(&world, address, &policy))).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("auditor".to_owned()).stack_size(STACK);
        thread.spawn(work)?;
        Ok(Self { wanted, made })
    }

    /// Has a block made, acted with the policy of these parameters. Whether there is still a thread to make it.
    pub(crate) fn want(&self, address: ShardAddress, policy: Arc<[f32]>) -> bool {
        self.wanted.send(Wanted { address, policy }).is_ok()
    }

    /// What has been made since this was last asked.
    pub(crate) fn made(&self) -> Vec<Made> {
        self.made.try_iter().collect()
    }
}

fn make(world: &World, address: ShardAddress, policy: &[f32]) -> Result<Digest, String> {
    let policy = world.policy(policy).map_err(|error| error.to_string())?;
    let (iteration, shard) = address;
    let spec = RolloutSpec { seed: world.config.run.seed, iteration, shard, policy: &policy };
    let mut block = vec![0.0; world.block_layout().len];
    rollout(world, &spec, &mut block, &mut |_| {}).map_err(|error| error.to_string())?;
    Ok(Digest::of_block(&block))
}
