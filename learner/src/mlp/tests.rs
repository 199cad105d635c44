use proto::agents::Joints;
use proto::config::{Config, Layers, Preset};
use proto::layout::Dimensions;

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::plain::PlainPasses;
use super::torch::TorchPasses;
use super::*;
use crate::layer_norm::standardise_input;
use crate::network::{NetworkKind, NetworkSpec, Parameter};
use crate::precision::Arithmetic;
use crate::product::Native;

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
                for sees in [Sees::Own, Sees::All] {
                    let compare = |arithmetic, way, tolerance| {
                        compare(&config, (kind, sees), arithmetic, way, tolerance)
                    };
                    compare(Arithmetic::F32, Way::Theirs, 3e-6);
                    let theirs = compare(Arithmetic::Bf16, Way::Theirs, 0.3);
                    for device in [Some(Device::Cpu), crate::gpu()].into_iter().flatten() {
                        compare(Arithmetic::F32, Way::Operations(device), 3e-6);
                        compare(Arithmetic::Bf16, Way::Operations(device), 0.3);
                    }
                    // The same roundings, but for a last place of a sum here and there.
                    for native in Native::all() {
                        let own = compare(Arithmetic::Bf16, Way::Own(native), 0.3);
                        for (own, theirs) in own.iter().zip(&theirs) {
                            let error = relative(own, theirs);
                            assert!(error < 1e-2, "{native:?} and libtorch: {error}");
                        }
                    }
                }
            }
        }
    }
}

/// How passes are computed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    /// With products of our own, where one pass over the samples stands between them.
    Own(Native),
    /// With libtorch's products.
    Theirs,
    /// With libtorch's operations alone.
    Operations(Device),
}

/// What actors see.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sees {
    /// Each something else.
    Own,
    /// All the same, as critics do.
    All,
}

/// The distance relative to the norm.
fn relative(ours: &Tensor, theirs: &Tensor) -> f64 {
    ((ours - theirs).norm() / theirs.norm()).double_value(&[])
}

/// Tolerances relative to the norm: in f32 about 50 roundings of 2⁻²⁴ = 6e-8 each. In bf16 a few of
/// 2⁻⁹ = 2e-3 each along the layers, and pre-activations within a rounding of zero change side: with
/// ReLU, whose gradients differ most, about one in a hundred units of a sample is on or off where its twin is not.
///
/// Returns outputs and gradients.
fn compare(
    config: &Config,
    (kind, sees): (NetworkKind, Sees),
    arithmetic: Arithmetic,
    way: Way,
    tolerance: f64,
) -> Vec<Tensor> {
    let device = if let Way::Operations(device) = way { device } else { Device::Cpu };
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
    let width = if sees == Sees::Own { a * spec.input } else { spec.input };
    let x = Tensor::randn([b, width], options).to_kind(arithmetic.kind());
    let weights = Tensor::randn([a, spec.output, b], options);
    let leaf = x.view([b, -1, spec.input]).expand([b, a, spec.input], true);
    let leaf = leaf.transpose(0, 1).to_kind(Kind::Float).contiguous();
    let leaf = leaf.set_requires_grad(true);
    let expected = definition(&spec, config.network.activation, &flat, &leaf);
    (&expected * &weights).sum(Kind::Float).backward();

    tch::no_grad(|| {
        let (activation, kind_of_products) = (config.network.activation, arithmetic.kind());
        let several = Threads::Several;
        let mut compute = Compute::new(&spec, activation, kind_of_products, device, several);
        match way {
            Way::Own(native) => {
                if let Some(passes) = PlainPasses::new(&compute.stack, Some(native)) {
                    compute.passes = Box::new(passes);
                }
            }
            Way::Theirs => {}
            Way::Operations(_) => compute.passes = Box::new(TorchPasses::new(&compute.stack)),
        }
        let input = |compute: &Compute, x: &Tensor| match sees {
            Sees::Own => compute.by_network(x),
            Sees::All => compute.for_all(x),
        };
        // A larger chunk first: later ones use the beginning of its buffers.
        let larger = Tensor::randn([b + 7, width], options).to_kind(arithmetic.kind());
        // Nothing is read where nothing is learned.
        let learned = flat.detach().full_like(f64::NAN);
        for (mut learned, flat) in
            spec.learned_parts(&learned).into_iter().zip(spec.learned_parts(&flat))
        {
            learned.copy_(&flat);
        }
        compute.load(&learned);
        let _ = compute.forward(&input(&compute, &larger));
        // Nor what was written before.
        let gradient = flat.full_like(f64::NAN);
        let near = |ours: &Tensor, theirs: &Tensor, what: &str| {
            let error = relative(ours, theirs);
            assert!(
                error < tolerance,
                "{what} of {kind:?} {sees:?} {arithmetic:?}, {way:?}: {error}"
            );
        };
        let mut results = Vec::new();
        // Two halves add up to the whole.
        for start in [0, b / 2] {
            let half = input(&compute, &x.narrow(0, start, b / 2));
            let output = compute.forward(&half);
            near(&output, &expected.narrow(2, start, b / 2), "output");
            compute.backward(&half, &weights.narrow(2, start, b / 2).contiguous(), &gradient);
            results.push(output);
        }
        compute.unfold(&learned, &gradient);
        // By three inputs of each actor, other ones for each; adds nothing to the parameters' gradient.
        let columns = [1, 4, 0, 5];
        let x = input(&compute, &x);
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
            results.push(ours);
        }
        results
    })
}
