//! What acts from outside changes momentum and energy by its impulse and its work.

use crate::robot::Joints;
use nalgebra::Vector3;

use super::*;
use crate::dynamics::reference_dynamics::{Momentum, kinetic_energy, momentum};
use crate::dynamics::tests::Noise;
use crate::robot::Robot;
use crate::scalar::{LaneFn, dispatch};
use crate::state::State;
use crate::step::{StepOptions, step, step_disturbed};

/// Training's scheme.
fn training() -> StepOptions {
    StepOptions { contacts: false, ..StepOptions::default() }
}

fn paper() -> Robot {
    Robot::builtin("paper").unwrap()
}

/// The robot after `steps` control steps of random commands.
fn moving(robot: &Robot, steps: usize) -> State<f64> {
    let (model, mut noise) = (Model::<f64>::new(robot), Noise(7));
    let mut ws = Workspace::new(&model);
    let mut state = State::<f64>::home(robot);
    for _ in 0..steps {
        let command: Vec<f64> = (0..robot.n_joints()).map(|_| 0.6 * noise.next()).collect();
        step(&model, &mut ws, &mut state, &command, &training());
    }
    state
}

/// `state` after one control step with zero commands under a disturbance.
fn struck(
    robot: &Robot,
    state: &State<f64>,
    disturbance: &Disturbance<f64>,
    options: &StepOptions,
) -> State<f64> {
    let model = Model::<f64>::new(robot);
    let mut ws = Workspace::new(&model);
    let mut state = state.clone();
    let command = vec![0.0; robot.n_joints()];
    step_disturbed(&model, &mut ws, &mut state, &command, options, disturbance);
    state
}

/// A pull of 50 N at the hand of arm 1 and of another at that of arm 3.
fn pull() -> Disturbance<f64> {
    let mut disturbance = Disturbance::none(&Joints::of_sixes(4));
    disturbance.hand_force[1] = [30.0, -24.0, 32.0];
    disturbance.hand_force[3] = [0.0, 10.0, -5.0];
    disturbance
}

/// F t, and ½ F t² / m on top of the way that the centre of mass goes anyway.
#[test]
fn a_force_leaves_its_impulse() {
    let robot = paper();
    let state = moving(&robot, 3);
    let after = struck(&robot, &state, &pull(), &training());
    let (m0, m1) = (momentum(&robot, &state), momentum(&robot, &after));
    let (force, t) = (Vector3::new(30.0, -14.0, 27.0), 0.4);
    let gained = m1.linear - m0.linear;
    // Put right by the impulse, whose sum over the substeps is exact but for roundings of numbers up to 1e3.
    assert!((gained - force * t).norm() < 1e-10, "{gained}");
    let way = (m0.linear * t + force * (0.5 * t * t)) / robot.total_mass();
    assert!((m1.com - m0.com - way).norm() < 1e-11, "{}", m1.com - m0.com - way);
}

#[test]
fn a_torque_leaves_its_angular_impulse_and_nothing_else() {
    let robot = paper();
    let state = moving(&robot, 3);
    let torque = Vector3::new(15.0, -20.0, 10.0);
    let disturbance =
        Disturbance { base_torque: torque.into(), ..Disturbance::none(&Joints::of_sixes(4)) };
    let after = struck(&robot, &state, &disturbance, &training());
    let (m0, m1) = (momentum(&robot, &state), momentum(&robot, &after));
    assert!((m1.angular - m0.angular - torque * 0.4).norm() < 1e-10, "{}", m1.angular);
    assert!((m1.linear - m0.linear).norm() < 1e-10, "{}", m1.linear);
}

/// ∫ r × F dt has no closed form: a hundred times finer steps say what it is. Without the impulse in the projection this is off by all of it, 8 kg m²/s.
#[test]
fn a_forces_angular_impulse_is_that_of_the_converged_solution() {
    let robot = paper();
    let state = moving(&robot, 3);
    let angular = |m: Momentum| m.angular;
    let before = angular(momentum(&robot, &state));
    let [ours, converged] = [0.016, 0.00016].map(|substep| {
        let options = StepOptions { substep, ..training() };
        angular(momentum(&robot, &struck(&robot, &state, &pull(), &options)))
    });
    assert!((converged - before).norm() > 5.0, "{}", converged - before);
    // Third order on an arm that answers within 50 ms.
    assert!((ours - converged).norm() < 1e-3, "{}", ours - converged);
}

/// A wrench is what the forces at hands and the torque on the base are, on any body and at any point.
#[test]
fn a_wrench_at_a_hand_is_a_pull_there_and_one_on_the_base_turns_it() {
    let robot = paper();
    let state = moving(&robot, 3);
    let tool: [f64; 3] = robot.types[0].tool_position.into();
    let at_hand = |arm: usize| {
        let link = Some(robot.joints.of_arm(arm).end - 1);
        Wrench { link, point: tool, force: pull().hand_force[arm], torque: [0.0; 3] }
    };
    let torque = [15.0, -20.0, 10.0];
    let on_base = Wrench { link: None, point: [0.0; 3], force: [0.0; 3], torque };
    let ours = Disturbance {
        wrenches: vec![at_hand(1), at_hand(3), on_base],
        ..Disturbance::none(&Joints::of_sixes(4))
    };
    let theirs = Disturbance { base_torque: torque, ..pull() };
    let [ours, theirs] = [ours, theirs].map(|d| struck(&robot, &state, &d, &training()));
    assert!((ours.qd[8] - state.qd[8]).abs() > 1e-3, "it does something");
    let numbers = |state: &State<f64>| {
        let base = [state.base_linear_velocity, state.base_angular_velocity].concat();
        [&base, &state.q, &state.qd].into_iter().flatten().copied().collect::<Vec<f64>>()
    };
    for (a, b) in numbers(&ours).into_iter().zip(numbers(&theirs)) {
        assert!((a - b).abs() < 1e-11, "{a} {b}");
    }
}

/// F t and, for a couple, τ t, whatever body they act on.
#[test]
fn a_wrench_on_any_body_leaves_its_impulse() {
    let robot = paper();
    let state = moving(&robot, 3);
    for link in [None, Some(0), Some(8), Some(23)] {
        let force = Vector3::new(12.0, -9.0, 20.0);
        let torque = Vector3::new(-4.0, 6.0, 3.0);
        let acts = |force: Vector3<f64>, torque: Vector3<f64>| {
            let point = [0.1, -0.05, 0.02];
            let wrench = Wrench { link, point, force: force.into(), torque: torque.into() };
            let disturbance =
                Disturbance { wrenches: vec![wrench], ..Disturbance::none(&Joints::of_sixes(4)) };
            let after = struck(&robot, &state, &disturbance, &training());
            (momentum(&robot, &state), momentum(&robot, &after))
        };
        let (before, after) = acts(force, Vector3::zeros());
        let gained = after.linear - before.linear;
        assert!((gained - force * 0.4).norm() < 1e-10, "{link:?}: {gained}");
        let (before, after) = acts(Vector3::zeros(), torque);
        let gained = after.angular - before.angular;
        assert!((gained - torque * 0.4).norm() < 1e-10, "{link:?}: {gained}");
        assert!((after.linear - before.linear).norm() < 1e-10, "{link:?}");
    }
}

/// ∫ r × F dt of a push at the edge of the base, and at an elbow.
#[test]
fn a_pushs_angular_impulse_is_that_of_the_converged_solution() {
    let robot = paper();
    let state = moving(&robot, 3);
    for (link, point) in [(None, [0.4, 0.4, -0.4]), (Some(7), [0.2, 0.0, 0.1])] {
        let wrench = Wrench { link, point, force: [30.0, -24.0, 32.0], torque: [0.0; 3] };
        let disturbance =
            Disturbance { wrenches: vec![wrench], ..Disturbance::none(&Joints::of_sixes(4)) };
        let before = momentum(&robot, &state).angular;
        let [ours, converged] = [0.016, 0.00016].map(|substep| {
            let options = StepOptions { substep, ..training() };
            momentum(&robot, &struck(&robot, &state, &disturbance, &options)).angular
        });
        assert!((converged - before).norm() > 3.0, "{}", converged - before);
        assert!((ours - converged).norm() < 1e-3, "{}", ours - converged);
    }
}

/// With all servos limp nothing but the given torque works.
#[test]
fn limp_joints_keep_their_energy_and_torques_do_their_work() {
    let robot = paper();
    let state = moving(&robot, 3);
    let fine = StepOptions { substep: 0.001, ..training() };
    let mut limp = Disturbance::none(&Joints::of_sixes(4));
    limp.servo.fill(0.0);
    let energy = |state: &State<f64>| kinetic_energy(&robot, state);
    let before = energy(&state);
    assert!(before > 1.0, "it moves");
    let coasting = struck(&robot, &state, &limp, &fine);
    assert!((energy(&coasting) - before).abs() < 1e-7 * before, "{}", energy(&coasting));
    // Held, the servos brake.
    let held = struck(&robot, &state, &Disturbance::none(&Joints::of_sixes(4)), &fine);
    assert!(energy(&held) < 0.5 * before, "{}", energy(&held));
    limp.joint_torque[8] = 7.0;
    let driven = struck(&robot, &state, &limp, &fine);
    let work = 7.0 * (driven.q[8] - state.q[8]);
    let gained = energy(&driven) - before;
    assert!(work.abs() > 0.1, "{work}");
    assert!((gained - work).abs() < 1e-6 * before, "{gained} {work}");
}

#[test]
fn no_disturbance_is_none() {
    let robot = paper();
    let state = moving(&robot, 3);
    for contacts in [false, true] {
        let options = StepOptions { contacts, ..training() };
        let model = Model::<f64>::new(&robot);
        let mut ws = Workspace::new(&model);
        let mut plain = state.clone();
        step(&model, &mut ws, &mut plain, &[0.0; 24], &options);
        let none = struck(&robot, &state, &Disturbance::none(&Joints::of_sixes(4)), &options);
        assert_eq!(plain, none, "contacts {contacts}");
    }
}

/// One episode a lane, each with a pull of its own; base and joints of every lane after three steps.
struct Lanes<'a>(&'a Robot);

impl LaneFn for Lanes<'_> {
    type Output = Vec<State<f64>>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let model = Model::<S>::new(self.0);
        let mut ws = Workspace::new(&model);
        let mut state = State::<S>::home(self.0);
        let command = vec![S::splat(0.2); self.0.n_joints()];
        let mut disturbance = Disturbance::<S>::none(&self.0.joints);
        for lane in 0..S::LANES {
            let force = 5.0 * lane as f64;
            disturbance.hand_force[0][2].set_lane(lane, -force);
            disturbance.joint_torque[13].set_lane(lane, force);
            disturbance.base_torque[1].set_lane(lane, force);
            if lane % 2 == 1 {
                for joint in 6..12 {
                    disturbance.servo[joint].set_lane(lane, 0.0);
                }
            }
        }
        let options = StepOptions::default();
        for _ in 0..3 {
            step_disturbed(&model, &mut ws, &mut state, &command, &options, &disturbance);
        }
        (0..S::LANES).map(|lane| state.lane(lane)).collect()
    }
}

#[test]
fn lanes_follow_the_f64_twin_each_with_its_own() {
    let robot = paper();
    let lanes = dispatch(Lanes(&robot));
    assert!(lanes.len() >= 8, "{} lanes", lanes.len());
    let model = Model::<f64>::new(&robot);
    for (lane, ours) in lanes.iter().enumerate() {
        let force = 5.0 * lane as f64;
        let mut disturbance = Disturbance::none(&Joints::of_sixes(4));
        disturbance.hand_force[0][2] = -force;
        disturbance.joint_torque[13] = force;
        disturbance.base_torque[1] = force;
        if lane % 2 == 1 {
            disturbance.servo[6..12].fill(0.0);
        }
        let mut ws = Workspace::new(&model);
        let mut state = State::<f64>::home(&robot);
        for _ in 0..3 {
            let options = StepOptions::default();
            step_disturbed(&model, &mut ws, &mut state, &[0.2; 24], &options, &disturbance);
        }
        // 27 substeps a period of about a thousand operations, in single precision: see the rollout's twin.
        for (a, b) in ours.q.iter().chain(&ours.qd).zip(state.q.iter().chain(&state.qd)) {
            assert!((a - b).abs() < 2e-4, "lane {lane}: {a} {b}");
        }
        for (a, b) in ours.base_angular_velocity.iter().zip(&state.base_angular_velocity) {
            assert!((a - b).abs() < 2e-5, "lane {lane}: {a} {b}");
        }
    }
    let turned = |state: &State<f64>| state.base_angular_velocity[1];
    assert!(turned(&lanes[7]) > turned(&lanes[4]), "a lane has its own");
}
