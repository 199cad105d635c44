//! The thread that sends what a run commits.
//!
//! It looks at the run's own store, like any other program, once a second: the training knows nothing of it and never
//! waits. What cannot be sent stays where it is and is tried again, later and later up to a minute; a run that is
//! resumed goes on with what is left. Of several the newest goes first: it is the one to resume from.
//!
//! A checkpoint that the store's retention removes before it was sent is not sent any more; its successors are.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use proto::run_dir::RunDir;
use store::checkpoint::{CATALOGUE, CheckpointStore, Entry, Name};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::owner::Lease;
use crate::sent::{Sent, own};

/// How often the store is looked at.
const LOOK: Duration = Duration::from_secs(1);
/// How long to wait after the first failure; twice as long after each other one.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// And at most.
const LONGEST_PAUSE: Duration = Duration::from_mins(1);

/// What is asked of the thread: to send everything now, and to say how many checkpoints it could not send.
type Finish = Sender<usize>;

/// Who hears which checkpoints are not in the bucket, the newest first, and what keeps them from being sent.
pub type Listener = Box<dyn Fn(&[Name], Option<&str>) + Send>;

/// The thread.
#[derive(Debug)]
pub struct Mirror {
    orders: Option<Sender<Finish>>,
    thread: Option<JoinHandle<()>>,
}

impl Mirror {
    /// Starts to send what the run in `run_dir` commits to the bucket at `address`; `listener` hears how far it is.
    ///
    /// # Errors
    /// If the address cannot be one, or what was sent before cannot be read. Whether the bucket is there shows later.
    pub fn start(address: &str, run_dir: &RunDir, listener: Listener) -> Result<Self, BucketError> {
        let bucket = Bucket::open(address)?;
        let mut sent = Sent::of(run_dir, address)?;
        // What was in the way of a session before may be gone, and is said again if it is not.
        sent.trouble = None;
        sent.write(run_dir)?;
        let store = CheckpointStore::new(run_dir.checkpoints());
        let lease = Lease::new(sent.run());
        let mut sender = Sending {
            bucket,
            run_dir: run_dir.clone(),
            store,
            lease,
            sent,
            claimed: false,
            given_up: false,
            seen: None,
            pause: Duration::ZERO,
            next: None,
            set_aside: BTreeMap::new(),
            unreadable_labels: None,
            listener,
        };
        sender.tell();
        let (orders, inbox) = channel();
        let thread = std::thread::Builder::new()
            .name("bucket".to_owned())
            .spawn(move || sender.run(&inbox))
            .map_err(|error| BucketError::File(format!("no thread: {error}")))?;
        Ok(Self { orders: Some(orders), thread: Some(thread) })
    }

    /// Has everything sent that can be, for as long as `patience` at most and while `goes_on`; returns how many
    /// checkpoints are left, if the thread has come to say so.
    pub fn finish(mut self, patience: Duration, goes_on: impl Fn() -> bool) -> Option<usize> {
        let (reply, answer) = channel();
        let begun = Instant::now();
        self.orders.take()?.send(reply).ok()?;
        while begun.elapsed() < patience && goes_on() {
            match answer.recv_timeout(Duration::from_millis(50)) {
                Ok(left) => {
                    if let Some(thread) = self.thread.take() {
                        // It has nothing else to do; a panic was its own.
                        let _ = thread.join();
                    }
                    return Some(left);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
        // Left to itself: what it is sending has no manifest yet, and so is nothing.
        None
    }
}

/// When the store was last changed, as far as a look from outside tells.
type Seen = Vec<(PathBuf, Option<SystemTime>)>;

/// What the thread owns.
struct Sending {
    bucket: Bucket,
    run_dir: RunDir,
    store: CheckpointStore,
    lease: Lease,
    sent: Sent,
    /// Whether the prefix is this session's.
    claimed: bool,
    /// The prefix is somebody else's for good.
    given_up: bool,
    /// The store as it was when there was nothing to send.
    seen: Option<Seen>,
    pause: Duration,
    /// When to try again, after a failure.
    next: Option<Instant>,
    /// Checkpoints whose own files were in the way: when each may be tried again, and what is wrong with it.
    set_aside: BTreeMap<Name, (Instant, String)>,
    /// What is wrong with labels in the bucket that are in the way of those from here.
    unreadable_labels: Option<String>,
    listener: Listener,
}

impl Sending {
    fn run(&mut self, inbox: &Receiver<Finish>) {
        loop {
            match inbox.recv_timeout(LOOK) {
                Ok(reply) => {
                    // Once more, however long ago the last attempt was.
                    self.next = None;
                    self.seen = None;
                    self.set_aside.clear();
                    self.look();
                    // Nobody waits any more if that took too long.
                    let _ = reply.send(self.left());
                    return;
                }
                Err(RecvTimeoutError::Timeout) => self.look(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Checkpoints that are not in the bucket.
    fn left(&self) -> usize {
        own(&self.store).map_or(0, |own| self.sent.waiting(&own).len())
    }

    /// Says how far it is. A store that cannot be read shows elsewhere.
    fn tell(&self) {
        if let Ok(own) = own(&self.store) {
            (self.listener)(&self.sent.waiting(&own), self.sent.trouble.as_deref());
        }
    }

    /// Sends what is new, if it is time.
    fn look(&mut self) {
        if self.given_up || self.next.is_some_and(|next| Instant::now() < next) {
            return;
        }
        let seen = self.stamp();
        if self.seen.as_ref() == Some(&seen) {
            return;
        }
        if let Err(error) = self.send_all() {
            self.trouble(&error);
            self.pause = (2 * self.pause).clamp(FIRST_PAUSE, LONGEST_PAUSE);
            self.next = Some(Instant::now() + self.pause);
            return;
        }
        self.seen = Some(seen);
        self.pause = Duration::ZERO;
        self.next = None;
        if let Some((_, (_, why))) = self.set_aside.last_key_value() {
            let then = "it is passed over until it can be, and the run goes on";
            self.warn("not all checkpoints are sent", why.clone(), then);
        } else if let Some(why) = &self.unreadable_labels {
            let then = "checkpoints and other labels are sent";
            self.warn("not all labels are sent", why.clone(), then);
        } else if self.sent.trouble.take().is_some() {
            self.remember();
            self.tell();
            tracing::warn!("{}: all is in the bucket again", self.bucket.address());
        }
    }

    /// Sends the newest checkpoint that is not in the bucket, until there is none, and labels that have changed. One whose own files are in the way is
    /// set aside for a while.
    fn send_all(&mut self) -> Result<(), BucketError> {
        let now = Instant::now();
        self.set_aside.retain(|_, (until, _)| now < *until);
        loop {
            let entries = own(&self.store)?;
            self.sent.keep(&entries);
            self.set_aside.retain(|name, _| entries.iter().any(|entry| entry.name == *name));
            let waiting = self.sent.waiting(&entries);
            (self.listener)(&waiting, self.sent.trouble.as_deref());
            let is_due = |name: &Name| !self.set_aside.contains_key(name);
            let Some(name) = waiting.into_iter().find(is_due) else {
                return self.send_labels(&entries);
            };
            self.claim()?;
            let dir = self.store.dir(&name);
            let (bucket, places) = (&self.bucket, (&*dir, &self.run_dir));
            let damaged = self.sent.is_damaged(&name);
            let sent = bucket.wait(bucket.send(&self.lease, &name, places, damaged));
            match sent {
                Ok(()) => {}
                // Retention was faster.
                Err(_) if !dir.exists() => continue,
                Err(error) if error.is_local() => {
                    let until = Instant::now() + LONGEST_PAUSE;
                    self.set_aside.insert(name, (until, error.to_string()));
                    continue;
                }
                Err(error) => return Err(error),
            }
            let Some(entry) = entries.iter().find(|entry| entry.name == name) else { continue };
            // Labels come after it.
            self.sent.add(name, entry.digest, &store::checkpoint::Labels::default());
            self.remember();
        }
    }

    /// Sends labels that have changed. Those that cannot be read in the bucket stay as they are: what others have said
    /// there may be in them.
    fn send_labels(&mut self, entries: &[Entry]) -> Result<(), BucketError> {
        self.unreadable_labels = None;
        for entry in entries {
            let before = self.sent.labels(&entry.name).cloned().unwrap_or_default();
            if !self.sent.has(entry) || before == entry.labels {
                continue;
            }
            self.claim()?;
            let bucket = &self.bucket;
            match bucket.wait(bucket.send_labels(&entry.name, &before, &entry.labels)) {
                Ok(()) => {}
                Err(error @ BucketError::Damaged { .. }) => {
                    self.unreadable_labels = Some(error.to_string());
                    continue;
                }
                Err(error) => return Err(error),
            }
            self.sent.add(entry.name.clone(), entry.digest, &entry.labels);
            self.remember();
        }
        Ok(())
    }

    fn claim(&mut self) -> Result<(), BucketError> {
        if !self.claimed {
            self.bucket.wait(self.bucket.claim(&self.lease))?;
            self.claimed = true;
        }
        Ok(())
    }

    /// Says what is wrong with the bucket, once.
    fn trouble(&mut self, error: &BucketError) {
        self.given_up = error.is_final();
        let then = if self.given_up {
            "none is sent any more; the run goes on, and keeps its checkpoints here"
        } else {
            "the run goes on, and sends them when that is over"
        };
        self.warn("checkpoints are not sent", error.to_string(), then);
    }

    fn warn(&mut self, what: &str, told: String, then: &str) {
        if self.sent.trouble.as_ref() != Some(&told) {
            tracing::warn!("{what} to the bucket: {told}; {then}");
            self.sent.trouble = Some(told);
            self.remember();
            self.tell();
        }
    }

    /// What is lost of this is sent once more, or found there.
    fn remember(&self) {
        if let Err(error) = self.sent.write(&self.run_dir) {
            tracing::warn!(%error, "what is in the bucket could not be written down");
        }
    }

    /// Every change of a store changes its directory or its catalogue.
    fn stamp(&self) -> Seen {
        let root = self.store.root();
        let catalogue = |suffix: &str| root.join(format!("{CATALOGUE}{suffix}"));
        [root.to_owned(), catalogue(""), catalogue("-wal")]
            .map(|path| {
                let changed = fs::metadata(&path).and_then(|there| there.modified()).ok();
                (path, changed)
            })
            .into()
    }
}
