//! What goal postures add: to what agents see, and to what they do. Postures are `[batch, arms, 2 + longest]`: good, free, what is left of each joint (rad).

use simulator::task::observation::POSTURE_WIDTH;

use super::graph::{Attribute, Graph, Value};
use super::joints;
use crate::source::Source;

/// Numbers of a posture.
pub(super) fn numbers(source: &Source<'_>) -> usize {
    2 + source.longest_arm()
}

fn left(g: &mut Graph, source: &Source<'_>, postures: &Value) -> Value {
    let at: Vec<i64> = (2..numbers(source) as i64).collect();
    g.gather(postures, -1, &at)
}

/// What agents see of them: as they are, and what is left squashed.
pub(super) fn seen(g: &mut Graph, source: &Source<'_>, postures: &Value) -> [Value; 2] {
    let left = left(g, source, postures);
    let factor = g.float(1.0 / POSTURE_WIDTH);
    let scaled = g.op("Mul", &[&left, &factor]);
    [postures.clone(), g.op("Tanh", &[&scaled])]
}

/// Postures that observations `[batch, A, O]` tell, which shoulder and wrist have in common.
pub(super) fn told(g: &mut Graph, source: &Source<'_>, observations: &Value) -> Value {
    let dimensions = &source.world.dimensions;
    let shoulders: Vec<i64> = (0..dimensions.n_arms as i64).map(|arm| 2 * arm).collect();
    let of_arms = g.gather(observations, 1, &shoulders);
    // Behind them stand what is left, squashed, and the last action.
    let end = (dimensions.observation - 2 * source.longest_arm()) as i64;
    let at: Vec<i64> = (end - numbers(source) as i64..end).collect();
    g.gather(&of_arms, -1, &at)
}

/// Share of what agents say, `[batch, J]`: less near the goal postures.
pub(super) fn share(g: &mut Graph, source: &Source<'_>, postures: &Value, fade: f64) -> Value {
    let left = left(g, source, postures);
    let farthest = largest(g, &left);
    let fade = g.float(fade);
    let share = g.op("Div", &[&farthest, &fade]);
    let one = g.float(1.0);
    let share = g.op("Min", &[&share, &one]);
    // One number for all joints of an arm.
    let (arms, longest) = (source.world.task.n_arms(), source.longest_arm());
    let ones = g.floats(&[1, arms, longest], &vec![1.0; arms * longest]);
    let of_arms = g.op("Mul", &[&share, &ones]);
    joints::of_joints(g, &source.world.robot.joints, &of_arms)
}

/// The largest magnitude of each arm, `[batch, arms, 1]`.
fn largest(g: &mut Graph, of_arms: &Value) -> Value {
    let absolute = g.op("Abs", &[of_arms]);
    let last = g.ints(&[-1]);
    g.with("ReduceMax", &[&absolute, &last], vec![Attribute::Int("keepdims", 1)])
}

/// Actions `[batch, J]` that go there by themselves: all joints of an arm in proportion, within their limits.
pub(super) fn guidance(g: &mut Graph, source: &Source<'_>, postures: &Value) -> Value {
    let task = &source.world.task;
    let (of_robot, longest) = (&source.world.robot.joints, source.longest_arm());
    let left = left(g, source, postures);
    let free = g.gather(postures, -1, &[1]);
    let factor = g.float(task.posture.gain / (task.control_period * task.action_scale));
    let factor = g.op("Mul", &[&free, &factor]);
    let there = g.op("Mul", &[&left, &factor]);
    // Nothing is left of joints that a shorter arm has not: any limit will do.
    let limits = source.by_arm(&task.action_limit, 1.0);
    let limits = g.floats(&[1, task.n_arms(), longest], &limits);
    let shares = g.op("Div", &[&there, &limits]);
    let largest = largest(g, &shares);
    let one = g.float(1.0);
    let excess = g.op("Max", &[&largest, &one]);
    let within = g.op("Div", &[&there, &excess]);
    joints::of_joints(g, of_robot, &within)
}
