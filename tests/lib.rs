//! Drives the built programs: starts runs in directories of their own, reads what they wrote, and
//! makes sure that nothing outlives a test, also when it fails.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::{NamedTempFile, TempDir};

pub mod bucket;
pub mod chaos;
pub mod controllers;
pub mod golden;
pub mod guide;
pub mod imports;
pub mod network;
pub mod reference;
pub mod wheel;
pub mod worked_example;

/// Path of a built program: programs lie beside the directory of the test executables.
pub fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("a running test has a path");
    let profile = test.parent().and_then(Path::parent).expect("target/<profile>/deps/<test>");
    let program = profile.join(name);
    assert!(program.is_file(), "{} is missing: run `cargo build` first", program.display());
    program
}

/// Python of the tests' own virtual environment.
pub fn python() -> PathBuf {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../.venv-tests/bin/python");
    let path = std::env::var_os("SPACEOCTOPUS_TEST_PYTHON").map_or(default.into(), PathBuf::from);
    assert!(path.is_file(), "{} is missing: run `make test`", path.display());
    path
}

/// Path of a script in `tests/crosscheck`.
pub fn crosscheck(script: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("crosscheck").join(script)
}

/// Runs `octopus` to its end.
pub fn octopus(args: &[&str]) -> Output {
    Command::new(program("octopus"))
        .args(args)
        .stdin(Stdio::null())
        .output()
        .expect("octopus can be started")
}

/// Standard error of a finished command as text.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Flags of a run small enough for a test: 4 shards of 4 environments, 8 steps, tiny networks.
pub const SMALL: &[&str] = &[
    "--no-eval",
    "--seed=7",
    "--set=env.n_envs=16",
    "--set=env.n_shards=4",
    "--set=task.episode_steps=8",
    "--set=network.hidden=[16]",
    "--set=network.critic_hidden=[16]",
    "--set=algorithm.mini_batches=2",
    "--set=run.learner_threads=1",
    "--set=run.checkpoint_every=5",
    "--set=run.evaluate_every=0",
    // A search in every episode, which would be most of the time where episodes have eight steps.
    "--set=task.posture.seen=false",
    "--set=task.posture.gain=0",
];

/// After the options of a small run: with goal postures all the same.
pub const WITH_POSTURES: &[&str] = &["--set=task.posture.seen=true", "--set=task.posture.gain=0.7"];

/// What becomes a program that hears of a closed terminal, also where the tests were started with `nohup`.
pub const HEARS_HANG_UPS: &[&str] = &["env", "--default-signal=HUP"];

/// A process that a failed test does not leave behind.
#[derive(Debug)]
pub struct Owned(Child);

impl Owned {
    /// Starts it.
    pub fn spawn(command: &mut Command) -> Self {
        Self(command.spawn().expect("the program can be started"))
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.0.id()
    }

    /// The writing end of its standard input, if that is a pipe and was not taken before.
    pub fn stdin(&mut self) -> Option<ChildStdin> {
        self.0.stdin.take()
    }

    /// The reading end of its standard output, likewise.
    pub fn stdout(&mut self) -> Option<ChildStdout> {
        self.0.stdout.take()
    }

    /// Waits for its end; says whether it was a good one.
    pub fn succeeded(&mut self) -> bool {
        self.0.wait().expect("own child").success()
    }

    /// Waits until it has ended by itself, and not for ever: its exit code.
    pub fn code(&mut self) -> Option<i32> {
        let watchdog = Instant::now() + Duration::from_mins(1);
        loop {
            if let Some(status) = self.ended() {
                return status.code();
            }
            assert!(Instant::now() < watchdog, "process {} does not end", self.id());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// How it ended, if it has.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.0.try_wait().expect("own child")
    }
}

impl From<Child> for Owned {
    fn from(child: Child) -> Self {
        Self(child)
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A run in a directory that goes away with it.
#[derive(Debug)]
pub struct Run {
    dir: TempDir,
    log: NamedTempFile,
    process: Option<Child>,
    log_filter: Option<&'static str>,
    variables: Vec<(&'static str, String)>,
    launcher: Vec<String>,
}

impl Default for Run {
    fn default() -> Self {
        Self::new()
    }
}

impl Run {
    /// An empty directory, nothing started.
    pub fn new() -> Self {
        Self::below(&std::env::temp_dir())
    }

    /// The same in a directory made inside `place`, on whatever disk that is. What it says goes elsewhere.
    pub fn below(place: &Path) -> Self {
        Self {
            dir: tempfile::tempdir_in(place).expect("a temporary directory"),
            log: NamedTempFile::new().expect("a temporary file"),
            process: None,
            log_filter: None,
            variables: Vec::new(),
            launcher: Vec::new(),
        }
    }

    /// An empty directory whose workers will log every block that they send.
    pub fn with_logged_blocks() -> Self {
        let mut run = Self::new();
        run.log_filter = Some("warn,sim_worker=debug");
        run
    }

    /// An empty directory whose processes will see these environment variables.
    pub fn with_variables(variables: &[(&'static str, &str)]) -> Self {
        let mut run = Self::new();
        run.set_variables(variables);
        run
    }

    /// From the next start on the processes will see these environment variables instead.
    pub fn set_variables(&mut self, variables: &[(&'static str, &str)]) {
        self.variables =
            variables.iter().map(|(name, value)| (*name, (*value).to_owned())).collect();
    }

    /// From the next start on the environment is the test's own.
    pub fn forget_variables(&mut self) {
        self.variables.clear();
    }

    /// From the next start on `octopus` is started by this command, which becomes it.
    pub fn start_behind(&mut self, launcher: &[&str]) {
        self.launcher = launcher.iter().map(|&word| word.to_owned()).collect();
    }

    /// The run directory.
    pub fn path(&self) -> PathBuf {
        self.dir.path().join("run")
    }

    /// Starts `octopus train trajectory` with the small flags and `more` of them.
    pub fn train(more: &[&str]) -> Self {
        let mut run = Self::new();
        run.start_training(more);
        run
    }

    /// Starts `octopus train trajectory` in this directory, as [`Self::train`] does.
    pub fn start_training(&mut self, more: &[&str]) {
        self.start_training_of("trajectory", more);
    }

    /// The same for a task by its name.
    pub fn start_training_of(&mut self, task: &str, more: &[&str]) {
        let dir = format!("--run-dir={}", self.path().display());
        let args: Vec<&str> =
            ["train", task, &dir].iter().chain(SMALL).chain(more).copied().collect();
        self.start(&args);
    }

    /// Starts `octopus resume` on this directory.
    pub fn resume(&mut self, more: &[&str]) {
        let path = self.path();
        let path = path.to_str().expect("temporary paths are UTF-8");
        let args: Vec<&str> = ["resume", path, "--no-eval"].iter().chain(more).copied().collect();
        self.start(&args);
    }

    fn start(&mut self, args: &[&str]) {
        let log = std::fs::File::options().append(true).open(self.log.path());
        let log = log.expect("the log can be written");
        let launchers =
            HEARS_HANG_UPS.iter().copied().chain(self.launcher.iter().map(String::as_str));
        let mut words = launchers.map(OsString::from).chain([program("octopus").into_os_string()]);
        let mut command = Command::new(words.next().expect("the program at least"));
        command.args(words).args(args);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        command.envs(self.variables.iter().map(|(name, value)| (name, value)));
        if let Some(filter) = self.log_filter {
            command.env("RUST_LOG", filter);
        }
        self.process = Some(command.spawn().expect("octopus can be started"));
    }

    /// What the run wrote to standard error.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.log.path()).unwrap_or_default()
    }

    /// Process id of the coordinator.
    pub fn pid(&self) -> u32 {
        self.process.as_ref().expect("a started run").id()
    }

    /// Sends a signal to the coordinator.
    pub fn signal(&self, signal: Signal) {
        kill(self.pid(), signal);
    }

    /// How the coordinator ended, if it has: its exit code, or `None` if a signal ended it.
    pub fn ended(&mut self) -> Option<Option<i32>> {
        let status = self.process.as_mut()?.try_wait().expect("own child")?;
        Some(status.code())
    }

    /// Waits for the end; returns the exit code, or `None` if a signal ended it.
    pub fn wait(&mut self) -> Option<i32> {
        let mut process = self.process.take().expect("a started run");
        let watchdog = Instant::now() + Duration::from_mins(5);
        while process.try_wait().expect("own child").is_none() {
            if Instant::now() > watchdog {
                let _ = process.kill();
                let _ = process.wait();
                panic!("the run hangs; its log:\n{}", self.log());
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        process.wait().expect("own child").code()
    }

    /// Waits for a clean end.
    pub fn succeed(&mut self) {
        let code = self.wait();
        assert_eq!(code, Some(0), "the run failed; its log:\n{}", self.log());
    }

    /// The lines of `metrics.jsonl`; a line that is being written is left out.
    pub fn metrics(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.path().join("metrics.jsonl")).unwrap_or_default();
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Digest of every iteration; the iterations must be 0, 1, 2, ….
    pub fn digests(&self) -> Vec<String> {
        self.metrics()
            .iter()
            .enumerate()
            .map(|(index, line)| {
                assert_eq!(line["iteration"], index, "iterations follow each other");
                line["digest"].as_str().expect("a digest").to_owned()
            })
            .collect()
    }

    /// Waits until `n` iterations are done.
    pub fn wait_for_iterations(&mut self, n: usize) {
        let watchdog = Instant::now() + Duration::from_mins(2);
        while self.metrics().len() < n {
            let ended = self.process.as_mut().is_none_or(|p| p.try_wait().expect("own").is_some());
            assert!(!ended, "the run ended before {n} iterations; its log:\n{}", self.log());
            assert!(Instant::now() < watchdog, "no {n} iterations; log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Living processes of this run, by program name.
    pub fn children(&self, name: &str) -> Vec<u32> {
        processes_with(self.path().to_str().expect("UTF-8"))
            .into_iter()
            .filter(|(_, program)| program == name)
            .map(|(pid, _)| pid)
            .collect()
    }

    /// Name of the run's shared-memory domain, as soon as the run has one.
    pub fn domain_when_there(&mut self) -> String {
        let watchdog = Instant::now() + Duration::from_mins(1);
        loop {
            let text = std::fs::read_to_string(self.path().join("run.lock")).unwrap_or_default();
            if let Ok(holder) = serde_json::from_str::<Value>(&text) {
                return holder["domain"].as_str().expect("a name").to_owned();
            }
            assert!(Instant::now() < watchdog, "no run; log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Name of the run's shared-memory domain, while it lives.
    pub fn domain(&self) -> String {
        let text = std::fs::read_to_string(self.path().join("run.lock")).expect("a live run");
        let holder: Value = serde_json::from_str(&text).expect("JSON");
        holder["domain"].as_str().expect("a name").to_owned()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let Some(mut process) = self.process.take() else { return };
        let lock = self.path().join("run.lock");
        let _ = process.kill();
        let _ = process.wait();
        // The janitor needs a moment to end the children and remove the shared memory. Whoever is
        // killed leaves in the lock file which it is.
        let holder = std::fs::read(lock).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let domain = holder.and_then(|holder: Value| Some(holder["domain"].as_str()?.to_owned()));
        let patience = Instant::now() + Duration::from_secs(5);
        while domain.as_ref().is_some_and(|domain| !leftovers(domain).is_empty())
            && Instant::now() < patience
        {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Sends a signal to a process; that it is gone already is no error.
pub fn kill(pid: u32, signal: Signal) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, signal);
    }
}

/// Living processes that have `argument` on their command line: id and program name.
pub fn processes_with(argument: &str) -> Vec<(u32, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").expect("Linux").flatten() {
        let Ok(pid) = entry.file_name().to_string_lossy().parse::<u32>() else { continue };
        let Ok(line) = std::fs::read(entry.path().join("cmdline")) else { continue };
        let line = String::from_utf8_lossy(&line).into_owned();
        if line.contains(argument) {
            let program = line.split('\0').next().unwrap_or_default();
            let name = Path::new(program).file_name().unwrap_or_default();
            found.push((pid, name.to_string_lossy().into_owned()));
        }
    }
    found
}

/// What a domain has left on this machine: processes, segments, files.
pub fn leftovers(domain: &str) -> Vec<String> {
    let mut found: Vec<String> =
        processes_with(domain).into_iter().map(|(pid, name)| format!("{name} {pid}")).collect();
    for directory in ["/dev/shm", "/tmp"] {
        for entry in std::fs::read_dir(directory).expect("Linux").flatten() {
            if entry.file_name().to_string_lossy().starts_with(domain) {
                found.push(entry.path().display().to_string());
            }
        }
    }
    found
}

/// Waits for the janitor, then asserts that nothing of the domain is left.
pub fn assert_nothing_left(domain: &str) {
    let patience = Instant::now() + Duration::from_secs(10);
    while !leftovers(domain).is_empty() && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(leftovers(domain), Vec::<String>::new());
}
