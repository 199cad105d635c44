use crate::robot::Joints;
use proto::config::{
    Activation, AlgorithmName, Config, CriticState, Inference, InputNorm, Layers, Preset,
};
use proto::layout::{ActorLayout, Dimensions};
use proto::rng::{Address, Purpose};

use super::*;
use crate::scalar::{Backend, LANES, LaneFn, Real, dispatch, dispatch_for, dispatch_on};

/// Normal numbers from an address, for parameters and inputs.
pub(crate) fn normals(seed: u64, n: usize) -> Vec<f32> {
    let address = |env| Address {
        seed,
        purpose: Purpose::Initialisation,
        iteration: 0,
        env,
        step: 0,
        index: 0,
    };
    (0..n.div_ceil(4) as u32).flat_map(|env| address(env).normals()).take(n).collect()
}

/// Parameters of a plausible network: weights of variance 1/inputs, gains near one.
pub(crate) fn parameters(config: &Config, dimensions: &Dimensions, seed: u64) -> Vec<f32> {
    let layout = ActorLayout::new(config, dimensions);
    let mut flat = vec![0.0; layout.len];
    for (i, tensor) in layout.tensors.iter().enumerate() {
        let values = normals(seed + i as u64, tensor.len());
        let (scale, offset) = match tensor.name.rsplit('.').next().expect("a name") {
            "weight" => (1.0 / (tensor.shape[1] as f32).sqrt(), 0.0),
            "gain" => (0.1, 1.0),
            "inverse_std" => (0.2, 1.0),
            "log_std" => (0.1, -0.7),
            _ => (0.1, 0.0),
        };
        for (slot, value) in flat[tensor.range()].iter_mut().zip(values) {
            *slot = scale * value + offset;
        }
    }
    flat
}

struct Means<'a> {
    policy: &'a Policy,
    actors: &'a [usize],
    /// `[actor][environment][input]`
    observations: &'a [f32],
}

impl LaneFn for Means<'_> {
    /// `[actor][environment][output]`, the first two in one.
    type Output = Vec<Vec<f32>>;
    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let (o, outputs) = (self.policy.input(), self.policy.output());
        let n = self.observations.len() / (self.actors.len() * o);
        let groups = n.div_ceil(S::LANES);
        let mut x = vec![S::zero(); self.actors.len() * groups * o];
        for (i, &value) in self.observations.iter().enumerate() {
            let (actor, env, o_idx) = (i / (n * o), i / o % n, i % o);
            let group = actor * groups + env / S::LANES;
            x[group * o + o_idx].set_lane(env % S::LANES, f64::from(value));
        }
        let mut scratch = Scratch::new(self.policy, self.actors.len() * groups);
        let mut means = vec![S::zero(); self.actors.len() * groups * outputs];
        self.policy.mean(self.actors, &x, &mut scratch, &mut means);
        (0..self.actors.len() * n)
            .map(|i| {
                let (actor, env) = (i / n, i % n);
                let row = &means[(actor * groups + env / S::LANES) * outputs..][..outputs];
                row.iter().map(|mean| mean.lane(env % S::LANES) as f32).collect()
            })
            .collect()
    }
}

/// The networks of every combination that the tests go through.
fn configurations() -> Vec<Config> {
    let base = Layers::new(Preset::Tuned, None);
    let mut all = Vec::new();
    for (activation, norm) in [
        (Activation::Relu, InputNorm::Running),
        (Activation::Elu, InputNorm::LayerNorm),
        (Activation::Tanh, InputNorm::None),
    ] {
        for (layer_norm, inference) in [
            (false, Inference::F32),
            (false, Inference::Bf16),
            (true, Inference::F32),
            (true, Inference::Bf16),
        ] {
            let mut config = base.resolve().expect("valid");
            config.network.inference = inference;
            config.network.hidden = vec![37, 64, 5];
            config.network.activation = activation;
            config.network.input_norm = norm;
            config.network.layer_norm = layer_norm;
            config.network.squash_mean = layer_norm;
            config.network.input_clip = 1.0;
            all.push(config.clone());
            if layer_norm {
                config.algorithm.name = AlgorithmName::Ppo;
                config.network.critic_state = CriticState::Own;
                all.push(config);
            }
        }
    }
    all
}

/// The network in plain `f64` loops, straight from the flat parameters, rounded where inference in
/// bfloat16 rounds.
pub(crate) fn plain_mean(
    config: &Config,
    dimensions: &Dimensions,
    parameters: &[f32],
    actor: usize,
    input: &[f64],
) -> Vec<f64> {
    let layout = ActorLayout::new(config, dimensions);
    let row = |name: &str| -> Vec<f64> {
        let tensor = layout.get(name).expect("exists");
        let len = tensor.len() / dimensions.n_actors;
        let from = tensor.offset + actor * len;
        parameters[from..from + len].iter().map(|&x| f64::from(x)).collect()
    };
    let norm = |x: &mut Vec<f64>, gain: Vec<f64>, shift: Vec<f64>| {
        let n = x.len() as f64;
        let mean = x.iter().sum::<f64>() / n;
        let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        for i in 0..x.len() {
            x[i] = (x[i] - mean) / (variance + 1e-5).sqrt() * gain[i] + shift[i];
        }
    };
    let dense = |x: &[f64], name: &str, bf16: bool| -> Vec<f64> {
        let (w, b) = (row(&format!("{name}.weight")), row(&format!("{name}.bias")));
        let round = |x: &f64| if bf16 { f64::from(half::bf16::from_f64(*x)) } else { *x };
        let (x, w): (Vec<f64>, Vec<f64>) =
            (x.iter().map(round).collect(), w.iter().map(round).collect());
        (0..b.len())
            .map(|j| b[j] + (0..x.len()).map(|i| x[i] * w[i * b.len() + j]).sum::<f64>())
            .collect()
    };
    let network = &config.network;
    let mut x = input.to_vec();
    match network.input_norm {
        InputNorm::None => {}
        InputNorm::LayerNorm => norm(&mut x, row("input.gain"), row("input.bias")),
        InputNorm::Running => {
            let (mean, scale) = (row("input.mean"), row("input.inverse_std"));
            let clip = network.input_clip;
            for i in 0..x.len() {
                x[i] = ((x[i] - mean[i]) * scale[i]).clamp(-clip, clip);
            }
        }
    }
    for i in 0..network.hidden.len() {
        x = dense(&x, &format!("hidden.{i}"), i > 0 && network.inference == Inference::Bf16);
        for value in &mut x {
            *value = match network.activation {
                Activation::Relu => value.max(0.0),
                Activation::Elu if *value <= 0.0 => value.exp_m1(),
                Activation::Elu => *value,
                Activation::Tanh => value.tanh(),
            };
        }
        if network.layer_norm {
            norm(&mut x, row(&format!("hidden.{i}.gain")), row(&format!("hidden.{i}.shift")));
        }
    }
    let head = dense(&x, "head", false);
    let deterministic = config.algorithm.name == AlgorithmName::Maddpg;
    let limit = if deterministic { config.algorithm.maddpg.action_limit } else { 1.0 };
    head.into_iter()
        .map(|mean| if network.squash_mean { limit * mean.tanh() } else { mean })
        .collect()
}

#[test]
fn inference_agrees_with_plain_f64_loops() {
    for config in configurations() {
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let flat = parameters(&config, &dimensions, 3);
        let policy = Policy::new(&config, &dimensions, &flat).expect("a policy");
        let o = dimensions.actor_input();
        let n = 3 * LANES + 5;
        let bf16 = config.network.inference == Inference::Bf16;
        let (mut close, mut all) = (0, 0);
        let observations = normals(77, n * o);
        for actor in [0, 5 % dimensions.n_actors] {
            let means =
                dispatch(Means { policy: &policy, actors: &[actor], observations: &observations });
            for (row, mean) in observations.chunks_exact(o).zip(means) {
                let row: Vec<f64> = row.iter().map(|&x| f64::from(x)).collect();
                let plain = plain_mean(&config, &dimensions, &flat, actor, &row);
                assert_eq!(mean.len(), dimensions.actor_output());
                for u in 0..plain.len() {
                    // Three layers of sums of at most 64 products of size one: each sum errs by
                    // about √64 · 2⁻²⁴ = 5e-7, LayerNorm over 5 units may amplify by a few; × 10.
                    let error = (f64::from(mean[u]) - plain[u]).abs();
                    // An activation that falls beside the middle between two bfloat16 may round
                    // to the other one: 2⁻⁸ of it, times a weight of an eighth, amplified alike.
                    let flip = if bf16 { 1e-2 } else { 0.0 };
                    assert!(error < 2e-5 + flip, "{:?}: {mean:?} vs {plain:?}", config.network);
                    close += usize::from(error < 2e-5);
                    all += 1;
                }
            }
        }
        // Such activations are few; without any rounding in the twin hardly one mean would agree.
        assert!(close * 100 >= all * 85, "{close} of {all}: {:?}", config.network);
    }
}

#[test]
fn an_environments_mean_does_not_depend_on_its_company() {
    for config in configurations() {
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let flat = parameters(&config, &dimensions, 3);
        let policy = Policy::new(&config, &dimensions, &flat).expect("a policy");
        let o = dimensions.actor_input();
        let actor = 2 % dimensions.n_actors;
        let observations = normals(78, 70 * o);
        let means = |rows: std::ops::Range<usize>| {
            let observations = &observations[rows.start * o..rows.end * o];
            dispatch(Means { policy: &policy, actors: &[actor], observations })
        };
        let all = means(0..70);
        for (start, end) in [(0, 1), (3, 40), (17, 70), (69, 70), (5, 37)] {
            assert_eq!(means(start..end), all[start..end], "rows {start}..{end}");
        }
        // Groups of eight lanes stand side by side in registers; of three the last stands alone.
        for n in [3, 8, 13, 16, 24] {
            let observations = &observations[..n * o];
            let of_eight = Means { policy: &policy, actors: &[actor], observations };
            assert_eq!(dispatch_for(1, Backend::detect(), of_eight), all[..n], "{n} rows");
        }
    }
}

#[test]
fn every_back_end_gives_the_same_means() {
    for config in configurations() {
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let flat = parameters(&config, &dimensions, 3);
        let observations = normals(79, 37 * dimensions.actor_input());
        let actor = 2 % dimensions.n_actors;
        let on = |backend, widened| {
            let policy = Policy::packed(&config, &dimensions, &flat, widened).expect("a policy");
            dispatch_on(
                backend,
                Means { policy: &policy, actors: &[actor], observations: &observations },
            )
        };
        let portable = on(Backend::Portable, false);
        for backend in [Backend::Portable, Backend::Avx2, Backend::Avx512] {
            for widened in [false, true] {
                if backend.is_available() {
                    let means = on(backend, widened);
                    assert_eq!(means, portable, "{backend:?}, {widened}, {:?}", config.network);
                }
            }
        }
    }
}

#[test]
fn wrong_parameters_are_named() {
    let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
    let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
    let mut flat = parameters(&config, &dimensions, 3);
    let error = Policy::new(&config, &dimensions, &flat[1..]).expect_err("too short");
    assert_eq!(error, PolicyError::Length { found: flat.len() - 1, expected: flat.len() });
    let layout = ActorLayout::new(&config, &dimensions);
    let bias = layout.get("head.bias").expect("exists");
    flat[bias.offset + 6 * 3 + 1] = f32::INFINITY;
    let message = Policy::new(&config, &dimensions, &flat).expect_err("infinite").to_string();
    assert!(message.contains("`head.bias` of actor 6 holds inf"), "{message}");
    // Finite, but e⁹⁰ is no number.
    flat[bias.offset + 6 * 3 + 1] = 0.0;
    flat[layout.get("log_std").expect("exists").offset + 5 * 3] = 90.0;
    let error = Policy::new(&config, &dimensions, &flat).expect_err("too large");
    assert_eq!(error, PolicyError::Deviation { agent: 5, log_std: 90.0 });
}

/// Parameters of eight actors, of which every second has the same network.
fn shared(config: &Config, dimensions: &Dimensions) -> Vec<f32> {
    let mut flat = parameters(config, dimensions, 3);
    let layout = ActorLayout::new(config, dimensions);
    let is_of_network = |name: &str| name != "log_std" && name != "hidden.0.bias";
    for tensor in layout.tensors.iter().filter(|tensor| is_of_network(&tensor.name)) {
        let length = tensor.len() / 8;
        let rows = &mut flat[tensor.range()];
        for actor in 2..8 {
            rows.copy_within(actor % 2 * length..(actor % 2 + 1) * length, actor * length);
        }
    }
    flat
}

#[test]
fn actors_of_the_same_network_are_found() {
    let config = configurations().remove(0);
    let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
    let sharing = |flat: &[f32]| {
        Policy::new(&config, &dimensions, flat).expect("a policy").sharing().to_vec()
    };
    let flat = parameters(&config, &dimensions, 3);
    assert_eq!(sharing(&flat), (0..8).map(|actor| vec![actor]).collect::<Vec<_>>());
    let mut flat = shared(&config, &dimensions);
    assert_eq!(sharing(&flat), [[0, 2, 4, 6], [1, 3, 5, 7]]);
    // One bit of one weight.
    let layout = ActorLayout::new(&config, &dimensions);
    let head = layout.get("head.weight").expect("every network has one");
    let last = &mut flat[head.range().end - 1];
    *last = f32::from_bits(last.to_bits() ^ 1);
    assert_eq!(sharing(&flat), [vec![0, 2, 4, 6], vec![1, 3, 5], vec![7]]);
}

#[test]
fn actors_that_share_a_network_have_their_own_first_bias() {
    for config in configurations() {
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        if dimensions.n_actors != 8 {
            continue;
        }
        let flat = shared(&config, &dimensions);
        let policy = Policy::new(&config, &dimensions, &flat).expect("a policy");
        let o = dimensions.actor_input();
        let actors = [1, 3, 7];
        // One group of eight lanes each, and then two: some registers hold groups of two actors.
        for n in [5, 13, 40] {
            let observations = normals(80, n * o);
            let of_all = observations.repeat(actors.len());
            let together = || Means { policy: &policy, actors: &actors, observations: &of_all };
            let means = dispatch(together());
            for (&actor, means) in actors.iter().zip(means.chunks_exact(n)) {
                let own = Means { policy: &policy, actors: &[actor], observations: &observations };
                assert_eq!(dispatch(own), means, "actor {actor}");
            }
            assert_ne!(means[0], means[n], "biases differ");
            assert_eq!(dispatch_for(1, Backend::detect(), together()), means, "{n} rows");
        }
    }
}
