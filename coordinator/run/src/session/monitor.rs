//! What a live run looks like from outside, taken down a few times a second.

use std::time::{Duration, Instant};

use proto::message::{IterationReport, WorkerId};
use service::live::{ProcessStatus, Role, Stages};

use crate::report::{Diverged, Eta};
use crate::supervisor::ProcessView;

/// Time between two looks.
const INTERVAL: Duration = Duration::from_millis(250);

/// Sums that only the status shows.
#[derive(Debug)]
pub(super) struct Monitor {
    looked_at: Option<Instant>,
    pub(super) stages: Stages,
    pub(super) commits: u64,
    pub(super) checkpoint: Option<String>,
    pub(super) best: Option<(String, f64)>,
    pub(super) last: serde_json::Value,
    pub(super) env_steps_per_s: f64,
    pub(super) eta: Eta,
    pub(super) divergence: Option<Diverged>,
    pub(super) orders_missed: u64,
    pub(super) orders_overdue: u64,
    workers: std::collections::BTreeMap<WorkerId, (u64, Duration)>,
}

impl Monitor {
    pub(super) fn new() -> Self {
        Self {
            looked_at: None,
            stages: Stages::default(),
            commits: 0,
            checkpoint: None,
            best: None,
            last: serde_json::Value::Null,
            env_steps_per_s: 0.0,
            eta: Eta::default(),
            divergence: None,
            orders_missed: 0,
            orders_overdue: 0,
            workers: std::collections::BTreeMap::new(),
        }
    }

    /// Whether it is time for another look.
    pub(super) fn is_due(&mut self) -> bool {
        let due = self.looked_at.is_none_or(|at| at.elapsed() >= INTERVAL);
        if due {
            self.looked_at = Some(Instant::now());
        }
        due
    }

    /// A worker has sent a block.
    pub(super) fn block(&mut self, worker: WorkerId, env_steps: u64, rollout_ns: u64) {
        let (steps, time) = self.workers.entry(worker).or_default();
        *steps += env_steps;
        *time += Duration::from_nanos(rollout_ns);
    }

    /// An iteration is over.
    pub(super) fn iteration(&mut self, report: &IterationReport) {
        let timing = &report.timing;
        self.stages.rollout_s += timing.rollout_s;
        self.stages.wait_s += timing.wait_s;
        self.stages.update_s += timing.update_s;
        self.stages.publish_s += timing.publish_s;
        self.stages.digest_s += timing.digest_s;
        self.stages.copy_s += timing.copy_s;
    }

    /// A process as it is now. `ready` if it has said so.
    pub(super) fn process(
        &self,
        view: &ProcessView,
        ready: bool,
        shards: Vec<String>,
    ) -> ProcessStatus {
        let state = match view {
            ProcessView { leaving: true, .. } => "leaving",
            ProcessView { pid: None, .. } => "backing off",
            _ if ready => "ready",
            _ => "starting",
        };
        let (env_steps, rollout) =
            view.worker.and_then(|worker| self.workers.get(&worker).copied()).unwrap_or_default();
        let usage = view.pid.map(usage).unwrap_or_default();
        ProcessStatus {
            role: view.role,
            worker: view.worker,
            pid: view.pid,
            state: state.to_owned(),
            restarts: view.replaced,
            resident_bytes: usage.resident_bytes,
            cpu_s: usage.cpu_s,
            shards,
            env_steps,
            rollout_s: rollout.as_secs_f64(),
        }
    }

    /// This process.
    pub(super) fn coordinator() -> ProcessStatus {
        let pid = std::process::id();
        let usage = usage(pid);
        ProcessStatus {
            role: Role::Coordinator,
            worker: None,
            pid: Some(pid),
            state: "ready".to_owned(),
            restarts: 0,
            resident_bytes: usage.resident_bytes,
            cpu_s: usage.cpu_s,
            shards: Vec::new(),
            env_steps: 0,
            rollout_s: 0.0,
        }
    }
}

/// What a process uses; nothing if it has just gone.
#[derive(Debug, Clone, Copy, Default)]
struct Usage {
    resident_bytes: u64,
    cpu_s: f64,
}

fn usage(pid: u32) -> Usage {
    let read = |file: &str| std::fs::read_to_string(format!("/proc/{pid}/{file}"));
    let pages = |text: String| text.split_whitespace().nth(1)?.parse::<u64>().ok();
    let resident_bytes =
        read("statm").ok().and_then(pages).unwrap_or(0) * rustix::param::page_size() as u64;
    // The name stands in brackets and may hold anything; user and system time are the 12th and 13th
    // word after it.
    let ticks = |text: String| {
        let mut words = text.rsplit_once(')')?.1.split_whitespace().skip(11);
        let user: u64 = words.next()?.parse().ok()?;
        let system: u64 = words.next()?.parse().ok()?;
        Some(user + system)
    };
    let ticks = read("stat").ok().and_then(ticks).unwrap_or(0);
    Usage { resident_bytes, cpu_s: ticks as f64 / rustix::param::clock_ticks_per_second() as f64 }
}
