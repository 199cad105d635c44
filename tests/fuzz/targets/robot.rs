//! Robot descriptions: what is accepted is written, and read again, as the same robot.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use simulator::robot::Robot;

fn seeds() -> Vec<Vec<u8>> {
    let two_arms = include_str!("../../../sim-worker/simulator/robots/two-arm.toml");
    let seven = include_str!("../../../sim-worker/simulator/robots/seven-joints.toml");
    vec![two_arms.into(), seven.into(), fuzz::robot_toml().into()]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |text: &str| {
        let Ok(robot) = Robot::from_toml(text, Path::new("input.toml")) else { return };
        let written = robot.to_toml();
        let again = Robot::from_toml(&written, Path::new("again.toml"));
        let again = again.unwrap_or_else(|error| panic!("{error}: {written}"));
        assert_eq!(again.to_toml(), written);
    }
);
