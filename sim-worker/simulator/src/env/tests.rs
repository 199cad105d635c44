#![expect(clippy::approx_constant, reason = "the released model's own rounded numbers")]

use crate::robot::Joints;
use proto::config::{Layers, Preset};

use super::*;
use crate::robot::Robot;
use crate::state::State;

#[test]
fn home_is_the_released_models() {
    let home = home(&Robot::builtin("release").expect("built in"));
    let quarter = -1.570796;
    let by_mujoco = [
        ([0.298824, 1.553659, 4.315298], [0.0, -0.001593, 0.0]),
        ([0.300802, -1.553659, 4.315300], [0.0, 0.0, 0.001593]),
        ([0.300802, 0.235300, 5.553659], [quarter, 0.0, 0.001593]),
        ([0.298824, 0.235298, 2.446341], [quarter, -0.001593, 0.0]),
    ];
    assert_eq!((home.base_position, home.base_euler), ([0.0, 0.0, 4.0], [0.0; 3]));
    for (arm, (position, euler)) in home.arms.iter().zip(by_mujoco) {
        for i in 0..3 {
            // Six decimals, and the released file's π/2 and π are rounded to about 1e-7.
            assert!((arm.position[i] - position[i]).abs() < 1e-6, "{:?}", arm.position);
            assert!((arm.euler[i] - euler[i]).abs() < 1e-6, "{:?}", arm.euler);
        }
        assert_eq!(arm.command_limit, [2.0942, 2.0942, 2.0942, 3.14, 3.14, 3.14]);
    }
    // Faces +y, −y, +z, −z.
    let normals: Vec<_> = home.arms.iter().map(|arm| arm.mount[2]).collect();
    assert_eq!(normals, [[0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]]);
}

#[test]
fn a_state_beyond_bounds_is_named() {
    let robot = Robot::builtin("paper").expect("built in");
    let mut state = State::<f64>::home(&robot);
    check_state(&Joints::of_sixes(4), &state, 40, 3, 8, 7).expect("home is fine");
    state.qd[13] = f64::NAN;
    let message =
        check_state(&Joints::of_sixes(4), &state, 40, 3, 8, 7).expect_err("NaN").to_string();
    // Joint 13 is the second joint of agent 4; lane 0 of the group at 3 of a shard from 40 on.
    assert!(
        message.contains("environment 43, step 7, agent 4: joint rate (rad/s) is NaN"),
        "{message}"
    );
    state.qd[13] = 0.0;
    state.base_position[1] = -2e3;
    let message =
        check_state(&Joints::of_sixes(4), &state, 40, 3, 8, 7).expect_err("far").to_string();
    assert!(message.contains("step 7: base position (m) is -2000, not within ±1000"), "{message}");
}

#[test]
fn a_configuration_chooses_the_integration() {
    let config = Layers::new(Preset::Tuned, None)
        .set("env.integrator=euler")
        .and_then(|layers| layers.set("env.substep=0.001"))
        .and_then(|layers| layers.resolve())
        .expect("valid");
    let options = step_options(&config);
    assert_eq!((options.control_period, options.substep), (0.4, 0.001));
    assert_eq!(options.integrator, crate::step::Integrator::Euler);
}
