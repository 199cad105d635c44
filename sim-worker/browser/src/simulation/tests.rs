//! What a page is told, and what it is refused.

use std::fs;

use simulator::rollout::{RolloutSpec, rollout};

use super::*;

/// The files of a policy that comes with the program, one after the other.
fn files(task: &str) -> (Vec<u8>, usize, usize) {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/policies").join(task);
    let read = |name: &str| fs::read(directory.join(name)).expect("a policy");
    let [config, robot] = ["config.toml", "robot.toml"].map(read);
    let lengths = (config.len(), robot.len());
    ([config, robot, read("policy.safetensors")].concat(), lengths.0, lengths.1)
}

fn loaded() -> Simulation {
    let mut simulation = Simulation::default();
    let (input, config, robot) = files("trajectory");
    assert_eq!(simulation.policy(None, &input, config, robot), Ok(0));
    simulation
}

fn array(simulation: &mut Simulation, name: &str) -> Vec<f32> {
    let arrays = &simulation.playing().expect("loaded").arrays;
    arrays.get(name).to_vec()
}

#[test]
fn the_arrays_tell_one_and_the_same_robot() {
    let mut simulation = loaded();
    simulation.reset(br#"{"seed": 4, "episode": 2}"#).expect("a start");
    for _ in 0..3 {
        simulation.step().expect("a step");
    }
    let [state, bodies, hands, goals, errors, counters, commands, torques] = [
        "state",
        "bodies",
        "hands",
        "hand_goals",
        "hand_errors",
        "counters",
        "commands",
        "torques",
    ]
    .map(|name| array(&mut simulation, name));
    assert_eq!(bodies[12..15], state[..3], "the base's frame is where the base is");
    let robot = simulation.playing().expect("loaded").episode.robot().clone();
    for arm in 0..robot.n_arms {
        let hand = &hands[16 * arm..16 * (arm + 1)];
        for i in 0..3 {
            let error = goals[6 * arm + i] - hand[12 + i];
            assert!((error - errors[6 * arm + i]).abs() < 1e-6, "arm {arm}: {error}");
            // The hand is the last body's tool.
            let body = 16 * (6 * (arm + 1));
            let tool = robot.types[0].tool_position;
            let there = (0..3).map(|k| f64::from(bodies[body + 4 * k + i]) * tool[k]).sum::<f64>();
            let there = f64::from(bodies[body + 12 + i]) + there;
            assert!((there - f64::from(hand[12 + i])).abs() < 1e-5, "arm {arm}: {there}");
        }
    }
    assert_eq!(counters[1..], [3.0, 0.0, 0.0]);
    assert!(commands.iter().any(|rate| rate.abs() > 1e-2), "the arms move");
    assert!(torques.iter().any(|torque| torque.abs() > 1e-3), "something moves them");
}

#[test]
fn the_description_names_every_shape_and_array() {
    let mut simulation = loaded();
    let text = simulation.describe().expect("a description");
    let description: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((&description["n_arms"], &description["n_joints"]), (&4.into(), &24.into()));
    let bodies = description["bodies"].as_array().expect("bodies");
    assert_eq!(bodies.len(), 25);
    assert_eq!(bodies[7]["arm"], 1);
    let base = bodies[0]["shapes"].as_array().expect("shapes");
    assert_eq!(base[0]["box"]["half"].as_array().map(Vec::len), Some(3));
    assert!(base.iter().any(|shape| shape.get("box").is_none()), "pedestals are part of the base");
    let arrays = description["arrays"].as_object().expect("arrays");
    let total: u64 = arrays.values().map(|place| place["len"].as_u64().expect("a length")).sum();
    let first = arrays.values().map(|place| place["at"].as_u64().expect("an address"));
    let (first, last) = (first.clone().min().expect("some"), first.max().expect("some"));
    let last_len = arrays.values().find(|place| place["at"] == last).expect("it")["len"].as_u64();
    assert_eq!(last + 4 * last_len.expect("a length"), first + 4 * total, "one after the other");
}

#[test]
fn what_goes_wrong_is_said_in_words_and_changes_nothing() {
    let mut empty = Simulation::default();
    for error in [empty.step(), empty.restore(0), empty.reset(b"{}"), empty.describe().map(drop)] {
        assert_eq!(error, Err("no policy is loaded yet".to_owned()));
    }
    let (input, config, robot) = files("trajectory");
    let refused = |at: usize, config: usize, robot: usize, word: &str| {
        let slot = None;
        let error = Simulation::default().policy(slot, &input[..at], config, robot);
        let error = error.expect_err("refused");
        assert!(error.contains(word), "{error}");
    };
    refused(config, config, robot, "shorter");
    refused(input.len(), usize::MAX, robot, "shorter");
    refused(input.len(), 10, robot, "config.toml");
    refused(input.len() - 1, config, robot, "safetensors");

    let mut simulation = loaded();
    simulation.step().expect("a step");
    let before = array(&mut simulation, "state");
    for (json, word) in [
        ("{", "the event"),
        (r#"{"arm": {"arm": 0, "control": {"policy": 7}}}"#, "policy 7"),
        (r#"{"dance": {}}"#, "dance"),
        (r#"{"delay": {"steps": 1, "more": 2}}"#, "more"),
    ] {
        let error = simulation.event(json.as_bytes()).expect_err("refused");
        assert!(error.contains(word), "{error}");
    }
    assert!(simulation.reset(b"[1]").is_err());
    assert_eq!(simulation.restore(0), Err("snapshot 0 of 0".to_owned()));
    assert_eq!(array(&mut simulation, "state"), before);
}

#[test]
fn a_page_goes_back_in_time_and_on_again() {
    let mut simulation = loaded();
    let mut states = Vec::new();
    for step in 0..4 {
        assert_eq!(simulation.snapshot(), Ok(step));
        states.push(array(&mut simulation, "state"));
        simulation.step().expect("a step");
    }
    simulation.restore(1).expect("it is kept");
    assert_eq!(array(&mut simulation, "state"), states[1]);
    simulation.forget(2);
    simulation.step().expect("a step");
    assert_eq!(simulation.snapshot(), Ok(2));
    assert_eq!(array(&mut simulation, "state"), states[2]);
    // Another policy beside the first, which moves an arm of its own.
    let (input, config, robot) = files("reorientation");
    assert_eq!(simulation.policy(None, &input, config, robot), Ok(1));
    let event = br#"{"arm": {"arm": 3, "control": {"policy": 1}}}"#;
    simulation.event(event).expect("another policy");
    simulation.step().expect("a step");
    assert_ne!(array(&mut simulation, "state"), states[3]);
}

#[test]
fn a_policy_that_leaves_is_held_by_nothing() {
    let mut simulation = loaded();
    let more = |simulation: &mut Simulation, task: &str| {
        let (input, config, robot) = files(task);
        simulation.policy(None, &input, config, robot)
    };
    let give = |simulation: &mut Simulation, slot: usize| {
        let event = format!(r#"{{"arm": {{"arm": 3, "control": {{"policy": {slot}}}}}}}"#);
        simulation.event(event.as_bytes()).expect("it is there");
    };
    let on = |simulation: &mut Simulation| {
        simulation.step().expect("a step");
        array(simulation, "state")
    };
    let weak = |simulation: &mut Simulation, slot: usize| {
        Arc::downgrade(&simulation.playing().expect("loaded").episode.members()[slot])
    };
    assert_eq!(more(&mut simulation, "reorientation"), Ok(1));
    // At the beginning whoever is given an arm asks anew for goal postures.
    simulation.step().expect("a step");
    give(&mut simulation, 1);
    assert_eq!(simulation.snapshot(), Ok(0));
    let with = on(&mut simulation);
    give(&mut simulation, 0);

    let leaving = weak(&mut simulation, 1);
    let error = simulation.retire(1, 2).expect_err("there are two");
    assert!(error.contains("policy 2"), "{error}");
    assert!(leaving.upgrade().is_some());
    simulation.retire(1, 0).expect("both are there");
    assert!(leaving.upgrade().is_none(), "a moment that is kept holds it");
    simulation.restore(0).expect("it is kept");
    let without = on(&mut simulation);
    assert_ne!(without, with);
    simulation.restore(0).expect("it is kept");
    give(&mut simulation, 0);
    assert_eq!(on(&mut simulation), without, "its successor plays");

    // The successor, too, which has two places by now.
    assert_eq!(more(&mut simulation, "trajectory"), Ok(2));
    let leaving = weak(&mut simulation, 0);
    simulation.retire(0, 2).expect("both are there");
    assert!(leaving.upgrade().is_none(), "the place of another one holds it");
    simulation.restore(0).expect("it is kept");
    assert_eq!(on(&mut simulation), without, "the same policy under another number");
}

#[test]
fn a_block_is_the_one_that_a_worker_makes() {
    let mut simulation = loaded();
    simulation.step().expect("a step");
    let before = array(&mut simulation, "state");
    let text = simulation.block(br#"{"iteration": 3, "shard": 1}"#).expect("a block");
    let made: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(array(&mut simulation, "state"), before, "the episode goes on where it was");

    let member = simulation.playing().expect("loaded").episode.members()[0].clone();
    let Member { world, policy } = &*member;
    let mut block = vec![0.0; world.block_layout().len];
    let seed = world.config.run.seed;
    let spec = RolloutSpec { seed, iteration: 3, shard: 1, policy };
    rollout(world, &spec, &mut block, &mut |_| {}).expect("a block");
    assert_eq!(made["digest"], proto::Digest::of_block(&block).to_string());
    assert_eq!(made["seed"], seed.to_string(), "a number of the page does not hold all seeds");
    assert_eq!(made["env_steps"], world.block_env_steps());
    assert_eq!(made["returns"].as_array().map(Vec::len), Some(world.dimensions.n_agents));

    for (json, word) in [
        (r#"{"iteration": 3}"#, "shard"),
        (r#"{"iteration": 3, "shard": 99}"#, "99"),
        (r#"{"iteration": 4294967296, "shard": 0}"#, "4294967296"),
    ] {
        let error = simulation.block(json.as_bytes()).expect_err("refused");
        assert!(error.contains(word), "{error}");
    }
    let nothing = Simulation::default().block(br#"{"iteration": 0, "shard": 0}"#);
    assert_eq!(nothing, Err("no policy is loaded yet".to_owned()));
}
