//! Writes checkpoints on a thread of its own: the run's loop never waits for a disk.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use channels::WAITING_SNAPSHOTS;
use proto::config::Config;
use store::checkpoint::{
    CheckpointError, CheckpointStore, Name, Placement, Retention, Score, Snapshot,
};

/// What the thread is told to do, one after the other.
#[derive(Debug)]
enum CommitRequest {
    Commit(Waiting),
    Score(u64, Score),
    /// As `Score`, of a snapshot that was not handed over with it: without a checkpoint it is given up.
    Displaced(u64, Score),
    /// Nothing; the answer says that everything before is done.
    Report(Sender<()>),
}

/// A snapshot to be committed, and the score of its policy if that is the best so far.
#[derive(Debug)]
struct Waiting {
    snapshot: Arc<Snapshot>,
    score: Option<Score>,
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
    /// A snapshot was not committed; what was there before is as it was.
    Failed {
        /// Its iteration.
        iteration: u64,
        /// Why.
        error: CheckpointError,
    },
    /// A checkpoint is whole, but its score could not be written.
    ScoreFailed {
        /// The checkpoint's iteration.
        iteration: u64,
        /// Why.
        error: CheckpointError,
    },
    /// A snapshot was not committed, because the metrics of its iterations could not be made durable.
    Unrecorded {
        /// Its iteration.
        iteration: u64,
        /// Why.
        error: anyhow::Error,
    },
    /// A newer snapshot came before this one could be sent or the disk was ready for it.
    GivenUp {
        /// Its iteration.
        iteration: u64,
    },
}

/// The thread. Dropping it waits for the work under way.
///
/// While one snapshot is being written, others wait as far as there is memory for them, and the newest of those
/// with a score: a disk that is slower than the training costs checkpoints, not memory. Small states wait in
/// numbers, so that a short training on a busy machine loses none.
#[derive(Debug)]
pub struct Committer {
    jobs: Option<Sender<CommitRequest>>,
    /// What the thread has done; nothing once it has dealt with a snapshot.
    inbox: Receiver<Option<Committed>>,
    thread: Option<JoinHandle<()>>,
    /// Whether the thread has a snapshot.
    writing: bool,
    /// The oldest first.
    waiting: VecDeque<Waiting>,
    waiting_best: Option<Waiting>,
    /// What waits takes no more memory than this together (bytes), unless one alone does.
    pub(crate) room: usize,
    results: Vec<Committed>,
}

impl Committer {
    /// Starts the thread. It calls `record` before it commits a snapshot: the metrics of the snapshot's
    /// iterations are durable when that returns.
    pub fn start(
        store: CheckpointStore,
        config: Config,
        robot_toml: String,
        provenance: serde_json::Value,
        record: impl Fn() -> anyhow::Result<()> + Send + 'static,
    ) -> Self {
        let (jobs, orders) = channel();
        let (outbox, inbox) = channel();
        let thread = std::thread::spawn(move || {
            let mut writer =
                Writer { milestone_at: None, store, config, robot_toml, provenance, outbox };
            for job in orders {
                match job {
                    CommitRequest::Commit(waiting) => {
                        match record() {
                            Ok(()) => writer.commit(waiting),
                            Err(error) => {
                                let iteration = waiting.snapshot.iteration;
                                writer.tell(Committed::Unrecorded { iteration, error });
                            }
                        }
                        // Nobody listens only while the run is being given up.
                        let _ = writer.outbox.send(None);
                    }
                    CommitRequest::Score(iteration, score) => {
                        writer.score(iteration, score);
                    }
                    CommitRequest::Displaced(iteration, score) => {
                        if !writer.score(iteration, score) {
                            writer.tell(Committed::GivenUp { iteration });
                        }
                    }
                    CommitRequest::Report(done) => {
                        // Whoever asked may have gone.
                        let _ = done.send(());
                    }
                }
            }
        });
        Self {
            jobs: Some(jobs),
            inbox,
            thread: Some(thread),
            writing: false,
            waiting: VecDeque::new(),
            waiting_best: None,
            room: WAITING_SNAPSHOTS,
            results: Vec::new(),
        }
    }

    /// Has a snapshot committed, as the best so far if it has a score. One that is committed
    /// already only gets its score.
    pub fn commit(&mut self, snapshot: Arc<Snapshot>, score: Option<Score>) {
        let iteration = snapshot.iteration;
        if let Some(score) = score {
            let newer = Waiting { snapshot, score: Some(score) };
            let older = self.waiting_best.replace(newer);
            self.displace(older.filter(|older| older.snapshot.iteration != iteration));
        } else {
            self.waiting.retain(|older| older.snapshot.iteration != iteration);
            self.waiting.push_back(Waiting { snapshot, score: None });
            while self.waiting.len() > 1 && self.waiting_bytes() > self.room {
                let oldest = self.waiting.pop_front().expect("there are several");
                let iteration = oldest.snapshot.iteration;
                // Unless it waits as the best, too.
                let best = self.waiting_best.as_ref().map(|best| best.snapshot.iteration);
                if best != Some(iteration) {
                    self.results.push(Committed::GivenUp { iteration });
                }
            }
        }
        self.hand_over();
    }

    fn waiting_bytes(&self) -> usize {
        self.waiting.iter().map(|waiting| waiting.snapshot.bytes.len()).sum()
    }

    /// A better one has come before the disk was ready for this best. It may wait, or be there, as one of the others.
    fn displace(&mut self, older: Option<Waiting>) {
        let Some(Waiting { snapshot, score: Some(score) }) = older else { return };
        let iteration = snapshot.iteration;
        match self.waits(iteration) {
            Some(waiting) => waiting.score = Some(score),
            None => self.send(CommitRequest::Displaced(iteration, score)),
        }
    }

    /// Has a score written to the checkpoint of `iteration`, if that is still there.
    pub fn score(&mut self, iteration: u64, score: Score) {
        match self.waits(iteration) {
            Some(waiting) => waiting.score = Some(score),
            None => self.send(CommitRequest::Score(iteration, score)),
        }
    }

    /// The snapshot of `iteration`, if it waits without being the best.
    fn waits(&mut self, iteration: u64) -> Option<&mut Waiting> {
        self.waiting.iter_mut().find(|waiting| waiting.snapshot.iteration == iteration)
    }

    /// Whether a snapshot is being written or waits to be.
    pub fn is_busy(&self) -> bool {
        self.writing || !self.waiting.is_empty() || self.waiting_best.is_some()
    }

    /// What has been done since the last call, in order.
    pub fn results(&mut self) -> Vec<Committed> {
        self.collect();
        std::mem::take(&mut self.results)
    }

    /// Waits until everything handed over is written.
    pub fn settle(&mut self) {
        loop {
            let (done, wait) = channel();
            self.send(CommitRequest::Report(done));
            let reported = wait.recv();
            self.collect();
            if !self.is_busy() || reported.is_err() {
                return;
            }
        }
    }

    /// Leaves the thread to itself, whatever it waits for.
    pub fn abandon(&mut self) {
        self.jobs = None;
        self.thread = None;
    }

    fn collect(&mut self) {
        for result in self.inbox.try_iter() {
            match result {
                Some(result) => self.results.push(result),
                None => self.writing = false,
            }
        }
        self.hand_over();
    }

    /// Gives the thread the snapshot that waits longest, if it has none.
    fn hand_over(&mut self) {
        if self.writing {
            return;
        }
        let iteration = |waiting: Option<&Waiting>| {
            waiting.map_or(u64::MAX, |waiting| waiting.snapshot.iteration)
        };
        let best = self.waiting_best.as_ref();
        let first = if iteration(best) < iteration(self.waiting.front()) {
            self.waiting_best.take()
        } else {
            self.waiting.pop_front()
        };
        if let Some(next) = first {
            self.writing = true;
            self.send(CommitRequest::Commit(next));
        }
    }

    fn send(&self, job: CommitRequest) {
        if let Some(jobs) = &self.jobs {
            // A thread that has panicked shows when it is joined.
            let _ = jobs.send(job);
        }
    }
}

impl Drop for Committer {
    fn drop(&mut self) {
        self.settle();
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
    outbox: Sender<Option<Committed>>,
    /// When the newest milestone was committed (seconds since 1970); none before the first look.
    milestone_at: Option<f64>,
}

impl Writer {
    fn commit(&mut self, Waiting { snapshot, score }: Waiting) {
        let iteration = snapshot.iteration;
        let begun = Instant::now();
        let is_there = self.store.dir(&Name::of_iteration(iteration)).exists();
        let value = score.as_ref().map(|score| score.value);
        let result = self.store.commit_scored(
            &snapshot,
            &self.config,
            &self.robot_toml,
            &self.provenance,
            score,
        );
        match result {
            Ok(Placement { dir, best }) => {
                // The checkpoint is safe; what is left is housekeeping, and done again next time.
                if let Err(error) =
                    self.mark_milestone(iteration).and_then(|()| self.retain(iteration))
                {
                    tracing::warn!(%error, "checkpoints could not be tidied up");
                }
                self.tell(Committed::Checkpoint { iteration, dir, elapsed: begun.elapsed() });
                if let Some(value) = value {
                    self.tell(Committed::Score { iteration, value, best });
                }
            }
            Err(error) if is_there && value.is_some() => {
                self.tell(Committed::ScoreFailed { iteration, error });
            }
            Err(error) => self.tell(Committed::Failed { iteration, error }),
        }
    }

    /// Records the score of a checkpoint, if it is there.
    fn score(&self, iteration: u64, score: Score) -> bool {
        // Not the best, so it may have been tidied up meanwhile.
        let is_there = self.store.dir(&Name::of_iteration(iteration)).exists();
        if is_there {
            self.tell(self.record(iteration, score));
        }
        is_there
    }

    fn record(&self, iteration: u64, score: Score) -> Committed {
        let value = score.value;
        match self.store.record_score(&Name::of_iteration(iteration), score) {
            Ok(best) => Committed::Score { iteration, value, best },
            Err(error) => Committed::ScoreFailed { iteration, error },
        }
    }

    fn tell(&self, result: Committed) {
        let _ = self.outbox.send(Some(result));
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
        // One that lies ahead was written by a clock that was wrong, and would be waited for.
        let mut last = last.min(now);
        if now - last >= every {
            self.store.set_milestone(&Name::of_iteration(iteration), true)?;
            last = now;
        }
        self.milestone_at = Some(last);
        Ok(())
    }

    fn retain(&self, iteration: u64) -> Result<(), CheckpointError> {
        let run = &self.config.run;
        let retention =
            Retention { latest: run.checkpoints_kept, every: run.keep_every, best: true };
        self.store.retain_up_to(iteration, &retention).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};
    use simulator::robot::Robot;
    use store::checkpoint::fixtures::snapshot_of;
    use store::checkpoint::{Entry, MANIFEST};

    use super::*;

    fn config() -> Config {
        let settings =
            ["network.hidden=[4]", "network.critic_hidden=[4]", "run.milestone_every_s=0.001"];
        let layers =
            settings.iter().try_fold(Layers::new(Preset::Tuned, None), |l, set| l.set(set));
        layers.and_then(|layers| layers.resolve()).expect("valid")
    }

    /// One was told to be lost although it was there, and its score was lost.
    #[test]
    fn a_best_that_waits_as_one_of_the_others_keeps_its_score_when_a_better_one_comes() {
        let dir = tempfile::tempdir().expect("tempdir");
        let config = config();
        let store = CheckpointStore::new(dir.path().join("checkpoints"));
        let robot = Robot::builtin("paper").expect("built in").to_toml();
        let (release, held) = channel::<()>();
        // The disk is slow until this test lets it go on, and never again.
        let record = move || {
            let _ = held.recv();
            Ok(())
        };
        let mut committer =
            Committer::start(store.clone(), config.clone(), robot, serde_json::json!({}), record);
        let scored = |value: f64| Score {
            value,
            errors: std::collections::BTreeMap::default(),
            episodes: 1,
            steps: 1,
            seed: 1,
        };
        let snapshots: Vec<_> =
            (1..=4).map(|iteration| Arc::new(snapshot_of(&config, iteration, 0.0))).collect();
        // The first is being written, two more wait, and the fourth is not asked for but as the best.
        for snapshot in &snapshots[..3] {
            committer.commit(Arc::clone(snapshot), None);
        }
        for (index, value) in [(0, 4.0), (1, 3.0), (3, 2.0), (2, 1.0)] {
            committer.commit(Arc::clone(&snapshots[index]), Some(scored(value)));
        }
        drop(release);
        committer.settle();
        let given_up: Vec<u64> = committer
            .results()
            .into_iter()
            .filter_map(|result| match result {
                Committed::GivenUp { iteration } => Some(iteration),
                _ => None,
            })
            .collect();
        assert_eq!(given_up, [4], "it was the best alone");
        let value = |entry: &Entry| (entry.iteration, entry.labels.score.as_ref().map(|s| s.value));
        let found: Vec<_> = store.entries().expect("lists").iter().map(value).collect();
        assert_eq!(found, [(1, Some(4.0)), (2, Some(3.0)), (3, Some(1.0))]);
    }

    /// No other was marked until the clock came to that time.
    #[test]
    fn a_milestone_of_a_clock_that_was_wrong_is_not_waited_for() {
        let dir = tempfile::tempdir().expect("tempdir");
        let config = config();
        let store = CheckpointStore::new(dir.path().join("checkpoints"));
        let (outbox, _inbox) = channel();
        let mut writer = Writer {
            store: store.clone(),
            robot_toml: Robot::builtin("paper").expect("built in").to_toml(),
            provenance: serde_json::json!({}),
            outbox,
            milestone_at: None,
            config: config.clone(),
        };
        let commit = |iteration| {
            let (snapshot, robot) = (snapshot_of(&config, iteration, 0.0), &writer.robot_toml);
            store.commit(&snapshot, &config, robot, &writer.provenance).expect("commits")
        };
        let manifest = commit(1).join(MANIFEST);
        commit(2);
        let text = std::fs::read_to_string(&manifest).expect("readable");
        let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        json["created_unix_s"] = serde_json::json!(1_u64 << 40);
        std::fs::write(&manifest, json.to_string()).expect("writable");
        store.set_milestone(&Name::of_iteration(1), true).expect("marks");
        let mut mark = || {
            std::thread::sleep(Duration::from_millis(2));
            writer.mark_milestone(2).expect("marks");
            store.entry(&Name::of_iteration(2)).expect("there").labels.milestone
        };
        assert!(!mark(), "it looks when the last one was");
        assert!(!mark(), "its stretch begins now");
        assert!(mark());
    }
}
