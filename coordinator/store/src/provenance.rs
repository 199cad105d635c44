//! Where a run's numbers come from: program, machine, command line, time.

use std::borrow::Cow;
use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// What was true when a session of a run began; `provenance.json` holds one for each session, and
/// every checkpoint that of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program.
    pub version: Cow<'static, str>,
    /// Commit that it was built from, with `-dirty` if there were changes; `unknown` outside of git.
    pub commit: Cow<'static, str>,
    /// `debug` or `release`.
    pub build: Cow<'static, str>,
    /// The command line.
    pub command: Vec<String>,
    /// When the session began (UTC).
    pub started: String,
    /// Name of the machine.
    pub host: String,
    /// Kernel's name and release.
    pub system: String,
    /// The processor's name.
    pub processor: String,
    /// Vector instructions that matter here.
    pub vector_extensions: Vec<Cow<'static, str>>,
    /// Processors that this process may use.
    pub processors: usize,
    /// Memory of the machine (bytes).
    pub memory: u64,
    /// What the digests of the run can be compared with.
    pub promise: Cow<'static, str>,
}

/// Stands in every run: what equal digests depend on.
const PROMISE: &str = "digests are equal for the same configuration, seed, build (version, commit, \
    build) and processor type (processor, vector_extensions), whatever the number of workers, kills \
    and resumes; other processors, builds, learner threads, precisions and GPUs may round differently";

/// The commit of this program.
static COMMIT: OnceLock<&str> = OnceLock::new();

/// Says which commit this program was built from: the first thing that a program does which makes runs or
/// checkpoints. Only the program's own crate is built anew for every commit.
pub fn built_from(commit: &'static str) {
    let _ = COMMIT.set(commit);
}

impl Provenance {
    /// Looks around.
    pub fn gather() -> Self {
        let names = rustix::system::uname();
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: COMMIT.get().copied().unwrap_or("unknown").into(),
            build: if cfg!(debug_assertions) { "debug" } else { "release" }.into(),
            command: std::env::args().collect(),
            started: utc(SystemTime::now()).to_string(),
            host: names.nodename().to_string_lossy().into_owned(),
            system: format!(
                "{} {}",
                names.sysname().to_string_lossy(),
                names.release().to_string_lossy()
            ),
            processor: processor_name(),
            vector_extensions: vector_extensions().into_iter().map(Cow::Borrowed).collect(),
            processors: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            memory: memory(),
            promise: PROMISE.into(),
        }
    }
}

/// The processor's name as the kernel gives it.
pub fn processor_name() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1));
    name.unwrap_or(std::env::consts::ARCH).to_owned()
}

/// The vector extensions that decide how fast rollouts and updates are.
pub fn vector_extensions() -> Vec<&'static str> {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let flags = text.lines().find(|line| line.starts_with("flags")).unwrap_or_default();
    ["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"]
        .into_iter()
        .filter(|flag| flags.split_whitespace().any(|word| word == *flag))
        .collect()
}

/// Memory of the machine, or what the container may use of it (bytes).
pub fn memory() -> u64 {
    let info = rustix::system::sysinfo();
    let machine = info.totalram as u64 * u64::from(info.mem_unit);
    let limit = std::fs::read_to_string("/sys/fs/cgroup/memory.max").unwrap_or_default();
    limit.trim().parse().map_or(machine, |limit: u64| machine.min(limit))
}

/// A moment in UTC, in parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Utc {
    date: (i64, u64, u64),
    time: (u64, u64, u64),
}

impl Utc {
    /// As a part of a file name: `20260101-120000`.
    pub fn compact(&self) -> String {
        let ((year, month, day), (hour, minute, second)) = (self.date, self.time);
        format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}")
    }
}

impl std::fmt::Display for Utc {
    /// As RFC 3339 writes it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ((year, month, day), (hour, minute, second)) = (self.date, self.time);
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
    }
}

/// The moment in parts. A clock before 1970 counts as 1970.
pub fn utc(moment: SystemTime) -> Utc {
    let seconds = moment.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let (days, second_of_day) = (seconds / 86400, seconds % 86400);
    // Years begin in March here, so that the leap day is the last of its year; 719468 days lie
    // between 0000-03-01 and 1970-01-01, and 146097 days make 400 years.
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = (era * 400 + year_of_era + u64::from(month <= 2)) as i64;
    Utc {
        date: (year, month, day),
        time: (second_of_day / 3600, second_of_day / 60 % 60, second_of_day % 60),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn dates_around_leap_days() {
        // `date -u -d @…` says so.
        let text = |seconds| utc(UNIX_EPOCH + Duration::from_secs(seconds)).to_string();
        assert_eq!(text(0), "1970-01-01T00:00:00Z");
        assert_eq!(text(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(text(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(text(4_107_542_400), "2100-03-01T00:00:00Z");
        let compact = utc(UNIX_EPOCH + Duration::from_secs(1_767_268_801)).compact();
        assert_eq!(compact, "20260101-120001");
    }
}
