//! Who does what: a state machine without processes, clocks or channels of its own.
//!
//! The scheduler knows the shards and evaluations that are open, the workers that are ready, and what
//! each of them has been ordered. Any worker may make any shard and making one twice is harmless, so
//! all it has to guarantee is that every shard is ordered until the learner has it. Whose work counts, and what is
//! made for comparison alone, is what `trials` says.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use channels::ORDERS_PER_WORKER;
use proto::message::{EvaluationChunk, HostId, Order, WorkerId, host_of, policy_version_for};

pub use crate::task::{ShardAddress, Task};
use crate::trials::{Standing, Trials};

/// What the scheduler knows of a worker.
#[derive(Debug)]
struct Worker {
    incarnation: u32,
    /// Orders without a result yet, oldest first.
    queue: VecDeque<Task>,
    /// When the oldest order of the queue became the oldest.
    since: Instant,
    /// Gets no further orders.
    leaving: bool,
}

/// What a worker that is no more has left undone.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct UnfinishedWork {
    /// The block that it was busy with.
    pub at_hand: Option<ShardAddress>,
    /// All blocks that it had not delivered, that one included.
    pub undelivered: Vec<ShardAddress>,
}

/// See the module.
#[derive(Debug)]
pub struct Scheduler {
    n_shards: u32,
    overlap: usize,
    /// Iterations trained on; also the newest policy version.
    trained: u64,
    /// Iterations from here on are not ordered.
    end: u64,
    /// Shards that nobody has been ordered to make, first one first.
    pending: BTreeSet<ShardAddress>,
    /// Evaluations that nobody has been ordered to play.
    evaluations: BTreeSet<EvaluationChunk>,
    /// Shards of iterations not yet trained on that the learner has.
    received: BTreeSet<ShardAddress>,
    /// First iteration whose shards are not open yet.
    next_iteration: u64,
    workers: BTreeMap<WorkerId, Worker>,
    trials: Trials,
}

impl Scheduler {
    /// Nothing ordered, `trained` iterations done, none wanted from `end` on.
    pub fn new(n_shards: u32, overlap: usize, trained: u64, end: u64) -> Self {
        Self {
            n_shards,
            overlap,
            trained,
            end,
            pending: BTreeSet::new(),
            evaluations: BTreeSet::new(),
            received: BTreeSet::new(),
            next_iteration: trained,
            workers: BTreeMap::new(),
            trials: Trials::new(0, 0.0),
        }
    }

    /// The same where, in a run of this seed, this share of the blocks of other machines is for comparison.
    #[must_use]
    pub fn with_audits(self, seed: u64, share: f64) -> Self {
        Self { trials: Trials::new(seed, share), ..self }
    }

    /// A worker is up and has no orders.
    pub fn worker_ready(&mut self, worker: WorkerId, incarnation: u32, now: Instant) {
        self.worker_gone(worker);
        let queue = VecDeque::new();
        let ready = Worker { incarnation, queue, since: now, leaving: false };
        self.workers.insert(worker, ready);
    }

    /// Whether this worker is one that gets orders.
    pub fn knows(&self, worker: WorkerId, incarnation: u32) -> bool {
        self.workers.get(&worker).is_some_and(|known| known.incarnation == incarnation)
    }

    /// A worker is no more; its orders are open again.
    pub fn worker_gone(&mut self, worker: WorkerId) -> UnfinishedWork {
        let Some(gone) = self.workers.remove(&worker) else { return UnfinishedWork::default() };
        let mut unfinished = UnfinishedWork::default();
        for (place, task) in gone.queue.into_iter().enumerate() {
            if let Task::Rollout(address) = task
                && self.is_wanted(address)
            {
                unfinished.at_hand = (place == 0).then_some(address).or(unfinished.at_hand);
                unfinished.undelivered.push(address);
            }
            if let (Task::Audit(_), Some(host)) = (task, host_of(worker)) {
                self.trials.begin_again(host);
            }
            self.reopen(task);
        }
        unfinished
    }

    /// A worker shall finish what it is busy with; the rest of its orders is open again.
    pub fn retire(&mut self, worker: WorkerId) {
        let Some(leaving) = self.workers.get_mut(&worker) else { return };
        leaving.leaving = true;
        let rest = leaving.queue.split_off(leaving.queue.len().min(1));
        for task in rest {
            self.reopen(task);
        }
    }

    /// A worker could not make a block; it is open again.
    pub fn give_back(&mut self, worker: WorkerId, address: ShardAddress, now: Instant) {
        if let Some(worker) = self.workers.get_mut(&worker) {
            worker.done(&Task::Rollout(address), now);
        }
        self.reopen(Task::Rollout(address));
    }

    fn reopen(&mut self, task: Task) {
        match task {
            Task::Rollout(address) if self.is_wanted(address) => {
                self.pending.insert(address);
            }
            // What was to be compared has stayed open.
            Task::Rollout(_) | Task::Audit(_) => {}
            Task::Evaluation(chunk) => {
                self.evaluations.insert(chunk);
            }
        }
    }

    /// The learner has a block.
    pub fn block_received(&mut self, address: ShardAddress, now: Instant) {
        if address.0 >= self.trained {
            self.received.insert(address);
        }
        self.pending.remove(&address);
        for worker in self.workers.values_mut() {
            worker.done(&Task::Rollout(address), now);
        }
    }

    /// The learner has dropped a block that it had; it is open again.
    pub fn block_discarded(&mut self, address: ShardAddress) {
        if self.received.remove(&address) {
            self.reopen(Task::Rollout(address));
        }
    }

    /// A worker has made a block for comparison, or cannot.
    pub fn audit_made(&mut self, worker: WorkerId, address: ShardAddress, now: Instant) {
        if let Some(worker) = self.workers.get_mut(&worker) {
            worker.done(&Task::Audit(address), now);
        }
    }

    /// A block of a host was the same as this machine's. Whether the host is trusted only from now on.
    pub fn trust(&mut self, host: HostId) -> bool {
        self.trials.trust(host)
    }

    /// A block of a host could not be compared: if it was its first, another one will be.
    pub fn try_again(&mut self, host: HostId) {
        self.trials.begin_again(host);
    }

    /// Another gateway gives the numbers of hosts to others: nobody is trusted any more.
    pub fn forget_hosts(&mut self) {
        self.trials.forget_hosts();
    }

    /// Whether the work of a worker counts.
    pub fn trusts(&self, worker: WorkerId) -> bool {
        self.trials.standing(worker) == Standing::Trusted
    }

    /// Episodes are to be played, before any further rollout: the policy does not stay for ever.
    pub fn evaluate(&mut self, chunks: impl IntoIterator<Item = EvaluationChunk>) {
        self.evaluations.extend(chunks);
    }

    /// Episodes have been played, or are not wanted any more.
    pub fn evaluation_done(&mut self, chunk: EvaluationChunk, now: Instant) {
        self.evaluations.remove(&chunk);
        for worker in self.workers.values_mut() {
            worker.done(&Task::Evaluation(chunk), now);
        }
    }

    /// The learner has trained on `iteration`.
    pub fn iteration_done(&mut self, iteration: u64) {
        self.trained = iteration + 1;
        let trained = self.trained;
        self.received.retain(|address| address.0 >= trained);
        self.pending.retain(|address| address.0 >= trained);
        self.trials.iterations_done(trained);
    }

    /// Orders no iteration from now on that has not been begun.
    pub fn stop_after_current(&mut self) {
        self.end = self.end.min(self.next_iteration.max(self.trained));
    }

    /// Whether all ordered iterations are trained on and none is to follow.
    pub fn is_finished(&self) -> bool {
        self.trained >= self.end
    }

    /// Shards that nobody has been ordered to make yet.
    pub fn open(&self) -> usize {
        self.pending.len()
    }

    /// Shards ordered, not yet at the learner.
    pub fn in_flight(&self) -> usize {
        let tasks = self.workers.values().flat_map(|worker| &worker.queue);
        tasks.filter(|task| matches!(task, Task::Rollout(_))).count()
    }

    /// Blocks at the learner that it has not trained on.
    pub fn received(&self) -> usize {
        self.received.len()
    }

    /// What a worker has been ordered to do.
    pub fn tasks(&self, worker: WorkerId) -> impl Iterator<Item = &Task> {
        self.workers.get(&worker).into_iter().flat_map(|worker| &worker.queue)
    }

    /// The orders to send now.
    pub fn assign(&mut self, now: Instant) -> Vec<Order> {
        self.open_iterations();
        let mut orders = Vec::new();
        // One order a worker and round: the shards spread evenly however few there are.
        for depth in 0..ORDERS_PER_WORKER {
            let ids: Vec<_> = self.workers.keys().copied().collect();
            for id in ids {
                let worker = &self.workers[&id];
                if worker.leaving || worker.queue.len() > depth {
                    continue;
                }
                let Some(task) = self.next_task(id) else { continue };
                let overlap = self.overlap;
                let Some(worker) = self.workers.get_mut(&id) else { continue };
                if worker.queue.is_empty() {
                    worker.since = now;
                }
                worker.queue.push_back(task);
                orders.push(order(id, worker.incarnation, task, overlap));
            }
        }
        orders
    }

    /// What a worker is to do next, if there is anything for it.
    fn next_task(&mut self, id: WorkerId) -> Option<Task> {
        match (self.trials.standing(id), host_of(id)) {
            (Standing::OnTrial, _) => return None,
            (Standing::Unknown, Some(host)) => {
                let address = *self.pending.first()?;
                self.trials.begin(host);
                return Some(Task::Audit(address));
            }
            (Standing::Unknown, None) | (Standing::Trusted, _) => {}
        }
        if let Some(chunk) = self.evaluations.pop_first() {
            return Some(Task::Evaluation(chunk));
        }
        // Two orders for one block could not be told apart.
        let queue = &self.workers[&id].queue;
        let is_free = |address: &&ShardAddress| !queue.contains(&Task::Audit(**address));
        let address = *self.pending.iter().find(is_free)?;
        if self.trials.takes(id, address) {
            return Some(Task::Audit(address));
        }
        self.pending.remove(&address);
        Some(Task::Rollout(address))
    }

    /// Repeats the orders of workers that have delivered nothing for `deadline`: an order or a
    /// block may have been dropped on the way.
    pub fn repeat_overdue(&mut self, now: Instant, deadline: Duration) -> Vec<Order> {
        let overlap = self.overlap;
        let mut orders = Vec::new();
        for (&id, worker) in &mut self.workers {
            if worker.queue.is_empty() || now.duration_since(worker.since) < deadline {
                continue;
            }
            worker.since = now;
            let repeated =
                worker.queue.iter().map(|task| order(id, worker.incarnation, *task, overlap));
            orders.extend(repeated);
        }
        orders
    }

    /// Nobody could be heard for so long: what is overdue by the clock is so only so much later.
    pub fn postpone_deadlines(&mut self, late: Duration) {
        for worker in self.workers.values_mut() {
            worker.since += late;
        }
    }

    /// Whether an order is still to be carried out by the worker that it was for.
    pub fn awaits(&self, order: &Order) -> bool {
        let (id, incarnation, task) = match order {
            Order::Rollout { worker, incarnation, iteration, shards, .. } => {
                let Some(&shard) = shards.first() else { return false };
                (worker, incarnation, Task::Rollout((*iteration, shard)))
            }
            Order::Audit { worker, incarnation, iteration, shard, .. } => {
                (worker, incarnation, Task::Audit((*iteration, *shard)))
            }
            Order::Evaluate { worker, incarnation, episodes } => {
                (worker, incarnation, Task::Evaluation(*episodes))
            }
            _ => return false,
        };
        let worker = self.workers.get(id).filter(|worker| worker.incarnation == *incarnation);
        worker.is_some_and(|worker| worker.queue.contains(&task))
    }

    /// Opens the shards of every iteration whose policy version exists.
    fn open_iterations(&mut self) {
        while self.next_iteration < self.end
            && policy_version_for(self.next_iteration, self.overlap) <= self.trained
            // Not further than one iteration ahead of the one that is trained on.
            && self.next_iteration <= self.trained + self.overlap as u64
            && self.previous_is_collected()
        {
            let iteration = self.next_iteration;
            self.pending.extend((0..self.n_shards).map(|shard| (iteration, shard)));
            self.next_iteration += 1;
        }
    }

    /// Whether every shard of the iteration before the next one is ordered: an older iteration
    /// always goes first, so that the learner is never short of it.
    fn previous_is_collected(&self) -> bool {
        self.pending.is_empty()
    }

    fn is_wanted(&self, address: ShardAddress) -> bool {
        address.0 >= self.trained && !self.received.contains(&address)
    }
}

impl Worker {
    fn done(&mut self, task: &Task, now: Instant) {
        if self.queue.front() == Some(task) {
            self.since = now;
        }
        self.queue.retain(|queued| queued != task);
    }
}

fn order(worker: WorkerId, incarnation: u32, task: Task, overlap: usize) -> Order {
    match task {
        Task::Rollout((iteration, shard)) => Order::Rollout {
            worker,
            incarnation,
            iteration,
            policy_version: policy_version_for(iteration, overlap),
            shards: vec![shard],
        },
        Task::Audit((iteration, shard)) => Order::Audit {
            worker,
            incarnation,
            iteration,
            policy_version: policy_version_for(iteration, overlap),
            shard,
        },
        Task::Evaluation(episodes) => Order::Evaluate { worker, incarnation, episodes },
    }
}

#[cfg(test)]
mod tests;
