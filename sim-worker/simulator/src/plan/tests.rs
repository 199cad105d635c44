//! Plans against what the simulation makes of them.

use super::*;
use crate::executor::InOrder;
use crate::executor::tests::Apart;
use crate::inverse_kinematics::{base_pose, forward};
use crate::state::State;

fn robot() -> Robot {
    Robot::builtin("paper").expect("built in")
}

const WITHIN: Tolerance = Tolerance { position: 5e-3, orientation: 10e-3 };

fn question(robot: &Robot, arm: usize, goal: [f64; 6]) -> Question {
    let mut hands = vec![None; robot.n_arms];
    hands[arm] = Some(goal);
    let start = State::home(robot);
    Question { start, hands, hold_base: false, within: WITHIN, fastest: 0.8, seed: 0 }
}

/// Pose of a hand with its arm's joints moved from home.
fn moved(robot: &Robot, arm: usize, by: [f64; 6]) -> [f64; 6] {
    let mut q = crate::inverse_kinematics::padded(&robot.arms[arm].home);
    for (angle, by) in q.iter_mut().zip(by) {
        *angle += by;
    }
    let hand = base_pose(&State::home(robot)) * forward(robot, arm, &q).0;
    let rotation = hand.rotation.to_rotation_matrix();
    let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation.matrix()[(i, j)]));
    let [a, b, c] = crate::spatial::euler_xyz(&rows);
    let p = hand.translation.vector;
    [p.x, p.y, p.z, a, b, c]
}

fn asked(robot: &Robot, question: &Question, executor: &dyn Executor, waves: usize) -> Plan {
    let mut left = waves;
    let mut go_on = || {
        left -= 1;
        left > 0
    };
    plan(robot, &StepOptions::default(), question, &[], executor, &mut go_on)
}

#[test]
fn a_plan_arrives_where_it_says_and_is_the_same_on_any_executor() {
    let robot = robot();
    for arm in 0..robot.n_arms {
        let question = question(&robot, arm, moved(&robot, arm, [0.4, -0.3, 0.5, 0.2, 0.4, -0.3]));
        let found = asked(&robot, &question, &InOrder, 4);
        assert_eq!(found.obstacle, None, "arm {arm}");
        assert_eq!(found, asked(&robot, &question, &Apart, 4), "arm {arm}");
        let [miss] = found.misses[..] else { panic!("one hand was asked for") };
        assert!(miss.position <= 5e-3 && miss.orientation <= 10e-3, "{miss:?}");
        let rows = simulate_from(
            &robot,
            &question.start,
            &widen(&found.commands),
            Precision::F64,
            &StepOptions::default(),
        );
        // In double precision, too, hand and goal are where they should be, and nothing touches.
        let last = rows.last().expect("a row");
        let goal = question.hands[arm].expect("asked for");
        let off: f64 = (0..3).map(|i| (last.hands[arm][i] - goal[i]).powi(2)).sum::<f64>().sqrt();
        assert!(off <= 5.1e-3, "arm {arm}: {off}");
        assert!(rows.iter().all(|row| row.contacts == 0));
        let arrived = found.arrived.expect("reached");
        assert!(arrived < rows.len());
        let fastest = found.commands.iter().flatten().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(fastest <= 0.8 + 1e-6, "{fastest}");
    }
}

#[test]
fn several_hands_are_brought_to_their_poses_together() {
    let robot = robot();
    let mut question = question(&robot, 0, moved(&robot, 0, [0.2, -0.2, 0.3, 0.1, 0.2, 0.1]));
    question.hands[2] = Some(moved(&robot, 2, [-0.2, -0.1, 0.3, 0.2, 0.1, 0.0]));
    let found = asked(&robot, &question, &InOrder, 8);
    assert_eq!(found.obstacle, None);
    assert_eq!(found.misses.iter().map(|miss| miss.arm).collect::<Vec<_>>(), [0, 2]);
}

#[test]
fn the_other_arms_can_hold_the_base() {
    let robot = robot();
    let free = question(&robot, 1, moved(&robot, 1, [0.6, -0.4, 0.6, 0.0, 0.3, 0.0]));
    let held = Question { hold_base: true, ..free.clone() };
    let turned = |question: &Question| {
        let found = asked(&robot, question, &InOrder, 4);
        assert_eq!(found.obstacle, None);
        let rows = simulate_from(
            &robot,
            &question.start,
            &widen(&found.commands),
            Precision::F32,
            &StepOptions::default(),
        );
        let home = base_pose(&question.start);
        let off = rows.iter().map(|row| base_pose(&row.state).rotation.angle_to(&home.rotation));
        off.fold(0.0, f64::max)
    };
    let [free, held] = [turned(&free), turned(&held)];
    assert!(held < 0.25 * free, "free {free} rad, held {held} rad");
}

#[test]
fn what_cannot_be_reached_is_told_with_its_reason() {
    let robot = robot();
    let mut goal = moved(&robot, 0, [0.0; 6]);
    goal[1] += 3.0;
    let found = asked(&robot, &question(&robot, 0, goal), &InOrder, 1);
    assert_eq!(found.obstacle, Some(Obstacle::Kinematics { arm: 0 }));
    assert!(found.misses[0].position > 2.0, "{:?}", found.misses);
    // Hardly out of reach: a candidate that moves the base finds it later.
    let goal = [0.34762, 1.29268, 4.18466, -0.02327, 0.29328, 0.14952];
    let found = asked(&robot, &question(&robot, 0, goal), &InOrder, 1);
    assert_eq!(found.obstacle, Some(Obstacle::Reach { arm: 0 }));
    // Inside of the base.
    let mut goal = moved(&robot, 0, [0.0; 6]);
    goal[1] -= 0.9;
    let found = asked(&robot, &question(&robot, 0, goal), &InOrder, 1);
    assert!(found.obstacle.is_some());
}

#[test]
fn a_hand_that_is_nowhere_misses_by_more_than_any_other() {
    let robot = robot();
    let mut question = question(&robot, 0, moved(&robot, 0, [0.0; 6]));
    question.hands[1] = Some(moved(&robot, 1, [0.1; 6]));
    let mut state = State::home(&robot);
    let far = question.worst_miss(&robot, &state);
    assert!(far.is_finite() && far > 1.0, "{far}");
    for arm in [0, 1] {
        state.q = State::home(&robot).q;
        state.q[robot.arms[0].home.len() * arm] = f64::NAN;
        assert_eq!(question.worst_miss(&robot, &state), f64::INFINITY, "arm {arm}");
    }
    let played = |miss| Played { commands: Vec::new(), miss, touched: 0, arrived: None };
    let mut best = Best::default();
    for miss in [f64::INFINITY, 3.0, f64::INFINITY] {
        best.consider(played(miss), None);
    }
    assert_eq!(best.played.map(|(best, _)| best.miss), Some(3.0));
}

#[test]
fn a_proposal_that_arrives_is_taken() {
    let robot = robot();
    let question = question(&robot, 3, moved(&robot, 3, [0.3, -0.3, 0.4, 0.2, 0.2, 0.2]));
    let known = asked(&robot, &question, &InOrder, 4);
    let nothing = vec![vec![0.0; robot.n_joints()]; 3];
    let proposals = [nothing, known.commands.clone()];
    let options = StepOptions::default();
    let found = plan(&robot, &options, &question, &proposals, &InOrder, &mut || false);
    assert_eq!((found.proposal, found.tried, &found.commands), (Some(1), 2, &known.commands));
}
