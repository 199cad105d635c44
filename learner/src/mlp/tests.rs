use proto::agents::Joints;
use proto::config::{Config, Layers, Preset};
use proto::layout::Dimensions;

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::torch::TorchPasses;
use super::*;
use crate::layer_norm::standardise_input;
use crate::network::{NetworkKind, NetworkSpec, Parameter};
use crate::precision::Arithmetic;

fn config(assignments: &[&str]) -> Config {
    assignments
        .iter()
        .fold(Layers::new(Preset::Tuned, None), |layers, a| layers.set(a).expect("well formed"))
        .resolve()
        .expect("valid")
}

/// The network as its definition says: unfolded, for libtorch to differentiate.
fn definition(spec: &NetworkSpec, activation: Activation, flat: &Tensor, x: &Tensor) -> Tensor {
    let view = |name: &str| {
        let parameter = spec.get(name);
        let mut shape = vec![-1];
        shape.extend(&parameter.shape);
        flat.narrow(1, parameter.offset, parameter.len()).reshape(shape)
    };
    let affine =
        |x: Tensor, gain: &str, bias: &str| x * view(gain).unsqueeze(1) + view(bias).unsqueeze(1);
    let mut h = x.shallow_clone();
    if spec.input_layer_norm {
        h = affine(h, "input.gain", "input.bias");
    }
    for layer in 0..spec.hidden.len() {
        let name = |part: &str| format!("hidden.{layer}.{part}");
        h = h.bmm(&view(&name("weight"))) + view(&name("bias")).unsqueeze(1);
        h = match activation {
            Activation::Relu => h.relu(),
            Activation::Elu => h.elu(),
            Activation::Tanh => h.tanh(),
        };
        if spec.layer_norm {
            h = affine(standardise_input(&h), &name("gain"), &name("shift"));
        }
    }
    (h.bmm(&view("head.weight")) + view("head.bias").unsqueeze(1)).transpose(1, 2)
}

#[test]
fn passes_by_hand_are_those_of_automatic_differentiation() {
    for activation in ["relu", "elu", "tanh"] {
        for (norm, sharing) in ["false", "true"]
            .into_iter()
            .flat_map(|norm| ["none", "roles", "all"].map(|sharing| (norm, sharing)))
        {
            for kind in [NetworkKind::Actor, NetworkKind::Critic] {
                let input = if norm == "true" { "layer_norm" } else { "none" };
                let config = config(&[
                    &format!("network.activation={activation}"),
                    &format!("network.layer_norm={norm}"),
                    &format!("network.parameter_sharing={sharing}"),
                    &format!("network.input_norm={input}"),
                    "network.hidden=[24,16,20]",
                    "network.critic_hidden=[]",
                ]);
                for (device, way) in [Way::Alone, Way::Fused, Way::Operations]
                    .map(|way| (Device::Cpu, way))
                    .into_iter()
                    .chain(crate::gpu().map(|gpu| (gpu, Way::Operations)))
                {
                    compare(&config, kind, Arithmetic::F32, device, way, 3e-6);
                    compare(&config, kind, Arithmetic::Bf16, device, way, 0.25);
                }
            }
        }
    }
}

/// How passes are computed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    /// With products of our own, where there are some.
    Alone,
    /// With libtorch's products.
    Fused,
    /// With libtorch's operations alone.
    Operations,
}

/// Tolerances relative to the norm: in f32 about 50 roundings of 2⁻²⁴ = 6e-8 each. In bf16 a few of
/// 2⁻⁹ = 2e-3 each along the layers, and pre-activations within a rounding of zero change side: with
/// ReLU, whose gradients differ most, about one in a hundred units of a sample is on or off where its twin is not.
fn compare(
    config: &Config,
    kind: NetworkKind,
    arithmetic: Arithmetic,
    device: Device,
    way: Way,
    tolerance: f64,
) {
    let spec = NetworkSpec::new(kind, config, &Dimensions::new(config, Joints::of_sixes(2)));
    let (a, b) = (4, 30);
    tch::manual_seed(4);
    let options = (Kind::Float, device);
    // Away from the initial values, where gains are one and shifts zero.
    let start = spec.initial(&config.network, 3).to_device(device);
    let flat = &start + Tensor::randn_like(&start) * 0.1;
    spec.unify(&flat);
    let flat = flat.set_requires_grad(true);
    // As samples are gathered: one after the other, of each what all see.
    let x = Tensor::randn([b, a * spec.input], options).to_kind(arithmetic.kind());
    let weights = Tensor::randn([a, spec.output, b], options);
    let leaf = x.view([b, a, -1]).transpose(0, 1).to_kind(Kind::Float).contiguous();
    let leaf = leaf.set_requires_grad(true);
    let expected = definition(&spec, config.network.activation, &flat, &leaf);
    (&expected * &weights).sum(Kind::Float).backward();

    tch::no_grad(|| {
        let mut compute = Compute::new(&spec, config.network.activation, arithmetic.kind(), device);
        match way {
            Way::Alone => compute.multiply_alone(),
            Way::Fused => {}
            Way::Operations => compute.passes = Box::new(TorchPasses::new(&compute.stack)),
        }
        // A larger chunk first: later ones use the beginning of its buffers.
        let larger = Tensor::randn([b + 7, a * spec.input], options).to_kind(arithmetic.kind());
        // Nothing is read where nothing is learned.
        let learned = flat.detach().full_like(f64::NAN);
        for (mut learned, flat) in
            spec.learned_parts(&learned).into_iter().zip(spec.learned_parts(&flat))
        {
            learned.copy_(&flat);
        }
        compute.load(&learned);
        let _ = compute.forward(&compute.by_network(&larger));
        // Nor what was written before.
        let gradient = flat.full_like(f64::NAN);
        let near = |ours: &Tensor, theirs: &Tensor, what: &str| {
            let error = ((ours - theirs).norm() / theirs.norm()).double_value(&[]);
            assert!(
                error < tolerance,
                "{what} of {kind:?} {arithmetic:?} on {device:?}, {way:?}: {error}"
            );
        };
        // Two halves add up to the whole.
        for start in [0, b / 2] {
            let half = compute.by_network(&x.narrow(0, start, b / 2));
            let output = compute.forward(&half);
            near(&output, &expected.narrow(2, start, b / 2), "output");
            compute.backward(&half, &weights.narrow(2, start, b / 2).contiguous(), &gradient);
        }
        compute.unfold(&learned, &gradient);
        // By three inputs of each actor, other ones for each; adds nothing to the parameters' gradient.
        let columns = [1, 4, 0, 5];
        let x = compute.by_network(&x);
        let _ = compute.forward(&x);
        let ours = compute.input_gradient(&x, &weights, &columns, 3);
        let theirs = (0..a).zip(columns).map(|(i, column)| leaf.grad().get(i).narrow(1, column, 3));
        near(&ours, &Tensor::stack(&theirs.collect::<Vec<_>>(), 0), "input gradient");
        // Of rows of one network, the sum; but each has its first bias.
        for Parameter { name, .. } in spec.parameters.iter().filter(|p| p.name != "log_std") {
            let ours = spec.learned(name, &gradient);
            let theirs = spec.view(name, &flat.grad());
            let networks: Vec<Tensor> = (0..ours.size()[0])
                .map(|row| theirs.slice(0, row, None, ours.size()[0]))
                .map(|rows| rows.sum_dim_intlist(&[0i64][..], false, Kind::Float))
                .collect();
            near(&ours, &Tensor::stack(&networks, 0), name);
        }
    });
}
