//! Orders on their way: what a full queue has missed is sent again, and at once.
//!
//! Every worker and the learner get all orders and take what is addressed to them. One that is busy
//! reads none of them meanwhile, and its queue may fill up; an order that it misses then is not lost but
//! kept here, until there is room or nobody wants it any more.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use channels::ChannelError;
use channels::OrderSender;
use proto::message::{Order, PortId, WorkerId};

/// Time between two tries: a queue that is full now is so for a while.
const PAUSE: Duration = Duration::from_millis(20);

/// Who takes an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Addressee {
    Learner,
    Worker(WorkerId),
}

impl Addressee {
    /// Of an order; none if it is for all.
    fn of(order: &Order) -> Option<Self> {
        match order {
            Order::Rollout { worker, .. }
            | Order::Audit { worker, .. }
            | Order::Evaluate { worker, .. }
            | Order::Leave { worker, .. } => Some(Self::Worker(*worker)),
            Order::Snapshot | Order::Discard { .. } => Some(Self::Learner),
            _ => None,
        }
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct OrderQueue {
    sender: OrderSender,
    ports: BTreeMap<Addressee, PortId>,
    missed: VecDeque<Order>,
    tried: Instant,
}

impl OrderQueue {
    pub(super) fn new(sender: OrderSender) -> Self {
        let (ports, missed) = (BTreeMap::new(), VecDeque::new());
        Self { sender, ports, missed, tried: Instant::now() }
    }

    /// Where somebody takes orders, who may have taken the place of another. Whether that was not known.
    pub(super) fn introduce(&mut self, addressee: Addressee, port: PortId) -> bool {
        self.ports.insert(addressee, port) != Some(port)
    }

    /// Nobody is left of those who were introduced.
    pub(super) fn forget_all(&mut self) {
        self.ports.clear();
        self.missed.clear();
    }

    /// Sends an order.
    pub(super) fn send(&mut self, order: Order) -> Result<(), ChannelError> {
        let missed = self.sender.send(&order)?;
        let Some(addressee) = Addressee::of(&order) else { return Ok(()) };
        let is_missed = match self.ports.get(&addressee) {
            Some(port) => missed.includes(*port),
            None => !missed.is_nobody(),
        };
        if is_missed {
            tracing::debug!(?order, "there is no room for it");
            self.missed.push_back(order);
        }
        Ok(())
    }

    /// Sends again what was missed and is still wanted; returns how many orders that were.
    pub(super) fn retry(
        &mut self,
        is_wanted: impl Fn(&Order) -> bool,
    ) -> Result<usize, ChannelError> {
        if self.missed.is_empty() || self.tried.elapsed() < PAUSE {
            return Ok(0);
        }
        self.tried = Instant::now();
        let missed = std::mem::take(&mut self.missed);
        let mut sent = 0;
        for order in missed.into_iter().filter(|order| is_wanted(order)) {
            self.send(order)?;
            sent += 1;
        }
        Ok(sent)
    }
}

#[cfg(test)]
mod tests {
    use channels::{ChannelSizes, Channels, Domain};

    use super::*;

    struct TestDomain(Domain);

    impl Drop for TestDomain {
        fn drop(&mut self) {
            let _ = self.0.remove_leftovers();
        }
    }

    fn leave(worker: WorkerId) -> Order {
        Order::Leave { worker, incarnation: 0 }
    }

    #[test]
    fn what_its_addressee_missed_is_sent_again_until_it_has_it_or_nobody_wants_it() {
        let domain = TestDomain(Domain::fresh());
        let sizes = ChannelSizes {
            max_workers: 4,
            block_len: 16,
            policy_len: 16,
            order_buffer: 2,
            block_buffer: 2,
            block_borrowed: 4,
        };
        let channels = Channels::create(&domain.0, sizes).expect("create");
        let mut mail = OrderQueue::new(channels.order_sender().expect("sender"));
        let [quick, busy] = [(); 2].map(|()| channels.order_receiver().expect("receiver"));
        assert!(mail.introduce(Addressee::Worker(0), quick.port()));
        assert!(!mail.introduce(Addressee::Worker(0), quick.port()), "known");
        mail.introduce(Addressee::Worker(1), busy.port());
        let retry = |mail: &mut OrderQueue, wanted: bool| {
            std::thread::sleep(PAUSE);
            mail.retry(|_| wanted).expect("sends")
        };
        // Fills the queue of the busy one; the quick one empties its own.
        for _ in 0..3 {
            mail.send(leave(0)).expect("sends");
            assert_eq!(quick.try_receive().expect("receives"), Some(leave(0)));
        }
        assert_eq!(retry(&mut mail, true), 0, "the one that it is for has each of them");
        mail.send(leave(1)).expect("sends");
        mail.send(Order::Snapshot).expect("sends");
        assert_eq!(retry(&mut mail, true), 2, "nobody knows where the learner is");
        for receiver in [&quick, &busy] {
            while receiver.try_receive().expect("receives").is_some() {}
        }
        assert_eq!(retry(&mut mail, true), 2);
        assert_eq!(busy.try_receive().expect("receives"), Some(leave(1)));
        assert_eq!(retry(&mut mail, true), 0);
        for _ in 0..3 {
            mail.send(leave(1)).expect("sends");
        }
        assert_eq!(retry(&mut mail, false), 0, "nobody wants it any more");
        assert_eq!(retry(&mut mail, true), 0);
    }
}
