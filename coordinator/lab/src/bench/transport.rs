//! A block from one process to tensors in another: through the run's own channel, and the same bytes
//! through a pipe and a Unix socket. Both processes are the `learner` program.

use std::process::Command;

use anyhow::Context as _;
use channels::{ChannelSizes, Channels, Domain};
use run::janitor::Janitor;
use run::preflight::{self, Verdict};
use serde_json::Value;

use super::context::Bench;
use super::figures::{Figure, Figures};
use super::{child, learner};

/// Blocks of a measurement, unless its time is over before.
const BLOCKS: &str = "2000";

/// Figures `transport.*`.
pub(super) fn measure(bench: &Bench, figures: &mut Figures) -> anyhow::Result<()> {
    bench.begin("transport")?;
    let check = preflight::shared_memory(&bench.config, &bench.dimensions, 0, &["--workers"]);
    if check.verdict == Verdict::Failure {
        return Err(child::environment(check.sentence()).into());
    }
    let mut domain = LiveDomain::create(bench)?;
    let mut way = |name: &str| -> anyhow::Result<Value> {
        bench.begin(&format!("transport, {name}"))?;
        domain.receive(bench, name)
    };
    let (channel, pipe, socket) = (way("channel")?, way("pipe")?, way("socket")?);
    let wake = way("wake")?;
    domain.close()?;
    let number =
        |said: &Value, key: &str| said[key].as_f64().with_context(|| format!("no figure {key}"));
    // The fastest of all: a percentile says how busy the machine was, not what it allows.
    let floor = number(&wake, "min_us")?;
    let best = number(&pipe, "p99_us")?.min(number(&socket, "p99_us")?);
    let figure = Figure::cost("transport.p99_us", "µs", number(&channel, "p99_us")?);
    figures.push(figure.peer(Some(best)).floor(Some(floor)));
    let best = number(&pipe, "p50_us")?.min(number(&socket, "p50_us")?);
    let figure = Figure::cost("transport.p50_us", "µs", number(&channel, "p50_us")?);
    figures.push(figure.peer(Some(best)).floor(Some(floor)));
    for (prefix, said) in [("", &channel), ("pipe_", &pipe), ("unix_socket_", &socket)] {
        let mut push = |key: &str, name: &str| -> anyhow::Result<()> {
            let key_out = format!("transport.{prefix}{name}");
            figures.push(Figure::cost(key_out, "µs", number(said, key)?));
            Ok(())
        };
        if !prefix.is_empty() {
            push("p99_us", "p99_us")?;
            push("p50_us", "p50_us")?;
        }
        push("sender_cpu_us", "sender_cpu_us_per_block")?;
        push("receiver_cpu_us", "receiver_cpu_us_per_block")?;
    }
    let bytes = number(&channel, "block_bytes")?;
    figures.push(Figure::cost("transport.block_bytes", "bytes", bytes));
    figures.push(Figure::rate("transport.blocks", "blocks", number(&channel, "blocks")?));
    Ok(())
}

/// Shared memory that goes away, also when this process is killed.
struct LiveDomain {
    domain: Domain,
    janitor: Option<Janitor>,
    channels: Option<Channels>,
}

impl LiveDomain {
    fn create(bench: &Bench) -> anyhow::Result<Self> {
        let domain = Domain::fresh();
        tracing::info!(domain = domain.as_str(), "shared memory of a measurement");
        let janitor = Janitor::start(&domain)
            .map_err(|error| child::environment(format!("cannot start the janitor: {error}")))?;
        let mut this = Self { domain, janitor: Some(janitor), channels: None };
        let sizes = ChannelSizes::new(&bench.config, &bench.dimensions);
        this.channels =
            Some(Channels::create(&this.domain, sizes).map_err(proto::ExitError::from)?);
        Ok(this)
    }

    /// Has a pair of processes pass blocks on.
    fn receive(&mut self, bench: &Bench, way: &str) -> anyhow::Result<Value> {
        let mut command = Command::new(Bench::programs()?.learner);
        command.args(["bench", "receive", "--way", way, "--blocks", BLOCKS]);
        command.args(["--domain", self.domain.as_str()]);
        learner::complete(&mut command, bench, &bench.config)?;
        let text = child::output(bench, command, |pid| {
            if let Some(janitor) = &mut self.janitor {
                janitor.watch(pid);
            }
        })?;
        serde_json::from_str(&text).context("the learner's figures are no JSON")
    }

    /// Removes everything; that it cannot is an error.
    fn close(mut self) -> anyhow::Result<()> {
        self.clear().context("shared memory of this measurement could not be removed")
    }

    fn clear(&mut self) -> std::io::Result<()> {
        drop(self.channels.take());
        let removed = self.domain.remove_leftovers().map(|_| ());
        // If it did not work here, the janitor tries once more when its pipe is closed.
        if removed.is_ok()
            && let Some(janitor) = self.janitor.take()
        {
            janitor.dismiss();
        }
        removed
    }
}

impl Drop for LiveDomain {
    fn drop(&mut self) {
        if self.channels.is_some() || self.janitor.is_some() {
            // A sender dies with the receiver that has just been killed; it needs a moment.
            std::thread::sleep(std::time::Duration::from_millis(50));
            let _ = self.clear();
        }
    }
}
