//! Clocks for measurements. Nothing that trains reads them.

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

#[cfg(test)]
mod tests {
    use super::*;

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
