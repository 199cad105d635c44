//! Commits snapshots on a thread of its own: the run's loop never waits for a disk.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use proto::config::Config;

use crate::checkpoint::{CheckpointError, CheckpointStore, Snapshot};

/// The thread and what it has done so far. Dropping it waits for the commits under way.
#[derive(Debug)]
pub struct Committer {
    snapshots: Option<Sender<Snapshot>>,
    results: Receiver<Result<(u64, PathBuf), CheckpointError>>,
    thread: Option<JoinHandle<()>>,
    newest: Option<(u64, PathBuf)>,
}

impl Committer {
    /// Starts the thread.
    pub fn start(
        store: CheckpointStore,
        config: Config,
        robot_toml: String,
        provenance: serde_json::Value,
    ) -> Self {
        let (snapshots, inbox) = channel::<Snapshot>();
        let (outbox, results) = channel();
        let thread = std::thread::spawn(move || {
            for snapshot in inbox {
                let result =
                    store.commit(&snapshot, &config, &robot_toml, &provenance).and_then(|path| {
                        store.prune(config.run.checkpoints_kept)?;
                        Ok((snapshot.iteration, path))
                    });
                if outbox.send(result).is_err() {
                    break;
                }
            }
        });
        Self { snapshots: Some(snapshots), results, thread: Some(thread), newest: None }
    }

    /// Hands a snapshot over.
    pub fn commit(&self, snapshot: Snapshot) {
        if let Some(snapshots) = &self.snapshots {
            // A thread that is gone has left its error in the results.
            let _ = snapshots.send(snapshot);
        }
    }

    /// Takes in what has been done; returns the first failure.
    pub fn failure(&mut self) -> Option<CheckpointError> {
        for result in self.results.try_iter() {
            match result {
                Ok(done) => self.newest = Some(done),
                Err(error) => return Some(error),
            }
        }
        None
    }

    /// Iteration and directory of the newest commit that [`Self::failure`] has seen.
    pub fn newest(&self) -> Option<(u64, PathBuf)> {
        self.newest.clone()
    }
}

impl Drop for Committer {
    fn drop(&mut self) {
        self.snapshots = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
