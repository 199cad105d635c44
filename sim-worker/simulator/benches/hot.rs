//! The hot functions of a rollout, one lane group of environments at a time unless said otherwise.
//!
//! `cargo bench -p sim-worker`; `-- --save-baseline before` and `-- --baseline before` compare a change.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use proto::config::{Layers, Preset};
use proto::layout::ActorLayout;
use simulator::collision::count_contacts;
use simulator::model::Model;
use simulator::policy::Scratch;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};
use simulator::scalar::{LaneFn, Real, dispatch};
use simulator::state::State;
use simulator::step::{StepOptions, step};
use simulator::workspace::Workspace;

/// Lane groups that a policy is evaluated for at once: a shard of 32 environments.
const GROUPS: usize = 2;

fn robot() -> Robot {
    Robot::builtin("paper").expect("built in")
}

/// A world of the preset `paper`, and parameters with which actions stay of size one.
fn world() -> (World, Vec<f32>) {
    let config = Layers::new(Preset::Paper, None).resolve().expect("presets are valid");
    let world = World::new(&config, &robot());
    let length = ActorLayout::new(&config, &world.dimensions).len;
    let parameters = (0..length).map(|i| ((i * 7919) % 1000) as f32 * 2e-4 - 0.1).collect();
    (world, parameters)
}

/// Measures in the lanes of this processor: what is set up stays outside of the loop.
struct Physics<'a, 'b> {
    name: &'static str,
    options: Option<StepOptions>,
    group: &'a mut criterion::BenchmarkGroup<'b, criterion::measurement::WallTime>,
}

impl LaneFn for Physics<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call<S: Real>(self) {
        let robot = robot();
        let model = Model::<S>::new(&robot);
        let mut ws = Workspace::new(&model);
        let mut state = State::<S>::home(&robot);
        let command = vec![S::splat(0.3); robot.n_joints()];
        self.group.throughput(Throughput::Elements(S::LANES as u64));
        match self.options {
            Some(options) => self.group.bench_function(self.name, |bencher| {
                bencher.iter_batched_ref(
                    || State::<S>::home(&robot),
                    |state| step(&model, &mut ws, state, &command, &options),
                    criterion::BatchSize::SmallInput,
                );
            }),
            None => self.group.bench_function(self.name, |bencher| {
                step(&model, &mut ws, &mut state, &command, &StepOptions::default());
                bencher.iter(|| count_contacts(&model, &mut ws, &state));
            }),
        };
    }
}

fn physics(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("physics");
    let with = StepOptions::default();
    let without = StepOptions { contacts: false, ..with };
    for (name, options) in [
        ("control_step/contacts", Some(with)),
        ("control_step/free", Some(without)),
        ("count_contacts", None),
    ] {
        dispatch(Physics { name, options, group: &mut group });
    }
    group.finish();
}

/// One agent's actions.
struct Inference<'a, 'b>(&'a mut criterion::BenchmarkGroup<'b, criterion::measurement::WallTime>);

impl LaneFn for Inference<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call<S: Real>(self) {
        let (world, parameters) = world();
        let policy = world.policy(&parameters).expect("of this configuration");
        let mut scratch = Scratch::<S>::new(&policy, GROUPS);
        let observations = vec![S::splat(0.5); GROUPS * world.dimensions.observation];
        let mut means = vec![S::zero(); GROUPS * 3];
        self.0.throughput(Throughput::Elements((GROUPS * S::LANES) as u64));
        self.0.bench_function("one_agent/2x512", |bencher| {
            bencher.iter(|| policy.mean(&[0], &observations, &mut scratch, &mut means));
        });
    }
}

fn policy(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("policy");
    dispatch(Inference(&mut group));
    group.finish();
}

fn whole(criterion: &mut Criterion) {
    let (world, parameters) = world();
    let policy = world.policy(&parameters).expect("of this configuration");
    let mut block = vec![0.0; world.block_layout().len];
    let steps = world.dimensions.n_envs * world.dimensions.n_steps;
    let mut group = criterion.benchmark_group("rollout");
    group.throughput(Throughput::Elements(steps as u64)).sample_size(10);
    group.bench_function("shard/paper", |bencher| {
        let spec = RolloutSpec { seed: 1, iteration: 0, shard: 0, policy: &policy };
        bencher.iter(|| rollout(&world, &spec, &mut block, &mut |_| {}).expect("rolls out"));
    });
    group.finish();
}

criterion_group!(benches, physics, policy, whole);
criterion_main!(benches);
