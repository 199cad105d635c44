//! What goal postures add: to what agents see, and to what they do. Postures are `[batch, arms, 8]`: good, free, what is left of six joints (rad).

use simulator::task::observation::POSTURE_WIDTH;

use super::graph::{Attribute, Graph, Value};
use crate::source::{ARM_JOINTS, Source};

/// Numbers of a posture.
pub(super) const NUMBERS: usize = 2 + ARM_JOINTS;

/// Numbers of an observation behind those of a posture: what is left, squashed, and the last action.
const BEHIND: usize = 2 * ARM_JOINTS;

fn left(g: &mut Graph, postures: &Value) -> Value {
    let at: Vec<i64> = (2..NUMBERS as i64).collect();
    g.gather(postures, -1, &at)
}

/// What agents see of them: as they are, and what is left squashed.
pub(super) fn seen(g: &mut Graph, postures: &Value) -> [Value; 2] {
    let left = left(g, postures);
    let factor = g.float(1.0 / POSTURE_WIDTH);
    let scaled = g.op("Mul", &[&left, &factor]);
    [postures.clone(), g.op("Tanh", &[&scaled])]
}

/// Postures that observations `[batch, A, O]` tell, which shoulder and wrist have in common.
pub(super) fn told(g: &mut Graph, source: &Source<'_>, observations: &Value) -> Value {
    let dimensions = &source.world.dimensions;
    let shoulders: Vec<i64> = (0..dimensions.n_arms as i64).map(|arm| 2 * arm).collect();
    let of_arms = g.gather(observations, 1, &shoulders);
    let end = (dimensions.observation - BEHIND) as i64;
    let at: Vec<i64> = (end - NUMBERS as i64..end).collect();
    g.gather(&of_arms, -1, &at)
}

/// Actions `[batch, J]` that go there by themselves: all joints of an arm in proportion, within their limits.
pub(super) fn guidance(g: &mut Graph, source: &Source<'_>, postures: &Value) -> Value {
    let task = &source.world.task;
    let (arms, joints) = (task.n_arms(), task.action_limit.len());
    let left = left(g, postures);
    let free = g.gather(postures, -1, &[1]);
    let factor = g.float(task.posture.gain / (task.control_period * task.action_scale));
    let factor = g.op("Mul", &[&free, &factor]);
    let there = g.op("Mul", &[&left, &factor]);
    let limits = g.floats(&[1, arms, ARM_JOINTS], &task.action_limit);
    let absolute = g.op("Abs", &[&there]);
    let shares = g.op("Div", &[&absolute, &limits]);
    let last = g.ints(&[-1]);
    let largest = g.with("ReduceMax", &[&shares, &last], vec![Attribute::Int("keepdims", 1)]);
    let one = g.float(1.0);
    let excess = g.op("Max", &[&largest, &one]);
    let within = g.op("Div", &[&there, &excess]);
    g.reshape(&within, &[0, joints as i64])
}
