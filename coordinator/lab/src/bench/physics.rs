//! The dynamics alone: control steps under random commands, a lane group of environments at a time.

use process::clock::thread_cpu;
use proto::statistics::median;
use simulator::env::step_options;
use simulator::random_motion::{operations_per_step, random_motion};
use simulator::robot::Robot;
use simulator::step::StepOptions;

use super::arithmetic;
use super::context::Bench;
use super::figures::{Figure, Figures};
use super::peer::Peers;
use super::processor::Processor;

/// Turns that a measurement is split into, between those of the peer.
const TURNS: usize = 3;

/// Figures `physics.*`.
pub(super) fn measure(
    bench: &Bench,
    peers: Option<&Peers>,
    figures: &mut Figures,
) -> anyhow::Result<()> {
    bench.begin("physics")?;
    let options = step_options(&bench.config);
    let with = StepOptions { contacts: true, ..options };
    let without = StepOptions { contacts: false, ..options };
    let turn = bench.seconds / TURNS as f64;
    let (mut rates, mut free, mut peer_rates) = (Vec::new(), Vec::new(), Vec::new());
    let mut touching = 0.0;
    // Ours and the peer's by turns: a machine that is busy for a while is so for both.
    for _ in 0..TURNS {
        let (rate, pairs) = rate(bench, &bench.robot, with, turn)?;
        rates.push(rate);
        touching = pairs;
        free.push(self::rate(bench, &bench.robot, without, turn)?.0);
        if let Some(peers) = peers {
            peer_rates.push(peers.mujoco(bench, turn)?);
        }
    }
    let peer = peers.map(|peers| peers.remember_mujoco(median(peer_rates)));
    let peak = arithmetic::peak(bench.seconds / 10.0);
    let flops = operations_per_step(&bench.robot, &with);
    let unit = "env-steps/s";
    let figure = Figure::rate("physics.env_steps_per_s_per_core", unit, median(rates));
    figures.push(figure.peer(peer).floor(Some(peak / flops)));
    let free =
        Figure::rate("physics.without_contacts_env_steps_per_s_per_core", unit, median(free));
    let free_flops = operations_per_step(&bench.robot, &without);
    figures.push(free.floor(Some(peak / free_flops)));
    figures.push(Figure::cost("physics.touching_pairs", "pairs", touching));
    figures.push(Figure::cost("physics.mflop_per_env_step", "MFLOP", flops * 1e-6));
    let limit = 1e-9 * Processor::here().peak(false);
    let core = Figure::rate("physics.core_gflop_per_s", "GFLOP/s", peak * 1e-9);
    figures.push(core.limit(Some(limit)));
    Ok(())
}

/// Env-steps per second of processor time, and the mean number of touching pairs.
pub(super) fn rate(
    bench: &Bench,
    robot: &Robot,
    options: StepOptions,
    seconds: f64,
) -> anyhow::Result<(f64, f64)> {
    let start = thread_cpu();
    let mut elapsed = 0.0;
    let motion = random_motion(robot, options, &mut || {
        elapsed = thread_cpu() - start;
        elapsed < seconds && bench.stop.count() == 0
    });
    bench.go_on()?;
    Ok((motion.env_steps as f64 / elapsed, motion.touching_pairs))
}
