//! Writes checkpoints on a thread of its own: the run's loop never waits for a disk.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use proto::config::Config;

use crate::checkpoint::{CheckpointError, CheckpointStore, Name, Retention, Score, Snapshot};

/// What the thread is told to do, one after the other.
#[derive(Debug)]
enum Job {
    Commit(Snapshot),
    Score(u64, Score),
    /// Nothing; the answer says that everything before is done.
    Report(Sender<()>),
}

/// What it has done.
#[derive(Debug)]
pub enum Committed {
    /// A checkpoint is on the disk.
    Checkpoint {
        /// Iterations trained on.
        iteration: u64,
        /// Its directory.
        dir: PathBuf,
        /// Time that it took.
        elapsed: Duration,
    },
    /// A score is recorded.
    Score {
        /// The checkpoint's iteration.
        iteration: u64,
        /// The score.
        value: f64,
        /// Whether it is the best so far.
        best: bool,
    },
    /// Something could not be written; what was there before is as it was.
    Failed {
        /// The checkpoint's iteration.
        iteration: u64,
        /// Why.
        error: CheckpointError,
    },
}

/// The thread. Dropping it waits for the work under way.
#[derive(Debug)]
pub struct Committer {
    jobs: Option<Sender<Job>>,
    results: Receiver<Committed>,
    thread: Option<JoinHandle<()>>,
}

impl Committer {
    /// Starts the thread.
    pub fn start(
        store: CheckpointStore,
        config: Config,
        robot_toml: String,
        provenance: serde_json::Value,
    ) -> Self {
        let (jobs, inbox) = channel();
        let (outbox, results) = channel();
        let thread = std::thread::spawn(move || {
            let mut writer = Writer { milestone_at: None, store, config, robot_toml, provenance };
            for job in inbox {
                let result = match job {
                    Job::Commit(snapshot) => writer.commit(&snapshot),
                    Job::Score(iteration, score) => writer.score(iteration, score),
                    Job::Report(done) => {
                        // Whoever asked may have gone.
                        let _ = done.send(());
                        continue;
                    }
                };
                if outbox.send(result).is_err() {
                    break;
                }
            }
        });
        Self { jobs: Some(jobs), results, thread: Some(thread) }
    }

    /// Hands a snapshot over.
    pub fn commit(&self, snapshot: Snapshot) {
        self.send(Job::Commit(snapshot));
    }

    /// Has a score written to the checkpoint of `iteration`, which has been handed over before.
    pub fn score(&self, iteration: u64, score: Score) {
        self.send(Job::Score(iteration, score));
    }

    fn send(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            // A thread that has panicked shows when it is joined.
            let _ = jobs.send(job);
        }
    }

    /// What has been done since the last call.
    pub fn results(&self) -> impl Iterator<Item = Committed> {
        self.results.try_iter()
    }

    /// Waits until everything handed over is written.
    pub fn settle(&self) {
        let (done, wait) = channel();
        self.send(Job::Report(done));
        let _ = wait.recv();
    }
}

impl Drop for Committer {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread owns.
struct Writer {
    store: CheckpointStore,
    config: Config,
    robot_toml: String,
    provenance: serde_json::Value,
    /// When the newest milestone was committed (seconds since 1970); none before the first look.
    milestone_at: Option<f64>,
}

impl Writer {
    fn commit(&mut self, snapshot: &Snapshot) -> Committed {
        let iteration = snapshot.iteration;
        let begun = Instant::now();
        let result = self.store.commit(snapshot, &self.config, &self.robot_toml, &self.provenance);
        match result {
            Ok(dir) => {
                // The checkpoint is safe; what is left is housekeeping, and done again next time.
                if let Err(error) = self.mark_milestone(iteration).and_then(|()| self.retain()) {
                    tracing::warn!(%error, "checkpoints could not be tidied up");
                }
                Committed::Checkpoint { iteration, dir, elapsed: begun.elapsed() }
            }
            Err(error) => Committed::Failed { iteration, error },
        }
    }

    /// Marks the first checkpoint of every stretch of time.
    fn mark_milestone(&mut self, iteration: u64) -> Result<(), CheckpointError> {
        let every = self.config.run.milestone_every_s;
        if every <= 0.0 {
            return Ok(());
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let Some(last) = self.milestone_at else {
            // The first stretch begins with the run's first checkpoint, which is no milestone: it
            // is hardly trained. A resumed run goes on with the stretch it was in.
            let entries = self.store.entries()?;
            let times = |milestone: bool| {
                let of_kind = entries.iter().filter(move |e| !milestone || e.labels.milestone);
                of_kind.map(|entry| entry.created_unix_s as f64)
            };
            let newest = times(true).reduce(f64::max);
            self.milestone_at = newest.or(times(false).reduce(f64::min)).or(Some(now));
            return Ok(());
        };
        if now - last >= every {
            self.store.set_milestone(&Name::of_iteration(iteration), true)?;
            self.milestone_at = Some(now);
        }
        Ok(())
    }

    fn score(&self, iteration: u64, score: Score) -> Committed {
        let value = score.value;
        let result = self
            .store
            .record_score(&Name::of_iteration(iteration), score)
            .and_then(|best| self.retain().map(|()| best));
        match result {
            Ok(best) => Committed::Score { iteration, value, best },
            Err(error) => Committed::Failed { iteration, error },
        }
    }

    fn retain(&self) -> Result<(), CheckpointError> {
        let run = &self.config.run;
        let retention =
            Retention { latest: run.checkpoints_kept, every: run.keep_every, best: true };
        self.store.retain(&retention).map(|_| ())
    }
}
