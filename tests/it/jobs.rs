//! What supervisors and clusters start: `deploy/jobs`.

use std::net::TcpListener;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal};
use tempfile::TempDir;
use tests::guide::repository;
use tests::{Owned, Run, SMALL, crosscheck, kill, processes_with, program, python, stderr};

const ITERATIONS: &str = "--iterations=300";

fn calm() -> Vec<String> {
    let mut run = Run::train(&[ITERATIONS]);
    run.succeed();
    run.digests()
}

fn jobs() -> PathBuf {
    repository().join("deploy/jobs")
}

/// Waits until `run` has `n` lines of metrics; says how many there are.
fn wait_for_lines(metrics: &Path, n: usize) -> usize {
    let watchdog = Instant::now() + Duration::from_mins(2);
    loop {
        let lines = std::fs::read_to_string(metrics).unwrap_or_default().lines().count();
        if lines >= n {
            return lines;
        }
        assert!(Instant::now() < watchdog, "{}: {lines} of {n} lines", metrics.display());
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A job that is asked to stop, and is started again until the run is done, has the bits of one that was left alone.
fn stopped_and_started_again(job: &dyn Fn(&Path) -> Command, requeued: &dyn Fn() -> usize) {
    let place = tempfile::tempdir().expect("tempdir");
    let run = place.path().join("run");
    for (starts, lines) in [(1, 5), (2, 40)] {
        let mut started = Owned::spawn(job(&run).stdout(Stdio::null()).stderr(Stdio::null()));
        let before = wait_for_lines(&run.join("metrics.jsonl"), lines);
        kill(started.id(), Signal::TERM);
        assert!(started.succeeded(), "start {starts} at {before} lines");
        assert!(
            wait_for_lines(&run.join("metrics.jsonl"), before) < 300,
            "it was to be stopped before its end"
        );
        assert_eq!(requeued(), starts);
    }
    // To its end; and once more, when there is nothing to do.
    for _ in 0..2 {
        let ended = job(&run).output().expect("it starts");
        assert!(ended.status.success(), "{}", stderr(&ended));
    }
    assert_eq!(requeued(), 2, "who is done is not started again");
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl")).expect("read");
    let lines = metrics.lines().map(serde_json::from_str::<serde_json::Value>);
    let digests: Vec<String> = lines
        .map(|line| line.expect("JSON")["digest"].as_str().expect("a digest").to_owned())
        .collect();
    assert_eq!(digests, calm());
}

#[test]
fn a_supervisor_may_stop_and_start_a_training() {
    let job = |run: &Path| {
        let mut command = Command::new(jobs().join("train-or-resume.sh"));
        command.arg(run).arg("trajectory").args(SMALL).arg(ITERATIONS);
        command.env("OCTOPUS", program("octopus"));
        command
    };
    let stops = std::cell::Cell::new(0);
    // Nobody is told: whoever stopped it starts it.
    stopped_and_started_again(&job, &|| {
        stops.set(stops.get() + 1);
        stops.get().min(2)
    });
}

/// A supervisor that takes status 0 for "done" hears 143 from a run that is not.
#[test]
fn who_is_stopped_before_the_end_says_so() {
    let place = tempfile::tempdir().expect("tempdir");
    let run = place.path().join("run");
    let job = || {
        // What runs in the background of a script is started deaf to SIGINT, below `nohup` to SIGHUP, and a shell stays so.
        let mut command = Command::new("env");
        command.arg("--default-signal=INT,HUP").arg(jobs().join("until-done.sh"));
        command.arg(&run).arg("trajectory").args(SMALL).arg(ITERATIONS);
        command.env("OCTOPUS", program("octopus")).env("OCTOPUS_ALWAYS", "--listen 127.0.0.1:0");
        command
    };
    let metrics = run.join("metrics.jsonl");
    for signal in [Signal::TERM, Signal::HUP, Signal::INT] {
        let before = std::fs::read_to_string(&metrics).map_or(0, |text| text.lines().count());
        let mut job = job();
        job.stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
        let mut started = Owned::spawn(&mut job);
        wait_for_lines(&metrics, before + 5);
        if signal == Signal::INT {
            // As a terminal does: to all that run in it.
            let group = Pid::from_raw(started.id() as i32).expect("a process");
            rustix::process::kill_process_group(group, signal).expect("it runs");
        } else {
            kill(started.id(), signal);
        }
        assert_eq!(started.code(), Some(143), "{signal:?}");
    }
    for _ in 0..2 {
        let ended = job().output().expect("it starts");
        assert!(ended.status.success(), "{}", stderr(&ended));
    }
}

const RUNNING: &str = "JobState=RUNNING";

/// Stand-ins for the commands of Slurm that write down how they were called.
struct Slurm {
    place: TempDir,
}

impl Slurm {
    fn new() -> Self {
        let place = tempfile::tempdir().expect("tempdir");
        let slurm = Self { place };
        slurm.is(RUNNING);
        // As many tasks as it is asked for, all on this machine.
        slurm.command(
            "srun",
            r#"for word; do case $word in --ntasks=*) tasks=${word#*=} ;; -*) ;; *) break ;; esac; shift; done
pids=
for task in $(seq "$tasks"); do "$@" --workers 1 --name "task-$task" & pids="$pids $!"; done
trap 'kill -TERM $pids' TERM
wait; wait
"#,
        );
        slurm
    }

    fn command(&self, name: &str, script: &str) {
        let path = self.place.path().join(name);
        let called = self.place.path().join(format!("{name}.called"));
        let text = format!("#!/bin/sh\necho \"$@\" >> '{}'\n{script}", called.display());
        std::fs::write(&path, text).expect("written");
        let executable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&path, executable).expect("own file");
    }

    /// How a command was called, a line each time.
    fn called(&self, name: &str) -> Vec<String> {
        let called = self.place.path().join(format!("{name}.called"));
        let text = std::fs::read_to_string(called).unwrap_or_default();
        text.lines().map(ToOwned::to_owned).collect()
    }

    /// The job is in this state.
    fn is(&self, state: &str) {
        let show = format!("[ \"$1\" = requeue ] || echo 'JobId=4711 {state} Reason=None'\n");
        self.command("scontrol", &show);
    }

    fn requeued(&self) -> usize {
        let called = self.called("scontrol");
        let mut asked = called.iter().filter(|line| *line != "requeue 4711");
        assert!(asked.all(|line| line == "--oneliner show job 4711"), "{called:?}");
        called.iter().filter(|line| *line == "requeue 4711").count()
    }

    /// A job of `deploy/jobs/slurm/train.sh`.
    fn job(&self, run: &Path) -> Command {
        let mut command = Command::new("bash");
        command.arg(jobs().join("slurm/train.sh")).arg(run).arg("trajectory").args(SMALL);
        command.arg(ITERATIONS).env("OCTOPUS", program("octopus")).env("SLURM_JOB_ID", "4711");
        command.env("SPACEOCTOPUS", repository());
        let path = std::env::var("PATH").expect("a path");
        command.env("PATH", format!("{}:{path}", self.place.path().display()));
        command
    }
}

/// A job that Slurm asks to stop asks Slurm to be started again.
#[test]
fn a_job_of_slurm_goes_on_after_its_time_limit() {
    let slurm = Slurm::new();
    stopped_and_started_again(&|run| slurm.job(run), &|| slurm.requeued());
    assert!(slurm.called("srun").is_empty(), "there is one machine");

    // What a person must mend is not tried again.
    let wrong = Command::new("bash")
        .arg(jobs().join("slurm/train.sh"))
        .arg(slurm.place.path().join("wrong"))
        .arg("no-task")
        .env("OCTOPUS", program("octopus"))
        .env("SPACEOCTOPUS", repository())
        .output()
        .expect("it starts");
    assert_eq!(wrong.status.code(), Some(2), "{}", stderr(&wrong));
    assert_eq!(slurm.requeued(), 2);
}

/// Slurm tells all processes of a job, and the scripts among them tell others once more.
#[test]
fn a_job_of_slurm_that_is_cancelled_ends_in_a_checkpoint_and_is_not_queued_again() {
    let slurm = Slurm::new();
    slurm.is("JobState=COMPLETING");
    let run = Run::new();
    let mut job = slurm.job(&run.path());
    let mut job = Owned::spawn(job.stdout(Stdio::null()).stderr(Stdio::null()));
    let patience = Instant::now() + Duration::from_mins(2);
    while run.metrics().len() < 3 {
        assert!(Instant::now() < patience && job.ended().is_none(), "no iterations");
        std::thread::sleep(Duration::from_millis(10));
    }
    for (pid, _) in processes_with(&run.path().display().to_string()) {
        kill(pid, Signal::TERM);
    }
    assert_eq!(job.code(), Some(143));
    assert_eq!(slurm.requeued(), 0);
    let done = run.metrics().len();
    let last = format!("iteration-{done:08}");
    assert!(run.path().join("checkpoints").join(last).exists(), "{done} iterations");
}

#[test]
fn machines_of_a_job_of_slurm_help_the_first() {
    let slurm = Slurm::new();
    let port = {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        listener.local_addr().expect("bound").port().to_string()
    };
    let job = |run: &Path| {
        let mut command = slurm.job(run);
        command.env("SLURM_JOB_NUM_NODES", "3").env("SLURMD_NODENAME", "127.0.0.1");
        command.env("PORT", &port);
        command
    };
    stopped_and_started_again(&job, &|| slurm.requeued());
    let called = slurm.called("srun");
    assert_eq!(called.len(), 4, "once a start: {called:?}");
    let first = "--nodes=2 --relative=1 --ntasks=2 ";
    let join = format!("join tcp/127.0.0.1:{port} --insecure --wait 10m");
    assert!(
        called.iter().all(|line| line.starts_with(first) && line.ends_with(&join)),
        "{called:?}"
    );
}

#[test]
fn manifests_of_kubernetes_fit_its_schemas() {
    let mut command = Command::new(python());
    command.arg(crosscheck("kubernetes.py")).arg(jobs().join("kubernetes/training.yaml"));
    let checked = command.output().expect("make venv was run");
    assert!(checked.status.success(), "{}", stderr(&checked));
    let said = String::from_utf8_lossy(&checked.stdout);
    assert_eq!(said, "PersistentVolumeClaim training-runs\nJobSet training\n");
}

/// A systemd in namespaces of its own.
struct Systemd {
    namespaces: Owned,
    init: u32,
}

impl Systemd {
    /// `None` where it cannot be: without root, namespaces or systemd.
    fn start(options: &str) -> Option<Self> {
        // The units hide these, and with them the libtorch that the programs were built with.
        let hidden = ["/home", "/root", "/tmp", "/var", "/run", "/opt"];
        let there = Path::new("/lib/systemd/systemd").exists()
            && rustix::process::geteuid().is_root()
            && !hidden.iter().any(|hidden| repository().starts_with(hidden));
        if !there {
            return None;
        }
        let programs = program("octopus").parent().expect("a directory").to_owned();
        // With the test it goes, too, and with the first of its processes all of them.
        let mut command = Command::new("setpriv");
        command.args([
            "--pdeathsig",
            "KILL",
            "unshare",
            "--pid",
            "--fork",
            "--kill-child",
            "--mount",
            "--cgroup",
            "--ipc",
        ]);
        command.arg("--mount-proc").arg(crosscheck("systemd.sh"));
        command.arg(&programs).arg(repository()).arg(options);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut namespaces = Owned::spawn(&mut command);
        let watchdog = Instant::now() + Duration::from_secs(30);
        while namespaces.ended().is_none() && Instant::now() < watchdog {
            let children = format!("/proc/{0}/task/{0}/children", namespaces.id());
            let children = std::fs::read_to_string(children).unwrap_or_default();
            if let Some(init) = children.split_whitespace().next().and_then(|pid| pid.parse().ok())
            {
                let systemd = Self { namespaces, init };
                let state = systemd.run(&["systemctl", "is-system-running"]);
                if state.stdout.starts_with(b"running") {
                    return Some(systemd);
                }
                namespaces = systemd.namespaces;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        None
    }

    fn run(&self, words: &[&str]) -> Output {
        let init = self.init.to_string();
        let mut command = Command::new("nsenter");
        command.args(["-t", &init, "-m", "-p", "-C", "-i"]).args(words);
        command.output().expect("nsenter starts")
    }

    fn succeed(&self, words: &[&str]) -> String {
        let output = self.run(words);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{words:?}: {said}{}", stderr(&output));
        said
    }
}

/// The units as they are, with everything that they forbid, under a real systemd.
#[test]
fn units_of_systemd_train_go_on_and_leave_nothing() {
    const UNIT: &str = "spaceoctopus-train@trial";
    let options = ["trajectory"].iter().chain(SMALL).chain(&[ITERATIONS]);
    let options: Vec<&str> = options.copied().collect();
    let Some(systemd) = Systemd::start(&options.join(" ")) else {
        return eprintln!(
            "not tried: it takes root, unshare, systemd, and a repository that units may see"
        );
    };
    for unit in ["spaceoctopus-train@.service", "spaceoctopus-serve.service"] {
        systemd.succeed(&["systemd-analyze", "verify", &format!("/etc/systemd/system/{unit}")]);
        // 20 is an exposure of 2.0, of 10.
        systemd.succeed(&["systemd-analyze", "security", "--threshold=20", "--no-pager", unit]);
    }
    let run = "/var/lib/private/spaceoctopus/trial";
    let lines = |n: usize| {
        let watchdog = Instant::now() + Duration::from_mins(2);
        loop {
            let text = systemd.run(&["cat", &format!("{run}/metrics.jsonl")]).stdout;
            let text = String::from_utf8(text).expect("UTF-8");
            if text.lines().count() >= n {
                return text;
            }
            let state = systemd.run(&["systemctl", "status", "--no-pager", UNIT]).stdout;
            assert!(Instant::now() < watchdog, "{}", String::from_utf8_lossy(&state));
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    systemd.succeed(&["systemctl", "start", UNIT, "spaceoctopus-serve"]);
    let before = lines(5).lines().count();
    systemd.succeed(&["systemctl", "restart", UNIT]);
    assert!(lines(before + 3).lines().count() < 300, "it was to be restarted before its end");
    let ended = lines(300);
    let digests: Vec<String> = ended
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"))
        .map(|line| line["digest"].as_str().expect("a digest").to_owned())
        .collect();
    assert_eq!(digests, calm());
    let shown = systemd.succeed(&["systemctl", "is-active", "spaceoctopus-serve"]);
    assert_eq!(shown.trim(), "active");
    systemd.succeed(&["systemctl", "stop", UNIT, "spaceoctopus-serve"]);
    assert_eq!(systemd.succeed(&["ls", "/dev/shm"]), "");
    assert_eq!(systemd.succeed(&["systemctl", "--failed", "--no-legend"]), "");
}
