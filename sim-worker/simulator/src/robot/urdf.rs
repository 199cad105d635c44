//! The robot as URDF, the description that robot viewers draw.
//!
//! Links are `base` and `<arm>_<link>`, joints `<arm>_<link>` likewise, with our angles and axes: a link's frame is the
//! one that the simulator has. `<arm>_hand` is a link without mass at each hand. Capsules become cylinders with a ball at each end.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::xml::{Xml, numbers};
use super::{BaseBox, RigidBody, Robot, Shape};

/// Colour of the base and of the arms: red, green, blue, alpha.
const COLOURS: [(&str, &str); 2] = [("body", "0.85 0.85 0.88 1"), ("arm", "0.36 0.55 0.80 1")];

/// The robot in URDF.
pub fn urdf(robot: &Robot) -> String {
    let mut x = Xml::new("<?xml version=\"1.0\"?>\n");
    x.open(&format!("robot name=\"{}\"", robot.name));
    for (name, rgba) in COLOURS {
        x.open(&format!("material name=\"{name}\""));
        x.line(&format!("color rgba=\"{rgba}\""));
        x.close("material");
    }
    x.open("link name=\"base\"");
    put_inertial(&mut x, &robot.base);
    for b in robot.boxes.iter().chain(robot.arms.iter().map(|arm| &arm.mount)) {
        put_solid(&mut x, b);
    }
    for shape in robot.arms.iter().flat_map(|arm| &arm.pedestal_shapes) {
        put_shape(&mut x, shape, "body");
    }
    x.close("link");
    for arm in &robot.arms {
        let (mut parent, mut position, mut rotation) =
            ("base".to_owned(), arm.position, arm.rotation);
        let kind = &robot.types[arm.arm_type];
        for link in &kind.links {
            let name = format!("{}_{}", arm.name, link.name);
            x.open(&format!("joint name=\"{name}\" type=\"continuous\""));
            x.line(&format!("origin {}", pose(&position, &rotation)));
            x.line(&format!("parent link=\"{parent}\""));
            x.line(&format!("child link=\"{name}\""));
            x.line("axis xyz=\"0 0 1\"");
            x.line(&format!("limit effort=\"{}\" velocity=\"{}\"", link.max_torque, link.max_rate));
            x.close("joint");
            x.open(&format!("link name=\"{name}\""));
            put_inertial(&mut x, &link.body);
            for shape in &link.shapes {
                put_shape(&mut x, shape, "arm");
            }
            x.close("link");
            (parent, position, rotation) = (name, link.shift, link.twist);
        }
        x.open(&format!("joint name=\"{}_hand\" type=\"fixed\"", arm.name));
        x.line(&format!("origin {}", pose(&kind.tool_position, &kind.tool_rotation)));
        x.line(&format!("parent link=\"{parent}\""));
        x.line(&format!("child link=\"{}_hand\"", arm.name));
        x.close("joint");
        x.line(&format!("link name=\"{}_hand\"", arm.name));
    }
    x.close("robot");
    x.into_text()
}

fn put_inertial(x: &mut Xml, body: &RigidBody) {
    let i = &body.inertia;
    x.open("inertial");
    x.line(&format!("origin xyz=\"{}\"", numbers(body.com.as_slice())));
    x.line(&format!("mass value=\"{}\"", body.mass));
    x.line(&format!(
        "inertia ixx=\"{}\" iyy=\"{}\" izz=\"{}\" ixy=\"{}\" ixz=\"{}\" iyz=\"{}\"",
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)]
    ));
    x.close("inertial");
}

/// A shape to be seen and to touch with.
fn put_geometry(x: &mut Xml, origin: &str, geometry: &str, material: &str) {
    for kind in ["visual", "collision"] {
        x.open(kind);
        x.line(&format!("origin {origin}"));
        x.open("geometry");
        x.line(geometry);
        x.close("geometry");
        if kind == "visual" {
            x.line(&format!("material name=\"{material}\""));
        }
        x.close(kind);
    }
}

fn put_solid(x: &mut Xml, b: &BaseBox) {
    let size = numbers((2.0 * b.half).as_slice());
    put_geometry(x, &pose(&b.centre, &b.rotation), &format!("box size=\"{size}\""), "body");
}

fn put_shape(x: &mut Xml, shape: &Shape, material: &str) {
    match shape {
        Shape::Capsule { from, to, radius } => {
            put_cylinder(x, from, to, *radius, material);
            for end in [from, to] {
                let origin = format!("xyz=\"{}\"", numbers(end.as_slice()));
                put_geometry(x, &origin, &format!("sphere radius=\"{radius}\""), material);
            }
        }
        Shape::Disc { centre, axis, radius, half_height } => {
            let half = axis * *half_height;
            put_cylinder(x, &(centre - half), &(centre + half), *radius, material);
        }
    }
}

fn put_cylinder(x: &mut Xml, from: &Vector3<f64>, to: &Vector3<f64>, radius: f64, material: &str) {
    let along = to - from;
    let turn = Rotation3::rotation_between(&Vector3::z(), &along)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let origin = pose(&((from + to) / 2.0), turn.matrix());
    let length = along.norm();
    if length > 0.0 {
        let geometry = format!("cylinder radius=\"{radius}\" length=\"{length}\"");
        put_geometry(x, &origin, &geometry, material);
    }
}

/// URDF's angles are those of Rz(yaw) Ry(pitch) Rx(roll), written roll, pitch, yaw.
fn pose(position: &Vector3<f64>, rotation: &Matrix3<f64>) -> String {
    let (roll, pitch, yaw) = Rotation3::from_matrix_unchecked(*rotation).euler_angles();
    format!("xyz=\"{}\" rpy=\"{roll} {pitch} {yaw}\"", numbers(position.as_slice()))
}
