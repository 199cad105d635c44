//! The dynamics alone: control steps under random commands, sixteen environments to a group.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use proto::clock::thread_cpu;
use sim_worker::collision::count_contacts;
use sim_worker::dynamics::{StepOptions, Workspace, step};
use sim_worker::env::step_options;
use sim_worker::robot::{Model, Robot};
use sim_worker::scalar::{LaneFn, Real, dispatch};
use sim_worker::state::State;

use super::figures::{Figure, Figures};
use super::{Bench, arithmetic, median};
use crate::signals::StopRequests;

/// Groups of lanes in flight, so that states come from the cache that a rollout would use.
const GROUPS: usize = 8;
/// Control steps of an episode.
pub(super) const EPISODE: usize = 50;
/// Largest commanded rate (rad/s).
const MAX_RATE: f64 = 0.8;
/// Turns that a measurement is split into, between those of the peer.
const TURNS: usize = 3;

/// Figures `physics.*`.
pub(super) fn measure(bench: &Bench, figures: &mut Figures) -> anyhow::Result<()> {
    bench.begin("physics")?;
    let options = step_options(&bench.config);
    let with = StepOptions { contacts: true, ..options };
    let without = StepOptions { contacts: false, ..options };
    let turn = bench.seconds / TURNS as f64;
    let (mut rates, mut free, mut peers) = (Vec::new(), Vec::new(), Vec::new());
    let mut touching = 0.0;
    // Ours and the peer's by turns: a machine that is busy for a while is so for both.
    for _ in 0..TURNS {
        let (rate, pairs) = rate(bench, &bench.robot, with, turn)?;
        rates.push(rate);
        touching = pairs;
        free.push(self::rate(bench, &bench.robot, without, turn)?.0);
        if let Some(all) = &bench.peers {
            peers.push(all.mujoco(bench, turn)?);
        }
    }
    let peer = bench.peers.as_ref().map(|all| all.remember_mujoco(median(peers)));
    let peak = arithmetic::peak(bench.seconds / 10.0);
    let flops = arithmetic::physics(&bench.robot, &with);
    let unit = "env-steps/s";
    let figure = Figure::rate("physics.env_steps_per_s_per_core", unit, median(rates));
    figures.push(figure.peer(peer).floor(Some(peak / flops)));
    let free =
        Figure::rate("physics.without_contacts_env_steps_per_s_per_core", unit, median(free));
    let free_flops = arithmetic::physics(&bench.robot, &without);
    figures.push(free.floor(Some(peak / free_flops)));
    figures.push(Figure::cost("physics.touching_pairs", "pairs", touching));
    figures.push(Figure::cost("physics.mflop_per_env_step", "MFLOP", flops * 1e-6));
    figures.push(Figure::rate("physics.core_gflop_per_s", "GFLOP/s", peak * 1e-9));
    Ok(())
}

/// Env-steps per second of processor time, and the mean number of touching pairs.
pub(super) fn rate(
    bench: &Bench,
    robot: &Robot,
    options: StepOptions,
    seconds: f64,
) -> anyhow::Result<(f64, f64)> {
    let result = dispatch(Run { robot, options, seconds, stop: &bench.stop });
    bench.go_on()?;
    Ok(result)
}

struct Run<'a> {
    robot: &'a Robot,
    options: StepOptions,
    seconds: f64,
    stop: &'a StopRequests,
}

impl LaneFn for Run<'_> {
    type Output = (f64, f64);

    #[inline(always)]
    fn call<S: Real>(self) -> (f64, f64) {
        let model = Model::<S>::new(self.robot);
        let mut ws = Workspace::new(&model);
        let n = self.robot.n_joints();
        let commands = commands::<S>(n, GROUPS);
        let (mut steps, mut contacts) = (0, S::zero());
        let start = thread_cpu();
        let elapsed = loop {
            let group = steps / EPISODE % GROUPS;
            let mut state = State::<S>::home(self.robot);
            for t in 0..EPISODE {
                let at = (group * EPISODE + t) * n;
                step(&model, &mut ws, &mut state, &commands[at..at + n], &self.options);
                if self.options.contacts {
                    contacts += count_contacts(&model, &mut ws, &state);
                }
            }
            assert!(state.is_finite(), "the simulation diverged");
            steps += EPISODE;
            let elapsed = thread_cpu() - start;
            if elapsed >= self.seconds || self.stop.count() > 0 {
                break elapsed;
            }
        };
        let touching = (0..S::LANES).map(|lane| contacts.lane(lane)).sum::<f64>();
        let env_steps = (steps * S::LANES) as f64;
        (env_steps / elapsed, touching / env_steps)
    }
}

/// Random commands for `groups` episodes of `n` joints.
#[inline(always)]
pub(super) fn commands<S: Real>(n: usize, groups: usize) -> Vec<S> {
    let mut counter = 1;
    let mut commands = vec![S::zero(); n * EPISODE * groups];
    for command in &mut commands {
        for lane in 0..S::LANES {
            command.set_lane(lane, MAX_RATE * noise(&mut counter));
        }
    }
    commands
}

/// Uniform numbers in ±1 from a counter.
fn noise(counter: &mut u64) -> f64 {
    *counter = counter.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*counter >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}
