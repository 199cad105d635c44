//! Clocks for measurements, and percentiles of what they measured. Nothing that trains reads them.

use std::time::Duration;

use rustix::time::{ClockId, Timespec, clock_gettime};

/// Time since a moment that all processes of this machine share (CLOCK_MONOTONIC): a time taken in
/// one process can be subtracted from one taken in another.
pub fn monotonic() -> Duration {
    duration(clock_gettime(ClockId::Monotonic))
}

/// Processor time that this thread has used (s): other load on the machine does not count.
pub fn thread_cpu() -> f64 {
    duration(clock_gettime(ClockId::ThreadCPUTime)).as_secs_f64()
}

fn duration(time: Timespec) -> Duration {
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// The nearest-rank percentile: the smallest value that at least `share` of all do not exceed; 0 if
/// there are none. `sorted` is in ascending order, `share` in 0…1.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    let index = rank.clamp(1, sorted.len().max(1)) - 1;
    sorted.get(index).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_values_that_were_measured() {
        // Nearest rank on 1…200: 0.99 · 200 = 198 values may lie at or below.
        let values: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!(percentile(&values, 0.99), 198.0);
        assert_eq!(percentile(&values, 0.5), 100.0);
        assert_eq!(percentile(&values, 1.0), 200.0);
        assert_eq!(percentile(&values, 0.0), 1.0);
        assert_eq!(percentile(&[7.0], 0.99), 7.0);
        assert_eq!(percentile(&[], 0.5), 0.0);
    }

    #[test]
    fn processor_time_passes_with_work_and_not_with_sleep() {
        let (wall, cpu) = (monotonic(), thread_cpu());
        let mut word = 1_u64;
        while thread_cpu() - cpu < 1e-3 {
            assert!(monotonic().saturating_sub(wall) < Duration::from_mins(1), "it stands still");
            word = std::hint::black_box(word.wrapping_mul(3));
        }
        let (wall, cpu) = (monotonic(), thread_cpu());
        std::thread::sleep(Duration::from_millis(30));
        assert!(thread_cpu() - cpu < 0.02);
        assert!(monotonic().saturating_sub(wall) >= Duration::from_millis(30));
    }
}
