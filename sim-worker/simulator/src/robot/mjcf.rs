//! The robot as a MuJoCo model.
//!
//! Every number is written so that it reads back to the same `f64`: frames as positions and quaternions, inertias as full tensors about the
//! centre of mass, the compiler's own inference switched off. The servos clip commands and torques as ours do.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::xml::{Xml, numbers};
use super::{ArmBody, BaseBox, RigidBody, Robot, Shape};

/// Capsules that are shorter (m) are balls.
const SHORTEST: f64 = 1e-9;

/// What goes into the model beside bodies, joints and servos.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MjcfOptions {
    /// Whether shapes touch. What MuJoCo counts then is what [`count_contacts`](crate::collision::count_contacts) counts, less the pairs told by
    /// joint angle; without, shapes are only drawn.
    pub contacts: bool,
}

/// The robot in MJCF, MuJoCo's XML format.
///
/// Bodies: `base`, then per arm `<arm>_<link>`; joints and actuators likewise, joint angles are ours; sites `<arm>_hand`. MuJoCo's generalised
/// positions and velocities then stand in the order of our [`State`](crate::state::State). Keyframe `home` is the robot at home.
pub fn mjcf(robot: &Robot, options: MjcfOptions) -> String {
    let mut x = Xml::new("");
    x.open(&format!("mujoco model=\"{}\"", robot.name));
    x.line("compiler angle=\"radian\" autolimits=\"true\" inertiafromgeom=\"false\" boundmass=\"0\" boundinertia=\"0\" balanceinertia=\"false\"");
    x.line("option timestep=\"0.001\" integrator=\"Euler\" gravity=\"0 0 0\" cone=\"elliptic\" impratio=\"5\"");
    x.open("worldbody");
    x.open(&format!("body name=\"base\" pos=\"{}\"", numbers(&robot.home_position)));
    x.line("freejoint name=\"base\"");
    put_inertial(&mut x, &robot.base);
    for b in &robot.boxes {
        put_solid(&mut x, b, options);
    }
    for arm in &robot.arms {
        let kind = &robot.types[arm.arm_type];
        put_solid(&mut x, &arm.mount, options);
        for (i, shape) in arm.pedestal_shapes.iter().enumerate() {
            put_shape(&mut x, (&format!("{}_pedestal_{i}", arm.name), shape), options);
        }
        let (mut position, mut rotation) = (arm.position, arm.rotation);
        for (j, link) in kind.links.iter().enumerate() {
            let name = format!("{}_{}", arm.name, link.name);
            x.open(&format!("body name=\"{name}\" {}", pose(&position, &rotation)));
            x.line(&format!(
                "joint name=\"{name}\" type=\"hinge\" axis=\"0 0 1\" ref=\"0\" armature=\"{}\"",
                link.armature
            ));
            put_inertial(&mut x, &link.body);
            for (i, shape) in link.shapes.iter().enumerate() {
                put_shape(&mut x, (&format!("{name}_{i}"), shape), options);
            }
            (position, rotation) = (link.shift, link.twist);
            if j + 1 == kind.links.len() {
                let at = pose(&kind.tool_position, &kind.tool_rotation);
                x.line(&format!("site name=\"{}_hand\" {at}", arm.name));
            }
        }
        for _ in &kind.links {
            x.close("body");
        }
    }
    x.close("body");
    x.close("worldbody");
    if options.contacts {
        put_exclusions(&mut x, robot);
    }
    x.open("actuator");
    for arm in &robot.arms {
        for link in &robot.types[arm.arm_type].links {
            x.line(&format!(
                "general name=\"{0}_{1}\" joint=\"{0}_{1}\" ctrlrange=\"{2} {3}\" forcerange=\"{4} {5}\" gainprm=\"{6}\" biastype=\"affine\" biasprm=\"0 0 {7}\"",
                arm.name, link.name, -link.max_rate, link.max_rate, -link.max_torque, link.max_torque, link.gain, -link.gain
            ));
        }
    }
    x.close("actuator");
    x.open("keyframe");
    let home: Vec<f64> =
        robot.home_position.into_iter().chain([1.0, 0.0, 0.0, 0.0]).chain(robot.home_q()).collect();
    x.line(&format!("key name=\"home\" qpos=\"{}\"", numbers(&home)));
    x.close("keyframe");
    x.close("mujoco");
    x.into_text()
}

fn put_inertial(x: &mut Xml, body: &RigidBody) {
    let i = &body.inertia;
    x.line(&format!(
        "inertial mass=\"{}\" pos=\"{}\" fullinertia=\"{}\"",
        body.mass,
        numbers(body.com.as_slice()),
        numbers(&[i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]])
    ));
}

/// Pairs of links told by joint angle. Mount and pedestal belong to the base's body, whose pairs cannot be excluded one by one: whoever counts
/// leaves those out by the shapes' names.
fn put_exclusions(x: &mut Xml, robot: &Robot) {
    x.open("contact");
    for arm in &robot.arms {
        let kind = &robot.types[arm.arm_type];
        for contact in &kind.angle_contacts {
            if let [ArmBody::Link(a), ArmBody::Link(b)] = contact.pair {
                let name = |l: usize| format!("{}_{}", arm.name, kind.links[l].name);
                x.line(&format!("exclude body1=\"{}\" body2=\"{}\"", name(a), name(b)));
            }
        }
    }
    x.close("contact");
}

fn touching(options: MjcfOptions) -> &'static str {
    if options.contacts {
        "contype=\"1\" conaffinity=\"1\""
    } else {
        "contype=\"0\" conaffinity=\"0\""
    }
}

fn put_solid(x: &mut Xml, b: &BaseBox, options: MjcfOptions) {
    x.line(&format!(
        "geom name=\"{}\" type=\"box\" size=\"{}\" {} {}",
        b.name,
        numbers(b.half.as_slice()),
        pose(&b.centre, &b.rotation),
        touching(options)
    ));
}

fn put_shape(x: &mut Xml, (name, shape): (&str, &Shape), options: MjcfOptions) {
    let touching = touching(options);
    match shape {
        // MuJoCo takes no capsule without a length.
        Shape::Capsule { from, to, radius } if (to - from).norm() < SHORTEST => x.line(&format!(
            "geom name=\"{name}\" type=\"sphere\" size=\"{radius}\" pos=\"{}\" {touching}",
            numbers(((from + to) / 2.0).as_slice())
        )),
        Shape::Capsule { from, to, radius } => x.line(&format!(
            "geom name=\"{name}\" type=\"capsule\" size=\"{radius}\" fromto=\"{} {}\" {touching}",
            numbers(from.as_slice()),
            numbers(to.as_slice())
        )),
        Shape::Disc { centre, axis, radius, half_height } => x.line(&format!(
            "geom name=\"{name}\" type=\"cylinder\" size=\"{radius}\" fromto=\"{} {}\" {touching}",
            numbers((centre - axis * *half_height).as_slice()),
            numbers((centre + axis * *half_height).as_slice())
        )),
    }
}

fn pose(position: &Vector3<f64>, rotation: &Matrix3<f64>) -> String {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    format!("pos=\"{}\" quat=\"{}\"", numbers(position.as_slice()), numbers(&[q.w, q.i, q.j, q.k]))
}
