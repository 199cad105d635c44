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
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn addresses(orders: &[Order]) -> Vec<(WorkerId, u64, u32)> {
        orders
            .iter()
            .map(|order| match order {
                Order::Rollout { worker, iteration, shards, .. } => {
                    (*worker, *iteration, shards[0])
                }
                other => panic!("{other:?} is no rollout"),
            })
            .collect()
    }

    /// Delivers everything that is ordered, until the scheduler has nothing more to order.
    fn deliver_all(scheduler: &mut Scheduler, now: Instant) -> Vec<(WorkerId, u64, u32)> {
        let mut all = Vec::new();
        loop {
            let orders = addresses(&scheduler.assign(now));
            if orders.is_empty() {
                return all;
            }
            for (_, iteration, shard) in &orders {
                scheduler.block_received((*iteration, *shard), now);
            }
            all.extend(orders);
        }
    }

    #[test]
    fn shards_spread_evenly_and_no_worker_gets_more_than_two() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(5, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.worker_ready(1, 0, now);
        let orders = addresses(&scheduler.assign(now));
        assert_eq!(orders, [(0, 0, 0), (1, 0, 1), (0, 0, 2), (1, 0, 3)]);
        assert!(scheduler.assign(now).is_empty(), "both are full");
        scheduler.block_received((0, 1), now);
        assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 4)]);
    }

    #[test]
    fn without_overlap_the_next_iteration_waits_for_the_training() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(3, 0, 0, 2);
        scheduler.worker_ready(0, 0, now);
        assert_eq!(deliver_all(&mut scheduler, now).len(), 3);
        scheduler.iteration_done(0);
        assert!(deliver_all(&mut scheduler, now).iter().all(|(_, iteration, _)| *iteration == 1));
        scheduler.iteration_done(1);
        assert!(scheduler.is_finished());
    }

    #[test]
    fn with_overlap_one_iteration_runs_ahead_with_the_policy_before() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(2, 1, 0, 9);
        scheduler.worker_ready(0, 0, now);
        let all = deliver_all(&mut scheduler, now);
        let iterations: Vec<u64> = all.iter().map(|(_, iteration, _)| *iteration).collect();
        assert_eq!(iterations, [0, 0, 1, 1], "1 is rolled out while 0 is trained on, 2 is not");
        scheduler.iteration_done(0);
        let orders = scheduler.assign(now);
        assert!(
            orders.iter().all(|order| matches!(
                order,
                Order::Rollout { iteration: 2, policy_version: 1, .. }
            ))
        );
    }

    #[test]
    fn what_a_dead_worker_had_is_ordered_again_unless_the_learner_has_it() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(2, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.assign(now);
        scheduler.block_received((0, 0), now);
        let unfinished = UnfinishedWork { at_hand: Some((0, 1)), undelivered: vec![(0, 1)] };
        assert_eq!(scheduler.worker_gone(0), unfinished);
        scheduler.worker_ready(0, 1, now);
        let orders = scheduler.assign(now);
        assert_eq!(addresses(&orders), [(0, 0, 1)]);
        assert!(matches!(orders[0], Order::Rollout { incarnation: 1, .. }));
        assert_eq!(scheduler.in_flight(), 1);
    }

    #[test]
    fn a_silent_worker_is_reminded_once_a_deadline() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(1, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        let first = scheduler.assign(now);
        assert!(scheduler.repeat_overdue(now + SECOND, 2 * SECOND).is_empty());
        assert_eq!(scheduler.repeat_overdue(now + 2 * SECOND, 2 * SECOND), first);
        assert!(scheduler.repeat_overdue(now + 3 * SECOND, 2 * SECOND).is_empty());
    }

    #[test]
    fn time_in_which_nobody_was_heard_makes_no_order_overdue() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(1, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.assign(now);
        let stopped = Duration::from_secs(110);
        scheduler.postpone_deadlines(stopped);
        assert_eq!(scheduler.repeat_overdue(now + stopped + SECOND, 2 * SECOND), []);
        assert_eq!(scheduler.repeat_overdue(now + stopped + 2 * SECOND, 2 * SECOND).len(), 1);
    }

    #[test]
    fn an_order_is_awaited_until_its_worker_has_delivered_or_is_another_one() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(2, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        let orders = scheduler.assign(now);
        assert!(orders.iter().all(|order| scheduler.awaits(order)));
        scheduler.block_received((0, 0), now);
        assert!(!scheduler.awaits(&orders[0]) && scheduler.awaits(&orders[1]));
        scheduler.worker_ready(0, 1, now);
        scheduler.assign(now);
        assert!(!scheduler.awaits(&orders[1]), "for the one before");
    }

    #[test]
    fn a_stop_finishes_what_is_begun_and_begins_nothing() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(2, 0, 0, 100);
        scheduler.worker_ready(0, 0, now);
        scheduler.assign(now);
        scheduler.stop_after_current();
        assert!(!scheduler.is_finished());
        deliver_all(&mut scheduler, now);
        scheduler.block_received((0, 0), now);
        scheduler.block_received((0, 1), now);
        scheduler.iteration_done(0);
        assert!(scheduler.is_finished());
        assert!(scheduler.assign(now).is_empty());
    }

    #[test]
    fn a_leaving_worker_finishes_what_is_at_hand_and_gets_no_more() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(3, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.worker_ready(1, 0, now);
        scheduler.assign(now);
        scheduler.retire(0);
        let tasks: Vec<_> = scheduler.tasks(0).copied().collect();
        assert_eq!(tasks, [Task::Rollout((0, 0))], "its second order is open again");
        scheduler.block_received((0, 1), now);
        assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 2)]);
        assert_eq!(scheduler.worker_gone(0).undelivered, [(0, 0)]);
        scheduler.block_received((0, 2), now);
        assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 0)]);
    }

    #[test]
    fn evaluations_go_first_and_outlive_their_worker() {
        let now = Instant::now();
        let chunk = EvaluationChunk { policy_version: 0, first: 0, episodes: 16 };
        let mut scheduler = Scheduler::new(1, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.evaluate([chunk]);
        let orders = scheduler.assign(now);
        assert_eq!(orders[0], Order::Evaluate { worker: 0, incarnation: 0, episodes: chunk });
        assert_eq!(scheduler.worker_gone(0).at_hand, None);
        scheduler.worker_ready(1, 0, now);
        assert!(matches!(scheduler.assign(now)[0], Order::Evaluate { worker: 1, .. }));
        scheduler.evaluation_done(chunk, now);
        assert_eq!(scheduler.tasks(1).count(), 1, "the shard is left");
    }

    #[test]
    fn a_block_that_cannot_be_made_is_open_again() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(1, 0, 0, 1);
        scheduler.worker_ready(0, 0, now);
        scheduler.assign(now);
        scheduler.give_back(0, (0, 0), now);
        assert_eq!((scheduler.open(), scheduler.in_flight()), (1, 0));
        assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 0)]);
    }

    #[test]
    fn a_host_makes_one_block_for_comparison_before_it_is_given_work() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(3, 0, 0, 1).with_audits(1, 0.0);
        let chunk = EvaluationChunk { policy_version: 0, first: 0, episodes: 16 };
        scheduler.evaluate([chunk]);
        for worker in [2000, 2001] {
            scheduler.worker_ready(worker, 9, now);
        }
        let audit = |worker| Order::Audit {
            worker,
            incarnation: 9,
            iteration: 0,
            policy_version: 0,
            shard: 0,
        };
        assert_eq!(scheduler.assign(now), [audit(2000)]);
        assert!(scheduler.awaits(&audit(2000)) && !scheduler.trusts(2001));
        // Its worker is lost: another one makes it.
        assert_eq!(scheduler.worker_gone(2000).undelivered, []);
        assert_eq!(scheduler.assign(now), [audit(2001)]);
        scheduler.audit_made(2001, (0, 0), now);
        assert!(scheduler.assign(now).is_empty(), "it is being compared");
        // This machine cannot tell: once more.
        scheduler.try_again(2);
        assert_eq!(scheduler.assign(now), [audit(2001)]);
        scheduler.audit_made(2001, (0, 0), now);
        assert!(scheduler.trust(2) && scheduler.trusts(2000));
        let orders = scheduler.assign(now);
        assert!(matches!(orders[0], Order::Evaluate { worker: 2001, .. }));
        assert_eq!(addresses(&orders[1..]), [(2001, 0, 0)], "the block that was compared is open");
    }

    #[test]
    fn what_is_compared_stays_open_and_is_not_given_to_the_same_worker_meanwhile() {
        let now = Instant::now();
        let mut scheduler = Scheduler::new(2, 0, 0, 1).with_audits(1, 1.0);
        scheduler.worker_ready(1000, 1, now);
        scheduler.trust(1);
        let audits = scheduler.assign(now);
        assert!(audits.iter().all(|order| matches!(order, Order::Audit { worker: 1000, .. })));
        assert_eq!((audits.len(), scheduler.open()), (2, 2));
        scheduler.worker_ready(0, 0, now);
        assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 0), (0, 0, 1)]);
        scheduler.block_received((0, 0), now);
        scheduler.block_received((0, 1), now);
        assert_eq!(scheduler.tasks(1000).count(), 2, "it is compared all the same");
        // One of them turns out to have come from a machine that makes other bits.
        scheduler.block_discarded((0, 1));
        assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 1)]);
    }
}
