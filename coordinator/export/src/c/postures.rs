//! Goal postures in C99: a fixed text, and the robot as it needs it.

use std::fmt::Write as _;

use simulator::model::{
    AngleContactModel, Bound, Core, FixedBody, FixedBox, Model, Pair, Partner, RigidInertia,
    Rounded,
};
use simulator::robot::Robot;
use simulator::task::UNGUIDED;

use super::tables::{define, float, matrix, table};
use crate::source::Source;

const SOURCE: &str = include_str!("postures.c");

/// The section of `controller.c`; nothing where the policy sees no postures.
pub(super) fn postures(source: &Source<'_>) -> String {
    if !source.has_postures() {
        return String::new();
    }
    SOURCE.replace("@POSTURE_TABLES@", tables(source).trim_end()) + "\n"
}

fn tables(source: &Source<'_>) -> String {
    let task = &source.world.task;
    let (gain, period) = (task.posture.gain, task.control_period);
    let pace = if gain > 0.0 { gain } else { UNGUIDED };
    let mut out = String::new();
    let factor = |factor: f64, to: &str| {
        format!("{} /* from what is left (rad) to {to} (rad/s) */", float(factor as f32))
    };
    define(&mut out, "PACE", &factor(pace / period, "a rate"));
    define(&mut out, "GUIDANCE", &factor(gain / (period * task.action_scale), "an action"));
    define(&mut out, "TRUST", &float(task.posture.trust as f32));
    let fade = format!("{} /* rad */", float(task.posture.fades().unwrap_or(0.0) as f32));
    define(&mut out, "FADE", &fade);
    let limits = task.action_limit.iter().map(|limit| float((limit * task.action_scale) as f32));
    table(&mut out, "float PACE_LIMITS[OCTOPUS_JOINTS]", limits);
    arms(&mut out, &source.world.robot);
    bodies(&mut out, &source.world.robot);
    out
}

/// What arms need alone.
fn arms(out: &mut String, robot: &Robot) {
    let steps = robot.types.iter().flat_map(|kind| &kind.links).map(|link| {
        let shift: [f64; 3] = link.shift.into();
        let twist = [0, 1, 2].map(|i| [0, 1, 2].map(|j| link.twist[(i, j)]));
        format!("\n    {{{}, {{{}}}}}", vector(&shift.map(|x| x as f32)), matrix(&twist))
    });
    table(out, "step_type STEPS[OCTOPUS_LINKS]", steps);
    let stops = robot.types.iter().flat_map(|kind| {
        let mut stops = vec![[0.0; 3]; kind.links.len()];
        for stop in kind.angle_contacts.iter().filter(|stop| stop.push) {
            stops[stop.joint] = [1.0, stop.centre as f32, stop.half as f32];
        }
        stops
    });
    let stops = stops
        .map(|[is, centre, half]| format!("\n    {{{is}, {}, {}}}", float(centre), float(half)));
    table(out, "stop_type STOPS[OCTOPUS_LINKS]", stops);
}

/// What weighs, and what can touch.
fn bodies(out: &mut String, robot: &Robot) {
    let model = Model::<f32>::new(robot);
    let _ = writeln!(out, "static const body_type BASE = {};", body(&model.base));
    let links = model.links.iter().map(|link| format!("\n    {}", body(&link.body)));
    table(out, "body_type BODIES[OCTOPUS_LINKS]", links);
    let permutations = model.arms.iter().map(|arm| match &arm.permutation {
        Some(p) => format!(
            "\n    {{1, {{{}}}, {}}}",
            p.place.map(|x| x.to_string()).join(", "),
            vector(&p.sign)
        ),
        None => "\n    {0, {0, 0, 0}, {0.0f, 0.0f, 0.0f}}".to_owned(),
    });
    table(out, "permutation_type PERMUTATIONS[OCTOPUS_ARMS]", permutations);
    let contacts = model.angle_contacts.iter().map(|contact| {
        let AngleContactModel { joint, centre, half, narrowing, narrowing_joint, .. } = contact;
        let numbers = [*centre, *half, *narrowing].map(float).join(", ");
        format!("\n    {{{joint}, {narrowing_joint}, {numbers}}}")
    });
    counted(
        out,
        "angle_contact_type",
        "ANGLE_CONTACTS",
        contacts.collect(),
        "{0, 0, 0.0f, 0.0f, 0.0f}",
    );
    let mut end = 0;
    let of_kinds = robot.types.iter().map(|kind| {
        let first = end;
        end += kind.angle_contacts.len();
        format!(" {{{first}, {end}}}")
    });
    table(out, "range_type CONTACTS_OF[OCTOPUS_KINDS]", of_kinds);

    let collision = &model.collision;
    let link_of = collision.link_of.iter().map(ToString::to_string);
    table(out, "unsigned char LINK_OF[OCTOPUS_JOINTS]", link_of);
    let mut shapes = Vec::new();
    let mut solids = Vec::new();
    let moving = collision.links.iter().map(|link| (&link.shapes, &link.bound));
    for (of_body, bound) in moving {
        solids.push(rounded(&mut shapes, of_body, bound));
    }
    for body in &collision.fixed {
        solids.push(match body {
            FixedBody::Rounded(of_body, bound) => rounded(&mut shapes, of_body, bound),
            FixedBody::Box(FixedBox { centre, rotation, half }) => {
                let [centre, half] = [centre, half].map(vector);
                format!(
                    "{{0, 0, 1, {NO_BOUND}, {{{centre}, {{{}}}, {half}}}}}",
                    matrix(&rotation.map(|row| row.map(f64::from)))
                )
            }
        });
    }
    counted(out, "shape_type", "SHAPES", shapes, "{0, {0.0f}, {0.0f}, 0.0f, 0.0f, 0.0f}");
    out.push_str("/* Links, then what is fixed to the base. */\n");
    counted(
        out,
        "solid_type",
        "SOLIDS",
        solids.iter().map(|solid| format!("\n    {solid}")).collect(),
        "",
    );
    let pairs = collision.pairs.iter().map(|Pair { a, b, reach, simple, .. }| {
        let (b, is_link) = match b {
            Partner::Link(b) => (b, 1),
            Partner::Fixed(b) => (b, 0),
        };
        format!(" {{{a}, {b}, {is_link}, {}, {}}}", i32::from(*simple), float(*reach))
    });
    counted(out, "pair_type", "PAIRS", pairs.collect(), "{0, 0, 0, 0, 0.0f}");
}

/// A table, and the number of its entries; one that is never used where there are none.
fn counted(out: &mut String, of: &str, name: &str, entries: Vec<String>, none: &str) {
    define(out, name, &entries.len().to_string());
    let entries = if entries.is_empty() { vec![none.to_owned()] } else { entries };
    table(out, &format!("{of} {name}[{}]", entries.len()), entries.into_iter());
}

const NO_BOUND: &str = "{{0.0f}, {0.0f}, 0.0f}";
const NO_BOX: &str = "{{0.0f}, {{{0.0f}}}, {0.0f}}";

fn vector(v: &[f32; 3]) -> String {
    format!("{{{}}}", v.map(float).join(", "))
}

fn body(RigidInertia { mass, h, inertia }: &RigidInertia<f32>) -> String {
    let inertia = inertia.map(float).join(", ");
    format!("{{{}, {}, {{{inertia}}}}}", float(*mass), vector(h))
}

/// A body of shapes, which are added to those of all bodies.
fn rounded(all: &mut Vec<String>, shapes: &[Rounded<f32>], bound: &Bound<f32>) -> String {
    let first = all.len();
    all.extend(shapes.iter().map(|Rounded { core, radius }| {
        let (is_cylinder, a, b, of_cylinder) = match core {
            Core::Segment { from, to } => (0, from, to, [0.0; 2]),
            Core::Cylinder { centre, axis, radius, half } => (1, centre, axis, [*radius, *half]),
        };
        let of_cylinder = of_cylinder.map(float).join(", ");
        format!(
            "\n    {{{is_cylinder}, {}, {}, {}, {of_cylinder}}}",
            vector(a),
            vector(b),
            float(*radius)
        )
    }));
    let bound =
        format!("{{{}, {}, {}}}", vector(&bound.from), vector(&bound.to), float(bound.radius));
    format!("{{{first}, {}, 0, {bound}, {NO_BOX}}}", shapes.len())
}
