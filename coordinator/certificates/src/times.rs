//! Points of time, as seconds since 1970 and as people write them.

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since 1970; before that, none.
pub(crate) fn seconds(time: SystemTime) -> i64 {
    let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

/// A point of time for a person.
pub(crate) fn date(seconds: i64) -> String {
    jiff::Timestamp::from_second(seconds).map_or_else(
        |_| format!("{seconds} s after 1970"),
        |time| time.strftime("%F %R UTC").to_string(),
    )
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn times_are_written_in_utc() {
        let time = UNIX_EPOCH + Duration::from_hours(490_896);
        assert_eq!(date(seconds(time)), "2026-01-01 00:00 UTC");
        assert_eq!(seconds(UNIX_EPOCH - Duration::from_secs(5)), 0);
        assert_eq!(date(i64::MAX), format!("{} s after 1970", i64::MAX));
    }
}
