//! A run seen from outside, cheaply enough to be looked at every few milliseconds.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::{Run, processes_with};

/// A worker's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct WorkerProcess {
    /// Number of the worker.
    pub worker: u32,
    /// How often it was started before.
    pub incarnation: u32,
    /// Process id.
    pub pid: u32,
}

/// Living workers of a run, in order.
pub fn workers(run: &Run) -> Vec<WorkerProcess> {
    let mut found: Vec<WorkerProcess> = run
        .children("sim-worker")
        .into_iter()
        .filter_map(|pid| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
            let line = String::from_utf8_lossy(&line).into_owned();
            let words: Vec<&str> = line.split('\0').collect();
            let after = |flag: &str| {
                let place = words.iter().position(|word| *word == flag)?;
                words.get(place + 1)?.parse().ok()
            };
            Some(WorkerProcess {
                worker: after("--worker")?,
                incarnation: after("--incarnation")?,
                pid,
            })
        })
        .collect();
    found.sort_unstable();
    found
}

/// Iterations that `metrics.jsonl` holds, by its last whole line.
pub fn iterations(run: &Run) -> usize {
    last_iterations(&run.path().join("metrics.jsonl")).unwrap_or(0)
}

fn last_iterations(path: &Path) -> Option<usize> {
    /// Longer than two lines of the metrics.
    const TAIL: u64 = 8192;
    let mut file = File::open(path).ok()?;
    let len = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(len.saturating_sub(TAIL))).ok()?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let whole = &text[..=text.rfind('\n')?];
    let last: Value = serde_json::from_str(whole.lines().next_back()?).ok()?;
    Some(last["iteration"].as_u64()? as usize + 1)
}

/// Whether the lock says that this process owns the run, and the domain that it uses.
pub fn domain_of(run: &Run, pid: u32) -> Option<String> {
    let text = std::fs::read_to_string(run.path().join("run.lock")).ok()?;
    let holder: Value = serde_json::from_str(&text).ok()?;
    (holder["pid"] == pid).then(|| holder["domain"].as_str().map(str::to_owned))?
}

fn log_of(run: &Run, worker: u32) -> PathBuf {
    run.path().join(format!("logs/worker-{worker}.log"))
}

/// The text of a file from `offset` on; none if there is no file.
fn read_from(path: &Path, offset: u64) -> String {
    let read = || -> std::io::Result<String> {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    };
    read().unwrap_or_default()
}

/// Waits in a worker's log for the first block of a process that was not there before.
#[derive(Debug)]
pub struct FirstBlock {
    log: PathBuf,
    offset: u64,
    successor: String,
}

impl FirstBlock {
    /// To be called before `worker` is killed.
    pub fn of_successor(run: &Run, worker: WorkerProcess) -> Self {
        Self::of(run, worker.worker, &format!(" incarnation={} ", worker.incarnation + 1))
    }

    /// To be called before the run is scaled up; `worker` does not live.
    pub fn of_new(run: &Run, worker: u32) -> Self {
        Self::of(run, worker, " incarnation=")
    }

    fn of(run: &Run, worker: u32, successor: &str) -> Self {
        let log = log_of(run, worker);
        let offset = std::fs::metadata(&log).map_or(0, |metadata| metadata.len());
        Self { log, offset, successor: successor.to_owned() }
    }

    /// Whether the block has been sent.
    pub fn is_sent(&self) -> bool {
        let text = read_from(&self.log, self.offset);
        // The predecessor's last words may come after the offset.
        text.rfind(&self.successor).is_some_and(|ready| text[ready..].contains("block sent"))
    }
}

/// Living processes that name the run's directory or one of its domains on their command lines.
pub fn everybody(run: &Run, domains: &[String]) -> Vec<u32> {
    let path = run.path().display().to_string();
    let names = domains.iter().map(String::as_str).chain([path.as_str()]);
    names.flat_map(processes_with).map(|(pid, _)| pid).collect()
}
