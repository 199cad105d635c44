//! The actors: observations to clipped actions.

use proto::config::{Activation, InputNorm};

use super::graph::{Attribute, Graph, Value};
use super::proto::{BFLOAT16, FLOAT};
use super::{joints, postures};
use crate::networks::{Networks, Stacked};
use crate::source::Source;

/// Actions `[batch, J]` (clipped, not scaled) of agents that see `observations`, `[batch, A, O]`, and act beside `postures`, `[batch, arms, 8]`.
pub(super) fn actions(
    g: &mut Graph,
    source: &Source<'_>,
    networks: &Networks,
    observations: &Value,
    postures: Option<&Value>,
) -> Value {
    let (dimensions, network) = (&source.world.dimensions, &source.world.config.network);
    let (actors, input) = (dimensions.n_actors as i64, dimensions.actor_input() as i64);
    let by_actor = g.reshape(observations, &[0, actors, input]);
    let mut x = g.transpose(&by_actor, &[1, 0, 2]);
    if let Some([first, second]) = &networks.input {
        x = match network.input_norm {
            InputNorm::Running => {
                let [mean, scale] = [first, second].map(|tensor| vector(g, tensor));
                let centred = g.op("Sub", &[&x, &mean]);
                let scaled = g.op("Mul", &[&centred, &scale]);
                clip(g, &scaled, network.input_clip)
            }
            InputNorm::LayerNorm | InputNorm::None => layer_norm(g, &x, [first, second]),
        };
    }
    for (index, layer) in networks.layers.iter().enumerate() {
        if layer.weight.half {
            let rounded = g.cast(&x, BFLOAT16);
            x = g.cast(&rounded, FLOAT);
        }
        let weight = g.stacked(&layer.weight, &layer.weight.shape);
        let bias = vector(g, &layer.bias);
        let product = g.op("MatMul", &[&x, &weight]);
        x = g.op("Add", &[&product, &bias]);
        if index + 1 < networks.layers.len() {
            let activation = match network.activation {
                Activation::Relu => "Relu",
                Activation::Elu => "Elu",
                Activation::Tanh => "Tanh",
            };
            x = g.op(activation, &[&x]);
            if let Some([gain, shift]) = &layer.norm {
                x = layer_norm(g, &x, [gain, shift]);
            }
        }
    }
    if network.squash_mean {
        let squashed = g.op("Tanh", &[&x]);
        let limit = g.float(source.squash_limit());
        x = g.op("Mul", &[&squashed, &limit]);
    }
    let by_robot = g.transpose(&x, &[1, 0, 2]);
    let joints = source.world.robot.n_joints();
    let mut means = joints::of_actions(g, &source.world.robot.joints, &by_robot);
    if let Some(postures) = postures {
        if let Some(fade) = source.world.task.posture.fades() {
            let share = postures::share(g, source, postures, fade);
            means = g.op("Mul", &[&means, &share]);
        }
        let guidance = postures::guidance(g, source, postures);
        means = g.op("Add", &[&means, &guidance]);
    }
    let limits = &source.world.task.action_limit;
    let upper = g.floats(&[joints], limits);
    let lower: Vec<f64> = limits.iter().map(|limit| -limit).collect();
    let lower = g.floats(&[joints], &lower);
    let above = g.op("Max", &[&means, &lower]);
    g.op("Min", &[&above, &upper])
}

/// One row an actor, to stand beside `[P, batch, n]`.
fn vector(g: &mut Graph, tensor: &Stacked) -> Value {
    g.stacked(tensor, &[1, tensor.shape[0]])
}

fn clip(g: &mut Graph, x: &Value, limit: f64) -> Value {
    let [low, high] = [-limit, limit].map(|limit| g.float(limit));
    g.op("Clip", &[x, &low, &high])
}

fn layer_norm(g: &mut Graph, x: &Value, [gain, shift]: [&Stacked; 2]) -> Value {
    let n = gain.shape[0];
    let ones = g.floats(&[n], &vec![1.0; n]);
    let attributes = vec![Attribute::Int("axis", -1), Attribute::Float("epsilon", 1e-5)];
    let normal = g.with("LayerNormalization", &[x, &ones], attributes);
    let [gain, shift] = [gain, shift].map(|tensor| vector(g, tensor));
    let scaled = g.op("Mul", &[&normal, &gain]);
    g.op("Add", &[&scaled, &shift])
}
