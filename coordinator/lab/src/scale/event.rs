//! What happens when.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Address of a block: iteration and shard.
pub(super) type Shard = (u64, u32);

/// What can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Event {
    /// An order reaches a worker.
    Ordered { worker: usize, shard: Shard },
    /// A worker has made a block.
    Made { worker: usize, shard: Shard },
    /// The first bytes of a block reach the learner's machine.
    Arrives { worker: usize, shard: Shard },
    /// The learner has a block.
    Received { worker: usize, shard: Shard },
    /// An iteration is trained on.
    Trained,
    /// A host has a policy.
    Policy { host: usize, version: u64 },
}

/// Events to come. Those of the same time happen in the order in which they were put down.
#[derive(Debug, Default)]
pub(super) struct Agenda {
    events: BinaryHeap<Entry>,
    put_down: u64,
}

#[derive(Debug)]
struct Entry {
    time: f64,
    number: u64,
    event: Event,
}

impl Agenda {
    /// `event` happens at `time` (s).
    pub(super) fn put(&mut self, time: f64, event: Event) {
        self.events.push(Entry { time, number: self.put_down, event });
        self.put_down += 1;
    }

    /// The next event, and when it is.
    pub(super) fn next(&mut self) -> Option<(f64, Event)> {
        self.events.pop().map(|entry| (entry.time, entry.event))
    }
}

impl Ord for Entry {
    /// The earliest is the greatest: a heap gives that first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.time.total_cmp(&self.time).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Entry {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_come_in_the_order_of_their_times_and_then_of_their_making() {
        let mut agenda = Agenda::default();
        let policy = |version| Event::Policy { host: 0, version };
        agenda.put(2.0, policy(0));
        agenda.put(1.0, policy(1));
        agenda.put(1.0, policy(2));
        let order: Vec<_> = std::iter::from_fn(|| agenda.next()).collect();
        assert_eq!(order, [(1.0, policy(1)), (1.0, policy(2)), (2.0, policy(0))]);
    }
}
