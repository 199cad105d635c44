//! What the workers of this machine have been asked to do: no network, clock or channel of its own.
//!
//! A worker that dies is replaced by `octopus join`; its successor is sent what it had left undone. The run hears
//! nothing of that, but that it takes longer.

use std::collections::BTreeMap;

use proto::message::PortId;

use crate::orders::{Single, Task};

/// A worker that has been ready.
#[derive(Debug)]
struct Worker {
    incarnation: u32,
    orders: PortId,
}

/// An order, and the question to be answered with what comes of it.
#[derive(Debug)]
struct Open<Q> {
    policy_version: u64,
    question: Q,
    /// The incarnation that it was sent to.
    sent: Option<u32>,
}

/// See the module. `Q` is a question of the run.
#[derive(Debug)]
pub(super) struct Workers<Q> {
    known: BTreeMap<u32, Worker>,
    /// Incarnations of those that were sent home.
    gone: BTreeMap<u32, u32>,
    open: BTreeMap<(u32, Task), Open<Q>>,
}

impl<Q> Default for Workers<Q> {
    fn default() -> Self {
        Self { known: BTreeMap::new(), gone: BTreeMap::new(), open: BTreeMap::new() }
    }
}

impl<Q> Workers<Q> {
    /// A worker says that it is there. Whether the run does not know that yet.
    pub(super) fn lives(&mut self, worker: u32, incarnation: u32, orders: PortId) -> bool {
        if self.gone.get(&worker).is_some_and(|gone| *gone >= incarnation) {
            return false;
        }
        match self.known.get(&worker) {
            // A late word of the dead.
            Some(known) if known.incarnation > incarnation => false,
            known => {
                let is_new = known.is_none();
                self.known.insert(worker, Worker { incarnation, orders });
                is_new
            }
        }
    }

    /// A worker is sent home. Whether the run has it.
    pub(super) fn leaves(&mut self, worker: u32, incarnation: u32) -> bool {
        self.gone.insert(worker, incarnation);
        self.known.remove(&worker).is_some()
    }

    /// Nobody waits for what a worker was to do.
    pub(super) fn forget(&mut self, worker: u32) {
        self.open.retain(|(of, _), _| *of != worker);
    }

    /// Numbers of the workers that have been ready.
    pub(super) fn numbers(&self) -> Vec<u32> {
        self.known.keys().copied().collect()
    }

    /// The run wants something done. What is being done already is not begun again, and answers this question.
    pub(super) fn ordered(&mut self, order: Single, question: Q) {
        let Single { worker, task, policy_version, .. } = order;
        let sent = self.open.remove(&(worker, task)).and_then(|before| before.sent);
        self.open.insert((worker, task), Open { policy_version, question, sent });
    }

    /// Orders to send now, and where: all that those who are there now have not been sent.
    pub(super) fn unsent(&mut self) -> Vec<(Single, PortId)> {
        let mut orders = Vec::new();
        for (&(worker, task), open) in &mut self.open {
            let Some(&Worker { incarnation, orders: port }) = self.known.get(&worker) else {
                continue;
            };
            if open.sent != Some(incarnation) {
                open.sent = Some(incarnation);
                let policy_version = open.policy_version;
                orders.push((Single { worker, incarnation, task, policy_version }, port));
            }
        }
        orders
    }

    /// An order found no room, and is to be sent again.
    pub(super) fn missed(&mut self, order: &Single) {
        if let Some(open) = self.open.get_mut(&(order.worker, order.task)) {
            open.sent = None;
        }
    }

    /// Something has been done. The question that it answers, if one is open.
    pub(super) fn done(&mut self, worker: u32, task: Task) -> Option<Q> {
        self.open.remove(&(worker, task)).map(|open| open.question)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(worker: u32, shard: u32) -> Single {
        let task = Task::Block { iteration: 0, shard };
        Single { worker, incarnation: 77, task, policy_version: 0 }
    }

    /// Worker, incarnation, and shard of what is to be sent.
    fn sent(workers: &mut Workers<&str>) -> Vec<(u32, u32, Task)> {
        let orders = workers.unsent().into_iter();
        orders.map(|(order, _)| (order.worker, order.incarnation, order.task)).collect()
    }

    #[test]
    fn a_successor_is_sent_what_its_predecessor_left_undone() {
        let mut workers = Workers::default();
        let (first, second) = (order(0, 1), order(0, 2));
        workers.ordered(first, "one");
        assert!(sent(&mut workers).is_empty(), "nobody is there");
        assert!(workers.lives(0, 0, 5) && !workers.lives(0, 0, 5));
        workers.ordered(second, "two");
        assert_eq!(sent(&mut workers), [(0, 0, first.task), (0, 0, second.task)]);
        assert!(sent(&mut workers).is_empty());
        assert_eq!(workers.done(0, first.task), Some("one"));
        assert!(!workers.lives(0, 1, 6), "for the run it is the same");
        assert!(!workers.lives(0, 0, 5), "a late word");
        assert_eq!(workers.unsent(), [(Single { incarnation: 1, ..second }, 6)]);
        workers.missed(&second);
        assert_eq!(sent(&mut workers), [(0, 1, second.task)]);
        assert_eq!(
            (workers.done(0, second.task), workers.done(0, second.task)),
            (Some("two"), None)
        );
    }

    #[test]
    fn an_order_that_comes_again_is_not_begun_again_and_the_last_question_is_answered() {
        let mut workers = Workers::default();
        workers.lives(3, 0, 1);
        workers.ordered(order(3, 0), "lost with its link");
        assert_eq!(sent(&mut workers).len(), 1);
        workers.ordered(order(3, 0), "asked again");
        assert!(sent(&mut workers).is_empty());
        assert_eq!(workers.done(3, order(3, 0).task), Some("asked again"));
        assert_eq!(workers.numbers(), [3]);
    }

    #[test]
    fn one_that_is_sent_home_is_none_any_more_but_its_number_may_come_back() {
        let mut workers = Workers::default();
        workers.lives(0, 0, 1);
        workers.lives(1, 4, 2);
        workers.ordered(order(1, 0), "open");
        assert!(workers.leaves(1, 4) && !workers.leaves(1, 4));
        workers.forget(1);
        assert!(!workers.lives(1, 4, 2), "a late word");
        assert_eq!((workers.numbers(), workers.unsent()), (vec![0], vec![]));
        assert!(workers.lives(1, 5, 3));
        assert_eq!(workers.numbers(), [0, 1]);
    }
}
