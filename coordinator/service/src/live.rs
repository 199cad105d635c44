//! A live run as others see it: what it is doing, and what it can be asked to do.
//!
//! The loop of a run (`session` of the crate `run`) owns every process and channel and answers to nobody's
//! thread but its own. Between it and the HTTP service stands a [`LiveRun`]: the loop writes a
//! [`LiveStatus`] into it a few times a second and takes [`Command`]s out of it on every turn.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use proto::message::Accounting;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;
use utoipa::ToSchema;

use crate::history::{Happening, History, What};

/// What a child process, or the coordinator itself, is to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Owns the run.
    Coordinator,
    /// Trains.
    Learner,
    /// Rolls out.
    Worker,
    /// Carries orders, blocks and policies to other machines and back.
    Gateway,
}

/// Another machine whose workers help a run.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct HostStatus {
    /// Its number in this run.
    pub host: u32,
    /// What it calls itself.
    pub name: String,
    /// Numbers of its workers that take orders.
    pub workers: Vec<u32>,
    /// How many it is to have.
    pub wanted: usize,
    /// How many it can have at most.
    pub max_workers: usize,
    /// Shards that they have been ordered to make, `iteration/shard`.
    pub shards: Vec<String>,
    /// Blocks of it that were made a second time and were the same; it works for the run from the first one on.
    pub compared: u64,
    /// Blocks that came from it.
    pub blocks: u64,
    /// Bytes of these.
    pub bytes: u64,
    /// Pieces of blocks that were waited for and did not come.
    pub missing: u64,
}

/// Another machine that was thrown out, because it made a block with other bits than this one, or none.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct RefusedHost {
    /// What it calls itself.
    pub name: String,
    /// Which block, both digests, and what was trained on.
    pub reason: String,
}

/// One process of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ProcessStatus {
    /// What it does.
    pub role: Role,
    /// Number of the worker.
    pub worker: Option<u32>,
    /// Process id; none while a successor waits for its back-off.
    pub pid: Option<u32>,
    /// `starting`, `ready`, `leaving` or `backing off`.
    pub state: String,
    /// How often it has died and been replaced.
    pub restarts: u32,
    /// Resident memory, shared memory included (bytes).
    pub resident_bytes: u64,
    /// Processor time used so far (s).
    pub cpu_s: f64,
    /// Shards that it has been ordered to make, `iteration/shard`.
    pub shards: Vec<String>,
    /// Env-steps that it has sent.
    pub env_steps: u64,
    /// Time that it spent rolling these out (s).
    pub rollout_s: f64,
}

/// Where a training has diverged, and by what that is seen.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Diverged {
    /// The iteration in which it was first seen.
    pub iteration: u64,
    /// By what.
    pub reason: String,
}

impl std::fmt::Display for Diverged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the training has diverged in iteration {}: {}", self.iteration, self.reason)
    }
}

/// Seconds by stage, summed since this session of the run began.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Stages {
    /// Workers: rolling out the blocks that were trained on, summed over workers.
    pub rollout_s: f64,
    /// Learner: waiting for blocks.
    pub wait_s: f64,
    /// Learner: updating.
    pub update_s: f64,
    /// Learner: publishing policies.
    pub publish_s: f64,
    /// Learner: computing digests.
    pub digest_s: f64,
    /// Learner: copying its state for a snapshot, while training stands still.
    pub copy_s: f64,
    /// Coordinator: committing checkpoints, beside the training.
    pub commit_s: f64,
}

/// Env-steps by fate, summed since this session of the run began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct Totals {
    /// Sent by workers.
    pub produced: u64,
    /// Arrived at the learner in time, or were compared.
    pub received: u64,
    /// Trained on.
    pub trained: u64,
    /// Arrived twice, or were made by other machines for comparison, and dropped.
    pub duplicate: u64,
    /// Died with a process, came when their iteration was over, or from a machine that makes other bits.
    pub lost: u64,
}

impl Totals {
    /// Adds an iteration's.
    pub fn add(&mut self, accounting: &Accounting) {
        self.produced += accounting.produced;
        self.received += accounting.received;
        self.trained += accounting.trained;
        self.duplicate += accounting.duplicate;
        self.lost += accounting.lost;
    }
}

/// What of a run is in the bucket that its checkpoints go to.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct BucketStatus {
    /// Its address.
    pub address: String,
    /// Names of the checkpoints that are here and not there, the newest first.
    pub waiting: Vec<String>,
    /// What keeps them from being sent, if anything does.
    pub trouble: Option<String>,
}

/// The checkpoint with the lowest score.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Best {
    /// Its name.
    pub name: String,
    /// Its score; lower is better, and 1 as good as the paper.
    pub score: f64,
}

/// What a live run is doing.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct LiveStatus {
    /// Its directory.
    #[schema(value_type = String)]
    pub run_dir: PathBuf,
    /// `starting`, `training`, `recovering`, `stopping` or `finishing`; `waiting` where it has no workers until another
    /// machine joins.
    pub state: String,
    /// The task.
    pub task: String,
    /// Iterations trained on.
    pub iterations: u64,
    /// Iterations planned.
    pub planned_iterations: u64,
    /// Env-steps trained on.
    pub env_steps: u64,
    /// Env-steps trained on a second, of late.
    pub env_steps_per_s: f64,
    /// Time since this session of the run began (s).
    pub wall_s: f64,
    /// Time until the budget is used up at the rate of late, or until the time limit if that is sooner (s);
    /// none while nothing is known of the rate, and when only the end is left to be written.
    pub eta_s: Option<f64>,
    /// Workers wanted.
    pub workers: usize,
    /// Fewest workers that the run can be told to have: none, if it is open to other machines.
    pub min_workers: usize,
    /// Most workers that the channels of the run allow.
    pub max_workers: usize,
    /// Coordinator, learner, workers of this machine, and the gateway to others if the run has one.
    pub processes: Vec<ProcessStatus>,
    /// Other machines that help now.
    pub hosts: Vec<HostStatus>,
    /// Other machines that were thrown out, because they make other bits.
    pub refused_hosts: Vec<RefusedHost>,
    /// Shards that nobody has been ordered to make yet.
    pub shards_open: usize,
    /// Shards ordered and not yet at the learner.
    pub shards_in_flight: usize,
    /// Orders sent again since this session began, because their receiver had no room for them.
    pub orders_missed: u64,
    /// Orders sent again since this session began, because nothing had come of them for a whole
    /// `run.order_deadline_s`.
    pub orders_overdue: u64,
    /// Workers replaced since this session began.
    pub worker_restarts: u64,
    /// Learners replaced since this session began.
    pub learner_restarts: u64,
    /// Where the time goes.
    pub stages: Stages,
    /// What became of the env-steps.
    pub accounting: Totals,
    /// Resident memory of all processes, shared memory counted in each (bytes).
    pub resident_bytes: u64,
    /// The run's files in shared memory (bytes).
    pub shared_memory_bytes: u64,
    /// Checkpoints committed since this session began.
    pub commits: u64,
    /// Name of the newest checkpoint.
    pub checkpoint: Option<String>,
    /// The best checkpoint.
    pub best: Option<Best>,
    /// The bucket that its checkpoints go to, too, if there is one.
    #[serde(default)]
    pub bucket: Option<BucketStatus>,
    /// Where the training has diverged, if it has.
    pub divergence: Option<Diverged>,
    /// The last line of the metrics.
    #[schema(value_type = Object)]
    pub last: serde_json::Value,
}

impl LiveStatus {
    /// The host of this name or number. The error says which hosts there are.
    pub fn host(&self, wanted: &str) -> Result<&HostStatus, String> {
        let named: Vec<_> = self.hosts.iter().filter(|host| host.name == wanted).collect();
        let numbered = || self.hosts.iter().find(|host| host.host.to_string() == wanted);
        let all: Vec<_> =
            self.hosts.iter().map(|host| format!("{} ({})", host.host, host.name)).collect();
        match (named.as_slice(), numbered()) {
            ([host], _) => Ok(*host),
            ([], Some(host)) => Ok(host),
            ([], None) if all.is_empty() => {
                Err(format!("no host is called `{wanted}`: no other machine helps this run now"))
            }
            ([], None) => {
                Err(format!("no host is called `{wanted}`; there are {}", all.join(", ")))
            }
            (several, _) => {
                let numbers: Vec<_> = several.iter().map(|host| host.host.to_string()).collect();
                Err(format!(
                    "several hosts are called `{wanted}`: give its number, {}",
                    numbers.join(" or ")
                ))
            }
        }
    }
}

/// What a live run can be asked to do.
#[derive(Debug)]
pub enum Command {
    /// Have this many workers from now on; answers with the number before.
    Scale {
        /// Workers wanted.
        workers: usize,
        /// Where the answer goes.
        reply: oneshot::Sender<Result<usize, String>>,
    },
    /// Have a host have this many workers from now on; answers with the number before.
    ScaleHost {
        /// The host.
        host: u32,
        /// Workers wanted.
        workers: usize,
        /// Where the answer goes.
        reply: oneshot::Sender<Result<usize, String>>,
    },
    /// Commit a checkpoint after the iteration that is being trained on; answers with its name.
    Checkpoint {
        /// Where the answer goes.
        reply: oneshot::Sender<Result<String, String>>,
    },
}

/// The board between a run's loop and everybody else. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct LiveRun(Arc<Mutex<Board>>);

#[derive(Debug, Default)]
struct Board {
    status: LiveStatus,
    /// Told by who sends, not by the loop.
    bucket: Option<BucketStatus>,
    history: History,
    commands: VecDeque<Command>,
    closed: bool,
}

impl LiveRun {
    /// An empty board.
    pub fn new() -> Self {
        Self::default()
    }

    /// What the run is doing.
    pub fn status(&self) -> LiveStatus {
        let board = self.board();
        LiveStatus { bucket: board.bucket.clone(), ..board.status.clone() }
    }

    /// The loop's side: says what it is doing.
    pub fn publish(&self, status: LiveStatus) {
        self.board().status = status;
    }

    /// Says what is in the bucket.
    pub fn tell_bucket(&self, bucket: BucketStatus) {
        self.board().bucket = Some(bucket);
    }

    /// The loop's side: says what has just happened.
    pub fn tell(&self, what: What) {
        self.board().history.tell(what);
    }

    /// What has happened of late, from a number on; the number of what happens next; and the time since the session
    /// began (s).
    pub fn happened(&self, from: u64) -> (Vec<Happening>, u64, f64) {
        self.board().history.since(from)
    }

    /// Asks the run for something. Dropped, and so answered by a closed channel, if it has ended.
    pub fn ask(&self, command: Command) {
        let mut board = self.board();
        if !board.closed {
            board.commands.push_back(command);
        }
    }

    /// The loop's side: takes the oldest command.
    pub fn next_command(&self) -> Option<Command> {
        self.board().commands.pop_front()
    }

    /// The loop's side: no command will be taken any more.
    pub fn close(&self) {
        let mut board = self.board();
        board.closed = true;
        board.commands.clear();
    }

    fn board(&self) -> std::sync::MutexGuard<'_, Board> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
