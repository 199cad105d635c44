use proto::DigestBuilder;
use proto::agents::Joints;
use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions};
use safetensors::SafeTensors;
use tch::Device;

use super::image::Image;
use super::*;
use crate::precision::Arithmetic;

fn config(assignments: &[&str]) -> Config {
    ["network.hidden=[8]", "network.critic_hidden=[]", "env.n_envs=8"]
        .iter()
        .chain(assignments)
        .fold(Layers::new(Preset::Tuned, None), |layers, a| layers.set(a).expect("well formed"))
        .resolve()
        .expect("valid")
}

fn state(config: &Config) -> (TrainingState, Dimensions) {
    let dimensions = Dimensions::new(config, Joints::of_sixes(1));
    (TrainingState::initial(config, &dimensions, Arithmetic::F32, Device::Cpu), dimensions)
}

fn refusal(data: &[u8], config: &Config) -> String {
    let dimensions = Dimensions::new(config, Joints::of_sixes(1));
    TrainingState::from_safetensors(data, config, &dimensions, Device::Cpu)
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn the_digest_can_be_recomputed_from_the_file() {
    let (state, _) = state(&config(&[]));
    let bytes = state.to_safetensors();
    let file = SafeTensors::deserialize(&bytes).expect("valid");
    let mut names: Vec<&str> =
        file.names().into_iter().filter(|name| !name.starts_with("policy.")).collect();
    names.sort_unstable();
    let mut builder = DigestBuilder::new();
    for name in names {
        builder.field(name, file.tensor(name).expect("listed").data());
    }
    assert_eq!(builder.finish(), state.digest());
}

#[test]
fn every_array_changes_the_digest() {
    let config = config(&[]);
    let (state, dimensions) = state(&config);
    let bytes = state.to_safetensors();
    let file = SafeTensors::deserialize(&bytes).expect("valid");
    let mut refused = Vec::new();
    // `policy.` repeats what actors and moments say, for other readers of the file.
    for (name, tensor) in
        file.tensors().into_iter().filter(|(name, _)| !name.starts_with("policy."))
    {
        // The lowest bit of the array's first number.
        let at = tensor.data().as_ptr() as usize - bytes.as_ptr() as usize;
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        let read = TrainingState::from_safetensors(&changed, &config, &dimensions, Device::Cpu);
        match read {
            Ok(read) => assert_ne!(read.digest(), state.digest(), "{name}"),
            Err(_) => refused.push(name),
        }
    }
    assert_eq!(refused, ["counters.precision"], "another name is none");
}

#[test]
fn a_state_of_another_shape_is_refused_by_name() {
    let (state, _) = state(&config(&[]));
    let bytes = state.to_safetensors();
    let error = refusal(&bytes, &config(&["network.hidden=[9]"]));
    assert!(error.contains("`actor.adam.m.head.weight` is F32 [2, 8, 3]"), "{error}");
    assert!(error.contains("expected F32 [2, 9, 3]"), "{error}");
    let error = refusal(&bytes, &config(&["network.layer_norm=true"]));
    assert!(error.contains("`actor.adam.m.hidden.0.gain` is missing"), "{error}");
    let error = refusal(&bytes, &config(&["network.input_norm=none"]));
    assert!(error.contains("`previous_policy` is F32 [1056], expected F32 [864]"), "{error}");
    let error = refusal(&bytes, &config(&["network.critic_state=own", "algorithm.name=ippo"]));
    assert!(error.contains("`critic.adam.m.hidden.0.weight` is F32 [2, 55, 8]"), "{error}");
    let (steered, _) = self::state(&config(&["optimizer.target_kl=0.1"]));
    let error = refusal(&steered.to_safetensors(), &config(&[]));
    assert!(error.contains("`actor.rate`") && error.contains("is unknown"), "{error}");
}

#[test]
fn damage_is_refused() {
    let config = config(&[]);
    let (state, _) = state(&config);
    let bytes = state.to_safetensors();
    assert!(refusal(&bytes[..bytes.len() - 1], &config).contains("no valid safetensors file"));
    assert!(refusal(b"", &config).contains("no valid safetensors file"));
    let _ = state.actor.flat.get(0).get(0).fill_(f64::NAN);
    let error = refusal(&state.to_safetensors(), &config);
    assert!(error.contains("`actor.hidden.0.weight` holds a number that is not finite"), "{error}");
}

#[test]
fn a_published_policy_holds_floored_deviations_and_the_normaliser() {
    let config = config(&["network.initial_log_std=-0.7", "network.min_log_std=-0.7"]);
    let (mut state, dimensions) = state(&config);
    let layout = ActorLayout::new(&config, &dimensions);
    let _ = state.actor.spec.view("log_std", &state.actor.flat).fill_(-3.0);
    let norm = state.observation_norm.as_mut().expect("running");
    norm.count = 4.0;
    norm.mean[1] = 2.5;
    norm.m2.fill(4.0);
    let mut policy = vec![f32::NAN; layout.len];
    state.write_policy(&mut policy);
    let get = |name: &str| &policy[layout.get(name).expect("present").range()];
    assert!(get("log_std").iter().all(|&x| x == -0.7));
    assert_eq!(get("input.mean")[1], 2.5);
    assert!((get("input.inverse_std")[0] - 1.0).abs() < 1e-6);
    let weight = state.actor.spec.view("hidden.0.weight", &state.actor.flat).get(1).get(2).get(3);
    let at = (dimensions.observation + 2) * 8 + 3;
    assert_eq!(f64::from(get("hidden.0.weight")[at]), weight.double_value(&[]));
}

#[test]
fn an_image_is_the_file_that_the_library_writes() {
    for settings in [&[][..], &["network.parameter_sharing=all", "network.input_norm=running"]] {
        let (mut state, _) = state(&config(settings));
        let (mut image, first) = Image::new(&state);
        assert_eq!(first, state.to_safetensors());
        state.iteration += 1;
        let _ = state.actor.flat.fill_(0.25);
        let _ = state.critic.adam.v.get(1).get(3).fill_(1e-30);
        // Memory that is too long, too short, and just right.
        for mut out in [vec![7; first.len() + 5], Vec::new(), first.clone()] {
            image.write(&state, &mut out);
            assert!(out == state.to_safetensors(), "{settings:?}");
        }
    }
}

#[test]
fn what_is_not_finite_after_an_update_is_named() {
    let config = config(&[]);
    let said = |change: &dyn Fn(&mut TrainingState)| {
        let (mut state, _) = state(&config);
        change(&mut state);
        state.check_bounds().map_err(|error| error.to_string())
    };
    assert_eq!(said(&|_| {}), Ok(()));
    let put = |network: &NetworkState, name: &str, agent: i64, x: f64| {
        let _ = network.spec.view(name, &network.flat).select(0, agent).fill_(x);
    };
    for (network, agent, x) in [("actor", 1, f64::NAN), ("critic", 0, f64::INFINITY)] {
        let message = said(&|state| {
            let of = if network == "actor" { &state.actor } else { &state.critic };
            put(of, "head.bias", agent, x);
        })
        .expect_err("not finite");
        let expected = format!("the {network} of agent {agent} holds parameters that are not");
        assert!(message.starts_with(&expected), "{message}");
    }
    // Of a shared network the first bias is each agent's own.
    let shared = self::config(&["network.parameter_sharing=all"]);
    let (of_all, _) = state(&shared);
    put(&of_all.actor, "hidden.0.bias", 1, f64::NAN);
    let message = of_all.check_bounds().expect_err("not finite").to_string();
    assert!(message.starts_with("the actor of agent 1 holds parameters"), "{message}");
    // Finite, but e⁹⁰ is beyond single precision.
    let message = said(&|state| put(&state.actor, "log_std", 1, 90.0)).expect_err("too large");
    assert!(message.starts_with("the actor of agent 1 holds deviations"), "{message}");
}
