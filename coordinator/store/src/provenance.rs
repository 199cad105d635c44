//! Where a run's numbers come from: program, machine, command line, time.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;

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
    /// Names of the machine's GPUs, used or not.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gpus: Vec<String>,
    /// What the digests of the run can be compared with.
    pub promise: Cow<'static, str>,
}

/// Stands in every run: what equal digests depend on.
const PROMISE: &str = "digests are equal for the same configuration, seed, build (version, commit, \
    build), C library and processor type (processor, vector_extensions), whatever the number of \
    workers, kills and resumes; other processors, builds, C libraries, learner threads, precisions and \
    GPUs may round differently";

/// The fields of [`Provenance`] that tell of it.
pub const PROMISED_FOR: [&str; 5] =
    ["version", "commit", "build", "processor", "vector_extensions"];

/// The commit of this program.
static COMMIT: OnceLock<&str> = OnceLock::new();

/// Says which commit this program was built from: the first thing that a program does which makes runs or
/// checkpoints. Only the program's own crate is built anew for every commit.
pub fn built_from(commit: &'static str) {
    let _ = COMMIT.set(commit);
}

impl Provenance {
    /// What has changed since the session `before` of that which equal digests depend on, in words; nothing if nothing has.
    pub fn changes_since(&self, before: &Self) -> Option<String> {
        let [now, then] = [self, before].map(|session| serde_json::json!(session));
        let shown = |value: &Value| match value {
            Value::String(text) => text.clone(),
            Value::Array(values) => {
                values.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(" ")
            }
            other => other.to_string(),
        };
        let changed = PROMISED_FOR.iter().filter(|field| now[**field] != then[**field]);
        let said: Vec<_> = changed
            .map(|field| {
                let (name, now, then) = (field.replace('_', " "), &now[*field], &then[*field]);
                format!("{name} {}, before {}", shown(now), shown(then))
            })
            .collect();
        (!said.is_empty()).then(|| said.join("; "))
    }

    /// Looks around.
    pub fn gather() -> Self {
        let names = rustix::system::uname();
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: COMMIT.get().copied().unwrap_or("unknown").into(),
            build: if cfg!(debug_assertions) { "debug" } else { "release" }.into(),
            command: std::env::args().collect(),
            started: Utc::now().to_string(),
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
            gpus: gpus(Path::new("/proc/driver/nvidia/gpus")),
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

/// Name and vector instructions in one line: what two machines can be compared by.
pub fn processor_type() -> String {
    let extensions = vector_extensions().join(", ");
    format!("{} ({})", processor_name(), if extensions.is_empty() { "plain" } else { &extensions })
}

/// Memory of the machine, or what the container may use of it (bytes).
pub fn memory() -> u64 {
    let info = rustix::system::sysinfo();
    let machine = info.totalram as u64 * u64::from(info.mem_unit);
    let limit = std::fs::read_to_string("/sys/fs/cgroup/memory.max").unwrap_or_default();
    limit.trim().parse().map_or(machine, |limit: u64| machine.min(limit))
}

/// The GPUs' names as their driver gives them, a folder each in `directory`.
fn gpus(directory: &Path) -> Vec<String> {
    let folders = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let mut folders: Vec<_> = folders.map(|folder| folder.path()).collect();
    folders.sort();
    let name = |folder: &PathBuf| {
        let text = std::fs::read_to_string(folder.join("information")).ok()?;
        let name = text.lines().find_map(|line| line.strip_prefix("Model:"))?;
        Some(name.trim().to_owned())
    };
    folders.iter().filter_map(name).collect()
}

/// A moment in UTC, to the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Utc(Timestamp);

impl Utc {
    /// This moment. A clock before 1970 counts as 1970.
    pub fn now() -> Self {
        Self::from_unix(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs())
    }

    /// The moment so many seconds after 1970 began; what is beyond the year 9999 is its end.
    pub fn from_unix(seconds: u64) -> Self {
        let moment = i64::try_from(seconds).ok().map(Timestamp::from_second);
        Self(moment.and_then(Result::ok).unwrap_or(Timestamp::MAX))
    }

    /// As a part of a file name: `20260101-120000`.
    pub fn compact(&self) -> String {
        self.0.strftime("%Y%m%d-%H%M%S").to_string()
    }
}

impl std::fmt::Display for Utc {
    /// As RFC 3339 writes it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.strftime("%Y-%m-%dT%H:%M:%SZ").fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_processor_or_build_is_told_and_another_machine_is_not() {
        let before = Provenance::gather();
        let elsewhere = Provenance { host: "elsewhere".to_owned(), ..before.clone() };
        assert_eq!(elsewhere.changes_since(&before), None);
        let now =
            Provenance { commit: "abc".into(), processor: "another".to_owned(), ..before.clone() };
        let expected = format!(
            "commit abc, before {}; processor another, before {}",
            before.commit, before.processor
        );
        assert_eq!(now.changes_since(&before), Some(expected));
    }

    #[test]
    fn dates_around_leap_days() {
        // `date -u -d @…` says so.
        let text = |seconds| Utc::from_unix(seconds).to_string();
        assert_eq!(text(0), "1970-01-01T00:00:00Z");
        assert_eq!(text(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(text(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(text(4_107_542_400), "2100-03-01T00:00:00Z");
        assert_eq!(Utc::from_unix(1_767_268_801).compact(), "20260101-120001");
    }

    #[test]
    fn gpus_are_told_by_their_names() {
        let place = tempfile::tempdir().expect("tempdir");
        let there = place.path();
        assert!(gpus(&there.join("nowhere")).is_empty());
        for (slot, name) in [("0000:02:00.0", "B"), ("0000:01:00.0", "A")] {
            std::fs::create_dir(there.join(slot)).expect("room");
            let text = format!("Model: \t\t {name}\nIRQ:   \t\t 16\n");
            std::fs::write(there.join(slot).join("information"), text).expect("room");
        }
        std::fs::create_dir(there.join("0000:03:00.0")).expect("room");
        assert_eq!(gpus(there), ["A", "B"]);
    }

    /// Seconds come from manifests, which others may have written.
    #[test]
    fn no_count_of_seconds_is_too_large() {
        for seconds in [u64::MAX, i64::MAX as u64, 1 << 40] {
            assert!(Utc::from_unix(seconds).to_string().starts_with("9999-12-"), "{seconds}");
        }
    }
}
