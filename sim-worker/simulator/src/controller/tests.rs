//! The controller's rates do what they say.

use proto::config::{Layers, Preset, TaskName};

use super::*;
use crate::evaluate::Evaluation;
use crate::executor::InOrder;
use crate::experiment::{Player, Trial, play};

fn world(task: TaskName) -> World {
    let config = Layers::new(Preset::Tuned, Some(task)).resolve().expect("valid");
    World::new(&config, &Robot::builtin("paper").expect("built in"))
}

/// A state with joints away from home and a base that drifts.
fn state(robot: &Robot) -> State<f64> {
    let mut state = State::<f64>::home(robot);
    for (joint, q) in state.q.iter_mut().enumerate() {
        *q += 0.4 * ((joint * 7 % 11) as f64 / 11.0 - 0.5);
    }
    state.base_angular_velocity = [0.001, -0.0008, 0.0005];
    state.base_linear_velocity = [0.0005, 0.0003, -0.0008];
    state
}

#[test]
fn the_generalised_jacobian_is_what_the_simulator_does() {
    // A robot whose joints have rates by magic: velocities of the base that keep the momentum, against those of the map.
    let world = world(TaskName::Trajectory);
    let robot = &world.robot;
    let still = state(robot);
    let motion = momentum::BaseMotion::of(robot, &still).expect("an inertia");
    let rates: Vec<f64> = (0..24).map(|joint| 0.3 * ((joint * 5 % 7) as f64 / 7.0 - 0.4)).collect();
    let v = motion.drift
        + nalgebra::SVector::<f64, 6>::from_iterator(
            (&motion.by_joints * nalgebra::DVector::from_column_slice(&rates)).iter().copied(),
        );
    let mut moving = still.clone();
    moving.qd.clone_from(&rates);
    moving.base_linear_velocity = [v[0], v[1], v[2]];
    moving.base_angular_velocity = [v[3], v[4], v[5]];
    let momentum = |state: &State<f64>| crate::dynamics::reference_dynamics::momentum(robot, state);
    let (before, after) = (momentum(&still), momentum(&moving));
    assert!((before.linear - after.linear).norm() < 1e-9 * before.linear_scale.max(1.0));
    assert!((before.angular - after.angular).norm() < 1e-9 * after.angular_scale.max(1.0));
    assert!(motion.drift.norm() > 1e-3);
}

fn evaluation(task: TaskName, episodes: usize) -> Evaluation {
    let world = world(task);
    let controller = JacobianController::new(&world);
    let trial = Trial::new(Player::controlled(&world, &controller), 5, episodes, 120);
    Evaluation::of(&play(&trial, &InOrder, &|| {}).expect("stable"))
}

#[test]
fn most_goals_are_reached_to_a_millimetre() {
    let found = evaluation(TaskName::Trajectory, 8);
    let hands: Vec<_> = found.episodes.iter().flat_map(|episode| &episode.hands).collect();
    let reached = hands
        .iter()
        .filter(|hand| hand.position.last < 1e-3 && hand.orientation.last < 2e-3)
        .count();
    // Of the goals of this seed 86 % can be reached.
    assert!(reached * 4 > hands.len() * 3, "{reached} of {}", hands.len());
}

#[test]
fn the_base_turns_to_its_goal() {
    let found = evaluation(TaskName::Reorientation, 8);
    let reached = found.episodes.iter().filter(|episode| episode.base.last < 5e-3).count();
    assert!(
        reached >= 7,
        "{reached} of 8: {:?}",
        found.episodes.iter().map(|e| e.base.last).collect::<Vec<_>>()
    );
}

#[test]
fn with_an_arm_that_somebody_else_moves_the_others_carry_on() {
    let world = world(TaskName::Reorientation);
    let controller = JacobianController::new(&world);
    let mut memory = Memory::default();
    let now = State::<f64>::home(&world.robot);
    let mut goals = Goals::<f64>::at_home(&world.task.goals);
    goals.base = [0.1, -0.05, 0.02];
    let rates = controller.rates(&now, &goals, &[true, true, false, true], &mut memory);
    assert!(rates[12..18].iter().all(|rate| *rate == 0.0));
    assert!(rates[..12].iter().chain(&rates[18..]).any(|rate| rate.abs() > 1e-3));
}
