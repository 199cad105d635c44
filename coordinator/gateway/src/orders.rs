//! Orders on their way to hosts.

use std::collections::BTreeSet;

use proto::message::{EvaluationChunk, Order, WorkerId};

/// One thing that one worker is to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Task {
    /// A block.
    Block {
        /// Its iteration.
        iteration: u64,
        /// Its shard.
        shard: u32,
    },
    /// Episodes of an evaluation.
    Evaluation(EvaluationChunk),
}

impl Task {
    /// Whether a block with this address is what is to be done.
    pub(crate) fn is_block(&self, iteration: u64, shard: u32) -> bool {
        *self == Self::Block { iteration, shard }
    }
}

/// An order of one task for one worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Single {
    /// Who is to do it.
    pub(crate) worker: WorkerId,
    /// Its incarnation.
    pub(crate) incarnation: u32,
    /// What it is to do.
    pub(crate) task: Task,
    /// The policy version to act with.
    pub(crate) policy_version: u64,
}

impl Single {
    /// The tasks of an order; none if it is for all, or for the learner.
    pub(crate) fn all(order: &Order) -> Vec<Self> {
        match order {
            Order::Rollout { worker, incarnation, iteration, policy_version, shards } => {
                let single = |&shard| Self {
                    worker: *worker,
                    incarnation: *incarnation,
                    task: Task::Block { iteration: *iteration, shard },
                    policy_version: *policy_version,
                };
                shards.iter().map(single).collect()
            }
            // What it is for is nothing that its host has to know.
            Order::Audit { worker, incarnation, iteration, policy_version, shard } => vec![Self {
                worker: *worker,
                incarnation: *incarnation,
                task: Task::Block { iteration: *iteration, shard: *shard },
                policy_version: *policy_version,
            }],
            Order::Evaluate { worker, incarnation, episodes } => vec![Self {
                worker: *worker,
                incarnation: *incarnation,
                task: Task::Evaluation(*episodes),
                policy_version: episodes.policy_version,
            }],
            _ => Vec::new(),
        }
    }

    /// What tells it from others.
    pub(crate) fn key(&self) -> (WorkerId, u32, Task) {
        (self.worker, self.incarnation, self.task)
    }

    /// The order.
    pub(crate) fn order(&self) -> Order {
        let Self { worker, incarnation, task, policy_version } = *self;
        match task {
            Task::Block { iteration, shard } => Order::Rollout {
                worker,
                incarnation,
                iteration,
                policy_version,
                shards: vec![shard],
            },
            Task::Evaluation(episodes) => Order::Evaluate { worker, incarnation, episodes },
        }
    }
}

/// What has been asked of hosts and not been answered: an order that comes again is not asked again.
#[derive(Debug, Default)]
pub(crate) struct InFlight(BTreeSet<(WorkerId, u32, Task)>);

impl InFlight {
    /// Notes an order. Whether it is new.
    pub(crate) fn begin(&mut self, order: &Single) -> bool {
        self.0.insert(order.key())
    }

    /// It has been answered, or will not be.
    pub(crate) fn end(&mut self, order: &Single) {
        self.0.remove(&order.key());
    }
}

#[cfg(test)]
mod tests {
    use proto::message::RunEnd;

    use super::*;

    #[test]
    fn an_order_is_its_tasks_and_each_is_asked_once() {
        let order = |shards| Order::Rollout {
            worker: 2001,
            incarnation: 5,
            iteration: 3,
            policy_version: 2,
            shards,
        };
        let singles = Single::all(&order(vec![4, 6]));
        assert_eq!([singles[0].order(), singles[1].order()], [order(vec![4]), order(vec![6])]);
        let episodes = EvaluationChunk { policy_version: 9, first: 16, episodes: 16 };
        let evaluation = Order::Evaluate { worker: 1000, incarnation: 1, episodes };
        assert_eq!(Single::all(&evaluation)[0].order(), evaluation);
        assert_eq!(
            (Single::all(&Order::Stop(RunEnd::Over)), Single::all(&Order::Snapshot)),
            (vec![], vec![])
        );
        let mut in_flight = InFlight::default();
        assert!(in_flight.begin(&singles[0]) && in_flight.begin(&singles[1]));
        assert!(!in_flight.begin(&singles[0]));
        in_flight.end(&singles[0]);
        assert!(in_flight.begin(&singles[0]));
    }
}
