//! Chaos: a run is killed, stopped, hung and scaled at random moments, and must end with the same
//! bits as one that was left alone, every env-step accounted for, and nothing left behind.
//!
//! [`plan`] draws what happens from a seed, [`Chaos::run`] lets it happen, and [`restarts`] kills
//! workers of one live run a thousand times. [`damage`] harms the files of a dead one, [`environment`] starts
//! runs from foreign shells, [`http`] and [`others`] attack a live run from outside, and [`standstills`] freezes
//! its disk. Nothing here depends on luck to pass: the moments fall differently on every machine, the bits must
//! not.

pub mod damage;
pub mod dice;
pub mod environment;
pub mod http;
pub mod measure;
pub mod observe;
pub mod others;
pub mod plan;
pub mod restarts;
pub mod standstills;
pub mod verdict;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use run::signals::StopRequests;
use rustix::process::Signal;
use serde_json::{Value, json};

use self::measure::Times;
use self::observe::{FirstBlock, domain_of, iterations, workers};
use self::plan::{Act, Event, Plan};
use crate::{Run, assert_nothing_left, kill, octopus, stderr};

/// Flags of every run here, calm or not; a hung process is noticed after three seconds.
const FLAGS: &[&str] = &["--workers=2", "--set=run.order_deadline_s=3", "--quiet"];
/// How long anything that must happen may take before the run counts as hung.
const PATIENCE: Duration = Duration::from_mins(2);
/// How often a run is looked at.
const TICK: Duration = Duration::from_millis(5);
/// A run gives up a worker that dies five times in a row without a block; so often it is killed in
/// a row before a block must be seen.
const KILLS_IN_A_ROW: u32 = 3;

/// What was done to a run and what came of it.
#[derive(Debug, Default)]
pub struct Report {
    /// What was done, by name, and how often.
    pub acts: BTreeMap<&'static str, usize>,
    /// Events that came when the run had done its last iteration: nothing was left to do them to.
    pub late: usize,
    /// Iterations of the run.
    pub iterations: usize,
    /// Coordinators that the run had.
    pub coordinators: usize,
    /// From a learner's death until the run was further than before.
    pub recoveries: Times,
    /// Time that the run took.
    pub wall: Duration,
}

impl Report {
    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({
            "acts": self.acts,
            "late": self.late,
            "iterations": self.iterations,
            "coordinators": self.coordinators,
            "learner_recovery": self.recoveries.to_json(),
            "seconds": self.wall.as_secs_f64(),
        })
    }
}

/// A run and what it is put through.
#[derive(Debug)]
pub struct Chaos<'a> {
    run: Run,
    stop: &'a StopRequests,
    /// Every shared-memory domain that the run has used.
    domains: Vec<String>,
    /// When the learner was killed, and the iterations done then.
    recovering: Option<(Instant, usize)>,
    /// By worker: kills in a row, and how the successor's first block is seen.
    unproven: BTreeMap<u32, (u32, FirstBlock)>,
    report: Report,
}

/// Digests of a run with `overlap` that is left alone for `iterations` iterations.
pub fn calm(overlap: usize, iterations: usize, stop: &StopRequests) -> Result<Vec<String>> {
    let mut run = Run::new();
    run.start_training(&flags(overlap, iterations).iter().map(String::as_str).collect::<Vec<_>>());
    let mut watch = Watch::new(stop);
    loop {
        match run.ended() {
            Some(Some(0)) => return Ok(run.digests()),
            Some(code) => bail!("the calm run ended with {code:?}:\n{}", run.log()),
            None => watch.pause(observe::iterations(&run) as u64, &run)?,
        }
    }
}

fn flags(overlap: usize, iterations: usize) -> Vec<String> {
    let own = [format!("--overlap={overlap}"), format!("--iterations={iterations}")];
    FLAGS.iter().map(|&flag| flag.to_owned()).chain(own).collect()
}

impl<'a> Chaos<'a> {
    /// Puts a run with `overlap` through `plan`. `narrate` is told of everything that happens.
    /// Fails if the bits are not `expected`, if an env-step is missing, or if anything is left.
    pub fn run(
        plan: &Plan,
        overlap: usize,
        expected: &[String],
        stop: &'a StopRequests,
        narrate: &mut dyn FnMut(&str),
    ) -> Result<Report> {
        let started = Instant::now();
        let mut run = Run::with_logged_blocks();
        let flags = flags(overlap, plan.iterations);
        run.start_training(&flags.iter().map(String::as_str).collect::<Vec<_>>());
        let mut chaos = Chaos {
            run,
            stop,
            domains: Vec::new(),
            recovering: None,
            unproven: BTreeMap::new(),
            report: Report { coordinators: 1, ..Report::default() },
        };
        for (number, event) in plan.events.iter().enumerate() {
            chaos.reach(event.at)?;
            let moment = Instant::now() + event.delay;
            while Instant::now() < moment {
                chaos.tend()?;
                std::thread::sleep(TICK.min(moment.saturating_duration_since(Instant::now())));
            }
            let done =
                chaos.act(event).with_context(|| format!("event {}: {event}", number + 1))?;
            match &done {
                Some(_) => *chaos.report.acts.entry(event.act.name()).or_default() += 1,
                None => chaos.report.late += 1,
            }
            let done = done.as_deref().unwrap_or("too late, the run is done");
            narrate(&format!("{:3}/{} {event}: {done}", number + 1, plan.events.len()));
        }
        chaos.reach(plan.iterations)?;
        chaos.end(expected, overlap)?;
        chaos.report.wall = started.elapsed();
        chaos.report.iterations = plan.iterations;
        Ok(chaos.report)
    }

    /// Waits until `n` iterations are done, whatever it takes.
    fn reach(&mut self, n: usize) -> Result<()> {
        let mut watch = Watch::new(self.stop);
        while iterations(&self.run) < n {
            self.tend()?;
            watch.pause(iterations(&self.run) as u64, &self.run)?;
        }
        Ok(())
    }

    /// Looks after the run: learns its domain, resumes it if a killed learner ended it.
    fn tend(&mut self) -> Result<()> {
        if let Some(domain) = domain_of(&self.run, self.run.pid())
            && !self.domains.contains(&domain)
        {
            self.domains.push(domain);
        }
        if let Some((killed, before)) = self.recovering
            // The iteration that was under way may still have been reported.
            && iterations(&self.run) > before + 1
        {
            self.report.recoveries.push(killed.elapsed());
            self.recovering = None;
        }
        match self.run.ended() {
            // The run may be done before its last event.
            None | Some(Some(0)) => Ok(()),
            Some(code) => bail!("the run ended with {code:?}; its log:\n{}", self.run.log()),
        }
    }

    /// Whether the run has done all that it was to do.
    fn is_done(&mut self) -> bool {
        matches!(self.run.ended(), Some(Some(0)))
    }

    /// Does what is due and says what was done; nothing if the run is done.
    fn act(&mut self, event: &Event) -> Result<Option<String>> {
        if self.is_done() {
            return Ok(None);
        }
        match event.act {
            Act::KillWorker => {
                let Some(worker) = self.choose_worker(event.victim)? else { return Ok(None) };
                let first_block = FirstBlock::of_successor(&self.run, worker);
                kill(worker.pid, Signal::KILL);
                let in_a_row = self.unproven.get(&worker.worker).map_or(0, |(kills, _)| *kills) + 1;
                self.unproven.insert(worker.worker, (in_a_row, first_block));
                Ok(Some(format!("worker {} process {}", worker.worker, worker.pid)))
            }
            Act::HangWorker => {
                // Also one that is not ready yet, which costs the deadline for starting.
                let Some(worker) = self.choose_worker(event.victim)? else { return Ok(None) };
                kill(worker.pid, Signal::STOP);
                Ok(Some(format!("worker {} process {}", worker.worker, worker.pid)))
            }
            Act::KillLearner => {
                let Some(learner) = self.learner()? else { return Ok(None) };
                self.recovering = Some((Instant::now(), iterations(&self.run)));
                kill(learner, Signal::KILL);
                Ok(Some(format!("process {learner}")))
            }
            Act::KillCoordinator(workers) => {
                self.wait_until_begun()?;
                let pid = self.run.pid();
                self.run.signal(Signal::KILL);
                let code = self.run.wait();
                // Whoever is killed leaves its name in the lock.
                self.domains.extend(domain_of(&self.run, pid));
                self.domains.dedup();
                self.wait_until_gone()?;
                self.resume(workers);
                Ok(Some(format!("process {pid} ended with {code:?}")))
            }
            Act::Interrupt(workers) => {
                self.wait_until_begun()?;
                self.run.signal(Signal::INT);
                self.stopped("Ctrl-C", workers).map(Some)
            }
            Act::SignalAll(signal, workers) => {
                self.wait_until_begun()?;
                let coordinator = self.run.pid();
                self.domains.extend(domain_of(&self.run, coordinator));
                self.domains.dedup();
                // Children first, so that none of them hears of it from the coordinator.
                let mut everybody = observe::everybody(&self.run, &self.domains);
                everybody.retain(|pid| *pid != coordinator);
                for pid in everybody.into_iter().chain([coordinator]) {
                    kill(pid, signal);
                }
                self.stopped("a signal to all", workers).map(Some)
            }
            Act::FreezeCoordinator(time) => {
                self.run.signal(Signal::STOP);
                std::thread::sleep(time);
                self.run.signal(Signal::CONT);
                Ok(Some(format!("process {}", self.run.pid())))
            }
            Act::Scale(workers) => Ok(self.scale(workers)?.then(|| "accepted".to_owned())),
        }
    }

    /// Waits until there is a run that can be resumed.
    fn wait_until_begun(&mut self) -> Result<()> {
        let mut watch = Watch::new(self.stop);
        while !self.run.path().join("config.toml").exists() {
            self.tend()?;
            watch.pause(0, &self.run)?;
        }
        Ok(())
    }

    /// Waits for the end of a run that was asked to stop, and resumes it.
    fn stopped(&mut self, how: &str, workers: usize) -> Result<String> {
        let pid = self.run.pid();
        let code = self.run.wait();
        self.domains.extend(domain_of(&self.run, pid));
        self.domains.dedup();
        // A signal that comes before the program listens ends it at once, and with a learner that
        // was killed just before the run cannot end as it should.
        let expected = match code {
            Some(0) | None => true,
            Some(6) => self.recovering.is_some(),
            Some(_) => false,
        };
        ensure!(expected, "{how} ended with {code:?}; log:\n{}", self.run.log());
        self.wait_until_gone()?;
        self.resume(workers);
        Ok(format!("process {pid} ended with {code:?}"))
    }

    /// The learner, as soon as there is one; none if the run is done.
    fn learner(&mut self) -> Result<Option<u32>> {
        let mut watch = Watch::new(self.stop);
        loop {
            self.tend()?;
            if let Some(&learner) = self.run.children("learner").first() {
                return Ok(Some(learner));
            }
            if self.is_done() {
                return Ok(None);
            }
            watch.pause(0, &self.run)?;
        }
    }

    /// A worker to be killed, as soon as there is one that has sent a block since the last kill or
    /// was not killed too often in a row; none if the run is done.
    fn choose_worker(&mut self, victim: u32) -> Result<Option<observe::WorkerProcess>> {
        let mut watch = Watch::new(self.stop);
        loop {
            self.tend()?;
            self.unproven.retain(|_, (_, first_block)| !first_block.is_sent());
            let mut candidates = workers(&self.run);
            candidates.retain(|candidate| {
                let killed = self.unproven.get(&candidate.worker);
                killed.is_none_or(|(kills, _)| *kills < KILLS_IN_A_ROW)
            });
            if let Some(index) = (victim as usize).checked_rem(candidates.len()) {
                return Ok(Some(candidates[index]));
            }
            if self.is_done() {
                return Ok(None);
            }
            watch.pause(0, &self.run)?;
        }
    }

    /// Scales, again and again until the run is there to hear it; false if the run is done.
    fn scale(&mut self, workers: usize) -> Result<bool> {
        let path = self.run.path().display().to_string();
        let mut watch = Watch::new(self.stop);
        loop {
            let output = octopus(&["scale", &path, &workers.to_string()]);
            if output.status.success() {
                return Ok(true);
            }
            if self.is_done() {
                return Ok(false);
            }
            let refused = stderr(&output);
            self.tend()?;
            watch.pause(0, &self.run).context(refused)?;
        }
    }

    /// Waits until no process of the run lives, its janitor included.
    fn wait_until_gone(&self) -> Result<()> {
        let mut watch = Watch::new(self.stop);
        while !observe::everybody(&self.run, &self.domains).is_empty() {
            watch.pause(0, &self.run)?;
        }
        Ok(())
    }

    fn resume(&mut self, workers: usize) {
        self.recovering = None;
        self.unproven.clear();
        self.report.coordinators += 1;
        self.run.resume(&[&format!("--workers={workers}"), "--quiet"]);
    }

    /// Lets the run end and checks everything that it leaves and must not leave.
    fn end(&mut self, expected: &[String], overlap: usize) -> Result<()> {
        let mut watch = Watch::new(self.stop);
        loop {
            self.tend()?;
            match self.run.ended() {
                Some(Some(0)) => break,
                _ => watch.pause(iterations(&self.run) as u64, &self.run)?,
            }
        }
        check_lines(&self.run.metrics())?;
        let digests = self.run.digests();
        let part = digests.iter().zip(expected).position(|(found, expected)| found != expected);
        ensure!(part.is_none(), "overlap {overlap}: the digests part at iteration {part:?}");
        ensure!(
            digests.len() == expected.len(),
            "{} iterations instead of {}",
            digests.len(),
            expected.len()
        );
        self.wait_until_gone()?;
        for domain in &self.domains {
            assert_nothing_left(domain);
        }
        ensure!(!self.domains.is_empty(), "no domain was ever seen, so none was checked");
        Ok(())
    }
}

/// Every line of the metrics accounts for every env-step.
pub fn check_lines(lines: &[Value]) -> Result<()> {
    for line in lines {
        let steps = |key: &str| {
            line["accounting"][key].as_u64().with_context(|| format!("no count `{key}` in {line}"))
        };
        let (produced, received) = (steps("produced")?, steps("received")?);
        let (trained, duplicate, lost) = (steps("trained")?, steps("duplicate")?, steps("lost")?);
        ensure!(
            produced == trained + duplicate + lost && received == trained + duplicate,
            "{line} does not add up"
        );
        ensure!(trained == 128, "{trained} of 128 env-steps were trained on: {line}");
    }
    Ok(())
}

/// Waits in small steps, and notices when nothing changes any more or when Ctrl-C was pressed.
#[derive(Debug)]
struct Watch<'a> {
    stop: &'a StopRequests,
    state: u64,
    since: Instant,
}

impl<'a> Watch<'a> {
    fn new(stop: &'a StopRequests) -> Self {
        Self { stop, state: 0, since: Instant::now() }
    }

    /// Sleeps for a tick; `state` is what should change.
    fn pause(&mut self, state: u64, run: &Run) -> Result<()> {
        ensure!(self.stop.count() == 0, "interrupted");
        if state != self.state {
            (self.state, self.since) = (state, Instant::now());
        }
        ensure!(
            self.since.elapsed() < PATIENCE,
            "nothing has happened for {} s; the log of the run:\n{}",
            PATIENCE.as_secs(),
            run.log()
        );
        std::thread::sleep(TICK);
        Ok(())
    }
}
