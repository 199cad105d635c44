//! What is measured while a run is disturbed: times, and whether anything grows.

use std::path::Path;
use std::time::Duration;

use proto::statistics::percentile;
use serde_json::{Value, json};

/// Times of one kind.
#[derive(Debug, Clone, Default)]
pub struct Times(Vec<Duration>);

impl Times {
    /// Adds one.
    pub fn push(&mut self, time: Duration) {
        self.0.push(time);
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The smallest time that at least `share` of all do not exceed (s); none of no times.
    pub fn percentile(&self, share: f64) -> Option<f64> {
        let mut sorted: Vec<f64> = self.0.iter().map(Duration::as_secs_f64).collect();
        sorted.sort_by(f64::total_cmp);
        (!sorted.is_empty()).then(|| percentile(&sorted, share))
    }

    /// Count, percentiles and maximum (s).
    pub fn to_json(&self) -> Value {
        json!({
            "count": self.len(),
            "p50_s": self.percentile(0.5),
            "p99_s": self.percentile(0.99),
            "max_s": self.percentile(1.0),
        })
    }
}

/// Samples of something that must not grow while it is used.
#[derive(Debug, Clone, Default)]
pub struct Trend(Vec<u64>);

impl Trend {
    /// Adds a sample.
    pub fn push(&mut self, sample: u64) {
        self.0.push(sample);
    }

    /// The first sample.
    pub fn first(&self) -> Option<u64> {
        self.0.first().copied()
    }

    /// How much it has grown from the first third of the samples to the last: the smallest of the
    /// last third over the largest of the first. What comes and goes counts for nothing; what is
    /// lost at every turn counts in full. None of fewer than nine samples.
    pub fn growth(&self) -> Option<u64> {
        let third = self.0.len() / 3;
        let before = self.0.iter().take(third).max()?;
        let after = self.0.iter().rev().take(third).min()?;
        (third >= 3).then(|| after.saturating_sub(*before))
    }

    /// First, last, largest, and growth.
    pub fn to_json(&self) -> Value {
        json!({
            "samples": self.0.len(),
            "first": self.0.first(),
            "last": self.0.last(),
            "max": self.0.iter().max(),
            "growth": self.growth(),
        })
    }
}

/// Open descriptors of a process; none if it is gone.
pub fn descriptors(pid: u32) -> Option<u64> {
    Some(std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count() as u64)
}

/// Memory of a process that no other shares (bytes); none if it is gone.
pub fn private_memory(pid: u32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kilobytes)
}

/// Files of a domain: segments in shared memory, sockets and others below its folder.
pub fn domain_files(domain: &str) -> u64 {
    ["/dev/shm", "/tmp"]
        .into_iter()
        .flat_map(|directory| std::fs::read_dir(directory).into_iter().flatten().flatten())
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(domain))
        .map(|entry| count(&entry.path()))
        .sum()
}

fn count(path: &Path) -> u64 {
    let inside = std::fs::read_dir(path).into_iter().flatten().flatten();
    1 + inside.map(|entry| count(&entry.path())).sum::<u64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_known_times() {
        let mut times = Times::default();
        assert_eq!(times.percentile(0.5), None);
        for millis in [30, 10, 20, 40] {
            times.push(Duration::from_millis(millis));
        }
        // Nearest rank: of four, half is the second and everything above three quarters the last.
        assert_eq!(times.percentile(0.5), Some(0.02));
        assert_eq!(times.percentile(0.99), Some(0.04));
        assert_eq!(times.percentile(1.0), Some(0.04));
    }

    #[test]
    fn a_leak_is_growth_and_coming_and_going_is_none() {
        let trend = |samples: &[u64]| Trend(samples.to_vec()).growth();
        assert_eq!(trend(&[5, 6, 7, 8, 9, 10, 11, 12, 13]), Some(4));
        assert_eq!(trend(&[5, 9, 5, 6, 9, 5, 9, 6, 5]), Some(0));
        assert_eq!(trend(&[5, 5, 9]), None, "too few to say");
    }
}
