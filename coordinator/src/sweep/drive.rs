//! The loop of a sweep: trials are begun, gone on with, scored and recorded, as many at a time as there are slots for.
//!
//! A trial is trained by `octopus train` and `octopus resume` in a process of its own, to the next rung, where it pauses. It dies
//! with this process. One thread starts and awaits all of them: the kernel ends children with the thread that started them.

use std::collections::BTreeSet;
use std::fs::File;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use lab::sweep::halving::Next;
use lab::sweep::record::Record;
use lab::sweep::score::{Scored, score_at_end, score_at_rung};
use lab::threads::Threads;
use proto::ExitCode;
use run::signals::StopRequests;
use run::supervisor::log_tail_from;
use run::{environment, errors, signal_isolation};
use rustix::process::{Pid, Signal, kill_process};
use store::checkpoint::{CheckpointStore, Name};
use store::regular_files::{self, Links};

use super::place::Place;
use super::plan::Plan;
use super::slots::Slots;

/// How often trials are looked at.
const TICK: Duration = Duration::from_millis(20);
/// Lines of a log among which the reason of a failure is looked for.
const LAST_LINES: usize = 20;

/// How a sweep ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ended {
    /// There is nothing more to do now.
    Idle,
    /// Somebody asked it to stop.
    Stopped,
}

/// A sweep that is under way.
pub(super) struct Drive<'a> {
    plan: &'a Plan,
    place: &'a Place,
    slots: Slots,
    /// The trial that is done alone, if not all are.
    only: Option<usize>,
    records: Vec<Record>,
    /// Trials that have failed since this began, and those with damaged files; none of them is tried again.
    failed: BTreeSet<usize>,
    work: Vec<Work>,
    told: Vec<Next>,
}

/// Something that is done with a trial.
struct Work {
    trial: usize,
    slot: usize,
    kind: Kind,
}

enum Kind {
    /// Its training.
    Training(Training),
    /// Its score.
    Scoring(JoinHandle<anyhow::Result<Scored>>),
}

/// A process that trains a trial.
struct Training {
    child: Child,
    /// Up to so many iterations.
    until: u64,
    /// Bytes that its log had before: what earlier ones said.
    log_from: u64,
}

impl<'a> Drive<'a> {
    pub(super) fn new(plan: &'a Plan, place: &'a Place, slots: Slots, only: Option<usize>) -> Self {
        let records = place.records(plan);
        let failed: BTreeSet<usize> =
            (0..records.len()).filter(|trial| records[*trial].damaged).collect();
        let told = plan.study.next(&records, |trial| failed.contains(&trial));
        Self { plan, place, slots, only, records, failed, work: Vec::new(), told }
    }

    /// Goes on until there is nothing left to do, or somebody asks it to stop.
    pub(super) fn run(&mut self, stop: &StopRequests) -> anyhow::Result<Ended> {
        let mut heeded = 0;
        loop {
            self.hear(heeded > 0)?;
            let asked = stop.count();
            if asked > heeded {
                // Each request is for all; a second one ends them at once.
                for _ in heeded..asked {
                    self.interrupt();
                }
                if heeded == 0 && self.is_training() {
                    output::note(
                        "stopping: every trial finishes its iteration; Ctrl-C again does not wait for it",
                    );
                }
                heeded = asked;
            }
            // A trial that cannot even be begun leaves its place to others.
            while heeded == 0 && self.start()? {}
            // A score that is under way is made again.
            if self.work.is_empty() || (heeded > 0 && !self.is_training()) {
                return Ok(if heeded > 0 { Ended::Stopped } else { Ended::Idle });
            }
            std::thread::sleep(TICK);
        }
    }

    /// Whether a trial is not tried again in this call, because it has failed in it. Of the others' trials it is what they say.
    fn has_failed(&self, trial: usize) -> bool {
        self.failed.contains(&trial)
            || self.only.is_some_and(|only| only != trial && self.records[trial].failure.is_some())
    }

    fn is_training(&self) -> bool {
        self.work.iter().any(|work| matches!(work.kind, Kind::Training(..)))
    }

    fn interrupt(&self) {
        for work in &self.work {
            if let Kind::Training(Training { child, .. }) = &work.kind
                && let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw)
            {
                let _ = kill_process(pid, Signal::INT);
            }
        }
    }

    /// Begins what there is room for; says whether a trial has failed at that, so that others may have their turn.
    fn start(&mut self) -> anyhow::Result<bool> {
        if self.work.len() == self.slots.count() {
            return Ok(false);
        }
        if let Some(only) = self.only {
            if !self.work.is_empty() {
                return Ok(false);
            }
            // Others may have been scored meanwhile.
            let own = std::mem::take(&mut self.records[only]);
            self.records = self.place.records(self.plan);
            self.records[only] = own;
        }
        let next = self.plan.study.next(&self.records, |trial| self.has_failed(trial));
        self.tell(&next);
        let mut has_failed = false;
        for (trial, next) in next.into_iter().enumerate() {
            let Next::Rung(rung) = next else { continue };
            let is_under_way = self.work.iter().any(|work| work.trial == trial);
            if is_under_way || self.only.is_some_and(|only| only != trial) {
                continue;
            }
            let taken = |slot: &usize| self.work.iter().any(|work| work.slot == *slot);
            let Some(slot) = (0..self.slots.count()).find(|slot| !taken(slot)) else { break };
            match self.begin(trial, rung, slot) {
                Ok(kind) => self.work.push(Work { trial, slot, kind }),
                Err(error) => {
                    self.fail(trial, &errors::told(&error))?;
                    has_failed = true;
                }
            }
        }
        Ok(has_failed)
    }

    /// Says who goes on no further.
    fn tell(&mut self, next: &[Next]) {
        let why = |next: &Next| match next {
            Next::Stopped(_) => Some("stopped early, others are better"),
            Next::AnotherFailed(_) => Some("goes no further, one of its seeds has failed"),
            _ => None,
        };
        let stopped: BTreeSet<(usize, &str)> = next
            .iter()
            .zip(&self.told)
            .zip(&self.plan.study.trials)
            .filter(|((now, before), _)| now != before)
            .filter_map(|((now, _), trial)| Some((trial.configuration, why(now)?)))
            .collect();
        for (configuration, why) in stopped {
            let name = &self.plan.study.configurations[configuration];
            output::note(&format!("{name}: {why}"));
        }
        next.clone_into(&mut self.told);
    }

    /// Trains a trial up to a rung, or scores it if it is there.
    fn begin(&self, trial: usize, rung: usize, slot: usize) -> anyhow::Result<Kind> {
        let until = self.plan.study.trials[trial].rungs[rung];
        let run = &self.plan.runs[trial];
        let done = run.done()?;
        if done < until {
            // Scores that no longer count are gone before they could count again.
            self.write(trial)?;
            let training = self.slots.within(slot, || self.train(trial, until))??;
            self.note(trial, &format!("trains to iteration {until}, {done} are done"));
            return Ok(Kind::Training(training));
        }
        let store = CheckpointStore::new(run.run_dir().checkpoints());
        let dir = store.dir(&Name::of_iteration(until));
        if !dir.exists() {
            anyhow::bail!(
                "{} has no checkpoint of iteration {until}, at which it is to be scored, and is beyond it; remove the run, and \
                 it is trained anew",
                run.dir.display()
            );
        }
        let checkpoint = store.load(&dir)?;
        let threads = Threads::new(self.slots.threads());
        let is_end = rung + 1 == self.plan.study.trials[trial].rungs.len();
        let options = self.plan.evaluation();
        let score = move || {
            if is_end {
                score_at_end(checkpoint, &options, threads)
            } else {
                score_at_rung(checkpoint, threads)
            }
        };
        let thread = std::thread::Builder::new().name("score".to_owned());
        let thread = self.slots.within(slot, || thread.spawn(score))?;
        Ok(Kind::Scoring(thread.context("no thread for a score")?))
    }

    fn train(&self, trial: usize, until: u64) -> anyhow::Result<Training> {
        let run = &self.plan.runs[trial];
        let mut command = Command::new(std::env::current_exe().context("no program")?);
        environment::clean(&mut command);
        if run.has_begun()? {
            command.arg("resume").arg(&run.dir);
        } else {
            // A kill may have left a directory without a configuration and without results: nothing has begun in it.
            if run.dir.exists() {
                std::fs::remove_dir_all(&run.dir)
                    .with_context(|| format!("{}: cannot be removed", run.dir.display()))?;
            }
            let mut dir = std::ffi::OsString::from("--run-dir=");
            dir.push(&run.dir);
            command.arg("train").args(&run.words).arg(dir);
        }
        let log = log(&self.place.log(&self.plan.study.trials[trial].name))?;
        let log_from = log.metadata().context("a log cannot be looked at")?.len();
        command
            .args(["--no-eval", "--quiet", "--listen=off", "--pause-at", &until.to_string()])
            // Killed with this process; its janitor then cleans up.
            .args(["--parent", &std::process::id().to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            // Ctrl-C on the terminal is for this program, which tells the others.
            .process_group(0);
        let child = signal_isolation::spawn_interruptible(&mut command)
            .context("octopus cannot be started")?;
        Ok(Training { child, until, log_from })
    }

    /// Takes in what has ended.
    fn hear(&mut self, stopping: bool) -> anyhow::Result<()> {
        let mut going_on = Vec::new();
        for work in std::mem::take(&mut self.work) {
            let Work { trial, slot, kind } = work;
            match kind {
                Kind::Training(mut training) => match ended(&mut training.child)? {
                    None => {
                        let kind = Kind::Training(training);
                        going_on.push(Work { trial, slot, kind });
                    }
                    Some((status, cpu_s)) => {
                        self.records[trial].cpu_s += cpu_s;
                        self.write(trial)?;
                        self.trained(trial, &training, status, stopping)?;
                    }
                },
                Kind::Scoring(thread) if thread.is_finished() => match thread.join() {
                    Ok(Ok(scored)) => self.scored(trial, scored)?,
                    Ok(Err(error)) => self.fail(trial, &errors::told(&error))?,
                    Err(panic) => std::panic::resume_unwind(panic),
                },
                kind @ Kind::Scoring(_) => going_on.push(Work { trial, slot, kind }),
            }
        }
        self.work = going_on;
        Ok(())
    }

    fn trained(
        &mut self,
        trial: usize,
        training: &Training,
        status: ExitStatus,
        stopping: bool,
    ) -> anyhow::Result<()> {
        let done = match self.plan.runs[trial].done() {
            Ok(done) => done,
            Err(error) => return self.fail(trial, &errors::told(&error)),
        };
        let interrupted = status.success()
            || status.code() == Some(ExitCode::Interrupted as i32)
            // Before it could listen.
            || status.signal() == Some(Signal::INT.as_raw());
        if status.success() && done >= training.until || interrupted && stopping {
            return Ok(());
        }
        if interrupted {
            return self.fail(
                trial,
                &format!("somebody stopped it after {}", output::counted(done, "iteration")),
            );
        }
        let log = self.place.log(&self.plan.study.trials[trial].name);
        let log = log_tail_from(&log, training.log_from, LAST_LINES);
        let reason = log.lines().rev().find_map(|line| line.strip_prefix("error: "));
        let reason = reason.map_or_else(|| status.to_string(), str::to_owned);
        self.fail(trial, &reason)
    }

    fn scored(&mut self, trial: usize, scored: Scored) -> anyhow::Result<()> {
        let said = format!("score {:.3} after iteration {}", scored.score, scored.iteration);
        self.note(trial, &said);
        let record = &mut self.records[trial];
        record.scores.push(scored);
        record.failure = None;
        self.write(trial)
    }

    fn fail(&mut self, trial: usize, reason: &str) -> anyhow::Result<()> {
        self.note(trial, &format!("failed: {reason}"));
        self.records[trial].failure = Some(reason.to_owned());
        self.failed.insert(trial);
        self.write(trial)
    }

    fn write(&self, trial: usize) -> anyhow::Result<()> {
        let name = &self.plan.study.trials[trial].name;
        self.records[trial].write(&self.place.record(name))
    }

    fn note(&self, trial: usize, what: &str) {
        let trials = &self.plan.study.trials;
        let name = &trials[trial].name;
        output::note(&format!("{} of {}, {name}: {what}", trial + 1, trials.len()));
    }
}

fn log(path: &Path) -> anyhow::Result<File> {
    let mut options = File::options();
    options.create(true).append(true);
    regular_files::open_with(path, &mut options, Links::Follow)
        .with_context(|| format!("{}: cannot be written", path.display()))
}

/// How a child ended, if it has, and the processor time that it and its children took (s).
fn ended(child: &mut Child) -> anyhow::Result<Option<(ExitStatus, f64)>> {
    let cpu = process_times(child.id());
    // While nobody waits for it, the kernel keeps what it took.
    let Some((true, cpu_s)) = cpu else {
        return Ok(None);
    };
    let status = child.wait().context("a child cannot be waited for")?;
    Ok(Some((status, cpu_s)))
}

/// Whether a process has ended and is to be waited for, and the processor time of it and of the children that it has waited for,
/// see proc_pid_stat(5).
fn process_times(pid: u32) -> Option<(bool, f64)> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name stands in brackets and may hold anything; behind it stand the state and, from the 12th word on, the times.
    let words: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks: u64 =
        words.get(11..15)?.iter().map(|word| word.parse::<u64>().ok()).sum::<Option<u64>>()?;
    let seconds = ticks as f64 / rustix::param::clock_ticks_per_second() as f64;
    Some((words[0] == "Z", seconds))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn the_processor_time_of_a_child_counts_its_children() {
        // A shell that waits for another one, which counts.
        let count = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
        let mut child = Command::new("sh")
            .args(["-c", &format!("sh -c '{count}'; exit 3")])
            .spawn()
            .expect("sh starts");
        let patience = Instant::now() + Duration::from_mins(1);
        let (status, cpu_s) = loop {
            if let Some(ended) = ended(&mut child).expect("own child") {
                break ended;
            }
            assert!(Instant::now() < patience, "it hangs");
            std::thread::sleep(Duration::from_millis(5));
        };
        assert_eq!(status.code(), Some(3));
        assert!(cpu_s > 0.0 && cpu_s < 60.0, "{cpu_s}");
    }
}
