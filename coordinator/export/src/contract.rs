//! `contract.toml`: what every number of a controller is, and what the controller is not for.

use std::f64::consts::PI;

use proto::config::{Inference, Observation};
use proto::tasks::Target;
use serde::Serialize;

use crate::source::{HeldOut, Origin, Source};
use crate::vectors::{Case, Vectors};

/// One input or output.
#[derive(Debug, Serialize)]
struct Port {
    index: usize,
    name: String,
    shape: Vec<usize>,
    unit: &'static str,
    frame: &'static str,
    meaning: &'static str,
    /// What each number along the last axis is.
    elements: Vec<String>,
    /// What is accepted.
    range: [f64; 2],
    /// What the episodes of `vectors.json` passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    seen: Option<[f64; 2]>,
    /// Of each element, where they differ.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    ranges: Vec<[f64; 2]>,
}

#[derive(Debug, Serialize)]
struct Controller {
    task: &'static str,
    robot: String,
    control_period_s: f64,
    arms: usize,
    joints: usize,
    agents: usize,
    observation: usize,
    observation_layout: String,
    algorithm: &'static str,
    inference: &'static str,
}

#[derive(Debug, Serialize)]
struct Trained {
    #[serde(flatten)]
    origin: Origin,
    action_scale: f64,
    episode_steps: usize,
    goals: String,
    /// Ranges of the goals by element, as they were drawn in training; of goals that stay.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    goal_ranges: Vec<Vec<[f64; 2]>>,
    /// Of the base's goal, where hands have goals, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    base_goal_range: Option<[[f64; 2]; 3]>,
    /// What carries goals that move: `task.target` of the configuration.
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<Target>,
}

/// Where the robot begins: at rest, with its base's axes along the world's.
#[derive(Debug, Serialize)]
struct HomePose {
    base_position: [f64; 3],
    joint_angles: Vec<f64>,
    /// Position (m) and Euler angles (rad) of each hand.
    hands: Vec<[f64; 6]>,
}

#[derive(Debug, Serialize)]
struct Exactness {
    c: &'static str,
    onnx: &'static str,
    onnx_tolerance_rad_s: f64,
    why: &'static str,
}

#[derive(Debug, Serialize)]
struct Refusals {
    c: Vec<String>,
    onnx: &'static str,
}

#[derive(Debug, Serialize)]
struct Contract<'a> {
    format: u32,
    controller: Controller,
    home: HomePose,
    trained: Trained,
    held_out: &'a HeldOut,
    exactness: Exactness,
    refusals: Refusals,
    not_for: Vec<String>,
    input: Vec<Port>,
    output: Vec<Port>,
}

const HEAD: &str = "\
# What the controller of this directory takes and gives, what it was trained with, and what it is not for.
# Inputs are in the order of controller.onnx; a leading dimension `batch` is not written. The structs octopus_state
# and octopus_goals of controller.h have the same numbers, but for the last command and, where there are any, postures: octopus_memory keeps them.
# `range` is what the C code accepts, `ranges` of each element where they differ; `seen` is what the 256 states of vectors.json hold.

";

fn names(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

/// The text of the file.
pub(crate) fn contract(source: &Source<'_>, vectors: &Vectors) -> String {
    let world = source.world;
    let (config, dimensions) = (&world.config, &world.dimensions);
    let contract = Contract {
        format: 1,
        controller: Controller {
            task: source.task(),
            robot: world.robot.name.clone(),
            control_period_s: config.env.control_period,
            arms: dimensions.n_arms,
            joints: world.robot.n_joints(),
            agents: dimensions.n_agents,
            observation: dimensions.observation,
            observation_layout: format!("{:?}", config.task.observation).to_lowercase(),
            algorithm: config.algorithm.name.as_str(),
            inference: match config.network.inference {
                Inference::F32 => "f32",
                Inference::Bf16 => "bf16",
            },
        },
        home: HomePose {
            base_position: world.task.goals.home.base_position,
            joint_angles: world.robot.home_q(),
            hands: home_hands(source),
        },
        trained: Trained {
            origin: source.origin.clone(),
            action_scale: config.task.action_scale,
            episode_steps: config.task.episode_steps,
            goals: goals(source),
            goal_ranges: goal_ranges(source),
            base_goal_range: (source.has_hand_goals() && source.has_base_goal())
                .then(|| base_goal_range(source)),
            target: source.has_moving_goals().then_some(config.task.target),
        },
        held_out: source.held_out,
        exactness: Exactness {
            c: "the same bits as our workers, wherever single precision is IEEE 754 and fmaf is correctly rounded",
            onnx: "within onnx_tolerance_rad_s of the commands in vectors.json",
            onnx_tolerance_rad_s: source.onnx_tolerance(),
            why: if source.rounds() {
                "Weights and activations of hidden layers after the first are bfloat16 in the graph as in our workers. A \
                 runtime sums in another order, so an activation between two bfloat16 may go to the other one."
            } else {
                "A runtime sums in another order than we do, and its sines and exponentials round otherwise."
            },
        },
        refusals: Refusals {
            c: names(&[
                "1: a pointer is null",
                "2: a number of the state is NaN, infinite or beyond a million",
                "3: the square of the quaternion's length is off one by more than 0.001; it is not normalised, shorter errors act as they are",
                "4: a joint angle is beyond 1,000 rad",
                "5: a number of the goals is NaN, infinite or beyond a million, or an angle of them beyond 1,000 rad",
                "6: a hand's goal is farther from its arm's mount than the stretched arm is long; nearer goals may be out of reach, too",
                "7: the networks gave no number",
                "after any of them commands are zero, which holds the joints, and the memory is reset",
            ]),
            onnx: "nothing: what is not finite makes commands that mean nothing, so check before",
        },
        not_for: not_for(source),
        input: inputs(source, vectors),
        output: vec![Port {
            index: 0,
            name: "command".to_owned(),
            shape: vec![world.robot.n_joints()],
            unit: "rad/s",
            frame: "joints",
            meaning: "rate of each joint, to be held for a control period by a servo",
            elements: source.joint_names(),
            range: spread(
                world.task.action_limit.iter().map(|limit| limit * config.task.action_scale),
            ),
            seen: None,
            ranges: world
                .task
                .action_limit
                .iter()
                .map(|limit| limit * config.task.action_scale)
                .map(|limit| [-limit, limit])
                .collect(),
        }],
    };
    HEAD.to_owned() + &toml::to_string(&contract).expect("plain data")
}

/// ± the largest.
fn spread(limits: impl Iterator<Item = f64>) -> [f64; 2] {
    let largest = limits.fold(0.0, f64::max);
    [-largest, largest]
}

fn home_hands(source: &Source<'_>) -> Vec<[f64; 6]> {
    let arms = &source.world.task.goals.home.arms;
    let pose = |arm: &simulator::task::HomeArm| {
        let [[x, y, z], [a, b, c]] = [arm.position, arm.euler];
        [x, y, z, a, b, c].map(tidy)
    };
    arms.iter().map(pose).collect()
}

/// To nine digits after the point.
fn tidy(x: f64) -> f64 {
    (x * 1e9).round() / 1e9 + 0.0
}

/// What goals are of, in words.
fn goals(source: &Source<'_>) -> String {
    let mut all = Vec::new();
    if source.has_moving_goals() {
        let text = "hands: poses that a rigid body carries, which no force acts on; target is the table task.target of the configuration";
        all.push(text.to_owned());
    } else if source.has_hand_goals() {
        let goal_box = format!("{:?}", source.world.config.task.goal_box).to_lowercase();
        all.push(format!("hands: offsets from home, box {goal_box:?}"));
    }
    if source.has_base_goal() {
        all.push("base: Euler angles from home".to_owned());
    }
    all.join("; ")
}

fn base_goal_range(source: &Source<'_>) -> [[f64; 2]; 3] {
    let goals = &source.world.task.goals;
    goals.home.base_euler.map(|home| [home - goals.base, home + goals.base])
}

/// By arm and element, nothing for an arm that turns the base; of the base alone in `reorientation`. Of goals that move there are none.
fn goal_ranges(source: &Source<'_>) -> Vec<Vec<[f64; 2]>> {
    let goals = &source.world.task.goals;
    if source.has_moving_goals() {
        return Vec::new();
    }
    if !source.has_hand_goals() {
        return vec![base_goal_range(source).to_vec()];
    }
    let of_arm = |(home, ranges): (&simulator::task::HomeArm, &simulator::task::ArmGoals)| {
        let position = (0..3).map(|component| {
            let ends = ranges.axes.iter().zip(&ranges.position).map(|(axis, [low, high])| {
                let ends = [low * axis[component], high * axis[component]];
                [ends[0].min(ends[1]), ends[0].max(ends[1])]
            });
            ends.fold([home.position[component]; 2], |sum, end| [sum[0] + end[0], sum[1] + end[1]])
        });
        let orientation = ranges.orientation.iter().zip(home.euler);
        let orientation = orientation.map(|([low, high], home)| [home + low, home + high]);
        position.chain(orientation).map(|range| range.map(tidy)).collect()
    };
    let arms = goals.home.arms.iter().zip(&goals.arms).zip(source.reaches());
    arms.map(|(arm, reaches)| if reaches { of_arm(arm) } else { Vec::new() }).collect()
}

fn inputs(source: &Source<'_>, vectors: &Vectors) -> Vec<Port> {
    let world = source.world;
    let joints = world.robot.n_joints();
    let seen = |name: &str| {
        let all = vectors.cases.iter().flat_map(Case::state);
        let values = all.filter(|(of, _)| *of == name).flat_map(|(_, values)| values.iter());
        let ends = values
            .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &x| [low.min(x), high.max(x)]);
        ends[0].is_finite().then_some(ends.map(f64::from))
    };
    let port = |name: &str, unit, frame, meaning, elements: Vec<String>, most: f64| Port {
        index: 0,
        name: name.to_owned(),
        shape: vec![elements.len()],
        unit,
        frame,
        meaning,
        elements,
        range: [-most, most],
        seen: seen(name),
        ranges: Vec::new(),
    };
    let xyz = || names(&["x", "y", "z"]);
    let joint_names = source.joint_names();
    let mut last = port(
        "last_command",
        "rad/s",
        "joints",
        "the command before this one, zero at first or after a refusal",
        joint_names.clone(),
        1e6,
    );
    last.range =
        spread(world.task.action_limit.iter().map(|limit| limit * world.task.action_scale));
    let of_hands = |mut port: Port| {
        port.shape.insert(0, world.dimensions.n_arms);
        port
    };
    let hand_goals = source.has_hand_goals().then(|| {
        let elements = names(&["x", "y", "z", "a", "b", "c"]);
        let meaning = if source.reaches().all(|reaches| reaches) {
            "position of each hand, and Euler angles of its attitude Rx(a) Ry(b) Rz(c)"
        } else {
            "position of each hand, and Euler angles of its attitude Rx(a) Ry(b) Rz(c); what stands in the rows of arms that turn the base is not looked at"
        };
        let mut goals = port("hand_goals", "m, rad", "world", meaning, elements, 1e6);
        // Of angles a turn too many loses digits, so the C code takes less of them.
        goals.ranges = [[-1e6, 1e6]; 3].into_iter().chain([[-1e3, 1e3]; 3]).collect();
        of_hands(goals)
    });
    let hand_goal_velocities = source.has_moving_goals().then(|| {
        let elements = names(&["x", "y", "z", "about x", "about y", "about z"]);
        of_hands(port(
            "hand_goal_velocities",
            "m/s, rad/s",
            "world",
            "how fast the goal of each hand moves: velocity of its point, angular velocity",
            elements,
            1e6,
        ))
    });
    let base_goal = source.has_base_goal().then(|| {
        port(
            "base_goal",
            "rad",
            "world",
            "Euler angles of the base's attitude Rx(a) Ry(b) Rz(c)",
            names(&["a", "b", "c"]),
            1e3,
        )
    });
    let mut all = vec![
        port(
            "base_position",
            "m",
            "world",
            "origin of the base's frame, in which the robot file places its boxes and mounts; home.base_position at home",
            xyz(),
            1e6,
        ),
        port(
            "base_attitude",
            "1",
            "base to world",
            "unit quaternion, not normalised here",
            names(&["w", "x", "y", "z"]),
            // The C code takes 1.001 for the square of its length.
            1.001_f64.sqrt(),
        ),
        port("base_velocity", "m/s", "world", "velocity of the base's origin", xyz(), 1e6),
        port("base_angular_velocity", "rad/s", "base", "angular velocity of the base", xyz(), 1e6),
        port(
            "joint_angles",
            "rad",
            "joints",
            "by the robot's description; whole turns do not matter where an observation holds sine and cosine",
            joint_names.clone(),
            1e3,
        ),
        port("joint_rates", "rad/s", "joints", "rate of each joint", joint_names, 1e6),
        last,
    ];
    all.extend([hand_goals, hand_goal_velocities, base_goal].into_iter().flatten());
    if source.has_postures() {
        // Links of arms of several types have no names in common.
        let left = |joint: usize| match &world.robot.types[..] {
            [kind] => format!("left of {}", kind.links[joint].name),
            _ => format!("left of joint {}", joint + 1),
        };
        let left = (0..source.longest_arm()).map(left);
        let elements = names(&["good", "free"]).into_iter().chain(left).collect();
        let mut postures = port(
            "postures",
            "1, 1, rad",
            "joints",
            if world.robot.joints.by_arm().all(|joints| joints == source.longest_arm()) {
                "goal posture of each arm, by octopus_postures of controller.h: 1 if it brings the hand to its goal, 1 if it stops no joint, what is left to go; \
                 an input of controller.onnx alone, controller.c finds it"
            } else {
                "goal posture of each arm, by octopus_postures of controller.h: 1 if it brings the hand to its goal, 1 if it stops no joint, what is left to go, \
                 zeros behind the last joint of a shorter arm; an input of controller.onnx alone, controller.c finds it"
            },
            elements,
            2.0 * PI,
        );
        postures.shape.insert(0, world.dimensions.n_arms);
        all.push(postures);
    }
    for (index, port) in all.iter_mut().enumerate() {
        port.index = index;
    }
    debug_assert_eq!(joints, world.robot.n_joints());
    all
}

fn not_for(source: &Source<'_>) -> Vec<String> {
    let world = source.world;
    let period = world.config.env.control_period;
    let HeldOut { episodes, episodes_with_contact, .. } = source.held_out;
    let mut all = vec![
        format!("a robot other than `{}`: kinematics and limits are built in", world.robot.name),
        format!("another control period than {period} s, or a delay of more than one period"),
        "gravity, a base that is held or driven, hands that carry something heavy or touch their surroundings".to_owned(),
        if source.has_moving_goals() {
            "goals that move otherwise than with one rigid body as trained.target tells it, or not as hand_goal_velocities says; not all can be reached".to_owned()
        } else {
            "goals that move faster than a hand follows, or lie outside trained.goal_ranges, which not all can be reached in".to_owned()
        },
        format!(
            "keeping arms apart: {}, and bodies touched in {episodes_with_contact} of {episodes} held-out episodes",
            if source.has_postures() {
                "goal postures are chosen so that few bodies touch on the way, but nothing stops arms that are about to"
            } else {
                "nothing here looks for collisions"
            }
        ),
        "anything where a wrong motion can hurt: it is a neural network without a proof".to_owned(),
    ];
    if world.config.task.observation != Observation::Arm {
        all.push(
            "another place or attitude of the base than about home: this policy sees where the base is, and its \
             quaternion as it is, so keep w > 0"
                .to_owned(),
        );
    }
    all
}
