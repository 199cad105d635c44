use simulator::robot::RobotDescription;

use super::*;

fn paper() -> Robot {
    Robot::builtin("paper").expect("built in")
}

/// The paper's robot with a change.
fn changed(change: impl FnOnce(&mut RobotDescription)) -> Robot {
    let mut description = paper().description().clone();
    change(&mut description);
    Robot::from_description(description, "mine.toml".as_ref()).expect("valid")
}

fn refused(robot: &Robot, words: &[&str]) {
    let error = shakedown(robot, "mine.toml", &StepOptions::default()).expect_err("unfit");
    assert_eq!(error.code, ExitCode::BadInput);
    for word in words.iter().chain(&["robot mine.toml: ", ", expected ", "; "]) {
        assert!(error.message.contains(word), "{:?} lacks {word:?}", error.message);
    }
}

#[test]
fn robots_that_ship_are_fit_with_a_wide_margin() {
    let two = include_str!("../../../../sim-worker/simulator/robots/two-arm.toml");
    let two = Robot::from_toml(two, "two-arm.toml".as_ref()).expect("valid");
    let builtin = Robot::builtin_names().map(|name| Robot::builtin(name).expect("built in"));
    for robot in builtin.chain([two]) {
        for (integrator, substep) in
            [(Integrator::Rk3, 0.016), (Integrator::Rk4, 0.01), (Integrator::Euler, 0.001)]
        {
            let options = StepOptions { integrator, substep, ..StepOptions::default() };
            shakedown(&robot, &robot.name, &options).expect("fit");
            let commands = commands(&robot, options.control_period);
            let finer = StepOptions { substep: substep / 4.0, ..options };
            let rows = simulate(&robot, &commands, Precision::F32, &options);
            let reference = simulate(&robot, &commands, Precision::F64, &finer);
            for (row, finer) in rows.iter().zip(&reference) {
                for (hand, finer) in row.hands.iter().flatten().zip(finer.hands.iter().flatten()) {
                    assert!((hand - finer).abs() < 0.1 * HAND_TOLERANCE, "{hand} {finer}");
                }
            }
        }
    }
}

/// No reason to refuse: heavy arms on a base that weighs nearly nothing, or as much as a station.
#[test]
fn unusual_masses_are_fit() {
    let heavy = paper().with_arm_mass(3.0).expect("valid");
    for mass in [10.0, 1000.0, 4e5] {
        let robot = heavy.with_base_mass(mass).expect("valid");
        shakedown(&robot, "heavy", &StepOptions::default()).expect("fit");
    }
}

#[test]
fn an_arm_that_stands_inside_the_base_is_named() {
    let inside = changed(|robot| robot.arms[1].mount_position = [0.0; 3]);
    let pair = "`upper_arm` of arm `minus_y` touches the base (`cube`) at home";
    refused(&inside, &[pair, "change mount_position", "arms[1] (minus_y)"]);
}

#[test]
fn arms_that_stand_in_each_other_are_named() {
    let twice = changed(|robot| {
        let mut shifted = robot.arms[0].clone();
        shifted.name = "second".to_owned();
        shifted.mount_position[0] -= 0.25;
        robot.arms.truncate(1);
        robot.arms.push(shifted);
    });
    shakedown(&twice, "far enough", &StepOptions::default()).expect("fit");
    let mut description = twice.description().clone();
    description.arms[1].mount_position[0] += 0.15;
    let near = Robot::from_description(description, "mine.toml".as_ref()).expect("valid");
    refused(&near, &[" of arm `plus_y`, `second` touches ", "arms[0] (plus_y), arms[1] (second)"]);
}

#[test]
fn a_joint_that_stands_in_a_stop_is_named() {
    let stopped = changed(|robot| robot.arms[1].home[1] = 1.5);
    let pair = "`mount` and `upper_arm` of arm `minus_y` touch at home (and ";
    refused(
        &stopped,
        &[pair, "joint 2 stands at 1.5 rad, within stops[0]", "arms[1] (minus_y).home"],
    );
}

#[test]
fn a_part_that_drowns_the_others_is_named() {
    refused(
        &changed(|robot| robot.base[0].mass = 1e30),
        &["base[0] (cube).mass is 1e30 kg", "in kg"],
    );
    let link = changed(|robot| robot.links[1].mass = 1e30);
    refused(&link, &["links[1] (upper_arm).mass is 1e30 kg"]);
    let wide = changed(|robot| robot.links[1].inertia = robot.links[1].inertia.map(|x| 1e30 * x));
    refused(&wide, &["links[1] (upper_arm).inertia holds 3.5"]);
}

#[test]
fn a_servo_faster_than_the_substeps_is_named_with_the_cure() {
    let light = changed(|robot| robot.links[3].armature = 0.001);
    let cure = "more armature, less gain or a smaller substep";
    refused(&light, &["links[3] (wrist_1).servo.gain is 50 N m s/rad", cure]);
}

#[test]
fn a_joint_that_its_servo_does_not_move_is_named() {
    let weak = changed(|robot| {
        for link in &mut robot.links {
            link.servo.max_torque = 1e-9;
        }
    });
    refused(&weak, &["joint 1 of arm `plus_y` has moved by ", "a torque that is far"]);
    // So is one that nothing can move.
    let heavy = changed(|robot| {
        for link in &mut robot.links {
            link.mass *= 1e20;
            link.inertia = link.inertia.map(|x| 1e20 * x);
        }
        robot.base[0].mass = 1e22;
    });
    refused(&heavy, &["a mass, an inertia"]);
}
