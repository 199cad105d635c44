//! Which bodies touch at home. The simulator counts them by kind and by arm; by taking shapes away from the description, until
//! those of one link or two are left, it is told which they are.

use std::f64::consts::TAU;

use simulator::collision::{Touching, touching};
use simulator::model::{ContactKind, Model};
use simulator::robot::{ArmBody, Robot};
use simulator::state::State;
use simulator::workspace::Workspace;

use super::fault::Fault;
use super::keys::type_prefix;

/// The first two bodies that touch at home, and what to change.
pub(super) fn touches_at_home(robot: &Robot) -> Option<Fault> {
    let touches = at_home(robot).pairs;
    if touches == 0.0 {
        return None;
    }
    let more = match touches as usize - 1 {
        0 => String::new(),
        1 => " (and one pair more)".to_owned(),
        n => format!(" (and {n} pairs more)"),
    };
    let expected = "nothing to touch before anything has moved";
    Some(stopped(robot, &more).or_else(|| overlap(robot, &more)).unwrap_or_else(|| Fault {
        found: format!("bodies touch at home{more}"),
        cure: "change mount_position or home of the arms".to_owned(),
        expected,
    }))
    .map(|fault| Fault { expected, ..fault })
}

fn at_home(robot: &Robot) -> Touching<f64> {
    let model = Model::<f64>::new(robot);
    touching(&model, &mut Workspace::new(&model), &State::home(robot))
}

/// A joint that stands where two bodies touch.
fn stopped(robot: &Robot, more: &str) -> Option<Fault> {
    for (number, arm) in robot.arms.iter().enumerate() {
        let kind = robot.type_of(number);
        for (index, stop) in kind.angle_contacts.iter().enumerate() {
            let offset = arm.home[stop.joint] - stop.centre;
            let offset = offset - TAU * (offset / TAU).round();
            let narrowing = stop.narrowing * (2.0 * arm.home[stop.narrowing_joint]).sin().abs();
            if offset.abs() <= stop.half - narrowing {
                let [a, b] = stop.pair.map(|body| match body {
                    ArmBody::Mount => "mount",
                    ArmBody::Pedestal => "pedestal",
                    ArmBody::Link(link) => &kind.links[link].name,
                });
                return Some(Fault {
                    found: format!(
                        "`{a}` and `{b}` of arm `{}` touch at home{more}, as joint {} stands at {} rad, \
                         within {}stops[{index}].interval",
                        arm.name,
                        stop.joint + 1,
                        arm.home[stop.joint],
                        type_prefix(robot, number)
                    ),
                    expected: "",
                    cure: format!("change arms[{number}] ({}).home or the interval", arm.name),
                });
            }
        }
    }
    None
}

/// Two bodies whose shapes overlap.
fn overlap(robot: &Robot, more: &str) -> Option<Fault> {
    let found = |a: String, b: String, touching: &Touching<f64>| {
        let arms = robot.arms.iter().enumerate();
        let arms = arms.filter(|(arm, _)| touching.by_arm[*arm] > 0.0);
        let (keys, arms): (Vec<String>, Vec<String>) = arms
            .map(|(arm, it)| (format!("arms[{arm}] ({})", it.name), format!("`{}`", it.name)))
            .unzip();
        Some(Fault {
            found: format!("{a} of arm {} touches {b} at home{more}", arms.join(", ")),
            expected: "",
            cure: format!(
                "change mount_position, mount_euler_deg or home of {}, or the shapes",
                keys.join(", ")
            ),
        })
    };
    let kind = |touching: &Touching<f64>, kind: ContactKind| touching.by_kind[kind as usize] > 0.0;
    let boxes: Vec<String> = robot.boxes.iter().map(|part| format!("`{}`", part.name)).collect();
    // Every link of every type, as (type, link).
    let all: Vec<(usize, usize)> = robot
        .types
        .iter()
        .enumerate()
        .flat_map(|(arm_type, kind)| (0..kind.links.len()).map(move |link| (arm_type, link)))
        .collect();
    let name =
        |(arm_type, link): (usize, usize)| format!("`{}`", robot.types[arm_type].links[link].name);
    for &link in &all {
        let alone = at_home(&with_shapes_of(robot, &[link])?);
        if kind(&alone, ContactKind::Base) {
            return found(name(link), format!("the base ({})", boxes.join(", ")), &alone);
        }
        if kind(&alone, ContactKind::Mount) {
            return found(name(link), "a mount or pedestal".to_owned(), &alone);
        }
    }
    for (index, &a) in all.iter().enumerate() {
        for &b in &all[index..] {
            let both = at_home(&with_shapes_of(robot, &[a, b])?);
            if kind(&both, ContactKind::Own) {
                return found(name(a), format!("its own {}", name(b)), &both);
            }
            if kind(&both, ContactKind::Arms) {
                return found(name(a), format!("{} of another arm", name(b)), &both);
            }
        }
    }
    None
}

/// The robot with no shapes on its links but on these, each a type and the number of a link.
fn with_shapes_of(robot: &Robot, kept: &[(usize, usize)]) -> Option<Robot> {
    let mut description = robot.description().clone();
    for (arm_type, links) in description.links_of_types_mut().enumerate() {
        for (index, link) in links.iter_mut().enumerate() {
            if !kept.contains(&(arm_type, index)) {
                link.capsules.clear();
                link.discs.clear();
            }
        }
    }
    Robot::from_description(description, std::path::Path::new(&robot.name)).ok()
}
