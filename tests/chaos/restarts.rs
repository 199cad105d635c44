//! Workers and the learner of one live run are killed again and again: every replacement must come
//! to work, and what the coordinator holds must not grow.

use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use run::signals::StopRequests;
use rustix::process::Signal;
use serde_json::{Value, json};

use super::measure::{Times, Trend, descriptors, domain_files, private_memory};
use super::observe::{FirstBlock, domain_of, iterations, workers};
use super::{Watch, check_lines, flags};
use crate::{Run, assert_nothing_left, kill};

/// What a coordinator's own memory may grow by over any number of restarts (bytes): its allocator
/// settles only after a while, but what is lost at every restart shows in a thousand of them.
const MEMORY_GROWTH: u64 = 2 << 20;

/// What came of the restarts of one kind of process.
#[derive(Debug, Default)]
pub struct Phase {
    /// From a death until its successor was seen to do its work.
    pub times: Times,
    /// Open descriptors of the coordinator, after every restart.
    pub descriptors: Trend,
    /// Memory of the coordinator that no other process shares (bytes), after every restart.
    pub memory: Trend,
    /// Files in shared memory and sockets of the run, after every restart.
    pub files: Trend,
}

/// What came of the restarts.
#[derive(Debug, Default)]
pub struct Restarts {
    /// Of workers; a successor does its work when it has sent a block.
    pub workers: Phase,
    /// Of the learner; a successor does its work when the run is further than before.
    pub learners: Phase,
    /// Iterations of the run.
    pub iterations: usize,
    /// Time that the restarts took.
    pub wall: Duration,
}

impl Restarts {
    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({
            "workers": self.workers.to_json(),
            "learners": self.learners.to_json(),
            "iterations": self.iterations,
            "seconds": self.wall.as_secs_f64(),
        })
    }
}

/// Kills `workers` workers of one run, one after the other, each when the one before has been
/// replaced and its successor has sent a block; then its learner `learners` times, each when the
/// run is further than before. Then stops the run and compares it with a calm one.
pub fn run(
    workers: usize,
    learners: usize,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Restarts> {
    // A budget that is never used up; the learning rate then hardly falls, but the same in both.
    let flags = flags(1, 1_000_000);
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let mut run = Run::with_logged_blocks();
    run.start_training(&flags);
    wait_for(&mut run, stop, |run| iterations(run) >= 5)?;
    let domain = domain_of(&run, run.pid()).context("a live run has a domain")?;
    let mut restarts = Restarts::default();
    let begun = Instant::now();
    let total = workers + learners;
    for i in 0..total {
        let phase = if i < workers {
            restarts.workers.times.push(kill_worker(&mut run, i, stop)?);
            &mut restarts.workers
        } else {
            restarts.learners.times.push(kill_learner(&mut run, stop)?);
            &mut restarts.learners
        };
        phase.sample(run.pid(), &domain)?;
        let done = i + 1;
        if done % 50 == 0 || done == workers || done == total {
            let rate = done as f64 / begun.elapsed().as_secs_f64();
            let left = (total - done) as f64 / rate;
            narrate(&format!("{done} of {total} restarts, {rate:.1} a second, {left:.0} s left"));
        }
    }
    restarts.wall = begun.elapsed();
    run.signal(Signal::INT);
    run.succeed();
    check_lines(&run.metrics())?;
    assert_nothing_left(&domain);
    let replaced = run.metrics().last().and_then(|line| line["restarts"].as_u64()).unwrap_or(0);
    ensure!(replaced >= total as u64, "the run counted {replaced} of {total} restarts");
    narrate(&restarts.to_json().to_string());
    restarts.workers.check("workers")?;
    restarts.learners.check("learners")?;

    let digests = run.digests();
    restarts.iterations = digests.len();
    narrate(&format!("comparing {} iterations with a calm run", digests.len()));
    let mut calm = Run::new();
    calm.start_training(&flags);
    wait_for(&mut calm, stop, |calm| iterations(calm) >= digests.len())?;
    calm.signal(Signal::INT);
    calm.succeed();
    let part = calm.digests().iter().zip(&digests).position(|(calm, here)| calm != here);
    ensure!(part.is_none(), "the digests part at iteration {part:?}");
    Ok(restarts)
}

impl Phase {
    /// As one JSON object.
    fn to_json(&self) -> Value {
        json!({
            "restart": self.times.to_json(),
            "descriptors": self.descriptors.to_json(),
            "memory_bytes": self.memory.to_json(),
            "files": self.files.to_json(),
        })
    }

    /// Looks at what must not grow.
    fn sample(&mut self, coordinator: u32, domain: &str) -> Result<()> {
        let gone = "the coordinator is gone";
        let mut open = descriptors(coordinator).context(gone)?;
        // A checkpoint that is being committed holds files for a moment, and a busy disk makes it a long one.
        for _ in 0..40 {
            if self.descriptors.first().is_none_or(|first| open <= first) {
                break;
            }
            std::thread::sleep(Duration::from_millis(25));
            open = open.min(descriptors(coordinator).context(gone)?);
        }
        self.descriptors.push(open);
        self.memory.push(private_memory(coordinator).context(gone)?);
        self.files.push(domain_files(domain));
        Ok(())
    }

    /// Fails if anything has grown.
    fn check(&self, whose: &str) -> Result<()> {
        let restarts = self.times.len();
        for (what, trend, allowed) in [
            ("open descriptors", &self.descriptors, 0),
            ("files of shared memory", &self.files, 0),
            ("bytes of memory", &self.memory, MEMORY_GROWTH),
        ] {
            let growth = trend.growth().unwrap_or(0);
            ensure!(
                growth <= allowed,
                "{growth} more {what} of the coordinator after {restarts} restarts of {whose}"
            );
        }
        Ok(())
    }
}

/// Kills a worker and waits for the first block of its successor. Returns the time in between.
fn kill_worker(run: &mut Run, turn: usize, stop: &StopRequests) -> Result<Duration> {
    // By turns, so that both workers and both places in the tables are used.
    let alive = workers(run);
    let worker = *alive.get(turn % 2).or(alive.first()).context("no worker lives")?;
    let first_block = FirstBlock::of_successor(run, worker);
    let killed = Instant::now();
    kill(worker.pid, Signal::KILL);
    wait_for(run, stop, |_| first_block.is_sent())
        .with_context(|| format!("restart {} of worker {}", turn + 1, worker.worker))?;
    Ok(killed.elapsed())
}

/// Kills the learner and waits until the run is further than before. Returns the time in between.
fn kill_learner(run: &mut Run, stop: &StopRequests) -> Result<Duration> {
    let learner = *run.children("learner").first().context("no learner lives")?;
    let before = iterations(run);
    let killed = Instant::now();
    kill(learner, Signal::KILL);
    // The iteration that was under way may still have been reported.
    wait_for(run, stop, |run| iterations(run) > before + 1).context("the learner's restart")?;
    Ok(killed.elapsed())
}

/// Waits for something of a run that must not end.
pub(super) fn wait_for(
    run: &mut Run,
    stop: &StopRequests,
    mut happened: impl FnMut(&Run) -> bool,
) -> Result<()> {
    let mut watch = Watch::new(stop);
    while !happened(run) {
        let ended = run.ended();
        ensure!(ended.is_none(), "the run ended with {ended:?}; its log:\n{}", run.log());
        watch.pause(iterations(run) as u64, run)?;
    }
    Ok(())
}
