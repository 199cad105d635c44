//! Standstills: the disk of a live run is frozen, or its coordinator stopped, for longer than every deadline. The
//! run goes on with the processes that it has and loses nothing; whoever asks it twice to stop meanwhile is heard.
//!
//! Only root can mount a file system and freeze it, and it takes loop devices. Without them nothing is tried, and
//! the report says so.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use run::signals::StopRequests;
use rustix::process::{Signal, geteuid};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::observe::{domain_of, iterations};
use super::restarts::wait_for;
use super::{PATIENCE, TICK, check_lines};
use crate::{Run, assert_nothing_left};

/// Flags of every run here: checkpoints often enough to be caught.
const FLAGS: &[&str] = &[
    "--workers=2",
    "--overlap=1",
    "--iterations=1000000",
    "--quiet",
    "--set=run.checkpoint_every=25",
];
/// What is tried, in turn.
const ACTS: &[Act] = &[
    Act { what: Standstill::Training, beyond: Beyond::All },
    Act { what: Standstill::Commit, beyond: Beyond::All },
    Act { what: Standstill::Coordinator, beyond: Beyond::All },
    Act { what: Standstill::StoppedTwice, beyond: Beyond::All },
    Act { what: Standstill::Training, beyond: Beyond::Orders },
    Act { what: Standstill::Commit, beyond: Beyond::Orders },
    Act { what: Standstill::Coordinator, beyond: Beyond::Orders },
];
/// Size of the file system (bytes); its file is sparse.
const SIZE: u64 = 1 << 30;
/// Between a first and a second request to stop.
const BETWEEN_REQUESTS: Duration = Duration::from_secs(5);

/// What stands still, and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Standstill {
    /// The disk, at any moment.
    Training,
    /// The disk, while a checkpoint is being written.
    Commit,
    /// The coordinator.
    Coordinator,
    /// The disk, and the run is asked twice to stop.
    StoppedTwice,
}

/// Which deadlines a standstill lasts beyond.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Beyond {
    /// That of orders and of silence.
    Orders,
    /// Every one.
    All,
}

#[derive(Debug, Clone, Copy)]
struct Act {
    what: Standstill,
    beyond: Beyond,
}

/// How long a standstill is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dose {
    /// Seconds, of a run whose orders and processes have three.
    Short,
    /// One to two minutes, of a run with the deadlines that it has by default: a minute for most.
    Long,
}

impl Dose {
    fn lasts(self, beyond: Beyond) -> Duration {
        Duration::from_secs(match (self, beyond) {
            (Self::Short, Beyond::Orders) => 6,
            (Self::Short, Beyond::All) => 9,
            (Self::Long, Beyond::Orders) => 75,
            (Self::Long, Beyond::All) => 110,
        })
    }

    /// Time in which what waited for the disk is written. Whatever the run trains meanwhile, a calm one trains again.
    fn catches_up(self) -> Duration {
        Duration::from_secs(match self {
            Self::Short => 1,
            Self::Long => 5,
        })
    }

    fn flags(self) -> Vec<&'static str> {
        let deadline = (self == Self::Short).then_some("--set=run.order_deadline_s=3");
        FLAGS.iter().copied().chain(deadline).collect()
    }
}

impl Standstill {
    fn name(self) -> &'static str {
        match self {
            Self::Training => "disk_while_training",
            Self::Commit => "disk_while_committing",
            Self::Coordinator => "coordinator",
            Self::StoppedTwice => "disk_and_stopped_twice",
        }
    }
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self.what {
            Standstill::Training => "the disk",
            Standstill::Commit => "the disk during a commit",
            Standstill::Coordinator => "the coordinator",
            Standstill::StoppedTwice => "the disk, and two requests to stop",
        };
        let beyond = match self.beyond {
            Beyond::Orders => "the deadline of orders",
            Beyond::All => "every deadline",
        };
        write!(f, "{what} beyond {beyond}")
    }
}

/// What came of many standstills.
#[derive(Debug, Default)]
pub struct Report {
    /// What stood still, and how often.
    pub acts: BTreeMap<&'static str, usize>,
    /// Iterations of the run.
    pub iterations: usize,
    /// Why nothing was tried, where it was not.
    pub not_tried: Option<String>,
}

impl Report {
    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({ "acts": self.acts, "iterations": self.iterations, "not_tried": self.not_tried })
    }
}

/// Lets the disk or the coordinator of one run stand still `times` times; then stops the run and compares it
/// with one that was left alone.
pub fn run(
    times: usize,
    dose: Dose,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Report> {
    let mut report = Report::default();
    let mut disk = match Disk::mount() {
        Ok(disk) => disk,
        Err(error) => {
            let reason = format!("{error:#}");
            narrate(&format!("no file system that can be frozen, nothing is tried: {reason}"));
            report.not_tried = Some(reason);
            return Ok(report);
        }
    };
    let mut run = Run::below(&disk.path());
    let flags = dose.flags();
    run.start_training(&flags);
    for (time, act) in ACTS.iter().copied().cycle().take(times).enumerate() {
        let so_far = iterations(&run);
        wait_for(&mut run, stop, |run| iterations(run) >= so_far + 30)?;
        inflict(act, dose, &mut run, &mut disk, stop)
            .with_context(|| format!("{act}; log:\n{}", run.log()))?;
        *report.acts.entry(act.what.name()).or_default() += 1;
        narrate(&format!("{:3}/{times} {act}: survived", time + 1));
    }
    let so_far = iterations(&run);
    wait_for(&mut run, stop, |run| iterations(run) >= so_far + 30)?;
    let domain = domain_of(&run, run.pid()).context("a live run has a domain")?;
    run.signal(Signal::INT);
    run.succeed();
    check_lines(&run.metrics())?;
    assert_nothing_left(&domain);

    let digests = run.digests();
    report.iterations = digests.len();
    narrate(&format!("comparing {} iterations with a calm run", digests.len()));
    let mut calm = Run::train(&flags);
    wait_for(&mut calm, stop, |calm| iterations(calm) >= digests.len())?;
    calm.signal(Signal::INT);
    calm.succeed();
    let part = calm.digests().iter().zip(&digests).position(|(calm, here)| calm != here);
    ensure!(part.is_none(), "the digests part at iteration {part:?}");
    Ok(report)
}

/// Lets something stand still, and looks at what comes of it.
fn inflict(
    act: Act,
    dose: Dose,
    run: &mut Run,
    disk: &mut Disk,
    stop: &StopRequests,
) -> Result<()> {
    let lasts = dose.lasts(act.beyond);
    let before = processes(run);
    ensure!(before.len() == 3, "a learner and two workers: {before:?}");
    match act.what {
        Standstill::Coordinator => {
            run.signal(Signal::STOP);
            let slept = sleep(lasts, stop);
            run.signal(Signal::CONT);
            slept?;
        }
        Standstill::Training | Standstill::Commit => {
            let still = if act.what == Standstill::Commit {
                freeze_during_commit(run, disk, stop)?
            } else {
                disk.freeze()?
            };
            sleep(lasts, stop)?;
            ensure!(run.ended().is_none(), "it ended while the disk stood still");
            still.thaw()?;
        }
        Standstill::StoppedTwice => return stop_twice(run, disk, stop),
    }
    sleep(dose.catches_up(), stop)?;
    let so_far = iterations(run);
    wait_for(run, stop, |run| iterations(run) > so_far + 20)?;
    let after = processes(run);
    ensure!(after == before, "other processes than before: {before:?}, {after:?}");
    let last = run.metrics().pop().context("lines")?;
    ensure!(last["restarts"] == 0, "{} restarts", last["restarts"]);
    Ok(())
}

/// Freezes the disk at a moment when a checkpoint is half written.
fn freeze_during_commit(run: &mut Run, disk: &mut Disk, stop: &StopRequests) -> Result<Frozen> {
    let store = run.path().join("checkpoints");
    let begun = Instant::now();
    loop {
        wait_for(run, stop, |_| is_being_written(&store))?;
        let still = disk.freeze()?;
        // The commit may have been faster.
        if is_being_written(&store) {
            return Ok(still);
        }
        still.thaw()?;
        ensure!(begun.elapsed() < PATIENCE, "no commit could be caught");
    }
}

/// Asks the run twice to stop while its disk stands still, and resumes it. A thread that waits for a frozen file
/// system cannot be ended, by nobody and no signal; all others are, and so are the children.
fn stop_twice(run: &mut Run, disk: &mut Disk, stop: &StopRequests) -> Result<()> {
    let pid = run.pid();
    let domain = domain_of(run, pid).context("a live run has a domain")?;
    let still = disk.freeze()?;
    sleep(BETWEEN_REQUESTS, stop)?;
    run.signal(Signal::INT);
    sleep(BETWEEN_REQUESTS, stop)?;
    ensure!(run.ended().is_none(), "nothing was committed, but it has ended");
    run.signal(Signal::INT);
    let begun = Instant::now();
    while !(has_exited(pid) && processes(run).is_empty()) {
        ensure!(begun.elapsed() < PATIENCE, "asked twice, and still there");
        sleep(TICK, stop)?;
    }
    still.thaw()?;
    let code = run.wait();
    ensure!(code == Some(130), "it ended with {code:?}");
    assert_nothing_left(&domain);
    run.resume(&["--workers=2", "--quiet"]);
    Ok(())
}

/// Whether a process is gone, or all of it that can go.
fn has_exited(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The state follows the name, which is in brackets.
    stat.rsplit(") ").next().is_none_or(|rest| rest.is_empty() || rest.starts_with(['Z', 'X']))
}

/// Learner and workers.
fn processes(run: &Run) -> Vec<u32> {
    let mut found = run.children("learner");
    found.extend(run.children("sim-worker"));
    found.sort_unstable();
    found
}

/// Whether a checkpoint is being written that is not committed yet.
fn is_being_written(store: &Path) -> bool {
    let entries = std::fs::read_dir(store).into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .any(|name| name.starts_with(".writing-"))
}

/// Sleeps, unless Ctrl-C is pressed.
fn sleep(time: Duration, stop: &StopRequests) -> Result<()> {
    let end = Instant::now() + time;
    while let Some(left) = end.checked_duration_since(Instant::now()) {
        ensure!(stop.count() == 0, "interrupted");
        std::thread::sleep(left.min(Duration::from_millis(100)));
    }
    Ok(())
}

/// A file system of its own, in a file, that goes away with this.
struct Disk {
    place: TempDir,
}

impl Disk {
    fn mount() -> Result<Self> {
        ensure!(geteuid().is_root(), "only root can mount a file system and freeze it");
        let place = tempfile::tempdir()?;
        let image = place.path().join("image");
        File::create(&image)?.set_len(SIZE)?;
        command("mkfs.ext4", &["-q", "-F"], &[&image])?;
        std::fs::create_dir(place.path().join("disk"))?;
        command("mount", &["-o", "loop"], &[&image, &place.path().join("disk")])?;
        Ok(Self { place })
    }

    fn path(&self) -> PathBuf {
        self.place.path().join("disk")
    }

    /// From now on whoever writes there waits, until what is returned goes.
    fn freeze(&mut self) -> Result<Frozen> {
        command("fsfreeze", &["--freeze"], &[&self.path()])?;
        Ok(Frozen { path: Some(self.path()) })
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Whoever was killed needs a moment to let go of its files.
        let patience = Instant::now() + Duration::from_secs(10);
        while command("umount", &[], &[&self.path()]).is_err() {
            if Instant::now() > patience {
                let _ = command("umount", &["--lazy"], &[&self.path()]);
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// A file system that stands still for as long as this lives: whoever waits for it cannot be ended meanwhile.
struct Frozen {
    path: Option<PathBuf>,
}

impl Frozen {
    fn thaw(mut self) -> Result<()> {
        let path = self.path.take().context("thawed once")?;
        command("fsfreeze", &["--unfreeze"], &[&path])
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            let _ = command("fsfreeze", &["--unfreeze"], &[path]);
        }
    }
}

/// Runs a tool of the system to its end.
fn command(program: &str, options: &[&str], paths: &[&Path]) -> Result<()> {
    let output = Command::new(program).args(options).args(paths).stdin(Stdio::null()).output();
    let output = output.with_context(|| format!("`{program}` cannot be started"))?;
    if !output.status.success() {
        bail!("`{program}`: {}", String::from_utf8_lossy(&output.stderr).trim_end());
    }
    Ok(())
}
