use proto::agents::Joints;
use proto::config::{Layers, Preset, TaskName};

use super::*;
use crate::precision::Arithmetic;
use crate::synthetic::blocks;

/// A small run: 2 shards of 4 environments, 5 steps; 8 updates an iteration after the first.
fn config(assignments: &[&str]) -> Config {
    [
        "algorithm.name=maddpg",
        "env.n_envs=8",
        "env.n_shards=2",
        "task.episode_steps=5",
        "network.hidden=[16,12]",
        "network.critic_hidden=[]",
        "algorithm.max_kl=0",
        "algorithm.maddpg.batch_size=32",
        "algorithm.maddpg.learning_starts=40",
        "algorithm.maddpg.updates_per_step=0.2",
        "algorithm.maddpg.replay_steps=85",
        "algorithm.maddpg.soft_update=0.1",
        "optimizer.actor_lr=1e-3",
        "run.learner_threads=2",
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
    maddpg: Maddpg,
    state: TrainingState,
    dimensions: Dimensions,
}

impl Run {
    fn new(config: &Config, arithmetic: Arithmetic) -> Self {
        let dimensions = Dimensions::new(config, Joints::of_sixes(2));
        let state = TrainingState::initial(config, &dimensions, arithmetic, Device::Cpu);
        Self { maddpg: Maddpg::new(config, &dimensions, &state), state, dimensions }
    }

    fn update(&mut self, seed: u64) -> UpdateReport {
        let blocks = blocks(&self.dimensions, seed);
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        self.maddpg.update(&mut self.state, &shards).expect("finite")
    }

    fn off_policy(&self) -> &OffPolicy {
        self.state.off_policy.as_ref().expect("MADDPG's")
    }
}

const VARIANTS: [&[&str]; 4] = [
    &[],
    &["network.layer_norm=true", "network.input_norm=layer_norm", "network.activation=elu"],
    &["network.input_norm=none", "network.critic_state=concatenated"],
    &["network.critic_state=concatenated", "algorithm.maddpg.action_limit=10"],
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
            (1..4).for_each(|seed| drop(run.update(seed)));
            run.state.digest()
        };
        assert_eq!(digest(), digest(), "{variant:?} {arithmetic:?}");
    }
}

/// The ring of 17 episodes is full in the third iteration of eight; the stop is after the second.
#[test]
fn a_resumed_run_goes_on_as_if_it_had_never_stopped() {
    let _alone = crate::alone();
    for variant in VARIANTS {
        let config = config(variant);
        let mut run = Run::new(&config, Arithmetic::Bf16);
        run.update(1);
        run.update(2);
        let saved = run.state.to_safetensors();
        let digest = run.state.digest();
        run.update(3);
        run.update(4);
        assert_eq!(run.off_policy().replay.episodes, 32);

        let mut resumed = Run::new(&config, Arithmetic::F32);
        resumed.state =
            TrainingState::from_safetensors(&saved, &config, &resumed.dimensions, Device::Cpu)
                .expect("its own bytes");
        assert_eq!(resumed.state.digest(), digest, "{variant:?}");
        assert_eq!(resumed.state.to_safetensors(), saved, "{variant:?}");
        resumed.maddpg = Maddpg::new(&config, &resumed.dimensions, &resumed.state);
        resumed.update(3);
        resumed.update(4);
        assert_eq!(resumed.state.digest(), run.state.digest(), "{variant:?}");
    }
}

#[test]
fn the_digest_covers_targets_and_replay() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(&[]), Arithmetic::F32);
    run.update(1);
    let before = run.state.digest();
    let changes: [fn(&mut OffPolicy); 4] = [
        |own| drop(own.target_actor.get(1).get(3).fill_(0.5)),
        |own| drop(own.target_critic.get(0).get(7).fill_(0.5)),
        |own| own.replay.reward[11] += 1.0,
        |own| own.replay.episodes += 1,
    ];
    let mut digests = vec![before];
    for change in changes {
        change(run.state.off_policy.as_mut().expect("MADDPG's"));
        let digest = run.state.digest();
        assert!(!digests.contains(&digest));
        digests.push(digest);
    }
}

#[test]
fn nothing_is_learned_before_it_starts_and_then_as_often_as_configured() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(&[]), Arithmetic::F32);
    let work = run.maddpg.work();
    let initial = run.state.actor.flat.copy();
    let report = run.update(1);
    assert_eq!(run.state.actor.flat, initial, "40 env-steps come first");
    assert_eq!((report.policy_loss, report.explained_variance), (vec![0.0; 4], vec![0.0; 4]));
    let report = run.update(2);
    // 40 env-steps, an update for every fifth.
    assert_eq!((work.load(Ordering::Relaxed), &run.state.actor.adam.steps[..]), (8, &[8; 4][..]));
    assert_eq!(run.state.critic.adam.steps, [8; 4]);
    assert!(report.value_loss.iter().all(|&loss| loss > 0.0), "{report:?}");
    assert!(report.actor_grad_norm.iter().all(|&norm| norm > 0.0), "{report:?}");
}

#[test]
fn targets_follow_slowly() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(&["algorithm.maddpg.updates_per_step=0.025"]), Arithmetic::F32);
    run.update(1);
    let before = run.off_policy().target_critic.copy();
    assert_eq!(before, run.state.critic.flat, "nothing has moved");
    let before = [before, run.off_policy().target_actor.copy()];
    run.update(2);
    assert_eq!(run.state.critic.adam.steps, [1; 4]);
    let own = run.off_policy();
    let targets = [&own.target_critic, &own.target_actor];
    let networks = [&run.state.critic.flat, &run.state.actor.flat];
    for ((target, before), now) in targets.into_iter().zip(&before).zip(networks) {
        let expected = before * 0.9 + now * 0.1;
        let error = (target - expected).abs().max().double_value(&[]);
        // Two roundings of parameters of order one.
        assert!(error < 2e-7, "{error}");
        assert!((target - before).abs().max().double_value(&[]) > 1e-5, "it moves");
    }
}

#[test]
fn gradients_that_are_not_finite_are_reported() {
    let _alone = crate::alone();
    let mut run = Run::new(&config(&[]), Arithmetic::F32);
    run.update(1);
    let layout = BlockLayout::new(&run.dimensions);
    let mut blocks = blocks(&run.dimensions, 2);
    // Of agent 1, in all environments: squares overflow.
    let rewards = layout.reward.len() / 4;
    for block in &mut blocks {
        block[layout.reward.start + rewards..][..rewards].fill(1e30);
    }
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    let error = run.maddpg.update(&mut run.state, &shards).expect_err("overflow").to_string();
    assert!(error.contains("critic gradient of agent 1"), "{error}");
}

/// Reports of eight iterations.
fn learn(
    assignments: &[&str],
    arithmetic: Arithmetic,
    change: fn(&Dimensions, &mut [f32]),
) -> Vec<UpdateReport> {
    let mut all = vec![
        "env.n_envs=32",
        "algorithm.maddpg.replay_steps=10_000",
        "run.env_steps=1e9",
        "optimizer.schedule=constant",
    ];
    all.extend(assignments);
    let mut run = Run::new(&config(&all), arithmetic);
    (0..8)
        .map(|iteration| {
            let mut blocks = blocks(&run.dimensions, 100 + iteration);
            for block in &mut blocks {
                change(&run.dimensions, block);
            }
            let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
            run.maddpg.update(&mut run.state, &shards).expect("finite")
        })
        .collect()
}

#[test]
fn critics_learn_what_actions_are_worth() {
    let _alone = crate::alone();
    for arithmetic in [Arithmetic::F32, Arithmetic::Bf16] {
        // An agent is paid its first action; without a future that is all there is to learn.
        let reports = learn(
            &["algorithm.gamma=0", "optimizer.critic_lr=0.003", "optimizer.actor_lr=0"],
            arithmetic,
            |dimensions, block| {
                let layout = BlockLayout::new(dimensions);
                for row in 0..layout.reward.len() {
                    block[layout.reward.start + row] = block[layout.action.start + 3 * row];
                }
            },
        );
        let (first, last) = (&reports[1].value_loss, &reports[7].value_loss);
        for agent in 0..4 {
            assert!(last[agent] < 0.5 * first[agent], "{arithmetic:?}: {first:?}, {last:?}");
        }
    }
}

#[test]
fn actors_climb_to_what_their_critics_value() {
    let _alone = crate::alone();
    for arithmetic in [Arithmetic::F32, Arithmetic::Bf16] {
        // Critics stay as they were drawn; actors that learn are compared with those that do not.
        let loss = |rate: &str| {
            let reports = learn(&["optimizer.critic_lr=0", rate], arithmetic, |_, _| {});
            reports[7].policy_loss.clone()
        };
        let (still, moved) = (loss("optimizer.actor_lr=0"), loss("optimizer.actor_lr=0.003"));
        for agent in 0..4 {
            assert!(moved[agent] < still[agent] - 0.05, "{arithmetic:?}: {still:?}, {moved:?}");
        }
    }
}
