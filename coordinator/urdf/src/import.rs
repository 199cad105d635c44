//! The whole way: from a text to a description, and what was lost on it.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use nalgebra::Isometry3;
use simulator::robot::description::{
    ArmDescription, ArmTypeDescription, BoxDescription, LinkDescription, MountDescription,
    PedestalDescription, RobotDescription, ServoDescription, ToolDescription,
};
use simulator::robot::{MAX_ARMS, Robot, RobotError};

use crate::alike::Build;
use crate::bodies::{Shapes, Solid, euler_deg};
use crate::chain::{Chain, chain};
use crate::document::{Document, Inertial, Joint};
use crate::error::UrdfError;
use crate::names::{names, plain};
use crate::tree::{Arm, Tree, shown};

/// What stands for the mount and the pedestal of an arm, which URDF has not: a milligram, a millimetre.
const NOTHING: (f64, f64) = (1e-6, 1e-3);
/// Drives, of which URDF says little: as those of the built-in robots (kg m², N m s/rad, rad/s, N m).
const ARMATURE: f64 = 1.0;
const GAIN: f64 = 100.0;
const VELOCITY: f64 = 2.0942;
const EFFORT: f64 = 150.0;

/// A robot, and what of the URDF it does not have.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The robot.
    pub description: RobotDescription,
    /// What was left out, added or taken for something else, a sentence each.
    pub notes: Vec<String>,
    /// Where links of the URDF went: a key of the robot's file, and the link that it was made of.
    origins: Vec<(String, String)>,
    /// What the URDF calls the joints of each arm.
    joints: Vec<Vec<String>>,
}

impl Imported {
    /// Turns joints away from the URDF's zero, which is home without this: each by an angle of the URDF (rad), under its name or the end
    /// of it. A whole name counts before its end, and a longer end before a shorter one.
    ///
    /// # Errors
    /// If a name is that of no joint, or is there twice.
    pub fn at_home(mut self, angles: &[(String, f64)]) -> Result<Self, UrdfError> {
        let ends: Vec<&str> = angles.iter().map(|(end, _)| end.as_str()).collect();
        if let Some((_, twice)) =
            ends.iter().enumerate().find(|(at, end)| ends[..*at].contains(end))
        {
            return Err(UrdfError::robot(
                format!("joint `{twice}` has two angles at home"),
                "give each one angle",
            ));
        }
        let names: Vec<&str> = self.joints.iter().flatten().map(String::as_str).collect();
        if let Some(end) = ends.iter().find(|end| !names.iter().any(|name| name.ends_with(*end))) {
            let found = format!("no joint of an arm has a name that ends in `{end}`");
            return Err(UrdfError::robot(found, format!("there are {}", shown(&names))));
        }
        for (arm, joints) in self.description.arms.iter_mut().zip(&self.joints) {
            for (home, name) in arm.home.iter_mut().zip(joints) {
                let own = angles.iter().filter(|(end, _)| name.ends_with(end.as_str()));
                if let Some((_, angle)) = own.max_by_key(|(end, _)| end.len()) {
                    // In (−π, π], as the zeros are.
                    *home = PI - (PI - (*home + angle)).rem_euclid(TAU);
                }
            }
        }
        Ok(self)
    }

    /// Checks and completes the robot; `path` is that of the URDF. What is wrong is said with the URDF's link.
    ///
    /// # Errors
    /// If the URDF has values that no robot can have.
    pub fn robot(&self, path: &Path) -> Result<Robot, RobotError> {
        Robot::from_description(self.description.clone(), path).map_err(|error| match error {
            RobotError::Value { path, key, found, expected } => {
                let of = |(part, _): &&(String, String)| key.starts_with(&format!("{part} "));
                let origin = self.origins.iter().find(of);
                let key = origin.map_or(key.clone(), |(_, link)| format!("link `{link}`: {key}"));
                RobotError::Value { path, key, found, expected }
            }
            other => other,
        })
    }
}

/// Makes a robot of a URDF.
///
/// `hand` is the link whose frame is the hand of an arm, by the end of its name; without one it is the last link that is fixed to the last
/// joint's. `home_position` is where the base begins (m).
///
/// # Errors
/// If the text is no URDF, or its robot is none of ours: a base with one to eight arms of two to seven joints that turn.
pub fn import(
    text: &str,
    hand: Option<&str>,
    home_position: [f64; 3],
) -> Result<Imported, UrdfError> {
    let document = Document::parse(text)?;
    let tree = Tree::of(&document)?;
    if tree.arms.len() > MAX_ARMS {
        let found = format!("{} arms hang on the base", tree.arms.len());
        return Err(UrdfError::robot(found, format!("a robot has 1 to {MAX_ARMS}")));
    }
    let names = names(&tree.arms);
    let mut notes = Notes::default();
    let mut arms = Vec::new();
    let mut types: Vec<Build> = Vec::new();
    let mut origins = vec![("base[0]".to_owned(), tree.base[0].0.name.clone())];
    for (arm, (arm_name, link_names)) in tree.arms.iter().zip(&names) {
        let (hand_link, pose) = hand_of(arm, arm_name, hand)?;
        notes.push(format!("the hand of arm `{arm_name}` is link `{hand_link}`"));
        let chain = chain(&arm.joints, &pose);
        let links = (0..arm.joints.len())
            .map(|i| link(arm, &chain, i, &link_names[i], &mut notes))
            .collect::<Result<Vec<_>, _>>()?;
        let tool = chain.frames[arm.joints.len()].inverse() * pose;
        let tool = tool.translation.vector.map(|x| (x * 1e9).round() / 1e9 + 0.0).into();
        let mount = &chain.frames[0];
        arms.push(ArmDescription {
            name: arm_name.clone(),
            arm_type: None,
            mount_position: mount.translation.vector.into(),
            mount_euler_deg: euler_deg(mount.rotation.to_rotation_matrix().matrix()),
            home: chain.zeros.clone(),
        });
        if chain.left_over.abs() > 1e-3 {
            notes.add(format!(
                "the frame of a hand is turned by {:.1}° about its z axis, as rows hold no more",
                -chain.left_over.to_degrees()
            ));
        }
        if chain.straightened > 0.0 {
            notes.add(format!(
                "axes that are {:.2} mrad from parallel are taken for parallel",
                1e3 * chain.straightened
            ));
        }
        let build = Build { name: arm_name.clone(), links, tool, left_over: chain.left_over };
        let alike = types.iter().position(|other| other.difference(&build).is_none());
        if alike.is_none() && !types.is_empty() {
            let why = types[0].difference(&build).unwrap_or_default();
            notes.push(format!(
                "arm `{arm_name}` is of a type of its own, as it differs from arm `{}`: {why}",
                types[0].name
            ));
        }
        let place = alike.unwrap_or(types.len());
        if alike.is_none() {
            // The first type stands at the top of the file, the others by the names of their first arms.
            let table = if place == 0 { String::new() } else { format!("arm_types.{arm_name}.") };
            let links = arm.bodies.iter().map(|body| body[0].0.name.clone()).enumerate();
            origins.extend(links.map(|(i, link)| (format!("{table}links[{i}]"), link)));
            types.push(build);
        }
        arms.last_mut().expect("just pushed").arm_type =
            (place > 0).then(|| types[place].name.clone());
    }
    let mut types = types.into_iter();
    let Build { links, tool, .. } = types.next().expect("a tree has arms");
    let arm_types = types.map(|Build { name, links, tool, .. }| {
        let arm_type = ArmTypeDescription {
            mount: no_mount(),
            pedestal: no_pedestal(),
            links,
            tool: ToolDescription { position: tool },
            angle_contacts: Vec::new(),
        };
        (name, arm_type)
    });
    let arm_types = arm_types.collect();
    notes.push(
        "mounts and pedestals of arms, which URDF has not, are a milligram each, the mount a box of a millimetre at the first joint"
            .to_owned(),
    );
    notes.push(format!(
        "armatures, which URDF has not, are {ARMATURE} kg m², and gains of servos {GAIN} N m s/rad"
    ));
    let no_weight = |inertial: &Inertial| inertial.mass <= 0.0 && inertial.inertia.norm() > 0.0;
    for link in document.links.iter().filter(|link| link.inertial.as_ref().is_some_and(no_weight)) {
        notes.push(format!("the inertia of link `{}` is left out: it has no mass", link.name));
    }
    for what in &document.ignored {
        notes.push(format!("passed over: {what}"));
    }
    let description = RobotDescription {
        name: plain(&document.name),
        home_position,
        base: vec![base(&tree, &mut notes)?],
        mount: no_mount(),
        pedestal: no_pedestal(),
        links,
        tool: ToolDescription { position: tool },
        angle_contacts: Vec::new(),
        arm_types,
        arms,
    };
    let of = |arm: &Arm<'_>| arm.joints.iter().map(|axis| axis.joint.name.clone()).collect();
    let joints = tree.arms.iter().map(of).collect();
    Ok(Imported { description, notes: notes.sentences(), origins, joints })
}

fn no_mount() -> MountDescription {
    MountDescription { size: [NOTHING.1; 3], mass: NOTHING.0, position: [0.0; 3] }
}

fn no_pedestal() -> PedestalDescription {
    PedestalDescription {
        euler_deg: [0.0; 3],
        mass: NOTHING.0,
        com: [0.0; 3],
        inertia: [1e-12, 1e-12, 1e-12, 0.0, 0.0, 0.0],
        capsules: Vec::new(),
        discs: Vec::new(),
    }
}

/// Each kind of remark once, with how often it was made.
#[derive(Default)]
struct Notes(Vec<(String, usize)>);

impl Notes {
    fn add(&mut self, note: String) {
        match self.0.iter_mut().find(|(there, _)| *there == note) {
            Some((_, times)) => *times += 1,
            None => self.0.push((note, 1)),
        }
    }

    /// A remark that is made once.
    fn push(&mut self, note: String) {
        self.0.push((note, 1));
    }

    fn sentences(self) -> Vec<String> {
        let sentence = |(note, times)| match times {
            1 => note,
            _ => format!("{note} ({times} times)"),
        };
        self.0.into_iter().map(sentence).collect()
    }
}

/// The base as the solid box with its mass and inertia.
fn base(tree: &Tree<'_>, notes: &mut Notes) -> Result<BoxDescription, UrdfError> {
    let root = &tree.base[0].0.name;
    let solid = Solid::of(&tree.base, &Isometry3::identity()).ok_or_else(|| {
        let found = format!("the base, link `{root}`, has no mass");
        UrdfError::robot(found, "give it an <inertial>: the robot floats")
    })?;
    let equivalent = solid.equivalent_box("base").ok_or_else(|| {
        let found = format!("the base, link `{root}`, has the moments of no solid body");
        UrdfError::robot(found, "each principal moment must be less than the two others together")
    })?;
    let [x, y, z] = equivalent.size;
    notes.push(format!(
        "the base is the solid box with its mass and inertia, {x:.3} by {y:.3} by {z:.3} m, which arms touch instead of its own shapes"
    ));
    Ok(equivalent)
}

fn link(
    arm: &Arm<'_>,
    chain: &Chain,
    i: usize,
    name: &str,
    notes: &mut Notes,
) -> Result<LinkDescription, UrdfError> {
    let frame = &chain.frames[i + 1];
    let body = &arm.bodies[i];
    let joint = arm.joints[i].joint;
    let solid = Solid::of(body, frame).ok_or_else(|| {
        let found = format!("link `{}` has no mass", body[0].0.name);
        UrdfError::robot(found, format!("give it an <inertial>: joint `{}` moves it", joint.name))
    })?;
    let Shapes { capsules, discs, notes: lost } = Shapes::of(body, frame);
    for (what, times) in lost {
        (0..times).for_each(|_| notes.add(what.to_owned()));
    }
    Ok(LinkDescription {
        name: name.to_owned(),
        dh: chain.rows[i],
        mass: solid.mass,
        com: solid.com.into(),
        inertia: solid.elements(),
        armature: ARMATURE,
        servo: servo(joint, notes),
        capsules,
        discs,
    })
}

fn servo(joint: &Joint, notes: &mut Notes) -> ServoDescription {
    let mut or = |value: Option<f64>, default: f64, what: &str, unit: &str| {
        value.unwrap_or_else(|| {
            notes.add(format!("a joint without a limit of {what} has {default} {unit}"));
            default
        })
    };
    ServoDescription {
        gain: GAIN,
        max_rate: or(joint.velocity, VELOCITY, "velocity", "rad/s"),
        max_torque: or(joint.effort, EFFORT, "effort", "N m"),
    }
}

/// The link that is an arm's hand, and where it is while all angles are zero.
fn hand_of<'d>(
    arm: &Arm<'d>,
    name: &str,
    hand: Option<&str>,
) -> Result<(&'d str, Isometry3<f64>), UrdfError> {
    let last: Vec<(&str, Isometry3<f64>)> = arm
        .bodies
        .last()
        .expect("an arm has a joint")
        .iter()
        .map(|(link, pose)| (link.name.as_str(), *pose))
        .collect();
    let Some(wanted) = hand else { return Ok(*last.last().expect("a body has a link")) };
    let exact: Vec<_> = last.iter().filter(|(link, _)| *link == wanted).collect();
    let ending: Vec<_> = last.iter().filter(|(link, _)| link.ends_with(wanted)).collect();
    let found = if exact.is_empty() { ending } else { exact };
    if let [one] = found[..] {
        return Ok(*one);
    }
    let links: Vec<&str> = last.iter().map(|(link, _)| *link).collect();
    Err(UrdfError::robot(
        match found.len() {
            0 => format!("arm `{name}` has no link at its end whose name ends in `{wanted}`"),
            n => format!("arm `{name}` has {n} links at its end whose names end in `{wanted}`"),
        },
        format!("its last joint moves {}", shown(&links)),
    ))
}

#[cfg(test)]
mod tests;
