//! The simulator as Python's programs step it, beside a rollout of ours without its policy, and MuJoCo from Python.

use anyhow::Context as _;
use serde_json::Value;

use super::context::Bench;
use super::figures::{Figure, Figures};
use super::peer::Peers;
use super::rollout;

/// Environments of a batch; the last one is held against the rollout.
const ENVS: [usize; 3] = [1, 16, 1024];

/// Figures `python.*`.
pub(super) fn measure(
    bench: &Bench,
    peers: Option<&Peers>,
    figures: &mut Figures,
) -> anyhow::Result<()> {
    let peers = peers.context("a Python is always given")?;
    let unit = "env-steps/s";
    bench.begin("rollout")?;
    let native =
        rollout::rates(bench, &bench.config, &bench.robot, bench.seconds)?.without_policy();
    bench.begin("Python")?;
    let measured = peers.batches(bench, &ENVS)?;
    let rate = |of: &Value, n: usize| {
        of[n.to_string()].as_f64().with_context(|| format!("the figures have no rate for {n}"))
    };
    figures.push(Figure::rate("python.native.env_steps_per_s_per_core", unit, native));
    let mut last = 0.0;
    for n in ENVS {
        last = rate(&measured["batch"], n)?;
        let figure = Figure::rate(format!("python.batch_{n}.env_steps_per_s_per_core"), unit, last);
        figures.push(figure.peer(Some(rate(&measured["mujoco"], n)?)));
    }
    figures.push(Figure::rate("python.share_of_native", "", last / native));
    Ok(())
}
