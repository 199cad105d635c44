//! Every layout and every term, worked by hand in `f64`.
#![expect(clippy::approx_constant, reason = "the released model's own rounded numbers")]

use crate::robot::Joints;
use proto::config::{Config, JointAngles, Layers, Preset, Reward, TaskName};
use proto::layout::Dimensions;
use proto::rng::Purpose;

use super::goal::GoalAddress;
use super::observation::observe;
use super::reward::rewards;
use super::state::critic_state;
use super::*;
use crate::collision::Touching;
use crate::env::Physics;
use crate::model::ContactKind;
use crate::robot::{MAX_ARMS, Robot};
use crate::scalar::{LaneFn, Real, dispatch};
use crate::spatial::{
    add, euler_xyz, euler_xyz_to_rotation, mat_mat, mat_t_vec, mat_vec, quaternion_exp,
    quaternion_product, quaternion_to_rotation,
};
use crate::state::State;
use crate::step::StepOptions;

/// The released robot at home, from `reference` values of its model.
fn home() -> Home {
    let arm = |q: [f64; 6], position, euler, mount| HomeArm {
        q: q.to_vec(),
        command_limit: vec![2.0942, 2.0942, 2.0942, 3.14, 3.14, 3.14],
        position,
        euler,
        mount,
    };
    let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let minus = |axis: [f64; 3]| axis.map(|c| -c);
    let half = std::f64::consts::FRAC_PI_2;
    let turned = [3.14, -1.57, 0.0, -1.57, 0.0, 3.14];
    let straight = [0.0, -1.57, 0.0, -1.57, 0.0, 0.0];
    Home {
        base_position: [0.0, 0.0, 4.0],
        base_euler: [0.0; 3],
        arms: vec![
            // Mounts are turned about x by −π/2, π/2, 0 and π: their y and z axes.
            arm(turned, [0.298824, 1.553659, 4.315298], [0.0, -0.001593, 0.0], [x, minus(z), y]),
            arm(straight, [0.300802, -1.553659, 4.315300], [0.0, 0.0, 0.001593], [x, z, minus(y)]),
            arm(straight, [0.300802, 0.235300, 5.553659], [-half, 0.0, 0.001593], [x, y, z]),
            arm(
                turned,
                [0.298824, 0.235298, 2.446341],
                [-half, -0.001593, 0.0],
                [x, minus(y), minus(z)],
            ),
        ],
    }
}

fn config(preset: Preset, name: TaskName) -> Config {
    Layers::new(preset, Some(name)).resolve().expect("valid")
}

/// A state in which every number says where it comes from.
fn readings() -> Readings<f64> {
    let mut r = Readings::new(&Joints::of_sixes(4));
    r.base_position = [0.1, 0.2, 4.3];
    r.base_quaternion = [0.7, 0.1, 0.5, 0.5];
    r.base_euler = [0.01, -0.02, 0.03];
    r.base_linear = [1.1, 1.2, 1.3];
    r.base_angular = [2.1, 2.2, 2.3];
    for j in 0..24 {
        r.q[j] = 100.0 + j as f64;
        r.qd[j] = 200.0 + j as f64;
        r.last_action[j] = 300.0 + j as f64;
    }
    for (arm, hand) in r.hands.iter_mut().enumerate() {
        let a = arm as f64;
        hand.position = [10.0 + a, 11.0 + a, 12.0 + a];
        hand.euler = [20.0 + a, 21.0 + a, 22.0 + a];
        hand.linear = [50.0, 100.0, -50.0];
        hand.angular = [5.0, 10.0, -5.0];
    }
    r
}

fn goals() -> Goals<f64> {
    // Arm i: position errors (0.03, 0.04, 0) + i/100 in z, Euler errors (0, 0, −0.1).
    let hand = |arm: usize| {
        let a = arm as f64;
        [10.03 + a, 11.04 + a, 12.0 + a + 0.01 * a, 20.0 + a, 21.0 + a, 21.9 + a]
    };
    Goals::fixed((0..4).map(hand).collect(), [0.05, 0.01, -0.06])
}

fn errors() -> Errors<f64> {
    let mut errors = Errors::new(4);
    errors.update(&readings(), &goals());
    errors
}

fn observed(preset: Preset, name: TaskName, agent: usize) -> Vec<f64> {
    let config = config(preset, name);
    let task = Task::new(&config, home());
    let mut out = vec![f64::NAN; Dimensions::new(&config, Joints::of_sixes(4)).observation];
    observe(&task, &readings(), &goals(), &errors(), agent, &mut out);
    out
}

fn assert_close(actual: &[f64], expected: &[f64]) {
    assert_eq!(actual.len(), expected.len());
    for (i, (a, e)) in actual.iter().zip(expected).enumerate() {
        // A few roundings of numbers up to 300.
        assert!((a - e).abs() < 1e-12 * e.abs().max(1.0), "index {i}: {a}, by hand {e}");
    }
}

const BASE: [f64; 7] = [0.1, 0.2, 4.3, 0.7, 0.1, 0.5, 0.5];
const BASE_VELOCITY: [f64; 6] = [1.1, 1.2, 1.3, 2.1, 2.2, 2.3];

#[test]
fn released_observation_of_a_position_and_an_orientation_agent() {
    // Agent 2: arm 1 (second), joints 6…8. Tip velocity × 0.02.
    let mut expected = BASE.to_vec();
    expected.extend([106.0, 107.0, 108.0]);
    expected.extend(BASE_VELOCITY);
    expected.extend([206.0, 207.0, 208.0, 11.0, 12.0, 13.0, 1.0, 2.0, -1.0]);
    expected.extend([11.03, 12.04, 13.01, 21.0, 22.0, 22.9]);
    assert_close(&observed(Preset::Release, TaskName::Trajectory, 2), &expected);

    // Agent 3: same arm, joints 9…11, Euler angles and angular velocity × 0.02.
    let mut expected = BASE.to_vec();
    expected.extend([109.0, 110.0, 111.0]);
    expected.extend(BASE_VELOCITY);
    expected.extend([209.0, 210.0, 211.0, 21.0, 22.0, 23.0, 0.1, 0.2, -0.1]);
    expected.extend([11.03, 12.04, 13.01, 21.0, 22.0, 22.9]);
    assert_close(&observed(Preset::Release, TaskName::Trajectory, 3), &expected);
}

#[test]
fn papers_observation_leaves_the_hand_velocity_out() {
    let mut expected = BASE.to_vec();
    expected.extend([121.0, 122.0, 123.0]);
    expected.extend(BASE_VELOCITY);
    expected.extend([221.0, 222.0, 223.0, 23.0, 24.0, 25.0]);
    expected.extend([13.03, 14.04, 15.03, 23.0, 24.0, 24.9]);
    assert_close(&observed(Preset::Paper, TaskName::Trajectory, 7), &expected);
}

#[test]
fn reorientation_observation_ends_with_base_and_goal_attitude() {
    let mut expected = BASE.to_vec();
    expected.extend([112.0, 113.0, 114.0]);
    expected.extend(BASE_VELOCITY);
    expected.extend([212.0, 213.0, 214.0, 0.01, -0.02, 0.03, 0.05, 0.01, -0.06]);
    for preset in [Preset::Paper, Preset::Release] {
        assert_close(&observed(preset, TaskName::Reorientation, 4), &expected);
    }
}

/// Base relative to its home (0, 0, 4), then velocities.
const TUNED_BASE: [f64; 13] = [
    0.1, 0.2, 0.3, 0.7, 0.1, 0.5, 0.5, //
    1.1, 1.2, 1.3, 2.1, 2.2, 2.3,
];

/// Angles of arm 2 (third): 112…117 less home (0, −1.57, 0, −1.57, 0, 0).
const ARM_2_ANGLES: [f64; 6] = [112.0, 114.57, 114.0, 116.57, 116.0, 117.0];
/// Its rates.
const ARM_2_RATES: [f64; 6] = [212.0, 213.0, 214.0, 215.0, 216.0, 217.0];

/// Joints of arm 2: sines, cosines, rates.
fn tuned_joints() -> Vec<f64> {
    [ARM_2_ANGLES.map(f64::sin), ARM_2_ANGLES.map(f64::cos), ARM_2_RATES].concat()
}

/// Velocities of the base in its axes: the linear one is turned by the quaternion's inverse.
const TUNED_BASE_SEEN: [f64; 6] = [0.18, 0.748, 1.936, 2.1, 2.2, 2.3];

/// `v` in the base's axes; rows of the quaternion's rotation are (0, −0.6, 0.8), (0.8, 0.48, 0.36)
/// and (−0.6, 0.64, 0.48).
fn in_base([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        0.8 * y - 0.6 * z,
        -0.6 * x + 0.48 * y + 0.64 * z,
        0.8 * x + 0.36 * y + 0.48 * z, //
    ]
}

/// `e` and its tanh at two widths, alternating as agents see them.
fn at_widths(e: [f64; 3], widths: [f64; 2]) -> [Vec<f64>; 2] {
    [e.to_vec(), widths.iter().flat_map(|width| e.map(|x| (x / width).tanh())).collect()]
}

/// Errors of arm 2: (0.03, 0.04, 0.02), and the last Euler angle shall turn by −0.1 about the hand's third axis.
fn tuned_errors() -> Vec<f64> {
    let (a, b) = (22.0_f64, 23.0_f64);
    let axis = [b.sin(), -a.sin() * b.cos(), a.cos() * b.cos()];
    let [position, p] = at_widths(in_base([0.03, 0.04, 0.02]), [0.05, 0.015]);
    let turn = in_base(axis.map(|x| -2.0 * 0.05_f64.sin() * x));
    let [rotation, r] = at_widths(turn, [0.08, 0.025]);
    [position, rotation, p, r].concat()
}

/// The quaternion of the base's goal as seen from the base, twice its vector part.
fn tuned_base_errors() -> Vec<f64> {
    let [x, y, z] = goals().base;
    let [x, y, z] = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]].map(quaternion_exp);
    let goal = quaternion_product(&quaternion_product(&x, &y), &z);
    let [w, x, y, z] = readings().base_quaternion;
    let [w, x, y, z] = quaternion_product(&[w, -x, -y, -z], &goal);
    let [plain, squashed] = at_widths([x, y, z].map(|c| 2.0 * w.signum() * c), [0.08, 0.025]);
    [plain, squashed].concat()
}

const TUNED_ACTION: [f64; 6] = [312.0, 313.0, 314.0, 315.0, 316.0, 317.0];

#[test]
fn tuned_observation_is_the_same_for_both_agents_of_an_arm() {
    let mut expected = TUNED_BASE_SEEN.to_vec();
    expected.extend(tuned_joints());
    expected.extend(tuned_errors());
    expected.extend(TUNED_ACTION);
    assert_close(&observed(Preset::Tuned, TaskName::Trajectory, 4), &expected);
    assert_close(&observed(Preset::Tuned, TaskName::Trajectory, 5), &expected);

    let mut expected = TUNED_BASE_SEEN.to_vec();
    expected.extend(tuned_joints());
    expected.extend(tuned_base_errors());
    expected.extend(TUNED_ACTION);
    assert_close(&observed(Preset::Tuned, TaskName::Reorientation, 4), &expected);
}

/// What agent 4 and critics of preset `tuned` see when the joints of arm 2 have made more turns.
fn seen_after_turns(joint_angles: JointAngles, turns: f64) -> [Vec<f64>; 2] {
    let mut config = config(Preset::Tuned, TaskName::Trajectory);
    config.task.joint_angles = joint_angles;
    let task = Task::new(&config, home());
    let mut readings = readings();
    for q in &mut readings.q[12..18] {
        *q += turns * std::f64::consts::TAU;
    }
    let sizes = Dimensions::new(&config, Joints::of_sixes(4));
    let mut seen = [sizes.observation, sizes.state].map(|len| vec![f64::NAN; len]);
    observe(&task, &readings, &goals(), &errors(), 4, &mut seen[0]);
    critic_state(&task, &readings, &errors(), &[], &mut seen[1]);
    seen
}

#[test]
fn unwound_angles_stand_where_sines_and_cosines_do() {
    let [actor, critic] = seen_after_turns(JointAngles::Unwound, 0.0);
    let [tuned, tuned_critic] = seen_after_turns(JointAngles::SinCos, 0.0);
    let joints = [ARM_2_ANGLES, ARM_2_RATES].concat();
    assert_close(&actor, &[&tuned[..6], &joints, &tuned[24..]].concat());
    // 13, then two arms of 36; or of 42.
    assert_close(&critic[85..121], &[&joints, &tuned_critic[115..139]].concat());
    let [turned, _] = seen_after_turns(JointAngles::Unwound, 1.0);
    assert!(turned.iter().zip(&actor).filter(|(a, b)| a != b).count() == 6);
}

#[test]
fn with_sines_and_cosines_a_turn_more_is_the_same_pose() {
    let [actor, critic] = seen_after_turns(JointAngles::SinCos, 0.0);
    for turns in [-3.0, 1.0] {
        let turned = seen_after_turns(JointAngles::SinCos, turns).concat();
        for (turned, still) in turned.iter().zip(actor.iter().chain(&critic)) {
            assert!((turned - still).abs() < 1e-12, "{turned} instead of {still}");
        }
    }
}

/// A robot, its goals and all velocities are moved and turned as one: no arm of preset `tuned` sees it.
#[test]
fn tuned_observations_do_not_tell_where_the_base_is() {
    let robot = Robot::builtin("paper").expect("built in");
    let mut state = State::<f64>::home(&robot);
    for (j, (q, qd)) in state.q.iter_mut().zip(&mut state.qd).enumerate() {
        *q += 0.3 * (j as f64).sin();
        *qd = 0.5 * (2.0 * j as f64).cos();
    }
    state.base_quaternion = quaternion_exp([0.1, -0.2, 0.05]);
    (state.base_linear_velocity, state.base_angular_velocity) =
        ([0.02, -0.03, 0.01], [0.05, 0.06, -0.07]);
    let turn = quaternion_exp([0.4, 0.3, -0.35]);
    let rotation = quaternion_to_rotation(&turn);
    let moved = State {
        base_position: add(mat_vec(&rotation, state.base_position), [3.0, -2.0, 1.0]),
        base_quaternion: quaternion_product(&turn, &state.base_quaternion),
        base_linear_velocity: mat_vec(&rotation, state.base_linear_velocity),
        ..state.clone()
    };
    let turned = |euler: [f64; 3]| euler_xyz(&mat_mat(&rotation, &euler_xyz_to_rotation(euler)));

    let mut physics = Physics::with_options(&robot, StepOptions::default());
    for name in [TaskName::Trajectory, TaskName::Reorientation] {
        let config = config(Preset::Tuned, name);
        let task = Task::new(&config, crate::env::home(&robot));
        let address = GoalAddress { seed: 3, purpose: Purpose::Goal, iteration: 0, env: 1 };
        let mut goals = Goals::at_home(&task.goals);
        goals.draw(&task, address, 0);
        let mut far = goals.clone();
        for pose in &mut far.hands {
            let [x, y, z, a, b, c] = *pose;
            let position = add(mat_vec(&rotation, [x, y, z]), [3.0, -2.0, 1.0]);
            pose[..3].copy_from_slice(&position);
            pose[3..].copy_from_slice(&turned([a, b, c]));
        }
        far.base = turned(goals.base);
        let mut seen = |state: &State<f64>, goals: &Goals<f64>, agent: usize| {
            let mut readings = Readings::new(&robot.joints);
            physics.read(state, &mut readings);
            let mut errors = Errors::new(robot.n_arms);
            errors.update(&readings, goals);
            let mut out = vec![f64::NAN; Dimensions::new(&config, robot.joints).observation];
            observe(&task, &readings, goals, &errors, agent, &mut out);
            out
        };
        for agent in 0..8 {
            assert_close(&seen(&moved, &far, agent), &seen(&state, &goals, agent));
        }
        assert_ne!(seen(&moved, &goals, 0), seen(&state, &goals, 0), "the goal has not moved");
    }
}

#[test]
fn compact_critic_state_holds_every_quantity_once() {
    for name in [TaskName::Trajectory, TaskName::Reorientation] {
        let config = config(Preset::Tuned, name);
        let task = Task::new(&config, home());
        let mut out = vec![f64::NAN; Dimensions::new(&config, Joints::of_sixes(4)).state];
        critic_state(&task, &readings(), &errors(), &[], &mut out);
        assert_close(&out[..13], &TUNED_BASE);
        let (arm_2, of_arm) = if name == TaskName::Trajectory {
            // 13, then two arms of 42.
            assert_close(&out[13 + 84 + 18..13 + 84 + 36], &tuned_errors());
            (13 + 84, 42)
        } else {
            assert_close(&out[13..22], &tuned_base_errors());
            (22 + 48, 24)
        };
        assert_close(&out[arm_2..arm_2 + 18], &tuned_joints());
        assert_close(&out[arm_2 + of_arm - 6..arm_2 + of_arm], &TUNED_ACTION);
    }
}

/// Arms 0 and 1 of four reach in `mixed`, arms 2 and 3 turn the base.
#[test]
fn in_a_mixed_task_all_see_the_base_and_hands_are_seen_by_those_that_reach() {
    let reaching = observed(Preset::Tuned, TaskName::Trajectory, 2);
    let mixed = observed(Preset::Tuned, TaskName::Mixed, 2);
    assert_eq!(mixed.len(), 57);
    assert_eq!(mixed[..42], reaching[..42]);
    assert_eq!(mixed[51..], reaching[42..]);
    let turning = observed(Preset::Tuned, TaskName::Reorientation, 4);
    let mixed = observed(Preset::Tuned, TaskName::Mixed, 4);
    assert_eq!(mixed[..24], turning[..24]);
    assert_eq!(mixed[24..42], [0.0; 18]);
    assert_eq!(mixed[42..], turning[24..]);

    let config = config(Preset::Tuned, TaskName::Mixed);
    let mut out = vec![f64::NAN; Dimensions::new(&config, Joints::of_sixes(4)).state];
    critic_state(&Task::new(&config, home()), &readings(), &errors(), &[], &mut out);
    assert_close(&out[13..22], &tuned_base_errors());
    // Then four arms of 42; arm 2 has no goal for its hand.
    assert_eq!(out[22 + 84 + 18..22 + 84 + 36], [0.0; 18]);
    assert!(out[22 + 42 + 18..22 + 42 + 36].iter().all(|x| *x != 0.0));
}

#[test]
fn in_a_mixed_task_each_is_paid_for_what_it_aims_at() {
    let of = |name| paid(Preset::Tuned, name, true);
    let (mixed, reaching) = (of(TaskName::Mixed), of(TaskName::Trajectory));
    assert_eq!(mixed[..4], reaching[..4]);
    // As all are paid in `reorientation`, but for the motion of arm 0, which is not theirs: 6.25 × (0.01 + 0.05).
    let turning = of(TaskName::Reorientation)[0];
    for paid in &mixed[4..] {
        assert!((paid - (turning + 0.375)).abs() < 1e-12, "{paid} {turning}");
    }
}

/// A goal that moves is seen to: its velocity, in the axes of the base and then of the arm.
#[test]
fn the_motion_of_a_goal_is_seen_beside_its_place() {
    let config = config(Preset::Tuned, TaskName::Capture);
    let task = Task::new(&config, home());
    let address = GoalAddress { seed: 3, purpose: Purpose::Goal, iteration: 0, env: 1 };
    let mut goals = Goals::<f64>::at_home(&task.goals);
    goals.draw(&task, address, 0);
    goals.attach();
    let mut readings = readings();
    let length = readings.base_quaternion.map(|x| x * x).iter().sum::<f64>().sqrt();
    readings.base_quaternion = readings.base_quaternion.map(|x| x / length);
    let mut seen = vec![f64::NAN; Dimensions::new(&config, Joints::of_sixes(4)).observation];
    let mut errors = Errors::new(4);
    errors.update(&readings, &goals);
    // Agent 4 is of arm 2, whose frame has the base's axes.
    observe(&task, &readings, &goals, &errors, 4, &mut seen);
    assert_eq!(seen.len(), 54);
    let before = goals.hands[2];
    let time = 1e-4;
    goals.advance(time);
    let after = goals.hands[2];
    let moved = std::array::from_fn(|i| (after[i] - before[i]) / time);
    let wanted = mat_t_vec(&quaternion_to_rotation(&readings.base_quaternion), moved);
    for (seen, wanted) in seen[42..45].iter().zip(wanted) {
        assert!((seen - wanted).abs() < 1e-6, "{seen} {wanted}");
    }
    assert!(seen[45..48].iter().any(|rate| rate.abs() > 1e-5), "{:?}", &seen[45..48]);
}

/// Goals of two tasks, drawn one after the other, in all lanes or in the first alone.
struct DrawnAgain {
    first_alone: bool,
}

impl LaneFn for DrawnAgain {
    type Output = ();
    #[inline(always)]
    fn call<S: Real>(self) {
        let [capture, reaching] = [TaskName::Capture, TaskName::Trajectory]
            .map(|name| Task::new(&config(Preset::Tuned, name), home()));
        let address = |lane| {
            let (purpose, env) = (Purpose::Goal, lane as u32);
            GoalAddress { seed: 3, purpose, iteration: 0, env }
        };
        let mut goals = Goals::<S>::at_home(&capture.goals);
        (0..S::LANES).for_each(|lane| goals.draw(&capture, address(lane), lane));
        let again = if self.first_alone { 1 } else { S::LANES };
        (0..again).for_each(|lane| goals.draw(&reaching, address(lane), lane));
        goals.attach();
        let Some(rates) = goals.hand_velocities() else {
            assert_eq!(again, S::LANES, "a body of other lanes is gone");
            return;
        };
        assert!(again < S::LANES, "nothing moves");
        for lane in 0..S::LANES {
            let rest = rates.iter().flatten().all(|rate| rate.lane(lane) == 0.0);
            assert_eq!(rest, lane == 0, "lane {lane}");
        }
        let before = goals.hands.clone();
        goals.advance(0.4);
        for (after, before) in goals.hands.iter().flatten().zip(before.iter().flatten()) {
            assert!((after.lane(0) - before.lane(0)).abs() < 1e-5);
        }
    }
}

#[test]
fn a_lane_that_is_drawn_again_leaves_the_bodies_of_others() {
    for first_alone in [true, false] {
        dispatch(DrawnAgain { first_alone });
    }
}

#[test]
fn concatenated_critic_state_is_all_observations_in_agent_order() {
    let config = config(Preset::Release, TaskName::Trajectory);
    let task = Task::new(&config, home());
    let observations: Vec<f64> =
        (0..8).flat_map(|a| observed(Preset::Release, TaskName::Trajectory, a)).collect();
    let mut out = vec![f64::NAN; 248];
    critic_state(&task, &readings(), &errors(), &observations, &mut out);
    assert_eq!(out, observations);
}

fn paid(preset: Preset, name: TaskName, count: bool) -> Vec<f64> {
    paid_with(preset, name, |reward| {
        reward.count_collisions = count;
        reward.own_collisions = false;
        reward.team_spirit = 0.0;
        // What preset `tuned` asks for contacts and effort is its own.
        if preset == Preset::Tuned {
            for weights in [&mut reward.position, &mut reward.orientation, &mut reward.base] {
                weights.collision = 0.5;
                weights.effort = 0.05;
            }
        }
    })
}

/// Three pairs touch, one within arm 0 and the others elsewhere.
fn paid_with(preset: Preset, name: TaskName, change: impl Fn(&mut Reward)) -> Vec<f64> {
    let mut config = config(preset, name);
    change(&mut config.task.reward);
    let task = Task::new(&config, home());
    // Arm 0 acts (1, 0.5, −1 | 2, 0, 0) after (0.5, 0.5, 0 | 0, 0, 1); the others rest.
    let (mut action, mut last) = (vec![0.0; 24], vec![0.0; 24]);
    action[..6].copy_from_slice(&[1.0, 0.5, -1.0, 2.0, 0.0, 0.0]);
    last[..6].copy_from_slice(&[0.5, 0.5, 0.0, 0.0, 0.0, 1.0]);
    let mut out = vec![f64::NAN; 8];
    let mut by_arm = [0.0; MAX_ARMS];
    by_arm[0] = 1.0;
    let touching =
        Touching { pairs: 3.0, by_kind: [0.0; ContactKind::COUNT], by_arm, penetration: 0.0 };
    rewards(&task, &errors(), &action, &last, &touching, &mut out);
    out
}

#[test]
fn released_rewards_by_hand() {
    // Arm 0: d = 0.05, d² = 0.0025; log10(0.002501) = −2.6018863; 0.001·d² = 2.5e-6;
    // ‖Δu‖² = 0.25 + 0 + 1 = 1.25, × 0.01 = 0.0125. r = 2.6018863 − 0.0000025 − 0.0125.
    // e = 0.2·0.1 = 0.02, e² = 0.0004; log10(0.000401) = −3.3968556; 4e-7;
    // ‖u‖² = 4, × 0.05 = 0.2. r = 3.3968556 − 0.0000004 − 0.2.
    // Arm 2, at rest: d² = 0.0009 + 0.0016 + 0.0004 = 0.0029; log10(0.002901) = −2.5374523.
    let r = paid(Preset::Release, TaskName::Trajectory, true);
    for (agent, by_hand) in
        [(0, 2.5893838), (1, 3.1968552), (4, 2.5374523 - 2.9e-6), (5, 3.3968552)]
    {
        assert!((r[agent] - by_hand).abs() < 2e-7, "agent {agent}: {} vs {by_hand}", r[agent]);
    }
    // Base: e² = 0.0016 + 0.0009 + 0.0081 = 0.0106; log10(0.010601) = −1.9746532; no quadratic
    // term. ‖Δu‖² = 1.25 + 4 + 1 = 6.25, × 0.01 = 0.0625; ‖u‖² = 2.25 + 4 = 6.25, × 0.05 = 0.3125;
    // 0.5 × 3 pairs = 1.5. r = 1.9746532 − 0.0625 − 0.3125 − 1.5.
    for r in paid(Preset::Release, TaskName::Reorientation, true) {
        assert!((r - 0.0996532).abs() < 2e-7, "{r}");
    }
}

#[test]
fn papers_rewards_by_hand() {
    for preset in [Preset::Paper, Preset::Tuned] {
        // All terms for all agents. Position agent of arm 0: as released, and 0.05·‖u‖² with
        // ‖u‖² = 2.25: 0.1125, and 0.5 × 3 = 1.5. r = 2.5893838 − 0.1125 − 1.5 = 0.9768838.
        // Orientation agent: e = 0.1, e² = 0.01; log10(0.010001) = −1.9999566; 0.001·e² = 1e-5;
        // ‖Δu‖² = 4 + 1 = 5, × 0.01 = 0.05; ‖u‖² = 4, × 0.05 = 0.2; 1.5. r = 0.2499466.
        let r = paid(preset, TaskName::Trajectory, true);
        assert!((r[0] - 0.9768838).abs() < 2e-7, "{}", r[0]);
        assert!((r[1] - 0.2499466).abs() < 2e-7, "{}", r[1]);
        // As an indicator the three pairs cost 0.5.
        let r = paid(preset, TaskName::Trajectory, false);
        assert!((r[0] - 1.9768838).abs() < 2e-7, "{}", r[0]);
        // Base: as released, less 0.001 · 0.0106.
        let r = paid(preset, TaskName::Reorientation, true);
        assert!((r[7] - 0.0996426).abs() < 2e-7, "{}", r[7]);
    }
}

#[test]
fn what_agents_share_and_what_they_answer_for_by_hand() {
    let own = |reward: &mut Reward| {
        reward.count_collisions = true;
        reward.own_collisions = true;
    };
    let r = paid_with(Preset::Paper, TaskName::Trajectory, own);
    // As by hand above, with 0.5 × 1 pair for arm 0 and none for arm 1, which rests at the goal's side.
    let all = paid(Preset::Paper, TaskName::Trajectory, true);
    for (agent, less) in [(0, 1.0), (1, 1.0), (2, 1.5), (7, 1.5)] {
        assert!((r[agent] - all[agent] - less).abs() < 1e-12, "agent {agent}");
    }
    let shared = paid_with(Preset::Paper, TaskName::Trajectory, |reward| {
        own(reward);
        reward.team_spirit = 0.5;
    });
    // Half of one's own, and half of the mean.
    assert!((shared[0] - (0.75 * r[0] + 0.25 * r[1])).abs() < 1e-12);
    assert!((shared[1] - (0.25 * r[0] + 0.75 * r[1])).abs() < 1e-12);
    // The base's reward is everybody's, less what the arm touches.
    let base = paid(Preset::Paper, TaskName::Reorientation, true);
    let r = paid_with(Preset::Paper, TaskName::Reorientation, own);
    for (agent, less) in [(0, 1.0), (1, 1.0), (2, 1.5), (7, 1.5)] {
        assert!((r[agent] - base[agent] - less).abs() < 1e-12, "agent {agent}");
    }
}

#[test]
fn hand_goals_fill_the_released_boxes_and_no_more() {
    let config = config(Preset::Release, TaskName::Trajectory);
    let task = Task::new(&config, home());
    // Directions of (x, inward, lateral) in the world: the released code's signs.
    let y = |s: f64| [0.0, s, 0.0];
    let z = |s: f64| [0.0, 0.0, s];
    let directions = [[y(-1.0), z(1.0)], [y(1.0), z(-1.0)], [z(-1.0), y(-1.0)], [z(1.0), y(1.0)]];
    let euler_ranges = [
        [[-0.2, 0.3], [-0.15, 0.35], [-0.3, 0.2]],
        [[-0.2, 0.3], [-0.35, 0.15], [-0.2, 0.3]],
        [[0.5, 1.0], [-0.15, 0.35], [-0.3, 0.2]],
        [[0.5, 1.0], [-0.35, 0.15], [-0.2, 0.3]],
    ];
    for arm in 0..4 {
        let mut seen = [[f64::INFINITY, f64::NEG_INFINITY]; 6];
        for env in 0..2000 {
            let address = GoalAddress { seed: 1, purpose: Purpose::Goal, iteration: 0, env };
            let pose = task.goals.hand(arm, address);
            let home = &task.goals.home.arms[arm];
            let offset: Vec<f64> = (0..3).map(|i| pose[i] - home.position[i]).collect();
            let dot = |axis: [f64; 3]| (0..3).map(|i| axis[i] * offset[i]).sum::<f64>();
            let [inward, lateral] = directions[arm];
            let mut numbers = [offset[0], dot(inward), dot(lateral), 0.0, 0.0, 0.0];
            for i in 0..3 {
                numbers[3 + i] = pose[3 + i] - home.euler[i];
            }
            for (seen, number) in seen.iter_mut().zip(numbers) {
                *seen = [seen[0].min(number), seen[1].max(number)];
            }
        }
        let position = [[-0.05, 0.20], [0.10, 0.35], [-0.10, 0.15]];
        for (i, range) in position.iter().chain(&euler_ranges[arm]).enumerate() {
            // Of 2000 uniform draws the outermost lie within 0.01 of a range's ends, but for
            // 2·e^(−2000·0.01/0.5) = 1e-17; inside up to the rounding of home's coordinates.
            let [low, high] = seen[i];
            assert!(low >= range[0] - 1e-12 && low < range[0] + 0.01, "arm {arm} {i}: {low}");
            assert!(high <= range[1] + 1e-12 && high > range[1] - 0.01, "arm {arm} {i}: {high}");
        }
    }
}

#[test]
fn base_goals_fill_their_range_and_differ_between_purposes() {
    let task = Task::new(&config(Preset::Paper, TaskName::Reorientation), home());
    let address = GoalAddress { seed: 1, purpose: Purpose::Goal, iteration: 0, env: 0 };
    let attitudes: Vec<_> =
        (0..1000).map(|env| task.goals.attitude(GoalAddress { env, ..address })).collect();
    for axis in 0..3 {
        let (low, high) = attitudes
            .iter()
            .fold((0.0_f64, 0.0_f64), |(low, high), a| (low.min(a[axis]), high.max(a[axis])));
        assert!((-0.2..-0.19).contains(&low) && (0.19..0.2).contains(&high), "{low} {high}");
    }
    let held_out = GoalAddress { purpose: Purpose::EvaluationGoal, ..address };
    assert_ne!(task.goals.attitude(held_out), attitudes[0]);
    assert_ne!(task.goals.attitude(GoalAddress { iteration: 1, ..address }), attitudes[0]);
}
