//! Shared memory: nobody else's, and full.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Signal, getuid};
use tests::{Run, SMALL, assert_nothing_left, kill, processes_with, program};

/// Everything in `directory` and below.
fn files(directory: &Path) -> Vec<(PathBuf, Metadata)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).expect("readable").flatten() {
        let path = entry.path();
        // What has gone since is of no interest.
        let Ok(metadata) = path.symlink_metadata() else { continue };
        if metadata.is_dir() {
            found.extend(files(&path));
        } else {
            found.push((path, metadata));
        }
    }
    found
}

/// Files and directories of `domain` that lie in a directory which others use, too.
fn entries(domain: &str) -> Vec<(PathBuf, Metadata)> {
    ["/dev/shm", "/tmp"]
        .into_iter()
        .flat_map(|directory| std::fs::read_dir(directory).expect("readable").flatten())
        .filter(|entry| entry.file_name().to_string_lossy().contains(domain))
        .map(|entry| (entry.path(), entry.metadata().expect("there")))
        .collect()
}

/// Whether nothing of `domain` can be reached by another user.
#[expect(clippy::print_stderr, reason = "a test says what it does not try")]
fn assert_is_private(domain: &str) {
    let entries = entries(domain);
    let [(root, metadata)] = &entries[..] else { panic!("more than a directory: {entries:?}") };
    assert!(metadata.is_dir());
    assert_eq!(metadata.mode() & 0o777, 0o700, "{}", root.display());
    let files = files(root);
    assert!(files.len() > 20, "{files:?}");
    for (path, metadata) in &files {
        assert_eq!(metadata.mode() & 0o077, 0, "{}: {:o}", path.display(), metadata.mode());
    }
    if getuid().is_root() {
        // The user `nobody`, who finds neither names nor contents.
        let paths = std::iter::once(root).chain(files.iter().map(|(path, _)| path));
        for path in paths {
            let status = Command::new("setpriv")
                .args(["--reuid=65534", "--regid=65534", "--clear-groups", "truncate", "--size=0"])
                .arg(path)
                .stderr(Stdio::null())
                .status()
                .expect("util-linux is there");
            assert!(!status.success(), "{}", path.display());
        }
    } else {
        eprintln!("not root: other users were not tried, only modes");
    }
}

#[test]
fn nobody_else_can_reach_the_memory_of_a_run() {
    let mut run = Run::train(&["--workers=2", "--iterations=100000"]);
    run.wait_for_iterations(1);
    let domain = run.domain();
    assert_is_private(&domain);
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);
}

#[test]
fn a_umask_of_nothing_opens_the_memory_of_a_run_to_nobody() {
    let run = Run::new();
    let mut process = tests::Owned::spawn(
        Command::new("sh")
            .args(["-c", "umask 0 && exec \"$@\"", "sh"])
            .arg(program("octopus"))
            .args(["train", "trajectory", "--run-dir"])
            .arg(run.path())
            .args(SMALL)
            .args(["--workers=2", "--iterations=100000", "--quiet"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null()),
    );
    let patience = Instant::now() + Duration::from_mins(2);
    while run.metrics().is_empty() {
        assert!(Instant::now() < patience && process.ended().is_none(), "no iteration");
        std::thread::sleep(Duration::from_millis(5));
    }
    let domain = run.domain();
    assert_is_private(&domain);
    kill(process.id(), Signal::INT);
    assert_eq!(process.code(), Some(0));
    assert_nothing_left(&domain);
}

/// A run in a mount namespace of its own, whose `/dev/shm` has a size of its own.
struct Confined {
    process: tests::Owned,
    dir: tempfile::TempDir,
    /// Size of its `/dev/shm`.
    mib: usize,
}

impl Confined {
    /// Starts `octopus train` with the small flags and `more`. None if this user cannot.
    #[expect(clippy::print_stderr, reason = "a test says what it does not try")]
    fn train(mib: usize, more: &[&str]) -> Option<Self> {
        if !getuid().is_root() {
            eprintln!("not root, so that no other /dev/shm can be mounted: not tried");
            return None;
        }
        let dir = tempfile::tempdir().expect("a temporary directory");
        let log = std::fs::File::create(dir.path().join("octopus.log")).expect("writable");
        let mount = format!("mount -t tmpfs -o size={mib}M tmpfs /dev/shm && exec \"$@\"");
        let process = tests::Owned::spawn(
            Command::new("unshare")
                .args(["--mount", "sh", "-c", &mount, "sh"])
                .arg(program("octopus"))
                .args(["train", "trajectory", "--run-dir"])
                .arg(dir.path().join("run"))
                .args(SMALL)
                .args(more)
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(log),
        );
        Some(Self { process, dir, mib })
    }

    /// Its `/dev/shm`, seen from here.
    fn shared_memory(&self) -> PathBuf {
        PathBuf::from(format!("/proc/{}/root/dev/shm", self.process.id()))
    }

    /// Whether its own `/dev/shm` is mounted. Until then that path leads to the machine's, which is not
    /// ours to fill.
    fn is_confined(&self) -> bool {
        let device = |path: &Path| path.metadata().ok().map(|there| there.dev());
        let (own, shared) = (device(&self.shared_memory()), device(Path::new("/dev/shm")));
        own.is_some() && shared.is_some() && own != shared
    }

    /// Takes all the room that is left: never more than its `/dev/shm` has, wherever that path leads.
    fn fill(&self) {
        assert!(self.is_confined(), "this would fill the machine's shared memory");
        let path = self.shared_memory().join("filler");
        let mut filler = std::fs::File::create(path).expect("writable");
        for (len, most) in [(1 << 20, self.mib), (1 << 12, 256)] {
            for _ in 0..most {
                if std::io::Write::write_all(&mut filler, &vec![1; len]).is_err() {
                    break;
                }
            }
        }
        let free = rustix::fs::statvfs(self.shared_memory()).expect("there").f_bavail;
        assert_eq!(free, 0, "pages are left");
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.dir.path().join("octopus.log")).unwrap_or_default()
    }

    fn wait_until(&mut self, what: &str, mut is_so: impl FnMut(&Self) -> bool) {
        let watchdog = Instant::now() + Duration::from_mins(2);
        while !is_so(self) {
            assert_eq!(self.process.ended(), None, "{}", self.log());
            assert!(Instant::now() < watchdog, "not {what}; log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn iterations(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.dir.path().join("run/metrics.jsonl"));
        let text = text.unwrap_or_default();
        let lines = text.lines().filter_map(|line| serde_json::from_str(line).ok());
        lines.map(|line: serde_json::Value| line["digest"].to_string()).collect()
    }

    /// Waits for the end and returns the exit code.
    fn end(&mut self) -> Option<i32> {
        let watchdog = Instant::now() + Duration::from_mins(3);
        loop {
            if let Some(status) = self.process.ended() {
                return status.code();
            }
            assert!(Instant::now() < watchdog, "hangs; log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn shared_memory_that_fills_up_later_harms_no_run() {
    let flags = ["--workers=2", "--iterations=40"];
    let mut calm = Run::train(&flags);
    calm.succeed();
    let calm: Vec<String> = calm.digests().iter().map(|digest| format!("\"{digest}\"")).collect();

    // A successor takes the memory of who has died; after the learner's death all are such.
    for victim in ["sim-worker", "learner"] {
        let Some(mut run) = Confined::train(256, &flags) else { return };
        run.wait_until("training", |run| run.iterations().len() >= 2);
        run.fill();
        let path = run.dir.path().join("run").display().to_string();
        let all = processes_with(&path).into_iter();
        let mut victims = all.filter(|(_, name)| name == victim).map(|(pid, _)| pid);
        kill(victims.next().expect("one of them"), Signal::KILL);
        assert_eq!(run.end(), Some(0), "{victim}: {}", run.log());
        assert!(run.log().contains("died (signal 9)"), "{victim}: {}", run.log());
        assert_eq!(run.iterations(), calm, "{victim}");
    }
}

#[test]
fn shared_memory_that_is_full_when_a_run_comes_up_is_named() {
    // The moment before learner and workers come up is short, and a busy machine may miss it.
    let caught = (0..20).find_map(|_| {
        let mut run = Confined::train(256, &["--workers=2", "--iterations=40"])?;
        run.wait_until("there", |run| {
            run.is_confined()
                && std::fs::read_dir(run.shared_memory())
                    .is_ok_and(|mut entries| entries.next().is_some())
        });
        kill(run.process.id(), Signal::STOP);
        std::thread::sleep(Duration::from_millis(20));
        let path = run.dir.path().join("run").display().to_string();
        let is_child = |name: &str| name == "learner" || name == "sim-worker";
        let early = !processes_with(&path).iter().any(|(_, name)| is_child(name));
        early.then_some(run)
    });
    let Some(mut run) = caught else {
        assert!(!getuid().is_root(), "the moment was missed twenty times");
        return;
    };
    run.fill();
    kill(run.process.id(), Signal::CONT);
    assert_eq!(run.end(), Some(4), "{}", run.log());
    let log = run.log();
    for part in ["shared memory is full", "/dev/shm", "octopus clean"] {
        assert!(log.contains(part), "{log}");
    }
    assert!(!log.contains("failed 3 times"), "no block is to blame: {log}");
}

#[test]
fn a_page_that_is_missing_is_an_error_and_no_signal() {
    // The moment in which a page can be missing is too short to be met: the signal is sent.
    let Some(mut run) = Confined::train(256, &["--workers=1", "--iterations=100000"]) else {
        return;
    };
    run.wait_until("training", |run| !run.iterations().is_empty());
    kill(run.process.id(), Signal::STOP);
    run.fill();
    kill(run.process.id(), Signal::BUS);
    kill(run.process.id(), Signal::CONT);
    assert_eq!(run.end(), Some(4), "{}", run.log());
    let log = run.log();
    assert!(
        log.contains("shared memory is full: /dev/shm had no page left; `octopus clean`"),
        "{log}"
    );
}

#[test]
fn a_bus_error_for_another_reason_stays_one() {
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(1);
    let domain = run.domain();
    run.signal(Signal::BUS);
    assert_eq!(run.wait(), None, "a signal ends it; its log:\n{}", run.log());
    assert_nothing_left(&domain);
}
