//! The update alone: the `learner` program on synthetic blocks, in the environment of a run.

use std::process::Command;

use anyhow::Context as _;
use proto::config::Config;
use run::environment;
use serde_json::Value;

use super::child;
use super::context::Bench;
use super::figures::{Figure, Figures};
use super::peer::Peers;
use super::processor::Processor;
use super::rollout::OTHERS;
use crate::threads::Threads;

/// The fastest of all updates: what the floor of a training reckons with.
pub(super) const BEST: &str = "learner.best_env_steps_per_s";
/// How often products are measured again if updates seem to be faster: other programs may have been busy just then.
const TURNS: usize = 3;

/// Figures `learner.*`.
pub(super) fn measure(
    bench: &Bench,
    peers: Option<&Peers>,
    figures: &mut Figures,
) -> anyhow::Result<()> {
    bench.begin("learner")?;
    let chosen = update(bench, &bench.whole(&[])?, true)?;
    let peer = match peers {
        Some(peers) => Some(peers.torch(bench)?.learner),
        None => None,
    };
    let unit = "env-steps/s";
    let rate = |key: String, update: &Update| {
        Figure::rate(key, unit, update.env_steps_per_s).floor(update.floor())
    };
    figures.push(rate("learner.env_steps_per_s".to_owned(), &chosen).peer(peer));
    let mflop = chosen.mflop_per_env_step;
    figures.push(Figure::cost("learner.mflop_per_env_step", "MFLOP", mflop));
    figures.push(Figure::rate(BEST, unit, chosen.best_env_steps_per_s));
    for precision in ["bf16", "f32"] {
        let measured;
        let update = if chosen.precision == precision {
            &chosen
        } else {
            bench.begin(&format!("learner {precision}"))?;
            let config = bench.whole(&[&format!("run.precision={precision}")])?;
            measured = self::update(bench, &config, true)?;
            &measured
        };
        let figure = rate(format!("learner.{precision}.env_steps_per_s"), update);
        figures.push(figure.peer(peer.filter(|_| precision == "f32")));
        figures.push(product(bench, precision, update));
    }
    for (name, change) in OTHERS {
        bench.begin(&format!("learner {name}"))?;
        let update = self::update(bench, &bench.whole(&[change])?, true)?;
        figures.push(rate(format!("learner.{name}.env_steps_per_s"), &update));
        figures.push(product(bench, name, &update));
    }
    Ok(())
}

/// The best rate of an update's matrix products, which its floor reckons with.
fn product(bench: &Bench, name: &str, update: &Update) -> Figure {
    let product = update.product_gflop_per_s.unwrap_or_default();
    let key = format!("learner.{name}.product_gflop_per_s");
    let limit =
        Processor::here().peak(update.precision == "bf16") * Threads::available().count() as f64;
    // The table knows processors, and no GPU.
    let limit = (bench.config.run.device == "cpu").then_some(1e-9 * limit);
    Figure::rate(key, "GFLOP/s", product).limit(limit)
}

/// What the learner says of a configuration.
#[derive(Debug, Clone)]
pub(super) struct Update {
    pub(super) env_steps_per_s: f64,
    best_env_steps_per_s: f64,
    precision: String,
    mflop_per_env_step: f64,
    /// Length of a training state's file.
    pub(super) state_bytes: f64,
    product_gflop_per_s: Option<f64>,
}

impl Update {
    /// Env-steps/s if all time went into matrix products at their best rate.
    fn floor(&self) -> Option<f64> {
        Some(1e3 * self.product_gflop_per_s? / self.mflop_per_env_step)
    }
}

/// Measures updates of a configuration; with `product` also libtorch's matrix products, of which the best rate of several turns
/// counts.
pub(super) fn update(bench: &Bench, config: &Config, product: bool) -> anyhow::Result<Update> {
    let mut update = measure_once(bench, config, product)?;
    for _ in 1..TURNS {
        if update.floor().is_none_or(|floor| update.env_steps_per_s <= floor) {
            break;
        }
        let again = measure_once(bench, config, product)?;
        let products = update.product_gflop_per_s.zip(again.product_gflop_per_s);
        update.product_gflop_per_s = products.map(|(one, other)| one.max(other));
    }
    Ok(update)
}

fn measure_once(bench: &Bench, config: &Config, product: bool) -> anyhow::Result<Update> {
    let mut command = Command::new(Bench::programs()?.learner);
    command.args(["bench", "update"]);
    command.args(product.then_some("--product"));
    complete(&mut command, bench, config)?;
    let text = child::output(bench, command, |_| {})?;
    let said: Value = serde_json::from_str(&text).context("the learner's figures are no JSON")?;
    let number = |key: &str| said[key].as_f64().with_context(|| format!("no figure {key}"));
    Ok(Update {
        env_steps_per_s: number("env_steps_per_s")?,
        best_env_steps_per_s: number("best_env_steps_per_s")?,
        precision: said["precision"].as_str().unwrap_or_default().to_owned(),
        mflop_per_env_step: number("mflop_per_env_step")?,
        state_bytes: number("state_bytes")?,
        product_gflop_per_s: said["product_gflop_per_s"].as_f64(),
    })
}

/// Adds what every measurement in the learner needs: options, and the environment of a run.
pub(super) fn complete(
    command: &mut Command,
    bench: &Bench,
    config: &Config,
) -> anyhow::Result<()> {
    command
        .arg("--run-dir")
        .arg(bench.run_dir(config)?.path())
        .args(["--seconds", &bench.seconds.to_string()])
        .args(["--parent", &std::process::id().to_string()]);
    environment::set_numerical(command, config.run.learner_threads);
    Ok(())
}
