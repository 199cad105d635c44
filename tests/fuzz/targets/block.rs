//! Blocks that people pass on: whatever they say, nothing panics, and what is taken can be made again.

#![no_main]

use std::sync::Arc;

use export::{Block, BlockAddress, replay_block};
use libfuzzer_sys::fuzz_target;
use simulator::executor::InOrder;
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};

fn seeds() -> Vec<Vec<u8>> {
    let config = fuzz::small_config();
    let world = World::new(&config, &Robot::builtin("paper").expect("built in"));
    let parameters = initial_parameters(&config, &world.dimensions, 1);
    let policy = world.policy(&parameters).expect("a policy");
    let mut numbers = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 1, iteration: 2, shard: 0, policy: &policy };
    rollout(&world, &spec, &mut numbers, &mut |_| {}).expect("a block");
    let address = BlockAddress { seed: 1, iteration: 2, shard: 0 };
    let file = Block { world: Arc::new(world), address, numbers }.write().expect("a file");
    let block = Block::read(&file).expect("one of ours");
    assert_eq!(replay_block(&block, &InOrder, 1).expect("stable").first, None);
    vec![file]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        if let Ok(block) = Block::read(bytes) {
            // It may diverge, which is told.
            let _ = replay_block(&block, &InOrder, 1);
        }
    }
);
