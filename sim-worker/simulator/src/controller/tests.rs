//! The controller's rates do what they say.

use proto::config::{Layers, Preset};

use super::*;
use crate::evaluate::Evaluation;
use crate::executor::InOrder;
use crate::experiment::{Player, Trial, play};
use crate::inverse_kinematics::{base_pose, forward};

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

#[test]
fn hands_go_where_the_rates_say() {
    let world = world(TaskName::Trajectory);
    let controller = JacobianController::new(&world);
    let robot = &world.robot;
    let now = state(robot);
    // Goals a little beside where the hands are.
    let at = |state: &State<f64>, arm: usize| {
        let q = std::array::from_fn(|j| state.q[arm * JOINTS_PER_ARM + j]);
        base_pose(state) * forward(robot, arm, &q).0
    };
    let mut goals = world.task.goals.at_home::<f64>();
    for (arm, goal) in goals.hands.iter_mut().enumerate() {
        let hand = at(&now, arm);
        let rotation = hand.rotation.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation.matrix()[(i, j)]));
        let [a, b, c] = crate::spatial::euler_xyz(&rows);
        let p = hand.translation.vector;
        *goal = [p.x + 1e-3, p.y - 5e-4, p.z + 8e-4, a + 1e-3, b, c - 2e-3];
    }
    // On the branches on which they stand.
    let branch = |(arm, goal): (usize, &[f64; 6])| {
        let angles = std::array::from_fn(|j| now.q[arm * JOINTS_PER_ARM + j]);
        Some(Branch { goal: *goal, angles, others: Vec::new(), steps: 0 })
    };
    let mut memory = Memory { branches: goals.hands.iter().enumerate().map(branch).collect() };
    let rates = controller.rates(&now, &goals, &[true; 4], &mut memory);
    assert!(rates.iter().zip(&controller.limits).all(|(rate, limit)| rate.abs() <= limit + 1e-12));
    // The joints turn for a little while, and the base as momentum wants it.
    let motion = momentum::BaseMotion::of(robot, &now).expect("an inertia");
    let v = motion.drift
        + nalgebra::SVector::<f64, 6>::from_iterator(
            (&motion.by_joints * nalgebra::DVector::from_column_slice(&rates)).iter().copied(),
        );
    let h = 1e-4;
    let mut later = now.clone();
    for (q, rate) in later.q.iter_mut().zip(&rates) {
        *q += h * rate;
    }
    for i in 0..3 {
        later.base_position[i] += h * v[i];
    }
    let turn =
        nalgebra::UnitQuaternion::from_scaled_axis(h * nalgebra::Vector3::new(v[3], v[4], v[5]));
    let turned = base_pose(&now).rotation * turn;
    later.base_quaternion = [turned.w, turned.i, turned.j, turned.k];
    for (arm, goal) in goals.hands.iter().enumerate() {
        let (before, after, goal) =
            (at(&now, arm), at(&later, arm), crate::inverse_kinematics::pose(*goal));
        let left = goal.translation.vector - before.translation.vector;
        let went = (after.translation.vector - before.translation.vector) / h;
        let wanted = GAIN / controller.period * left;
        // Damping takes a part of it where an arm is near a singularity.
        assert!((went - wanted).norm() < 0.3 * wanted.norm(), "hand {arm}: {went} for {wanted}");
        let left = (goal.rotation * before.rotation.inverse()).scaled_axis();
        let went = (after.rotation * before.rotation.inverse()).scaled_axis() / h;
        let wanted = GAIN / controller.period * left;
        assert!((went - wanted).norm() < 0.3 * wanted.norm(), "hand {arm}: {went} for {wanted}");
    }
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
    let mut goals = world.task.goals.at_home::<f64>();
    goals.base = [0.1, -0.05, 0.02];
    let rates = controller.rates(&now, &goals, &[true, true, false, true], &mut memory);
    assert!(rates[12..18].iter().all(|rate| *rate == 0.0));
    assert!(rates[..12].iter().chain(&rates[18..]).any(|rate| rate.abs() > 1e-3));
}
