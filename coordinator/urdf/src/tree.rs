//! The tree of links: what is fixed together, and the arms that hang on the base.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nalgebra::{Isometry3, Unit, Vector3};
use simulator::robot::{MAX_JOINTS_PER_ARM, MIN_JOINTS_PER_ARM};

use crate::document::{Document, Joint, Link};
use crate::error::UrdfError;

/// Links that do not move against each other, with their poses in the frame of the root link while all angles are zero.
pub(crate) type Body<'d> = Vec<(&'d Link, Isometry3<f64>)>;

/// An arm: joints one after the other, and what each of them moves.
#[derive(Debug)]
pub(crate) struct Arm<'d> {
    pub(crate) joints: Vec<Axis<'d>>,
    pub(crate) bodies: Vec<Body<'d>>,
}

/// A joint with all angles zero, in the frame of the root link.
#[derive(Debug)]
pub(crate) struct Axis<'d> {
    pub(crate) joint: &'d Joint,
    pub(crate) pose: Isometry3<f64>,
    pub(crate) direction: Unit<Vector3<f64>>,
}

/// The robot as one base and its arms.
#[derive(Debug)]
pub(crate) struct Tree<'d> {
    pub(crate) base: Body<'d>,
    pub(crate) arms: Vec<Arm<'d>>,
}

impl<'d> Tree<'d> {
    pub(crate) fn of(document: &'d Document) -> Result<Self, UrdfError> {
        if document.links.is_empty() {
            let cure = "expand it first, if it is written in xacro";
            return Err(UrdfError::robot("the robot has no link", cure));
        }
        let mut links = BTreeMap::new();
        for link in &document.links {
            if links.insert(link.name.as_str(), link).is_some() {
                let found = format!("two links are called `{}`", link.name);
                return Err(UrdfError::robot(found, "give each a name of its own"));
            }
        }
        let mut parents: BTreeMap<&str, &Joint> = BTreeMap::new();
        let mut children: BTreeMap<&str, Vec<&'d Joint>> = BTreeMap::new();
        let mut names = BTreeSet::new();
        for joint in &document.joints {
            if !names.insert(joint.name.as_str()) {
                let found = format!("two joints are called `{}`", joint.name);
                return Err(UrdfError::robot(found, "give each a name of its own"));
            }
            for end in [&joint.parent, &joint.child] {
                if !links.contains_key(end.as_str()) {
                    let found = format!("joint `{}` names the link `{end}`", joint.name);
                    return Err(UrdfError::robot(found, "there is no such link"));
                }
            }
            if let Some(other) = parents.insert(&joint.child, joint) {
                let found = format!(
                    "link `{}` hangs on two joints, `{}` and `{}`",
                    joint.child, other.name, joint.name
                );
                return Err(UrdfError::robot(found, "a robot must be a tree"));
            }
            children.entry(&joint.parent).or_default().push(joint);
        }
        let roots: Vec<&str> =
            links.keys().copied().filter(|name| !parents.contains_key(name)).collect();
        let [root] = roots[..] else {
            let found = match roots.as_slice() {
                [] => "no link is the base: each hangs on another".to_owned(),
                _ => format!("{} links hang on nothing: {}", roots.len(), shown(&roots)),
            };
            return Err(UrdfError::robot(found, "exactly one link, the base, hangs on none"));
        };
        let walk = Walk { links, children };
        let apart = walk.links.len() - walk.below(root);
        if apart > 0 {
            let found = format!("{apart} links hang on each other in a circle");
            return Err(UrdfError::robot(found, "a robot must be a tree"));
        }
        let (base, first) = walk.body(root, Isometry3::identity());
        let arms = first.into_iter().map(|joint| walk.arm(joint)).collect::<Result<Vec<_>, _>>()?;
        if arms.is_empty() {
            return Err(UrdfError::robot(
                format!("nothing moves on the base `{root}`"),
                format!("a robot has arms of {MIN_JOINTS_PER_ARM} to {MAX_JOINTS_PER_ARM} joints"),
            ));
        }
        Ok(Self { base, arms })
    }
}

struct Walk<'d> {
    links: BTreeMap<&'d str, &'d Link>,
    children: BTreeMap<&'d str, Vec<&'d Joint>>,
}

impl<'d> Walk<'d> {
    /// How many links there are from a link on.
    fn below(&self, link: &'d str) -> usize {
        let mut waiting = vec![link];
        let mut count = 0;
        while let Some(link) = waiting.pop() {
            count += 1;
            let joints = self.children.get(link).into_iter().flatten();
            waiting.extend(joints.map(|joint| joint.child.as_str()));
        }
        count
    }

    /// What is fixed to a link, and the joints by which others move on it.
    fn body(&self, link: &str, pose: Isometry3<f64>) -> (Body<'d>, Vec<Axis<'d>>) {
        let (mut body, mut moving) = (Vec::new(), Vec::new());
        let mut waiting = VecDeque::from([(self.links[link], pose)]);
        while let Some((link, pose)) = waiting.pop_front() {
            body.push((link, pose));
            for joint in self.children.get(link.name.as_str()).into_iter().flatten() {
                let pose = pose * joint.origin;
                if joint.moves {
                    let direction = Unit::new_normalize(pose.rotation * joint.axis.into_inner());
                    moving.push(Axis { joint, pose, direction });
                } else {
                    waiting.push_back((self.links[joint.child.as_str()], pose));
                }
            }
        }
        (body, moving)
    }

    fn arm(&self, first: Axis<'d>) -> Result<Arm<'d>, UrdfError> {
        let name = first.joint.name.clone();
        let wanted = format!(
            "an arm has {MIN_JOINTS_PER_ARM} to {MAX_JOINTS_PER_ARM} joints that turn, one after the other"
        );
        let (mut joints, mut bodies) = (Vec::new(), Vec::new());
        let mut next = Some(first);
        while let Some(axis) = next {
            let (body, mut moving) = self.body(&axis.joint.child, axis.pose);
            if moving.len() > 1 {
                let at = &axis.joint.child;
                let found = format!(
                    "{} joints move on link `{at}` of the arm that begins with `{name}`",
                    moving.len()
                );
                return Err(UrdfError::robot(found, wanted));
            }
            next = moving.pop();
            joints.push(axis);
            bodies.push(body);
        }
        if !(MIN_JOINTS_PER_ARM..=MAX_JOINTS_PER_ARM).contains(&joints.len()) {
            let found = format!("the arm that begins with joint `{name}` has {}", joints.len());
            return Err(UrdfError::robot(found, wanted));
        }
        Ok(Arm { joints, bodies })
    }
}

/// A few names, and how many more there are.
pub(crate) fn shown(names: &[&str]) -> String {
    const MOST: usize = 5;
    let mut text = names.iter().take(MOST).map(|name| format!("`{name}`")).collect::<Vec<_>>();
    if names.len() > MOST {
        text.push(format!("{} more", names.len() - MOST));
    }
    text.join(", ")
}
