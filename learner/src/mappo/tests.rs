use proto::agents::Joints;
use std::sync::atomic::Ordering;

use proto::config::{Config, Layers, Preset, TaskName};
use proto::layout::{BlockLayout, Dimensions};
use proto::rng::{Address, Purpose};
use tch::{Device, Kind, Tensor};

use super::update::steered;
use super::*;
use crate::mlp::{Compute, Threads};
use crate::optimizer_step::learning_rates;
use crate::precision::Arithmetic;
use crate::report::UpdateReport;
use crate::state::{NetworkState, TrainingState};
use crate::synthetic::blocks;
use crate::update::Update as _;

/// A small run: 2 shards of 4 environments, 5 steps.
fn config(assignments: &[&str]) -> Config {
    [
        "env.n_envs=8",
        "env.n_shards=2",
        "task.episode_steps=5",
        "network.hidden=[16,12]",
        "network.critic_hidden=[]",
        "algorithm.epochs=5",
        "algorithm.mini_batches=4",
        "algorithm.max_kl=0",
        "optimizer.actor_lr=1e-3",
        "optimizer.critic_lr=1e-3",
        "network.activation=relu",
        "network.parameter_sharing=none",
    ]
    .iter()
    .chain(assignments)
    .fold(Layers::new(Preset::Tuned, Some(TaskName::Trajectory)), |layers, assignment| {
        layers.set(assignment).expect("well formed")
    })
    .resolve()
    .expect("valid")
}

struct Run {
    mappo: Mappo,
    state: TrainingState,
    dimensions: Dimensions,
}

impl Run {
    fn new(config: &Config, arithmetic: Arithmetic) -> Self {
        Self::on(Device::Cpu, config, arithmetic)
    }

    fn on(device: Device, config: &Config, arithmetic: Arithmetic) -> Self {
        let dimensions = Dimensions::new(config, Joints::of_sixes(2));
        let state = TrainingState::initial(config, &dimensions, arithmetic, device);
        Self { mappo: Mappo::new(config, &dimensions, &state), state, dimensions }
    }

    fn update(&mut self, seed: u64) -> UpdateReport {
        let blocks = blocks(&self.dimensions, seed);
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        self.mappo.update(&mut self.state, &shards).expect("finite")
    }
}

const VARIANTS: [&[&str]; 10] = [
    &[],
    &["network.parameter_sharing=all", "run.learner_threads=1"],
    &["network.parameter_sharing=roles", "algorithm.name=ippo", "network.critic_state=own"],
    &["network.parameter_sharing=roles"],
    &["network.layer_norm=true", "network.input_norm=layer_norm", "network.activation=elu"],
    &[
        "network.critic_state=own",
        "algorithm.name=ippo",
        "network.activation=tanh",
        "algorithm.mini_batches=3",
        "optimizer.target_kl=0.01",
    ],
    &["algorithm.max_kl=0.001", "algorithm.value_norm=false", "algorithm.huber_delta=0"],
    &["network.input_norm=none", "network.critic_state=concatenated", "run.learner_threads=1"],
    &["algorithm.name=ppo", "run.learner_threads=1"],
    &["network.parameter_sharing=roles", "network.shared_critics=true"],
];

#[test]
fn the_same_samples_give_the_same_bits() {
    let _alone = crate::alone();
    for (variant, arithmetic) in
        VARIANTS.iter().flat_map(|v| [(v, Arithmetic::F32), (v, Arithmetic::Bf16)])
    {
        let config = config(variant);
        let digest = || {
            let mut run = Run::new(&config, arithmetic);
            run.update(1);
            run.update(2);
            run.state.digest()
        };
        assert_eq!(digest(), digest(), "{variant:?} {arithmetic:?}");
    }
}

#[test]
fn a_resumed_run_goes_on_as_if_it_had_never_stopped() {
    let _alone = crate::alone();
    for variant in VARIANTS {
        let config = config(variant);
        let mut run = Run::new(&config, Arithmetic::Bf16);
        run.update(1);
        let saved = run.state.to_safetensors();
        let digest = run.state.digest();
        run.update(2);

        let mut resumed = Run::new(&config, Arithmetic::F32);
        resumed.state =
            TrainingState::from_safetensors(&saved, &config, &resumed.dimensions, Device::Cpu)
                .expect("its own bytes");
        assert_eq!(resumed.state.digest(), digest, "{variant:?}");
        assert_eq!(resumed.state.to_safetensors(), saved, "{variant:?}");
        resumed.mappo = Mappo::new(&config, &resumed.dimensions, &resumed.state);
        resumed.update(2);
        assert_eq!(resumed.state.digest(), run.state.digest(), "{variant:?}");
    }
}

/// In bf16 the presets' LayerNorm once ended the learner there.
#[test]
fn a_gpu_learns_what_the_processor_learns() {
    let Some(gpu) = crate::gpu() else { return };
    let _alone = crate::alone();
    for (variant, arithmetic) in
        VARIANTS.iter().flat_map(|v| [(v, Arithmetic::F32), (v, Arithmetic::Bf16)])
    {
        let config = config(variant);
        let [mut here, mut there] =
            [Device::Cpu, gpu].map(|device| Run::on(device, &config, arithmetic));
        let (report, theirs) = (here.update(1), there.update(1));
        // Rounded otherwise; in f32 that is less than one step of Adam, of length 1e-3, after twenty.
        let tolerance = if arithmetic == Arithmetic::F32 { 1e-3 } else { 2e-2 };
        for (ours, theirs) in
            [(&here.state.actor, &there.state.actor), (&here.state.critic, &there.state.critic)]
        {
            let difference = (&ours.flat - theirs.flat.to_device(Device::Cpu)).abs().max();
            let difference = difference.double_value(&[]);
            assert!(difference < tolerance, "{variant:?} {arithmetic:?}: {difference}");
        }
        for (ours, theirs) in report.value_loss.iter().zip(&theirs.value_loss) {
            assert!((ours - theirs).abs() < 1e-2 * ours.abs(), "{variant:?}: {ours} {theirs}");
        }
        // What it saves is what it goes on from.
        let saved = there.state.to_safetensors();
        let state = TrainingState::from_safetensors(&saved, &config, &there.dimensions, gpu)
            .expect("its own bytes");
        assert_eq!(state.digest(), there.state.digest(), "{variant:?} {arithmetic:?}");
    }
}

#[test]
fn a_deviation_stops_at_its_floor_and_leaves_it_when_the_loss_asks_for_it() {
    let _alone = crate::alone();
    let floored = ["network.initial_log_std=-0.7", "network.min_log_std=-0.7"];
    let mut run = Run::new(&config(&floored), Arithmetic::F32);
    let log_std = |state: &TrainingState| {
        let parameter = state.actor.spec.view("log_std", &state.actor.flat).contiguous();
        Vec::<f32>::try_from(parameter.view([-1])).expect("f32")
    };
    run.update(1);
    let after = log_std(&run.state);
    let at_floor = after.iter().filter(|&&x| x == -0.7).count();
    assert!(after.iter().all(|&x| x >= -0.7), "{after:?}");
    assert!(0 < at_floor && at_floor < after.len(), "{after:?}");

    // With a bonus that outweighs the surrogate every deviation grows.
    let bonus = config(&[&floored[..], &["algorithm.entropy_coefficient=100"]].concat());
    run.mappo = Mappo::new(&bonus, &run.dimensions, &run.state);
    for seed in 2..6 {
        run.update(seed);
    }
    let later = log_std(&run.state);
    assert!(later.iter().all(|&x| x > -0.7), "{later:?}");
}

/// A learner was taken for hung that prepared a very large iteration, or whose mini-batches were as large.
#[test]
fn an_update_counts_what_it_computes_in_parts_of_bounded_size() {
    let _alone = crate::alone();
    let config = config(&["run.learner_threads=1"]);
    let mut run = Run::new(&config, Arithmetic::F32);
    let chunk = 10;
    for group in &mut run.mappo.groups {
        group.chunk_samples = chunk;
    }
    let work = run.mappo.work();
    run.update(1);
    let proto::layout::Dimensions { n_agents, n_steps, n_envs, n_shards, .. } = run.dimensions;
    let envs = n_envs * n_shards;
    let in_chunks = |samples: usize| samples.div_ceil(chunk as usize);
    let preparation = n_shards + in_chunks((n_steps + 1) * envs);
    let m = n_steps * envs;
    let n = config.algorithm.mini_batches;
    // Once for actors and once for critics.
    let epoch: usize = (0..n).map(|i| 2 * in_chunks((i + 1) * m / n - i * m / n)).sum();
    let planned = (n_agents * (preparation + config.algorithm.epochs * epoch)) as u64;
    assert_eq!(work.load(Ordering::Relaxed), planned);
    run.update(2);
    assert_eq!(work.load(Ordering::Relaxed), 2 * planned);
}

#[test]
fn what_is_learned_does_not_depend_on_the_number_of_threads() {
    let _alone = crate::alone();
    let of_its_own: &[&str] =
        &["run.learner_threads=2", "run.learner_threads=3", "run.learner_threads=4"];
    // Two networks are shared among eight agents: up to two threads.
    let shared: &[&str] = &["run.learner_threads=2"];
    for (variant, more) in [
        (&[][..], of_its_own),
        (&["network.parameter_sharing=roles"], shared),
        (&["network.parameter_sharing=roles", "algorithm.max_kl=0.001"], shared),
        (
            &["network.parameter_sharing=roles", "algorithm.name=ippo", "network.critic_state=own"],
            shared,
        ),
    ] {
        for arithmetic in [Arithmetic::F32, Arithmetic::Bf16] {
            let digest = |threads: &str| {
                let config = config(&[variant, &[threads]].concat());
                let mut run = Run::new(&config, arithmetic);
                run.update(1);
                run.update(2);
                run.state.digest()
            };
            let alone = digest("run.learner_threads=1");
            for threads in more {
                assert_eq!(digest(threads), alone, "{variant:?} {threads} {arithmetic:?}");
            }
        }
    }
}

#[test]
fn agents_learn_together_what_each_learns_alone() {
    let _alone = crate::alone();
    learn_together_and_alone(&config(&[]));
    learn_together_and_alone(&config(VARIANTS[9]));
}

fn learn_together_and_alone(config: &Config) {
    let mut alone = Run::new(config, Arithmetic::F32);
    let mut together = Run::new(config, Arithmetic::F32);
    together.mappo = Mappo::in_one_group(config, &together.dimensions, &together.state);
    let (alone_report, together_report) = (alone.update(1), together.update(1));
    // Products of another shape sum in another order: some roundings of 2⁻²⁴, which forty steps of
    // Adam, each of length 1e-3 whatever the size of the gradient, make visible.
    for (alone, together) in [
        (&alone.state.actor.flat, &together.state.actor.flat),
        (&alone.state.critic.flat, &together.state.critic.flat),
    ] {
        let difference = (alone - together).abs().max();
        assert!(difference.double_value(&[]) < 1e-4, "{difference:?}");
    }
    for (one, other) in alone_report.value_loss.iter().zip(&together_report.value_loss) {
        assert!((one - other).abs() < 1e-3 * one.abs(), "{one} {other}");
    }
}

#[test]
fn plain_gradients_have_the_bits_of_the_operations() {
    let _alone = crate::alone();
    let two = Joints::of_sixes(2);
    let uneven = Joints::new(&[7, 6]);
    let networks_of_eight: &[&str] = &["network.parameter_sharing=all"];
    let cases = VARIANTS.iter().map(|variant| (*variant, two));
    let cases = cases.chain([
        (VARIANTS[0], uneven),
        (VARIANTS[3], uneven),
        (VARIANTS[8], uneven),
        (networks_of_eight, Joints::of_sixes(4)),
    ]);
    for (variant, joints) in cases {
        for (arithmetic, in_one_group) in
            [(Arithmetic::F32, false), (Arithmetic::Bf16, false), (Arithmetic::F32, true)]
        {
            let config = config(variant);
            let dimensions = Dimensions::new(&config, joints);
            let updated = |by_operations: bool| {
                let mut state =
                    TrainingState::initial(&config, &dimensions, arithmetic, Device::Cpu);
                let new = if in_one_group { Mappo::in_one_group } else { Mappo::new };
                let mut mappo = new(&config, &dimensions, &state);
                for group in &mut mappo.groups {
                    // Of ten to fourteen samples three chunks or four, not all of one size.
                    group.chunk_samples = 4;
                    assert!(group.plain.is_some(), "on a CPU");
                    if by_operations {
                        group.plain = None;
                    }
                }
                let blocks = blocks(&dimensions, 1);
                let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
                let report = mappo.update(&mut state, &shards).expect("finite");
                let learned = [state.actor, state.critic];
                (learned.map(|NetworkState { flat, adam, .. }| [flat, adam.m, adam.v]), report)
            };
            let (ours, theirs) = (updated(false), updated(true));
            assert!(ours == theirs, "{variant:?}, {arithmetic:?}, in one group: {in_one_group}");
        }
    }
}

#[test]
fn a_shared_network_stays_one_network() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(VARIANTS[1]), Arithmetic::F32);
    run.update(1);
    let NetworkState { spec, flat, .. } = &run.state.actor;
    let weight = spec.view("hidden.1.weight", flat);
    assert_eq!(weight.get(0), weight.get(3));
    let bias = spec.view("hidden.0.bias", flat);
    assert_ne!(bias.get(0), bias.get(3), "agents are told apart");
}

#[test]
fn nothing_is_read_of_a_shared_network_where_it_is_not_learned() {
    let _alone = crate::alone();
    for variant in [VARIANTS[1], VARIANTS[2], VARIANTS[3], VARIANTS[9]] {
        let learn = |spoil: bool| {
            let mut run = Run::new(&config(variant), Arithmetic::F32);
            run.update(1);
            let state = &run.state;
            for NetworkState { spec, flat, adam } in [&state.actor, &state.critic] {
                for tensor in [flat, &adam.m, &adam.v].into_iter().filter(|_| spoil) {
                    let learned: Vec<Tensor> =
                        spec.learned_parts(tensor).iter().map(Tensor::copy).collect();
                    let _ = tensor.shallow_clone().fill_(f64::NAN);
                    for (mut part, learned) in spec.learned_parts(tensor).into_iter().zip(learned) {
                        part.copy_(&learned);
                    }
                }
            }
            run.update(2);
            [run.state.actor, run.state.critic]
                .map(|NetworkState { flat, adam, .. }| [flat, adam.m, adam.v])
        };
        assert_eq!(learn(true), learn(false), "{variant:?}");
    }
}

#[test]
fn agents_of_one_actor_share_a_critic_with_an_output_each() {
    let _alone = crate::alone();
    let run = Run::new(&config(VARIANTS[9]), Arithmetic::F32);
    let spec = &run.state.critic.spec;
    assert_eq!((run.dimensions.n_actors, spec.rows, spec.output), (4, 2, 2));
    assert_eq!(run.state.actor.spec.rows, 4);
    // Where every agent is an actor of its own there is nothing to share.
    let [own, shared] = ["false", "true"].map(|shared| {
        let mut run =
            Run::new(&config(&[&format!("network.shared_critics={shared}")]), Arithmetic::F32);
        run.update(1);
        run.state.digest()
    });
    assert_eq!(own, shared);
}

#[test]
fn a_centralised_actor_is_paid_the_sum_and_its_density_is_the_product() {
    let _alone = crate::alone();
    let config = config(&["algorithm.name=ppo", "run.learner_threads=1"]);
    let learn = |change: &dyn Fn(&mut [f32], &BlockLayout)| {
        let mut run = Run::new(&config, Arithmetic::F32);
        let layout = BlockLayout::new(&run.dimensions);
        let mut blocks = blocks(&run.dimensions, 1);
        for block in &mut blocks {
            // Quarters, so that sums are exact in whatever order.
            for range in [&layout.reward, &layout.log_prob] {
                block[range.clone()].iter_mut().for_each(|x| *x = (*x * 4.0).round() / 4.0);
            }
            change(block, &layout);
        }
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        let report = run.mappo.update(&mut run.state, &shards).expect("finite");
        assert_eq!((report.returns.len(), report.policy_loss.len()), (4, 1));
        run.state.digest()
    };
    // Adds to every number of the first agent's quarter of an array, and of the second's.
    let add = |array: &mut [f32], to_first: f32, to_second: f32| {
        let quarter = array.len() / 4;
        array[..quarter].iter_mut().for_each(|x| *x += to_first);
        array[quarter..2 * quarter].iter_mut().for_each(|x| *x += to_second);
    };
    let plain = learn(&|_, _| {});
    let moved = learn(&|block, layout| {
        add(&mut block[layout.reward.clone()], 1.5, -1.5);
        add(&mut block[layout.log_prob.clone()], -0.5, 0.5);
    });
    assert_eq!(moved, plain, "only sums count");
    let more_reward = learn(&|block, layout| add(&mut block[layout.reward.clone()], 1.5, 0.0));
    let denser = learn(&|block, layout| add(&mut block[layout.log_prob.clone()], -0.5, 0.0));
    assert!(more_reward != plain && denser != plain, "every agent counts");
}

#[test]
fn a_kl_limit_holds_agents_back() {
    let _alone = crate::alone();
    let free = config(&["algorithm.max_kl=0", "optimizer.actor_lr=0.05"]);
    let held = config(&["algorithm.max_kl=1e-9", "optimizer.actor_lr=0.05"]);
    let steps = |config: &Config| {
        let mut run = Run::new(config, Arithmetic::F32);
        run.update(1);
        run.state.actor.adam.steps.clone()
    };
    assert_eq!(steps(&free), [20; 4], "five epochs of four mini-batches");
    // Log-probabilities of the synthetic blocks are not the network's: over the limit at once.
    assert_eq!(steps(&held), [0; 4]);
}

#[test]
fn nothing_is_computed_for_actors_that_are_held_back() {
    let _alone = crate::alone();
    // Log-probabilities of the synthetic blocks are not the network's: over the limit soon.
    let config = config(&["algorithm.max_kl=0.02", "algorithm.name=ppo", "run.learner_threads=1"]);
    let update = |trace: Option<&mut MappoTrace>| {
        let mut run = Run::new(&config, Arithmetic::F32);
        let blocks = blocks(&run.dimensions, 1);
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        let report = run.mappo.update_traced(&mut run.state, &shards, trace).expect("finite");
        (run.state.digest(), run.state.actor.adam.steps.clone(), report)
    };
    let mut trace = MappoTrace::default();
    // A trace has every step's gradient, also of steps that are not made.
    let (all, steps, every) = update(Some(&mut trace));
    let (spared, _, made) = update(None);
    assert!(steps[0] < 20, "held back: {steps:?}");
    assert_eq!(trace.gradients.len(), 20);
    assert_eq!(all, spared);
    assert_eq!(every.value_loss, made.value_loss, "critics go on");
    assert_eq!(every.kl, made.kl, "steps of who is held back are in no mean");
}

#[test]
fn the_learning_rate_follows_the_divergence() {
    let _alone = crate::alone();
    assert_eq!(steered(0.6, 0.03, 0.01), 0.6 / 1.5);
    assert_eq!(steered(0.6, 0.01, 0.01), 0.6);
    assert_eq!(steered(0.6, 0.001, 0.01), 0.6 * 1.5);
    assert_eq!((steered(0.9, 0.0, 0.01), steered(1e-3, 1.0, 0.01)), (1.0, 1e-3), "bounds");

    // Log-probabilities of the synthetic blocks are not the network's: every actor is far from them.
    let mut run = Run::new(&config(&["optimizer.target_kl=0.01"]), Arithmetic::F32);
    let first = run.update(1);
    assert_eq!(run.state.actor_rate.as_deref(), Some(&[1.0 / 1.5; 4][..]));
    assert_eq!(first.actor_lr, 1e-3, "the first iteration is as scheduled");
    let scheduled = learning_rates(&run.mappo.config, run.state.env_steps).0;
    assert!((run.update(2).actor_lr / scheduled - 1.0 / 1.5).abs() < 1e-12);
    // Shares of one steer that actor alone.
    let mut one = Run::new(&config(&["optimizer.target_kl=1e9"]), Arithmetic::F32);
    one.state.actor_rate = Some(vec![0.1, 1.0, 1.0, 1.0]);
    let mut all = Run::new(&config(&["optimizer.target_kl=1e9"]), Arithmetic::F32);
    for run in [&mut one, &mut all] {
        run.update(1);
    }
    let moved = |agent| {
        let [one, all] = [&one, &all].map(|run| run.state.actor.flat.get(agent));
        (one - all).abs().max().double_value(&[])
    };
    assert!(moved(0) > 0.0 && moved(1) == 0.0);
    assert_eq!(one.state.actor_rate, Some(vec![0.1 * 1.5, 1.0, 1.0, 1.0]));
}

#[test]
fn gradients_that_are_not_finite_are_reported() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(&[]), Arithmetic::F32);
    let mut blocks = blocks(&run.dimensions, 1);
    let place = run.mappo.layout.action.start;
    blocks[0][place] = 1e30;
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    let error = run.mappo.update(&mut run.state, &shards).expect_err("z² overflows").to_string();
    assert!(error.contains("actor gradient of agent 0"), "{error}");
}

#[test]
fn the_learning_rate_falls_to_zero_over_the_planned_steps() {
    let _alone = crate::alone();
    let linear = config(&["run.env_steps=1000", "optimizer.schedule=linear"]);
    let rate = |env_steps| learning_rates(&linear, env_steps).0;
    assert_eq!([rate(0), rate(500), rate(1000), rate(5000)], [1e-3, 5e-4, 0.0, 0.0]);
    let constant = config(&["run.env_steps=1000", "optimizer.schedule=constant"]);
    assert_eq!(learning_rates(&constant, 5000).1, 1e-3);
}

/// A bandit: the best action of every agent is a linear function of what it sees. Rewards are
/// −‖a − c·o‖²; each iteration samples from the policy as it is now, as workers would.
#[test]
fn a_toy_problem_is_learned_in_a_fixed_number_of_updates() {
    let _alone = crate::alone();
    for arithmetic in [Arithmetic::F32, Arithmetic::Bf16] {
        let config = config(&[
            "env.n_envs=64",
            "network.squash_mean=false",
            "optimizer.actor_lr=0.003",
            "optimizer.critic_lr=0.003",
            "algorithm.mini_batches=4",
            "algorithm.gamma=0",
            "run.env_steps=1e9",
        ]);
        let mut run = Run::new(&config, arithmetic);
        let mut first = f64::NAN;
        let mut last = f64::NAN;
        for iteration in 0..60 {
            let mut blocks = blocks(&run.dimensions, 100 + iteration);
            play(&run, &config, &mut blocks, iteration);
            let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
            let report = run.mappo.update(&mut run.state, &shards).expect("finite");
            last = report.returns.iter().sum::<f64>() / report.returns.len() as f64;
            if iteration == 0 {
                first = last;
            }
        }
        // Five steps, three actions: −15 (c² + σ²) at first, −15 σ² at best, and σ falls.
        assert!(first < -8.0, "{first}");
        assert!(last > 0.35 * first, "{arithmetic:?}: from {first} to {last}");
    }
}

/// Overwrites actions, log-probabilities and rewards of `blocks` by those of the current policy.
fn play(run: &Run, config: &Config, blocks: &mut [Vec<f32>], iteration: u64) {
    let Dimensions { n_agents, n_steps, n_envs, observation, .. } = run.dimensions;
    let (a, t, n, o) = (n_agents as i64, n_steps as i64, n_envs as i64, observation as i64);
    let NetworkState { spec, flat, .. } = &run.state.actor;
    let mut compute =
        Compute::new(spec, config.network.activation, Kind::Float, Device::Cpu, Threads::Several);
    compute.load(flat);
    let norm = run.state.observation_norm.as_ref().expect("running").mean_and_inverse_std();
    let row = |x: &[f32]| Tensor::from_slice(x).view([a, 1, o]);
    let std = spec.view("log_std", flat).exp();
    for (shard, block) in blocks.iter_mut().enumerate() {
        let layout = &run.mappo.layout;
        let seen = Tensor::from_slice(&block[layout.observation.clone()]).view([a, t + 1, n, o]);
        let seen = seen.narrow(1, 0, t).reshape([a, t * n, o]);
        let x = ((&seen - row(&norm.0)) * row(&norm.1)).clamp(-8.0, 8.0);
        let mean = compute.forward(&x).transpose(1, 2);
        let noise: Vec<f32> = (0..(a * t * n * 3) as u32)
            .map(|step| {
                let address = Address {
                    seed: 3,
                    purpose: Purpose::ActionNoise,
                    iteration: iteration as u32,
                    env: shard as u32,
                    step,
                    index: 0,
                };
                address.normals()[0]
            })
            .collect();
        let z = Tensor::from_slice(&noise).view([a, t * n, 3]);
        let action = &mean + &z * std.unsqueeze(1);
        let log_prob = (z.square() * -0.5 - std.log().unsqueeze(1) - 0.918_938_5).sum_dim_intlist(
            &[2i64][..],
            false,
            Kind::Float,
        );
        let best = seen.narrow(2, 0, 3);
        let reward = -(&action - best).square().sum_dim_intlist(&[2i64][..], false, Kind::Float);
        for (range, tensor) in
            [(&layout.action, action), (&layout.log_prob, log_prob), (&layout.reward, reward)]
        {
            let values = Vec::<f32>::try_from(tensor.contiguous().view([-1])).expect("f32");
            block[range.clone()].copy_from_slice(&values);
        }
    }
}
