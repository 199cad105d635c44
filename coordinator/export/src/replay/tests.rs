//! What is kept is played again to the bit, and one bit is found.

use std::sync::Arc;

use proto::config::{Layers, Preset, TaskName};
use simulator::executor::InOrder;
use simulator::experiment::{Member, Start};
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};
use simulator::stepping::{ARRAYS, Batch, Begin, GoalKind, Rows};
use simulator::task::Aim;

use super::*;
use crate::block::{Block, BlockAddress};
use crate::recording::{Commanded, Recorded, Recording};

fn world(task: TaskName) -> World {
    world_of(Preset::Tuned, task)
}

fn world_of(preset: Preset, task: TaskName) -> World {
    let layers = Layers::new(preset, Some(task));
    let set = ["network.hidden=[8]", "task.episode_steps=5", "env.n_envs=12", "env.n_shards=4"];
    let layers = set.iter().try_fold(layers, |layers, set| layers.set(set)).expect("keys");
    let layers = if preset == Preset::Robust {
        // Drives and masses err in each environment.
        layers.set("task.randomization.share=1").expect("a key")
    } else {
        layers
    };
    let config = layers.resolve().expect("valid");
    World::new(&config, &Robot::builtin("paper").expect("built in"))
}

fn block() -> Block {
    block_of(Preset::Tuned, TaskName::Trajectory)
}

fn block_of(preset: Preset, task: TaskName) -> Block {
    let world = world_of(preset, task);
    let parameters = initial_parameters(&world.config, &world.dimensions, 3);
    let policy = world.policy(&parameters).expect("a policy");
    let address = BlockAddress { seed: 4, iteration: 9, shard: 2 };
    let mut numbers = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 4, iteration: 9, shard: 2, policy: &policy };
    rollout(&world, &spec, &mut numbers, &mut |_| {}).expect("a block");
    Block { world: Arc::new(world), address, numbers }
}

fn commanded(task: TaskName) -> Commanded {
    let world = world(task);
    let parameters = initial_parameters(&world.config, &world.dimensions, 3);
    let policy = world.policy(&parameters).expect("a policy");
    let start = Start { seed: 5, episode: 1, ..Start::default() };
    Commanded::by_policy(Member { world, policy }, start, 6).expect("an episode")
}

fn file_of(commanded: Commanded) -> Vec<u8> {
    Recording::of(commanded, &[]).expect("stable").mcap().expect("a file")
}

fn recording(task: TaskName) -> Vec<u8> {
    file_of(commanded(task))
}

fn changed(x: f32) -> f32 {
    f32::from_bits(x.to_bits() ^ 1)
}

#[test]
fn a_recording_is_played_again_to_the_bit_and_one_bit_is_found() {
    for &task in TaskName::ALL {
        let mut recorded = Recorded::read(&recording(task)).expect("read");
        assert_eq!(recorded.commanded.moved_goals.len(), if task.moves() { 6 } else { 0 });
        let same = replay_motion(&recorded).expect("stable");
        assert_eq!(same, Replay { steps: 6, numbers: 6 * (13 + 48), first: None });
        let was = recorded.states[3][14];
        recorded.states[3][14] = changed(was);
        let found = replay_motion(&recorded).expect("stable");
        let first = found.first.expect("a difference");
        assert_eq!((first.step, first.what.as_str()), (4, "angle of joint 2 (rad)"));
        assert_eq!((first.recorded, first.replayed), (changed(was), was));
        // A command that was another one shows in the step that it led to.
        recorded.states[3][14] = was;
        recorded.commanded.commands[1][0] += 0.01;
        assert_eq!(replay_motion(&recorded).expect("stable").first.expect("differs").step, 2);
    }
}

#[test]
fn a_block_is_made_again_to_the_bit_and_one_bit_is_found() {
    let block = block();
    let file = block.write().expect("a file");
    let mut read = Block::read(&file).expect("read");
    assert_eq!((read.address, &read.numbers), (block.address, &block.numbers));
    let same = replay_block(&read, &InOrder, 2).expect("stable");
    assert!(same.first.is_none() && same.steps == 5, "{same:?}");
    let layout = block.world.block_layout();
    assert_eq!(
        same.numbers as usize,
        layout.observation.len()
            + layout.state.len()
            + layout.reward.len()
            + layout.terminated.len()
            + layout.truncated.len()
    );
    // [A, T, N]: agent 7, control step 3, environment 1 of 3.
    let at = layout.reward.start + (7 * 5 + 3) * 3 + 1;
    read.numbers[at] = changed(read.numbers[at]);
    let first = replay_block(&read, &InOrder, 1).expect("stable").first.expect("a difference");
    assert_eq!((first.step, first.what.as_str()), (4, "environment 1, agent 7: reward"));
    read.numbers[at] = changed(read.numbers[at]);
    // [A, T, N, 3]: agent 0, control step 2, environment 0.
    let at = layout.action.start + 2 * 3 * 3;
    read.numbers[at] += 0.25;
    let first = replay_block(&read, &InOrder, 1).expect("stable").first.expect("a difference");
    assert_eq!(first.step, 3);
    assert!(first.what.starts_with("environment 0"), "{}", first.what);
}

fn rows(shown: &mut [Vec<f32>; ARRAYS]) -> Rows<'_> {
    Rows::of_arrays(shown.each_mut().map(Vec::as_mut_slice))
}

#[test]
fn an_environment_of_a_block_is_a_motion() {
    for (preset, task) in [
        (Preset::Tuned, TaskName::Trajectory),
        (Preset::Guided, TaskName::Trajectory),
        (Preset::Guided, TaskName::Capture),
        (Preset::Guided, TaskName::Mixed),
        (Preset::Robust, TaskName::Trajectory),
        (Preset::Robust, TaskName::Reorientation),
    ] {
        is_a_motion(&block_of(preset, task));
    }
}

fn is_a_motion(block: &Block) {
    let world = &block.world;
    let start = block_start(block, 1, &InOrder).expect("an address");
    let executed: Vec<Vec<f32>> = (0..5).map(|step| block.executed(1, step)).collect();
    let commands = executed.iter().map(Vec::as_slice);
    assert_eq!(start.erring.is_some(), world.config.task.randomization.share > 0.0);
    let commanded = Commanded::by_actions(world, start, commands);
    let recording = Recording::of(commanded, &[]).expect("stable");
    let recorded = Recorded::read(&recording.mcap().expect("a file")).expect("read");
    assert_eq!(replay_motion(&recorded).expect("stable").first, None);
    let Recorded { commanded, states } = &recorded;
    let places: std::collections::BTreeSet<u64> =
        commanded.moved_goals.iter().map(|hands| hands[0].expect("a goal")[0].to_bits()).collect();
    assert_eq!(places.len(), if world.task.name.moves() { 5 } else { 0 }, "they move");
    // Where the same actions bring a batch, and how far from its goals, to the bit.
    let begin = Begin { seed: 4, iteration: 9, first: 2 * 3 + 1, goals: GoalKind::Training };
    let mut shown = Rows::widths(&world.dimensions).map(|width| vec![0.0; width]);
    let mut batch = Batch::new(Arc::clone(world), 1, 1);
    batch.reset(begin, &InOrder, rows(&mut shown)).expect("an address");
    let mut motion = commanded.begin();
    for (step, state) in states.iter().enumerate().take(5) {
        let actions: Vec<f32> =
            (0..8).flat_map(|agent| block.actions(agent, step)[3..6].to_vec()).collect();
        batch.step(&actions, &InOrder, rows(&mut shown)).expect("stable");
        commanded.step(step, &mut motion).expect("stable");
        assert_eq!(&shown[9], state);
        let errors = motion.errors();
        for (arm, aim) in world.task.aims.iter().enumerate() {
            if *aim == Aim::Hand {
                assert_eq!(shown[3][arm], errors.position_norm[arm]);
                assert_eq!(shown[4][arm], errors.orientation_norm[arm]);
            }
        }
        if world.task.name.turns() {
            assert_eq!(shown[5], [errors.base_norm]);
        }
    }
}

#[test]
fn files_that_are_none_are_refused_with_what_is_wrong() {
    let file = recording(TaskName::Trajectory);
    let refused = |bytes: &[u8]| Recorded::read(bytes).expect_err("must be refused");
    assert!(!refused(&file[..file.len() / 2]).is_empty());
    assert!(!refused(b"\x89MCAP0\r\n").is_empty());
    // A digit of an attachment: its checksum says so.
    let place = file.windows(10).position(|window| window == b"\"commands\"").expect("there");
    let digit = (place..file.len()).find(|&at| file[at].is_ascii_digit()).expect("a number");
    let mut damaged = file.clone();
    damaged[digit] ^= 1;
    assert!(refused(&damaged).contains("motion.json"), "{}", refused(&damaged));
    // Goals that move, but not in every step.
    let mut short = commanded(TaskName::Capture);
    short.moved_goals.pop();
    let said = refused(&file_of(short));
    assert!(said.contains("goals after 5 control steps, expected 6"), "{said}");

    // Masses of other bodies than the robot has.
    let mut heavy = commanded(TaskName::Trajectory);
    heavy.mass_factors = vec![1.0; 7];
    let read = Recorded::read(&file_of(heavy.clone())).expect("a base and six links");
    assert_eq!(read.commanded.mass_factors, heavy.mass_factors);
    for factors in [vec![1.0; 8], vec![1e4; 7]] {
        heavy.mass_factors = factors;
        assert!(refused(&file_of(heavy.clone())).contains("mass_factors"));
    }

    let file = block().write().expect("a file");
    let refused = |bytes: &[u8]| Block::read(bytes).expect_err("must be refused");
    assert!(refused(&file[..file.len() - 4]).contains("no safetensors"));
    assert!(refused(b"what").contains("no safetensors"));
    let other = |from: &str, to: &str| {
        let text = from.as_bytes();
        let at = file.windows(text.len()).position(|window| window == text).expect("there");
        let mut file = file.clone();
        file[at..at + text.len()].copy_from_slice(to.as_bytes());
        refused(&file)
    };
    assert!(other("\"seed\":\"4\"", "\"seed\":\"x\"").contains("seed is \"x\""));
    assert!(other("\"format\":\"1\"", "\"format\":\"7\"").contains("format \"7\", expected 1"));
    assert!(other("n_envs = 12", "n_envs = 16").contains("expected F32 of"));
}

/// The states stand in an attachment; what viewers draw stands beside it.
#[test]
fn a_recording_whose_messages_are_damaged_is_none() {
    let file = recording(TaskName::Trajectory);
    let name = b"plus_y_upper_arm";
    let places: Vec<usize> =
        (0..file.len() - name.len()).filter(|at| file[*at..].starts_with(name)).collect();
    // Those before are in the robot's files.
    for at in [places[places.len() - 1], places[places.len() - 20]] {
        let mut damaged = file.clone();
        damaged[at + 30] ^= 1;
        let error = Recorded::read(&damaged).expect_err("a message is another one");
        assert!(error.contains("its messages"), "{error}");
    }
    Recorded::read(&file).expect("whole");
}
