//! The controller in C99: a fixed text, and what it is made for as constants and tables before it. Goal postures are a text of their own in it.

mod postures;
mod tables;

use proto::config::{Activation, InputNorm, JointAngles, Observation};

use crate::networks::Networks;
use crate::source::Source;
use tables::{define, tables};

const HEADER: &str = include_str!("controller.h");
const SOURCE: &str = include_str!("controller.c");
/// Holds the C code against `vectors.json`.
pub(crate) const CHECK: &str = include_str!("check.c");
/// A program that uses it.
pub(crate) const EXAMPLE: &str = include_str!("example.c");

/// `controller.h`.
pub(crate) fn header(source: &Source<'_>) -> String {
    let world = source.world;
    let dimensions = &world.dimensions;
    let mut out = source.comment();
    for (name, value) in [
        ("TRAJECTORY", "1 /* hands have goals */".to_owned()),
        ("REORIENTATION", "2 /* the base has one */".to_owned()),
        ("MOVING", "4 /* the hands' goals move */".to_owned()),
        ("TASK", goals(source)),
        ("ARMS", dimensions.n_arms.to_string()),
        ("AGENTS", dimensions.n_agents.to_string()),
        ("JOINTS", world.robot.n_joints().to_string()),
        ("ARM_JOINTS", format!("{} /* of the longest arm */", source.longest_arm())),
        ("OBSERVATION", dimensions.observation.to_string()),
        ("POSTURES", i32::from(source.has_postures()).to_string()),
        ("POSTURE_NUMBERS", "(2 + OCTOPUS_ARM_JOINTS)".to_owned()),
    ] {
        define(&mut out, name, &value);
    }
    define(&mut out, "CONTROL_PERIOD", &format!("{:?} /* (s) */", world.config.env.control_period));
    HEADER.replace("@DEFINITIONS@", out.trim_end())
}

/// What has goals, as a sum of flags.
fn goals(source: &Source<'_>) -> String {
    let flags = [
        (source.has_hand_goals(), "OCTOPUS_TRAJECTORY"),
        (source.has_base_goal(), "OCTOPUS_REORIENTATION"),
        (source.has_moving_goals(), "OCTOPUS_MOVING"),
    ];
    let flags: Vec<&str> = flags.iter().filter(|(is, _)| *is).map(|(_, flag)| *flag).collect();
    if let [one] = flags[..] { one.to_owned() } else { format!("({})", flags.join(" | ")) }
}

/// `controller.c`.
pub(crate) fn controller(source: &Source<'_>, networks: &Networks) -> String {
    SOURCE
        .replace("@POSTURES@\n", &postures::postures(source))
        .replace("@SWITCHES@", switches(source, networks).trim_end())
        .replace("@TABLES@", tables(source, networks).trim_end())
}

/// What of the fixed text is compiled.
fn switches(source: &Source<'_>, networks: &Networks) -> String {
    let world = source.world;
    let (dimensions, config) = (&world.dimensions, &world.config);
    let (task, network) = (&config.task, &config.network);
    let arm = task.observation == Observation::Arm;
    let trajectory = source.has_hand_goals();
    let squash = network.squash_mean;
    let tanh = arm || squash || network.activation == Activation::Tanh;
    let norm = network.layer_norm || network.input_norm == InputNorm::LayerNorm;
    let widest = networks.layers.iter().flat_map(super::networks::Layer::sizes).max();
    let mut out = String::new();
    let flag = |on: bool| i32::from(on).to_string();
    let number = |n: usize| n.to_string();
    for (name, value) in [
        ("LAYOUT_ARM", number(1)),
        ("LAYOUT_OTHER", number(2)),
        ("LAYOUT", number(if arm { 1 } else { 2 })),
        ("SIN_COS", flag(task.joint_angles == JointAngles::SinCos)),
        ("RELU", number(1)),
        ("ELU", number(2)),
        ("TANH", number(3)),
        (
            "ACTIVATION",
            number(match network.activation {
                Activation::Relu => 1,
                Activation::Elu => 2,
                Activation::Tanh => 3,
            }),
        ),
        ("RUNNING", number(1)),
        ("LAYER_NORM", number(2)),
        (
            "INPUT_NORM",
            number(match network.input_norm {
                InputNorm::None => 0,
                InputNorm::Running => 1,
                InputNorm::LayerNorm => 2,
            }),
        ),
        ("HIDDEN_LAYER_NORM", flag(network.layer_norm)),
        ("SQUASH", flag(squash)),
        ("NEEDS_ALGEBRA", flag(arm || trajectory)),
        ("NEEDS_HANDS", flag(trajectory)),
        ("NEEDS_HAND_VELOCITIES", flag(trajectory && task.observation == Observation::Release)),
        ("NEEDS_EULER", flag(trajectory || !arm)),
        ("NEEDS_TANH", flag(tanh)),
        ("NEEDS_EXP", flag(network.activation == Activation::Elu)),
        ("NEEDS_LAYER_NORM", flag(norm)),
        ("NEEDS_BF16", flag(networks.layers.iter().any(|layer| layer.weight.half))),
        ("AGENT_ACTIONS", number(dimensions.n_actions)),
        ("KINDS", number(world.robot.types.len())),
        ("LINKS", number(world.robot.types.iter().map(|kind| kind.links.len()).sum())),
        ("ACTORS", number(dimensions.n_actors)),
        ("ACTOR_INPUT", number(dimensions.actor_input())),
        ("ACTOR_OUTPUT", number(dimensions.actor_output())),
        ("LAYERS", number(networks.layers.len())),
        ("WIDEST", number(widest.unwrap_or(0))),
        ("INPUT_CLIP", tables::float(network.input_clip as f32)),
        ("ACTION_LIMIT", tables::float(source.squash_limit() as f32)),
        ("ACTION_SCALE", tables::float(task.action_scale as f32)),
    ] {
        define(&mut out, name, &value);
    }
    out
}
