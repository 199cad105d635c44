//! Every way in which a trial differs from a plain episode.

use crate::robot::Joints;
use std::path::Path;

use proto::config::{Layers, Preset, TaskName};
use proto::layout::EpisodeMetrics;
use proto::rng::Purpose;

use super::recording::norm;
use super::*;
use crate::executor::InOrder;
use crate::executor::tests::Apart;
use crate::model::ContactKind;
use crate::policy::Policy;
use crate::policy::tests::parameters;
use crate::robot::Robot;
use crate::rollout::{RolloutSpec, World, rollout};

/// A world with a small network, whose exploration is too small to change a bit.
pub(super) fn world(task: TaskName, robot: &Robot) -> World {
    world_of(Preset::Tuned, task, robot)
}

pub(super) fn world_of(preset: Preset, task: TaskName, robot: &Robot) -> World {
    let mut config = Layers::new(preset, Some(task)).resolve().expect("valid");
    config.network.hidden = vec![16];
    config.env.n_envs = 18;
    config.env.n_shards = 1;
    config.task.episode_steps = 6;
    // Trials begin at home.
    config.task.start.share = 0.0;
    World::new(&config, robot)
}

pub(super) fn paper() -> Robot {
    Robot::builtin("paper").expect("built in")
}

pub(super) fn policy(world: &World) -> Policy {
    let mut flat = parameters(&world.config, &world.dimensions, 8);
    let layout = proto::layout::ActorLayout::new(&world.config, &world.dimensions);
    let log_std = layout.tensors.iter().find(|tensor| tensor.name == "log_std").expect("exists");
    // e^-60 is lost beside any mean in single precision.
    flat[log_std.range()].fill(-60.0);
    world.policy(&flat).expect("a policy")
}

fn recorded(trial: &Trial<'_>) -> Recording {
    play(trial, &InOrder, &|| {}).expect("a recording")
}

/// The largest difference of two recordings of one trial, over the steps of `range`.
fn difference(one: &Recording, other: &Recording, range: std::ops::Range<usize>) -> f32 {
    let mut largest = 0.0_f32;
    for episode in 0..one.episodes() {
        for step in range.clone() {
            let rows = one.row(episode, step).iter().zip(other.row(episode, step));
            largest = rows.fold(largest, |largest, (a, b)| largest.max((a - b).abs()));
        }
    }
    largest
}

/// Training and experiments play episodes in loops of their own; they are the same episodes, to the bit.
#[test]
fn a_trial_in_which_nothing_happens_is_a_rollout_without_exploration() {
    for task in [TaskName::Trajectory, TaskName::Reorientation] {
        let world = world(task, &paper());
        let policy = policy(&world);
        let mut block = vec![0.0; world.block_layout().len];
        let spec = RolloutSpec { seed: 5, iteration: 0, shard: 0, policy: &policy };
        rollout(&world, &spec, &mut block, &mut |_| {}).expect("a block");
        let mut trial = Trial::new(Player::new(&world, &policy), 5, 18, 6);
        trial.goals.purpose = Purpose::Goal;
        let recording = recorded(&trial);
        let places = EpisodeMetrics::new(4);
        let k = world.dimensions.n_metrics;
        for (env, metrics) in
            block[world.block_layout().metrics.clone()].chunks_exact(k).enumerate()
        {
            for arm in 0..4 {
                let position = metrics[places.final_position.clone()][arm];
                assert_eq!(recording.position(env, 5, arm), position);
                let orientation = metrics[places.final_orientation.clone()][arm];
                assert_eq!(recording.orientation(env, 5, arm), orientation);
            }
            assert_eq!(recording.attitude(env, 5), metrics[places.final_base]);
            let pairs: u32 = (0..6).flat_map(|step| recording.contacts(env, step)).sum();
            assert_eq!(pairs as f32, metrics[places.contact_pairs]);
        }
    }
}

#[test]
fn a_recording_depends_neither_on_threads_nor_on_neighbours() {
    let world = world(TaskName::Trajectory, &paper());
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 35, 3);
    trial.sensors = SensorNoise { position: 0.01, angle: 0.01, velocity: 0.01, rate: 0.01 };
    let all = 0..usize::MAX;
    trial.interventions =
        vec![Intervention { steps: all, effect: Effect::JointTorque { std: 5.0 } }];
    let one = recorded(&trial);
    let steps = std::sync::atomic::AtomicUsize::new(0);
    let count = || _ = steps.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    assert_eq!(one, play(&trial, &Apart, &count).expect("a recording"));
    // Chunks of 32 and 3 episodes, three steps each.
    assert_eq!(steps.into_inner(), 6);
    // Fewer episodes are the first of more.
    trial.episodes = 5;
    let few = recorded(&trial);
    for episode in 0..5 {
        assert_eq!(few.row(episode, 2), one.row(episode, 2), "episode {episode}");
    }
    // Another seed errs otherwise.
    trial.goals.seed = 4;
    assert_ne!(few, recorded(&trial));
}

#[test]
fn actions_are_replaced_in_their_steps_alone() {
    let world = world(TaskName::Trajectory, &paper());
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 2, 5);
    let plain = recorded(&trial);
    trial.interventions =
        vec![Intervention { steps: 2..3, effect: Effect::Action { joints: 7..8, value: 1.3 } }];
    let pushed = recorded(&trial);
    assert_eq!(difference(&plain, &pushed, 0..2), 0.0);
    assert!(difference(&plain, &pushed, 2..3) > 1e-2);

    // All joints of all arms at once, whatever the policy says: as if it were not there.
    let flat = parameters(&world.config, &world.dimensions, 99);
    let other = world.policy(&flat).expect("a policy");
    let fixed = Effect::Action { joints: 0..24, value: 0.3 };
    trial.interventions = vec![Intervention { steps: 0..5, effect: fixed }];
    let one = recorded(&trial);
    trial.players = vec![Player::new(&world, &other)];
    assert_eq!(one, recorded(&trial));
    // An arm without a player is one whose actions are zero.
    trial.phases[0].arms[3] = None;
    trial.interventions[0].steps = 0..0;
    let held = recorded(&trial);
    trial.phases[0].arms[3] = Some(0);
    let zero = Effect::Action { joints: 18..24, value: 0.0 };
    trial.interventions = vec![Intervention { steps: 0..5, effect: zero }];
    assert_eq!(held, recorded(&trial));
}

#[test]
fn a_delayed_command_is_that_of_the_step_before() {
    let world = world(TaskName::Trajectory, &paper());
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 1, 4);
    // Whole actions are given, so that nothing depends on what the policy sees: 0.2, 0.4, 0.6, 0.8.
    let actions = |shift: usize| {
        let step = |i: usize| Intervention {
            steps: i..i + 1,
            effect: Effect::Action {
                joints: 0..24,
                value: if i < shift { 0.0 } else { 0.2 * (i - shift + 1) as f64 },
            },
        };
        (0..4).map(step).collect::<Vec<_>>()
    };
    for delay in [1, 2] {
        trial.interventions = actions(0);
        trial.delay = delay;
        let delayed = recorded(&trial);
        trial.interventions = actions(delay);
        trial.delay = 0;
        assert_eq!(delayed, recorded(&trial), "by {delay}");
    }
}

#[test]
fn policies_take_over_arms_with_what_each_of_them_sees() {
    let robot = paper();
    let (reach, turn) =
        (world(TaskName::Trajectory, &robot), world(TaskName::Reorientation, &robot));
    let (reaching, turning) = (policy(&reach), policy(&turn));
    let players = vec![Player::new(&reach, &reaching), Player::new(&turn, &turning)];
    let alone = |player: usize| {
        let mut trial = Trial::new(players[player], 3, 2, 4);
        trial.goals.purpose = Purpose::EvaluationGoal;
        // Both have the same goals, which each draws on its own otherwise.
        let pose = [0.4, -1.2, 4.2, 0.1, -0.1, 0.1];
        trial.fixed = FixedGoals { hands: vec![Some(pose); 4], base: Some([0.1, 0.05, -0.1]) };
        trial
    };
    let (one, two) = (recorded(&alone(0)), recorded(&alone(1)));
    let mut both = alone(0);
    both.players.clone_from(&players);
    assert_eq!(recorded(&both), one, "who moves no arm changes nothing");
    both.phases[0].arms = vec![Some(1); 4];
    assert_eq!(recorded(&both), two);
    both.phases = vec![
        Phase { from: 0, arms: vec![Some(0); 4] },
        Phase { from: 2, arms: vec![Some(1), Some(0), Some(1), Some(1)] },
    ];
    let switched = recorded(&both);
    assert_eq!(difference(&switched, &one, 0..2), 0.0);
    assert!(difference(&switched, &one, 2..3) > 1e-3);
    // Another scale of the actions is another speed.
    let mut slow = alone(0);
    slow.players[0].action_scale *= 0.5;
    assert!(difference(&recorded(&slow), &one, 0..1) > 1e-3);
}

#[test]
fn fixed_goals_are_what_errors_are_against() {
    let world = world(TaskName::Trajectory, &paper());
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 1, 1);
    let pose = [0.4, -1.2, 4.2, 0.1, -0.1, 0.1];
    trial.fixed.hands = vec![None, Some(pose)];
    // Held, the hands stay at home.
    trial.phases[0].arms = vec![None; 4];
    let recording = recorded(&trial);
    let home = &world.task.goals.home.arms[1];
    let error = recording.hand(0, 0, 1);
    for i in 0..3 {
        assert!((f64::from(error[i]) - (pose[i] - home.position[i])).abs() < 1e-6);
        assert!((f64::from(error[3 + i]) - (pose[3 + i] - home.euler[i])).abs() < 1e-6);
    }
    assert_eq!(recording.position(0, 0, 1), norm([error[0], error[1], error[2]]));
    // The others have drawn ones.
    assert!(recording.position(0, 0, 0) > 0.1);
    assert_eq!(recording.attitude(0, 0), 0.0, "no task of the base: its goal is home");
}

/// The numbers that sensors add have the standard deviations asked for, and are new in each step.
#[test]
fn sensors_err_as_told() {
    use super::chunk::Chunk;
    use super::intervention::Lanes;
    use crate::task::Readings;
    let noise = SensorNoise { position: 0.1, angle: 0.01, velocity: 10.0, rate: 1.0 };
    let (mut squares, mut n) = ([0.0_f64; 4], 0.0);
    let mut drawn = vec![0.0; SensorNoise::draws(&Joints::of_sixes(4))];
    for step in 0..200 {
        let mut readings = Readings::<f64>::new(&Joints::of_sixes(4));
        let envs = Chunk { seed: 1, first: 7, n_envs: 1 };
        let lanes = Lanes { envs, group: 0 };
        noise.add_to(lanes, step, &mut drawn, &mut readings);
        let of = |values: &[f64]| values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64;
        for hand in &readings.hands {
            squares[0] += of(&hand.position) / 4.0;
            squares[2] += of(&hand.linear) / 4.0;
        }
        squares[1] += of(&readings.q);
        squares[3] += of(&readings.qd);
        // The attitude is turned by small angles: its Euler angles and its quaternion say the same.
        let [w, x, ..] = readings.base_quaternion;
        assert!(
            (w * w + readings.base_quaternion[1..].iter().map(|x| x * x).sum::<f64>() - 1.0).abs()
                < 1e-12
        );
        assert!((2.0 * x - readings.base_euler[0]).abs() < 1e-2 * noise.angle.max(0.1));
        n += 1.0;
    }
    let wanted = [noise.position, noise.angle, noise.velocity, noise.rate];
    for (square, wanted) in squares.iter().zip(wanted) {
        // 200 steps of at least 12 numbers: the estimate is good to 1/√(2 · 2400) = 1.4 %.
        let std = (square / n).sqrt();
        assert!((std / wanted - 1.0).abs() < 0.06, "{std}, wanted {wanted}");
    }
}

/// What acts on the robot reaches the dynamics: an impulse, an angular impulse, a limp arm.
#[test]
fn forces_torques_and_limp_arms_move_the_robot() {
    let robot = paper();
    let world = world(TaskName::Reorientation, &robot);
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 1, 3);
    // All arms held: at rest, so that everything comes from outside.
    trial.phases[0].arms = vec![None; 4];
    let rest = recorded(&trial);
    assert!(norm(rest.base_rate(0, 2)) < 1e-6);
    let with = |effect: Effect| {
        let mut trial = trial.clone();
        trial.interventions = vec![Intervention { steps: 1..2, effect }];
        recorded(&trial)
    };
    // 20 N m for 0.4 s on about 150 kg m² about x: 53 mrad/s with rigid arms. Held arms give way a little.
    let turned = with(Effect::BaseTorque([20.0, 0.0, 0.0]));
    assert_eq!(difference(&turned, &rest, 0..1), 0.0);
    assert!((0.04..0.08).contains(&turned.base_rate(0, 1)[0]), "{:?}", turned.base_rate(0, 1));
    let pulled = with(Effect::HandForce { arm: 1, force: [50.0, 0.0, 0.0] });
    assert!(norm(pulled.base_rate(0, 1)) > 0.01);
    assert!(pulled.hand(0, 2, 1)[0] < rest.hand(0, 2, 1)[0] - 0.01, "the goal is behind the hand");
    // A limp arm at rest stays at rest, and gives way to a push that a held one takes.
    let limp = with(Effect::Limp { arm: 1 });
    assert!(difference(&limp, &rest, 0..3) < 1e-6);
    let mut trial = trial.clone();
    trial.interventions = vec![
        Intervention { steps: 0..3, effect: Effect::Limp { arm: 1 } },
        Intervention { steps: 1..2, effect: Effect::HandForce { arm: 1, force: [50.0, 0.0, 0.0] } },
    ];
    let given_way = recorded(&trial);
    // Near its centre of percussion a free arm leaves its pivot alone; a held one is a lever on the base.
    let turned = |recording: &Recording| norm(recording.base_rate(0, 1));
    assert!(
        turned(&given_way) < 0.6 * turned(&pulled),
        "{} {}",
        turned(&given_way),
        turned(&pulled)
    );
    // Joints that are disturbed move.
    assert!(difference(&with(Effect::JointTorque { std: 20.0 }), &rest, 1..2) > 1e-3);
}

#[test]
fn another_robot_than_the_policy_knows() {
    let robot = paper();
    let world = world(TaskName::Reorientation, &robot);
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 1, 3);
    let known = recorded(&trial);
    let heavy = robot.with_base_mass(1000.0).expect("valid");
    trial.robot = &heavy;
    let turned = |recording: &Recording| norm(recording.base_rate(0, 2));
    let of_heavy = recorded(&trial);
    assert!(turned(&of_heavy) < 0.8 * turned(&known), "a heavy base turns less");
    let slow = robot.with_arm_mass(0.5).expect("valid");
    assert_eq!(slow.types[0].links[1].body.mass, 0.5 * robot.types[0].links[1].body.mass);
    assert_eq!(slow.types[0].links[1].body.inertia, 0.5 * robot.types[0].links[1].body.inertia);
    assert_eq!(slow.types[0].links[1].armature, robot.types[0].links[1].armature);
    trial.robot = &slow;
    assert!(turned(&recorded(&trial)) < 0.8 * turned(&known), "light arms turn the base less");
    assert!(robot.with_arm_mass(-1.0).is_err());
}

#[test]
fn contacts_are_told_apart() {
    let two = include_str!("../../robots/two-arm.toml");
    let robot = Robot::from_toml(two, Path::new("two-arm.toml")).expect("valid");
    let world = world(TaskName::Trajectory, &robot);
    let policy = policy(&world);
    let mut trial = Trial::new(Player::new(&world, &policy), 3, 1, 12);
    // One shoulder leans towards the base for 4.8 s, until the forearm meets the cube.
    trial.phases[0].arms = vec![None; robot.n_arms];
    let lean = Effect::Action { joints: 1..2, value: 1.0 };
    trial.interventions = vec![Intervention { steps: 0..12, effect: lean }];
    let recording = recorded(&trial);
    let end = recording.contacts(0, 11);
    assert!(end[ContactKind::Base as usize] > 0, "{end:?}");
    assert_eq!(end[ContactKind::Arms as usize], 0, "{end:?}");
    assert_eq!(recording.contacts(0, 0), [0; 4], "home touches nothing");
}
