use super::*;
use crate::config::{Layers, Preset};
use crate::rng::Purpose;

fn home() -> Home {
    let arm = |position, euler| HomeArm {
        q: vec![0.0; 6],
        command_limit: vec![1.0; 6],
        position,
        euler,
        mount: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
    };
    Home {
        base_position: [0.0, 0.0, 4.0],
        base_euler: [0.0; 3],
        arms: vec![arm([0.3, 1.5, 4.0], [0.0; 3]), arm([0.3, 0.0, 2.5], [-1.57, 0.0, 0.0])],
    }
}

fn drawn(task: TaskName, env: u32) -> EpisodeGoals {
    let config = Layers::new(Preset::Tuned, Some(task)).resolve().expect("valid");
    let address = GoalAddress { seed: 3, purpose: Purpose::Goal, iteration: 1, env };
    let ranges = GoalRanges::new(
        config.task.goal_box,
        config.task.base_goal_range,
        config.task.target,
        home(),
    );
    task.definition().goals(&ranges, address)
}

#[test]
fn every_task_has_goals_where_its_arms_aim() {
    for &task in TaskName::ALL {
        assert_eq!(TaskName::named(task.as_str()), Some(task));
        let written = serde_json::to_string(&task).expect("a name");
        assert_eq!(written, format!("{:?}", task.as_str()), "serde has the same name");
        let goals = drawn(task, 0);
        for arm in 0..2 {
            let has = goals.hands.get(arm).is_some_and(Option::is_some);
            assert_eq!(has, task.aim(arm, 2) == Aim::Hand, "{task:?} {arm}");
        }
        assert_eq!(goals.base.is_some(), task.turns());
        assert_eq!(goals.body.is_some(), task.moves());
        assert_eq!(goals, drawn(task, 0));
        assert_ne!(goals, drawn(task, 1));
        assert!(task.reaches() || task.turns());
    }
    assert!(TaskName::listed().starts_with("`trajectory`, `reorientation`, "));
    assert_eq!(TaskName::listed().matches(" or ").count(), 1);
}

#[test]
fn a_robot_with_too_few_arms_is_refused() {
    let refused = TaskName::Mixed.check_arms("lone", 1);
    assert_eq!(refused, Err("robot lone has 1 arm, and task `mixed` needs 2".to_owned()));
    assert_eq!(TaskName::Mixed.check_arms("pair", 2), Ok(()));
    assert_eq!(TaskName::Trajectory.check_arms("lone", 1), Ok(()));
}

#[test]
fn what_mixed_draws_for_hands_and_base_is_independent() {
    let (mixed, hands, base) = (
        drawn(TaskName::Mixed, 7),
        drawn(TaskName::Trajectory, 7),
        drawn(TaskName::Reorientation, 7),
    );
    assert_eq!(mixed.hands, [hands.hands[0], None]);
    assert_ne!(mixed.base, base.base);
}

/// Grasp points lie on a circle about the body's centre, in one plane.
#[test]
fn grasp_points_lie_on_the_ring() {
    let config = Layers::new(Preset::Tuned, Some(TaskName::Capture)).resolve().expect("valid");
    for env in 0..20 {
        let EpisodeGoals { hands, body, .. } = drawn(TaskName::Capture, env);
        let body = body.expect("a body");
        let arms = hands.iter().map(|hand| {
            let hand = hand.expect("a grasp point");
            [0, 1, 2].map(|i| hand[i] - body.position[i])
        });
        let arms: Vec<[f64; 3]> = arms.collect();
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for arm in &arms {
            assert!((dot(*arm, *arm).sqrt() - config.task.target.radius).abs() < 1e-12);
        }
        // At home the two hands are a quarter of a turn apart.
        assert!(dot(arms[0], arms[1]).abs() < 1e-12);
    }
}

/// A body that is turned carries a hand around with it.
#[test]
fn what_a_body_carries_by_hand() {
    let half = std::f64::consts::FRAC_PI_2;
    let body = FreeBody {
        position: [1.0, 2.0, 3.0],
        turned: [half, 0.0, 0.0],
        linear: [0.0; 3],
        angular: [0.0; 3],
        inertia: [1.0; 3],
    };
    let [x, y, z, a, b, c] = body.carried([0.5, 1.0, 0.0], [0.2, 0.0, 0.0]);
    for (found, wanted) in [(x, 1.5), (y, 2.0), (z, 4.0), (a, half + 0.2), (b, 0.0), (c, 0.0)] {
        assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
    }
}
