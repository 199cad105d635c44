//! How often a process has died in a row, and when that is too often.

use std::time::Duration;

use proto::message::WorkerId;

use super::cause::Cause;

/// Crashes of one worker in a row, without a block in between, after which the run is given up.
pub(super) const MAX_CRASHES: u32 = 5;
/// The same for deaths by a signal from outside, which say less.
pub(super) const MAX_KILLS: u32 = 50;
/// First back-off; doubles with every failure in a row.
const BACK_OFF: Duration = Duration::from_millis(50);
/// Who has lived for this long did not die of what killed its predecessors.
const SETTLED: Duration = Duration::from_mins(1);
/// Deaths of a process and its successors in a row, with nothing achieved in between. Those by a
/// signal from outside say less about the program than crashes do, so each kind has its own count.
#[derive(Debug, Clone, Copy, Default)]
pub struct Deaths {
    crashes: u32,
    kills: u32,
}

impl Deaths {
    /// One more.
    pub fn count(&mut self, cause: Cause) {
        match cause {
            Cause::Killed(_) => self.kills += 1,
            Cause::Crash(_) | Cause::SharedMemoryFull | Cause::Hang => self.crashes += 1,
        }
    }

    /// These and one more, of a process that had lived for `lived`.
    pub(super) fn and(self, cause: Cause, lived: Duration) -> Self {
        // Who hangs lives on for as long as silence is borne, which may be longer, and has done nothing.
        let settled = lived > SETTLED && cause != Cause::Hang;
        let mut deaths = if settled { Self::default() } else { self };
        deaths.count(cause);
        deaths
    }

    /// How long a successor waits.
    pub(super) fn back_off(self) -> Duration {
        BACK_OFF * 2_u32.pow(self.total().saturating_sub(1).min(6))
    }

    /// All of them.
    pub fn total(self) -> u32 {
        self.crashes + self.kills
    }

    /// Whether there are as many crashes or as many kills as end a run.
    pub fn are_too_many(self, crashes: u32, kills: u32) -> bool {
        self.crashes >= crashes || self.kills >= kills
    }
}

/// A child that has ended.
#[derive(Debug)]
pub enum Death {
    /// The learner.
    Learner(Cause),
    /// A worker; its slot will start a successor.
    Worker(WorkerId, Cause),
    /// A worker that had been asked to.
    Left(WorkerId),
    /// The gateway, and with it all workers of hosts; it will have a successor.
    Gateway(Cause),
}
