//! The controller and the actors alone as ONNX models.

mod actors;
mod geometry;
mod graph;
mod joints;
mod observations;
mod postures;
mod proto;

use crate::networks::Networks;
use crate::source::Source;
use graph::Graph;
use observations::Inputs;

/// `policy.onnx`: observations `[batch, A, O]` to actions `[batch, J]`.
pub(crate) fn policy(
    source: &Source<'_>,
    networks: &Networks,
    metadata: &[(String, String)],
) -> Vec<u8> {
    let dimensions = &source.world.dimensions;
    let mut g = Graph::default();
    let seen = g.input(
        "observations",
        &[dimensions.n_agents, dimensions.observation],
        "What each agent sees, in the order of the guide's chapter on the environment.",
    );
    let postures = source.has_postures().then(|| postures::told(&mut g, source, &seen));
    let actions = actors::actions(&mut g, source, networks, &seen, postures.as_ref());
    let joints = source.world.robot.n_joints();
    g.output("actions", &actions, &[joints], "Clipped, not scaled; joint after joint (rad/s).");
    let doc = "The actors of a trained policy: observations in, actions out.";
    g.model("policy", doc, metadata, &source.origin.program)
}

/// `controller.onnx`: state and goals to joint rates `[batch, J]`.
pub(crate) fn controller(
    source: &Source<'_>,
    networks: &Networks,
    metadata: &[(String, String)],
) -> Vec<u8> {
    let joints = source.world.robot.n_joints();
    let mut g = Graph::default();
    let arms = source.world.dimensions.n_arms;
    let inputs = Inputs {
        base_position: g.input("base_position", &[3], "World (m)."),
        base_attitude: g.input("base_attitude", &[4], "Unit quaternion w, x, y, z; base to world."),
        base_velocity: g.input("base_velocity", &[3], "Of the base's origin, world axes (m/s)."),
        base_angular_velocity: g.input("base_angular_velocity", &[3], "Axes of the base (rad/s)."),
        joint_angles: g.input("joint_angles", &[joints], "Arm after arm (rad)."),
        joint_rates: g.input("joint_rates", &[joints], "Arm after arm (rad/s)."),
        last_command: g.input("last_command", &[joints], "Zero at first (rad/s)."),
        hand_goals: source.has_hand_goals().then(|| {
            let doc = "World: position of each hand (m), then Euler angles a, b, c of Rx(a) Ry(b) Rz(c) (rad).";
            g.input("hand_goals", &[arms, 6], doc)
        }),
        hand_goal_velocities: source.has_moving_goals().then(|| {
            let doc = "World: how fast each goal moves, linear (m/s), then angular (rad/s).";
            g.input("hand_goal_velocities", &[arms, 6], doc)
        }),
        base_goal: source.has_base_goal().then(|| {
            let doc = "World: Euler angles a, b, c of Rx(a) Ry(b) Rz(c) (rad).";
            g.input("base_goal", &[3], doc)
        }),
        postures: source.has_postures().then(|| {
            let shape = [arms, postures::numbers(source)];
            let doc = "Goal postures, as octopus_postures of controller.h finds them: good, free, left of each joint (rad).";
            g.input("postures", &shape, doc)
        }),
    };
    let seen = observations::observations(&mut g, source, &inputs);
    let actions = actors::actions(&mut g, source, networks, &seen, inputs.postures.as_ref());
    let scale = g.float(source.world.task.action_scale);
    let command = g.op("Mul", &[&actions, &scale]);
    g.output("command", &command, &[joints], "Joint rates to hold for a control period (rad/s).");
    let doc = "Where the robot is and where it shall go in, joint rates out; see contract.toml.";
    g.model("controller", doc, metadata, &source.origin.program)
}
