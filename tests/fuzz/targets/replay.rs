//! Recordings and blocks that people pass on; the first byte chooses which. Whatever they say, nothing panics, and what is taken can be played
//! again.

#![no_main]

use std::sync::Arc;

use export::{
    Block, BlockAddress, Commanded, Recorded, Recording, replay_block, replay_motion,
};
use libfuzzer_sys::fuzz_target;
use simulator::executor::InOrder;
use simulator::experiment::FixedGoals;
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};
use simulator::state::State;
use simulator::step::StepOptions;

fn seeds() -> Vec<Vec<u8>> {
    let robot = Robot::builtin("paper").expect("built in");
    let start = State::home(&robot);
    let goals = FixedGoals { hands: vec![None, Some([0.4, -1.1, 4.2, 1.6, 0.0, 1.5])], base: None };
    let commands = vec![vec![0.25; robot.n_joints()]];
    let options = StepOptions::default();
    let commanded = Commanded { robot: robot.clone(), options, start, goals, commands };
    let recording = Recording::of(commanded, &[]).and_then(|recording| recording.mcap());

    let config = fuzz::small_config();
    let world = World::new(&config, &robot);
    let parameters = initial_parameters(&config, &world.dimensions, 1);
    let policy = world.policy(&parameters).expect("a policy");
    let mut numbers = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 1, iteration: 2, shard: 0, policy: &policy };
    rollout(&world, &spec, &mut numbers, &mut |_| {}).expect("a block");
    let address = BlockAddress { seed: 1, iteration: 2, shard: 0 };
    let block = Block { world: Arc::new(world), address, numbers }.write().expect("a file");
    let tag = |kind: &[u8], bytes: Vec<u8>| [kind, &bytes].concat();
    vec![tag(b"m", recording.expect("a file")), tag(b"b", block)]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let Some((kind, bytes)) = bytes.split_first() else { return };
        if *kind == b'm' {
            let Ok(mut recorded) = Recorded::read(bytes) else { return };
            // Longer ones take long, and say no more.
            recorded.commanded.commands.truncate(1);
            // It may diverge, which is told.
            let _ = replay_motion(&recorded);
        } else if let Ok(block) = Block::read(bytes) {
            let _ = replay_block(&block, &InOrder, 1);
        }
    }
);
