//! Robots of other programs: what is taken in is a robot, or refused as a robot file would be; nothing panics.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use simulator::robot::Robot;
use simulator::robot::urdf::urdf;

fn seeds() -> Vec<Vec<u8>> {
    let two_arms = include_str!("../../../sim-worker/simulator/robots/two-arm.toml");
    let robot = Robot::from_toml(two_arms, Path::new("two-arm.toml")).expect("a robot");
    vec![urdf(&robot).into()]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |text: &str| {
        let Ok(imported) = ::urdf::import(text, None, [0.0, 0.0, 4.0]) else { return };
        let Ok(robot) = Robot::from_description(imported.description, Path::new("input.urdf")) else { return };
        let written = robot.to_toml();
        let again = Robot::from_toml(&written, Path::new("again.toml"));
        let again = again.unwrap_or_else(|error| panic!("{error}: {written}"));
        assert_eq!(again.to_toml(), written);
    }
);
