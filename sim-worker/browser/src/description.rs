//! What a page must know once: the robot, its shapes, and where the arrays are.

use std::collections::BTreeMap;

use proto::config::TaskName;
use proto::tasks::Aim;
use serde::Serialize;
use simulator::experiment::Episode;
use simulator::robot::Robot;

use crate::arrays::Arrays;

#[derive(Serialize)]
struct Description<'a> {
    /// Name of the robot.
    robot: &'a str,
    /// Task of every policy, by slot.
    task: Vec<&'static str>,
    /// What the tasks that there are have goals for.
    aims: BTreeMap<&'static str, Aims>,
    n_arms: usize,
    n_joints: usize,
    /// By arm: its first joint, and the first behind its last.
    joints: Vec<[usize; 2]>,
    /// Length of a control step (s).
    control_period: f64,
    /// Of every joint, arm-major (rad/s, N m).
    max_rates: Vec<f64>,
    max_torques: Vec<f64>,
    /// Of the base's first box (kg).
    base_mass: f64,
    /// Names.
    arms: Vec<&'a str>,
    /// The base, then the links, arm-major.
    bodies: Vec<Body<'a>>,
    arrays: BTreeMap<&'static str, Place>,
}

#[derive(Serialize)]
struct Body<'a> {
    name: &'a str,
    /// The arm that it belongs to.
    arm: Option<usize>,
    shapes: Vec<Shape<'a>>,
}

/// In the body's frame (m).
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum Shape<'a> {
    Capsule {
        from: [f64; 3],
        to: [f64; 3],
        radius: f64,
    },
    Disc {
        centre: [f64; 3],
        axis: [f64; 3],
        radius: f64,
        half_height: f64,
    },
    /// `rotation` is that of the box to the body's frame, row-major.
    Box {
        name: &'a str,
        half: [f64; 3],
        centre: [f64; 3],
        rotation: [f64; 9],
    },
}

/// What a task has goals for.
#[derive(Serialize)]
struct Aims {
    /// Arms whose hands have goals.
    hands: Vec<usize>,
    base: bool,
}

#[derive(Serialize)]
struct Place {
    /// Address (bytes).
    at: usize,
    /// Numbers.
    len: usize,
}

/// The description of an episode's robot and of its arrays.
pub(crate) fn json(episode: &Episode, arrays: &Arrays) -> Result<String, String> {
    let robot = episode.robot();
    let task =
        |member: &std::sync::Arc<simulator::experiment::Member>| member.world.task.name.as_str();
    let places = arrays.places().map(|(name, at, len)| (name, Place { at, len }));
    let n_joints = robot.n_joints();
    let description = Description {
        robot: &robot.name,
        task: episode.members().iter().map(task).collect(),
        aims: TaskName::ALL.iter().map(|task| (task.as_str(), aims(*task, robot.n_arms))).collect(),
        n_arms: robot.n_arms,
        n_joints,
        joints: (0..robot.n_arms)
            .map(|arm| robot.joints.of_arm(arm))
            .map(|of| [of.start, of.end])
            .collect(),
        control_period: episode.control_period(),
        max_rates: robot.max_rates(),
        max_torques: (0..n_joints).map(|joint| robot.link(joint).max_torque).collect(),
        base_mass: robot.boxes[0].body.mass,
        arms: robot.arms.iter().map(|arm| arm.name.as_str()).collect(),
        bodies: bodies(robot),
        arrays: places.collect(),
    };
    serde_json::to_string(&description).map_err(|error| error.to_string())
}

fn aims(task: TaskName, n_arms: usize) -> Aims {
    let reaches = |arm: &usize| task.aim(*arm, n_arms) == Aim::Hand;
    Aims { hands: (0..n_arms).filter(reaches).collect(), base: task.turns() }
}

fn bodies(robot: &Robot) -> Vec<Body<'_>> {
    let mounts = robot.arms.iter().map(|arm| &arm.mount);
    let boxes = robot.boxes.iter().chain(mounts).map(|b| Shape::Box {
        name: &b.name,
        half: b.half.into(),
        centre: b.centre.into(),
        rotation: std::array::from_fn(|i| b.rotation[(i / 3, i % 3)]),
    });
    let pedestals = robot.arms.iter().flat_map(|arm| &arm.pedestal_shapes).map(shape);
    let mut bodies =
        vec![Body { name: "base", arm: None, shapes: boxes.chain(pedestals).collect() }];
    for arm in 0..robot.n_arms {
        bodies.extend(robot.type_of(arm).links.iter().map(|link| Body {
            name: &link.name,
            arm: Some(arm),
            shapes: link.shapes.iter().map(shape).collect(),
        }));
    }
    bodies
}

fn shape(shape: &simulator::robot::Shape) -> Shape<'_> {
    match shape {
        simulator::robot::Shape::Capsule { from, to, radius } => {
            Shape::Capsule { from: (*from).into(), to: (*to).into(), radius: *radius }
        }
        simulator::robot::Shape::Disc { centre, axis, radius, half_height } => Shape::Disc {
            centre: (*centre).into(),
            axis: (*axis).into(),
            radius: *radius,
            half_height: *half_height,
        },
    }
}
