//! Places for connections: bounded, and never all kept from those who wait.
//!
//! A client that has not shown the token has its place only until somebody else needs one, the one
//! that came first goes first: nobody who may ask needs more than a moment to show it. A client that
//! has shown it keeps its place, but for [`Limits::connection_time`] only while others wait.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use super::limits::Limits;

/// A connection's place. Clones are the same place.
#[derive(Debug, Clone)]
pub(super) struct ConnectionSlot(Arc<Place>);

#[derive(Debug)]
struct Place {
    since: Instant,
    /// Whether it has shown the token.
    proven: AtomicBool,
    leave: Notify,
}

impl ConnectionSlot {
    /// The client has shown the token.
    pub(super) fn prove(&self) {
        self.0.proven.store(true, Ordering::Relaxed);
    }

    /// Waits until the place is needed for another.
    pub(super) async fn called_for(&self) {
        self.0.leave.notified().await;
    }
}

/// All places.
#[derive(Debug)]
pub(super) struct ConnectionSlots {
    most: usize,
    time: Duration,
    taken: Mutex<Taken>,
    freed: Notify,
}

#[derive(Debug, Default)]
struct Taken {
    /// By the order in which they came.
    seats: BTreeMap<u64, ConnectionSlot>,
    count: u64,
}

/// A place that is free again when this is dropped.
#[derive(Debug)]
pub(super) struct Held {
    seats: Arc<ConnectionSlots>,
    number: u64,
    seat: ConnectionSlot,
}

impl Held {
    pub(super) fn seat(&self) -> &ConnectionSlot {
        &self.seat
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.seats.taken().seats.remove(&self.number);
        self.seats.freed.notify_one();
    }
}

impl ConnectionSlots {
    pub(super) fn new(limits: &Limits) -> Arc<Self> {
        Arc::new(Self {
            most: limits.connections,
            time: limits.connection_time,
            taken: Mutex::default(),
            freed: Notify::new(),
        })
    }

    /// Takes a place, as soon as there is one.
    pub(super) async fn take(self: &Arc<Self>) -> Held {
        loop {
            let wait = match self.try_take() {
                Ok(held) => return held,
                Err(wait) => wait,
            };
            // Whoever was told to leave may take a moment.
            let _ = tokio::time::timeout(wait, self.freed.notified()).await;
        }
    }

    /// Takes a place if there is one. If not, tells somebody to leave, and returns how long to wait
    /// for that at most.
    fn try_take(self: &Arc<Self>) -> Result<Held, Duration> {
        let mut taken = self.taken();
        if taken.seats.len() >= self.most {
            let unproven = |seat: &&ConnectionSlot| !seat.0.proven.load(Ordering::Relaxed);
            let oldest = taken.seats.values().next();
            let left =
                oldest.map_or(self.time, |seat| self.time.saturating_sub(seat.0.since.elapsed()));
            let leaving = match taken.seats.values().find(unproven) {
                None => oldest.filter(|_| left.is_zero()),
                stranger => stranger,
            };
            return Err(match leaving {
                Some(seat) => {
                    seat.0.leave.notify_one();
                    Duration::from_secs(1)
                }
                None => left,
            });
        }
        let place =
            Place { since: Instant::now(), proven: AtomicBool::new(false), leave: Notify::new() };
        let (number, seat) = (taken.count, ConnectionSlot(Arc::new(place)));
        taken.count += 1;
        taken.seats.insert(number, seat.clone());
        Ok(Held { seats: Arc::clone(self), number, seat })
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seats(connections: usize, time: Duration) -> Arc<ConnectionSlots> {
        ConnectionSlots::new(&Limits { connections, connection_time: time, ..Limits::default() })
    }

    /// Whether somebody has been told to leave this place.
    async fn is_called_for(held: &Held) -> bool {
        let wait = Duration::from_millis(1);
        tokio::time::timeout(wait, held.seat().called_for()).await.is_ok()
    }

    #[tokio::test]
    async fn who_has_shown_no_token_makes_room_and_the_oldest_first() {
        let seats = seats(3, Duration::from_hours(1));
        let known = seats.take().await;
        known.seat().prove();
        let (first, second) = (seats.take().await, seats.take().await);
        seats.try_take().expect_err("all are taken");
        assert!(!is_called_for(&known).await);
        assert!(is_called_for(&first).await);
        assert!(!is_called_for(&second).await);
        drop(first);
        let third = seats.take().await;
        // Nobody here is a stranger, or has been here for an hour.
        second.seat().prove();
        third.seat().prove();
        let wait = seats.try_take().expect_err("all are taken");
        assert!(wait > Duration::from_mins(59));
        for held in [&known, &second, &third] {
            assert!(!is_called_for(held).await);
        }
    }

    #[tokio::test]
    async fn who_has_shown_the_token_makes_room_after_a_time() {
        let seats = seats(2, Duration::from_millis(50));
        let (first, second) = (seats.take().await, seats.take().await);
        for held in [&first, &second] {
            held.seat().prove();
        }
        let next = tokio::spawn({
            let seats = Arc::clone(&seats);
            async move { drop(seats.take().await) }
        });
        first.seat().called_for().await;
        assert!(!is_called_for(&second).await, "one place is enough");
        drop(first);
        next.await.expect("gets a place");
    }
}
