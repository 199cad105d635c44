//! Joints arm by arm or agent by agent, and back: with room for those of the longest, and zeros where a shorter one has none.

use std::ops::Range;

use simulator::robot::Joints;

use super::graph::{Graph, Value};

/// `[batch, arms, longest]` of `[batch, J]`.
pub(super) fn by_arm(g: &mut Graph, joints: &Joints, values: &Value) -> Value {
    spread(g, &of_arms(joints), joints.longest_arm(), values)
}

/// `[batch, agents, U]` of `[batch, J]`.
pub(super) fn by_agent(g: &mut Graph, joints: &Joints, values: &Value) -> Value {
    spread(g, &of_agents(joints), joints.per_agent(), values)
}

/// `[batch, arms, longest]` with zeros where an arm has no joint.
pub(super) fn blanked(g: &mut Graph, joints: &Joints, values: &Value) -> Value {
    blank(g, &of_arms(joints), joints.longest_arm(), values)
}

/// `[batch, J]` of `[batch, arms, longest]`.
pub(super) fn of_joints(g: &mut Graph, joints: &Joints, values: &Value) -> Value {
    gathered(g, &of_arms(joints), joints.longest_arm(), values)
}

/// `[batch, J]` of the actions of all agents, `[batch, …]` with agents × U numbers behind.
pub(super) fn of_actions(g: &mut Graph, joints: &Joints, values: &Value) -> Value {
    gathered(g, &of_agents(joints), joints.per_agent(), values)
}

fn of_arms(joints: &Joints) -> Vec<Range<usize>> {
    (0..joints.n_arms()).map(|arm| joints.of_arm(arm)).collect()
}

fn of_agents(joints: &Joints) -> Vec<Range<usize>> {
    (0..joints.n_agents()).map(|agent| joints.of_agent(agent)).collect()
}

fn are_even(rows: &[Range<usize>], room: usize) -> bool {
    rows.iter().all(|row| row.len() == room)
}

fn spread(g: &mut Graph, rows: &[Range<usize>], room: usize, values: &Value) -> Value {
    let shape = [0, rows.len() as i64, room as i64];
    if are_even(rows, room) {
        return g.reshape(values, &shape);
    }
    // Any joint in the place of one that there is not, before zero takes its place.
    let at =
        |row: &Range<usize>, place: usize| if place < row.len() { row.start + place } else { 0 };
    let all = rows.iter().flat_map(|row| (0..room).map(|place| at(row, place) as i64));
    let all: Vec<i64> = all.collect();
    let spread = g.gather(values, -1, &all);
    let spread = g.reshape(&spread, &shape);
    blank(g, rows, room, &spread)
}

fn blank(g: &mut Graph, rows: &[Range<usize>], room: usize, values: &Value) -> Value {
    if are_even(rows, room) {
        return values.clone();
    }
    let is = rows.iter().flat_map(|row| (0..room).map(|place| place < row.len()));
    let is: Vec<bool> = is.collect();
    g.or_zero(&[1, rows.len(), room], &is, values)
}

fn gathered(g: &mut Graph, rows: &[Range<usize>], room: usize, values: &Value) -> Value {
    let flat = g.reshape(values, &[0, (rows.len() * room) as i64]);
    if are_even(rows, room) {
        return flat;
    }
    let all = rows.iter().enumerate();
    let all = all.flat_map(|(row, of)| (0..of.len()).map(move |place| (row * room + place) as i64));
    let all: Vec<i64> = all.collect();
    g.gather(&flat, -1, &all)
}
