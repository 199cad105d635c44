//! How long processes may take, and with how large a state.

use std::time::Duration;

/// How long a learner or worker may take at least until it is ready, however short the deadline is
/// for one that has been heard.
pub(crate) const START_DEADLINE: Duration = Duration::from_secs(10);

/// How long the end of a run may take at least without a step: from the request of the last snapshot to the committed checkpoint, and
/// then from one piece of its evaluation to the next.
const FINISH_DEADLINE: Duration = Duration::from_mins(5);

/// Bytes of its training state that a learner gets through in a second at least while it starts, where it reads, restores,
/// copies and hashes them before it can say a word, and while the last of them are written.
const STATE_RATE: u64 = 10_000_000;

/// How long a learner with a state of so many bytes may take until it is ready, where one that is ready may be silent for
/// `deadline`.
pub(crate) fn learner_start_deadline(deadline: Duration, state: u64) -> Duration {
    deadline.max(START_DEADLINE) + Duration::from_secs(state / STATE_RATE)
}

/// How long the end of a run with a state of so many bytes may take without a step.
pub(crate) fn finish_deadline(state: u64) -> Duration {
    FINISH_DEADLINE + Duration::from_secs(state / STATE_RATE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A learner with a large replay was killed as it started, and so were all that took its place.
    #[test]
    fn a_large_state_has_time_to_be_read() {
        let minute = Duration::from_mins(1);
        assert_eq!(learner_start_deadline(Duration::from_secs(2), 400_000), START_DEADLINE);
        assert_eq!(learner_start_deadline(minute, 400_000), minute);
        assert_eq!(learner_start_deadline(minute, 6_000_000_000), 11 * minute);
        assert_eq!(finish_deadline(6_000_000_000), FINISH_DEADLINE + 10 * minute);
    }
}
