//! What no deadline may count: time in which the loop that watches over processes stood still itself.
//!
//! A coordinator that was stopped with Ctrl-Z, whose machine was asleep or whose disk stood still hears
//! nobody meanwhile, and nobody is to blame for that. So the loop looks at the clock once a turn, judges
//! all deadlines by that look, and where the look came late they all move by as much.

use std::time::{Duration, Instant};

/// Longest turn of the loop that is none to speak of.
const ON_TIME: Duration = Duration::from_millis(200);
/// A turn that is worth a word in the log.
pub(crate) const STANDSTILL: Duration = Duration::from_secs(2);

/// When the loop looked at the clock last.
#[derive(Debug)]
pub(crate) struct LoopClock {
    now: Instant,
}

impl LoopClock {
    pub(crate) fn new(now: Instant) -> Self {
        Self { now }
    }

    /// The time by which this turn judges.
    pub(crate) fn now(&self) -> Instant {
        self.now
    }

    /// A turn begins. Returns by how much the deadlines move: never by all of the turn, so that they
    /// also come in a loop that is always slow.
    pub(crate) fn turn(&mut self, now: Instant) -> Duration {
        let turn = now.saturating_duration_since(self.now);
        self.now = now;
        turn.saturating_sub(ON_TIME)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_that_took_long_moves_the_deadlines_and_others_do_not() {
        let begun = Instant::now();
        let mut attention = LoopClock::new(begun);
        let tick = Duration::from_millis(20);
        assert_eq!(attention.turn(begun + tick), Duration::ZERO);
        let stopped = Duration::from_secs(110);
        assert_eq!(attention.turn(begun + tick + stopped), stopped.saturating_sub(ON_TIME));
        assert_eq!(attention.turn(begun + 2 * tick + stopped), Duration::ZERO);
        assert_eq!(attention.now(), begun + 2 * tick + stopped);
    }
}
