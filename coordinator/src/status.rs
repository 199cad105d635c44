//! `octopus status`: how a run is doing.

use std::io::{ErrorKind, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use output::{counted, grouped};
use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use run::errors;
use run::preflight::mib;
use run::report::Diverged;
use run::report::divergence::{CURE, Divergence};
use run::start::bucket;
use run::start::directory::RUNS;
use serde::Serialize;
use serde_json::Value;
use service::client::Client;
use service::http::Token;
use service::live::{
    Best, BucketStatus, HostStatus, LiveStatus, ProcessStatus, RefusedHost, Role, Stages,
};
use store::checkpoint::{CheckpointStore, Name, Ownership};
use store::jsonl;
use store::lock::{LockError, RunLock};
use store::recorded::Recorded;
use store::runs::runs_in;

use crate::values::duration;

const STATUS_EXAMPLES: &str = "\
Examples:
  octopus status
  octopus status runs/trajectory-20260101-120000 --watch
  octopus status runs/trajectory-20260101-120000 --json | jq .live.stages
  octopus status runs/trajectory-20260101-120000 --token-file token.txt

Processes, shards and stages come from the run's HTTP service; if it cannot be asked, standard \
error and the key `live_error` say why.";

/// Options of `octopus status`.
#[derive(Debug, Clone, Args)]
#[command(after_help = STATUS_EXAMPLES)]
pub struct StatusArgs {
    /// The run directory [default: all in runs/].
    pub run_dir: Option<PathBuf>,
    /// Show it again and again, until the run ends or Ctrl-C: every 2 s, or as in --watch=10s.
    #[arg(long, requires = "run_dir", value_name = "TIME", num_args = 0..=1, require_equals = true, default_missing_value = "2", value_parser = duration)]
    pub watch: Option<Duration>,
    /// A file with the token to show [default: http.token of the run directory].
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Print as JSON; with --watch one line each time.
    #[arg(long)]
    pub json: bool,
}

/// What can be said about a run from outside.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunStatus {
    /// Its directory.
    pub run_dir: PathBuf,
    /// `running`, `finished`, or `stopped` before its budget was used up; `unknown` if its lock cannot be read and it is not
    /// finished.
    pub state: &'static str,
    /// Process of its coordinator, while it runs.
    pub pid: Option<u32>,
    /// The task.
    pub task: &'static str,
    /// Iterations done.
    pub iterations: u64,
    /// Iterations planned.
    pub planned_iterations: u64,
    /// The last line of its metrics.
    pub last: Option<Value>,
    /// The newest checkpoint of its own.
    pub checkpoint: Option<PathBuf>,
    /// The bucket that its checkpoints are sent to, if there is one.
    pub bucket: Option<BucketStatus>,
    /// Where the training has diverged, unless it has recovered.
    pub divergence: Option<Diverged>,
    /// What of its files is damaged or missing, so that it may not go on.
    pub damage: Option<String>,
    /// Why it is not known whether it goes on: its lock can be neither read nor tried.
    pub lock_error: Option<String>,
    /// Its processes and stages, while it runs and its HTTP service answers.
    pub live: Option<LiveStatus>,
    /// Why there is no `live`, although the run goes on.
    pub live_error: Option<String>,
}

/// What of a run is in its bucket, as a person reads it.
fn in_bucket(BucketStatus { address, waiting, trouble }: &BucketStatus) -> String {
    let state = match waiting.as_slice() {
        [] => "has all checkpoints".to_owned(),
        [one] => format!("{one} is not sent yet"),
        [newest, ..] => format!("{} are not sent yet, the newest {newest}", waiting.len()),
    };
    let why = trouble.as_ref().map_or_else(String::new, |trouble| format!(": {trouble}"));
    format!("{address}: {state}{why}")
}

/// The token to show to runs instead of their own, and the file that it is from.
struct Key<'a> {
    token: Option<Token>,
    file: Option<&'a Path>,
}

impl RunStatus {
    /// Asks the run, if it goes on, what only it knows.
    fn ask(&mut self, key: &Key<'_>) {
        if self.state != "running" {
            return;
        }
        let answer = Client::of_run(&self.run_dir, key.token.clone())
            .and_then(|client| client.status().map_err(|error| error.explained(key.file)));
        match answer {
            Ok(live) => self.live = Some(live),
            Err(error) => self.live_error = Some(error.to_string()),
        }
    }

    /// What is missing and why.
    fn complaints(&self) -> Vec<String> {
        let told = [
            self.damage.as_ref().map(|damage| format!("note: {damage}")),
            self.lock_error
                .as_ref()
                .map(|reason| format!("note: whether it goes on is not known: {reason}")),
            self.live_error.as_ref().map(|reason| {
                format!("note: processes, shards and stages are not known: {reason}")
            }),
        ];
        told.into_iter().flatten().collect()
    }

    /// Says it on standard error.
    fn complain(&self) {
        self.complaints().iter().for_each(|told| output::note(told));
    }
}

/// Shows one run or all.
pub fn run(args: &StatusArgs) -> anyhow::Result<()> {
    let file = args.token_file.as_deref();
    let key = Key { token: file.map(Token::from_file).transpose()?, file };
    let Some(run_dir) = &args.run_dir else { return list(args.json, &key) };
    let look = || -> anyhow::Result<RunStatus> {
        let mut status = inspect(run_dir)?;
        status.ask(&key);
        Ok(status)
    };
    let Some(interval) = args.watch else {
        let status = look()?;
        if args.json {
            output::json(&status)?;
        } else {
            output::line(&show(&status))?;
        }
        status.complain();
        return Ok(());
    };
    let clear = std::io::stdout().is_terminal() && !args.json;
    let mut complained = Vec::new();
    loop {
        let status = look()?;
        if args.json {
            output::json_line(&status)?;
        } else {
            // From the top left corner, and nothing of before below it.
            if clear {
                output::write(b"\x1b[H\x1b[J")?;
            }
            output::line(&format!("{}{}", show(&status), if clear { "" } else { "\n" }))?;
        }
        // Once, unless it is cleared away with the rest.
        let complaints = status.complaints();
        if clear || complained != complaints {
            status.complain();
            complained = complaints;
        }
        if status.state != "running" {
            return Ok(());
        }
        std::thread::sleep(interval);
    }
}

/// What a person reads.
fn show(status: &RunStatus) -> String {
    let number =
        |pointer: &str| status.last.as_ref().and_then(|last| last.pointer(pointer)?.as_f64());
    let mut lines = vec![
        format!("{:14}{}", "run", status.run_dir.display()),
        format!("{:14}{}", "state", describe(status)),
        format!("{:14}{}", "task", status.task),
        format!("{:14}{} of {}", "iterations", status.iterations, status.planned_iterations),
    ];
    let mut add = |name: &str, pointer: &str, show: &dyn Fn(f64) -> String| {
        if let Some(value) = number(pointer) {
            lines.push(format!("{name:14}{}", show(value)));
        }
    };
    let count = |value: f64| grouped(value as u64);
    add("env-steps", "/env_steps", &count);
    add("env-steps/s", "/env_steps_per_s", &count);
    add("time", "/wall_s", &|seconds| format!("{seconds:.0} s"));
    add("workers", "/workers", &count);
    add("replaced", "/restarts", &count);
    add("return", "/return_mean", &|value| format!("{value:.3}"));
    // Of a task that is not known to this program all errors are shown.
    let task = TaskName::named(status.task);
    if task.is_none_or(TaskName::reaches) {
        add("position", "/errors/position", &|error| format!("{:.1} mm", 1e3 * error));
        add("orientation", "/errors/orientation", &|error| format!("{:.1} mrad", 1e3 * error));
    }
    if task.is_none_or(TaskName::turns) {
        add("attitude", "/errors/base", &|error| format!("{:.1} mrad", 1e3 * error));
    }
    if let Some(digest) = status.last.as_ref().and_then(|last| last["digest"].as_str()) {
        lines.push(format!("{:14}{digest}", "digest"));
    }
    if let Some(checkpoint) = &status.checkpoint {
        lines.push(format!("{:14}{}", "checkpoint", checkpoint.display()));
    }
    if let Some(bucket) = &status.bucket {
        lines.push(format!("{:14}{}", "bucket", in_bucket(bucket)));
    }
    if let Some(diverged) = &status.divergence {
        lines.push(format!("{:14}{diverged}; {CURE}", "warning"));
    }
    if let Some(live) = &status.live {
        lines.push(show_live(live));
    }
    if status.state == "stopped" && status.damage.is_none() {
        let run = output::quoted(&status.run_dir);
        lines.push(format!("{:14}octopus resume {run}", "go on with"));
    }
    lines.join("\n")
}

/// What only the live run knows.
fn show_live(live: &LiveStatus) -> String {
    let Stages { rollout_s, wait_s, update_s, publish_s, digest_s, copy_s, commit_s } = live.stages;
    let share = |seconds: f64| format!("{seconds:.1} s ({:.1} %)", 100.0 * seconds / live.wall_s);
    let totals = &live.accounting;
    let mut lines = vec![
        format!("{:14}{} open, {} in flight", "shards", live.shards_open, live.shards_in_flight),
        format!(
            "{:14}{} produced, {} trained on, {} duplicate, {} lost",
            "accounting",
            grouped(totals.produced),
            grouped(totals.trained),
            grouped(totals.duplicate),
            grouped(totals.lost)
        ),
        format!(
            "{:14}{} resident, of it shared {}",
            "memory",
            mib(live.resident_bytes),
            mib(live.shared_memory_bytes)
        ),
        format!("{:14}{} committed", "checkpoints", live.commits),
    ];
    if let Some(Best { name, score }) = &live.best {
        lines.push(format!("{:14}{name}, score {score:.3}", "best"));
    }
    if let Some(eta) = live.eta_s {
        lines.push(format!("{:14}{:.0} s", "left", eta.ceil()));
    }
    let stages = [
        ("rollout", rollout_s),
        ("wait", wait_s),
        ("update", update_s),
        ("publish", publish_s),
        ("digest", digest_s),
        ("copy", copy_s),
        ("commit", commit_s),
    ];
    lines.push(String::new());
    lines.push(output::table(
        ["stage", "time, share of this session"],
        stages.map(|(name, seconds)| [name.to_owned(), share(seconds)]),
    ));
    lines.push(
        "rollout is summed over the workers; it and commit go on beside the rest, so the\n\
         shares can add up to more than 100 %"
            .to_owned(),
    );
    lines.push(String::new());
    lines.push(processes(&live.processes, output::columns()));
    if !live.hosts.is_empty() {
        lines.push(String::new());
        lines.push(hosts(&live.hosts, output::columns()));
    }
    for RefusedHost { name, reason } in &live.refused_hosts {
        lines.push(String::new());
        lines.push(format!("{name} was thrown out: it {reason}"));
    }
    lines.join("\n")
}

/// The processes of a run as a table.
fn processes(processes: &[ProcessStatus], columns: usize) -> String {
    let rows = processes.iter().map(|process| {
        let name = match (process.role, process.worker) {
            (Role::Coordinator, _) => "coordinator".to_owned(),
            (Role::Learner, _) => "learner".to_owned(),
            (Role::Worker, worker) => format!("worker {}", worker.unwrap_or_default()),
            (Role::Gateway, _) => "gateway".to_owned(),
        };
        let rate = process.env_steps as f64 / process.rollout_s;
        [
            name,
            process.pid.map_or_else(|| "-".to_owned(), |pid| pid.to_string()),
            process.state.clone(),
            process.restarts.to_string(),
            format!("{:.1} s", process.cpu_s),
            mib(process.resident_bytes),
            if rate.is_finite() { grouped(rate as u64) } else { "-".to_owned() },
            process.shards.join(" "),
        ]
    });
    let header = ["process", "pid", "state", "replaced", "cpu", "memory", "steps/s", "shards"];
    output::table_within(columns, header, rows)
}

/// The machines that help a run as a table.
fn hosts(hosts: &[HostStatus], columns: usize) -> String {
    let rows = hosts.iter().map(|host| {
        [
            format!("{} {}", host.host, host.name),
            host.workers.len().to_string(),
            grouped(host.blocks),
            grouped(host.compared),
            mib(host.bytes),
            host.missing.to_string(),
            host.shards.join(" "),
        ]
    });
    let header = ["host", "workers", "blocks", "compared", "came", "missing pieces", "shards"];
    output::table_within(columns, header, rows)
}

fn describe(status: &RunStatus) -> String {
    match status.pid {
        Some(pid) => format!("{} (process {pid})", status.state),
        None => status.state.to_owned(),
    }
}

/// Shows every run in `runs/`.
fn list(json: bool, key: &Key<'_>) -> anyhow::Result<()> {
    let directories = match runs_in(Path::new(RUNS)) {
        Err(error) if is_forbidden(&error) => {
            let message = format!("{RUNS}: cannot be read: {error}");
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        }
        directories => directories.unwrap_or_default(),
    };
    let found = directories.len();
    let mut runs = Vec::new();
    for run_dir in directories {
        match inspect(run_dir.path()) {
            Ok(status) => runs.push(status),
            // One damaged run does not hide the others.
            Err(error) => output::note(&format!("note: {}", errors::told(&error))),
        }
    }
    if json {
        for status in &mut runs {
            status.ask(key);
            status.complain();
        }
        return output::json(&runs);
    }
    if runs.is_empty() && found > 0 {
        return output::line(&format!(
            "none of {} in {RUNS}/ can be read",
            counted(found as u64, "run")
        ));
    }
    if runs.is_empty() {
        return output::line(&format!("no runs in {RUNS}/; `octopus train` starts one"));
    }
    output::line(&listed(&runs, output::columns()))?;
    runs.iter().for_each(RunStatus::complain);
    Ok(())
}

/// Runs as a table.
fn listed(runs: &[RunStatus], columns: usize) -> String {
    let rows = runs.iter().map(|status| {
        let number =
            |pointer: &str| status.last.as_ref().and_then(|last| last.pointer(pointer)?.as_f64());
        let shown = |pointer: &str, show: &dyn Fn(f64) -> String| {
            number(pointer).map_or_else(|| "-".to_owned(), show)
        };
        [
            status.run_dir.display().to_string(),
            status.state.to_owned(),
            format!("{} / {}", status.iterations, status.planned_iterations),
            shown("/env_steps", &|value| grouped(value as u64)),
            shown("/return_mean", &|value| format!("{value:.2}")),
        ]
    });
    let header = ["run", "state", "iterations", "env-steps", "return"];
    output::table_within(columns, header, rows)
}

/// Reads what a run left and whether it lives; does not ask it.
pub fn inspect(path: &Path) -> anyhow::Result<RunStatus> {
    let run_dir = store::run_files::run_directory(path)?;
    store::run_files::check_no_checkpoint(&run_dir, "octopus status")?;
    let config = store::run_files::read_config(&run_dir)?;
    // Looked at before the metrics, which reach every one.
    let store = CheckpointStore::new(run_dir.checkpoints());
    let (checkpoints, entries) = (store.list()?, bucket::entries(&config, &store)?);
    let metrics = run_dir.metrics_jsonl();
    let mut lines = jsonl::read(&metrics)?;
    let divergence = Divergence::of_lines(&lines).found().cloned();
    let recorded = Recorded::of_lines(metrics, &lines).map(Arc::new);
    // What was imported or copied is nothing that the run has done.
    let ownership = Ownership::of_run(recorded.as_ref().ok().cloned());
    let [own, _] = ownership.part(checkpoints);
    let checkpoint = own.into_iter().next();
    let committed = checkpoint.as_deref().map_or(0, iteration_of);
    let last = lines.pop().map(|(_, line)| line);
    let iterations = last.as_ref().and_then(|line| line["iteration"].as_u64()).map_or(0, |k| k + 1);
    let (holder, lock_error) = match RunLock::holder(&run_dir.lock()) {
        // The system's reasons are no damage: rights, or file systems without locks.
        Err(LockError::Unreadable { path, source }) if source.raw_os_error().is_some() => {
            (None, Some(LockError::Unreadable { path, source }.to_string()))
        }
        holder => (holder?, None),
    };
    let planned_iterations = config.planned_iterations();
    // A run that was killed between its last line and its last checkpoint has that still to make.
    let done = iterations.min(committed);
    let state = match &holder {
        Some(_) => "running",
        None if done >= planned_iterations => "finished",
        None if lock_error.is_some() => "unknown",
        None => "stopped",
    };
    Ok(RunStatus {
        run_dir: path.to_owned(),
        state,
        pid: holder.map(|holder| holder.pid),
        task: config.task.name.as_str(),
        iterations,
        planned_iterations,
        last,
        checkpoint,
        bucket: bucket::status(&config, &run_dir, entries, &ownership)?,
        divergence,
        damage: damage(recorded, committed),
        lock_error,
        live: None,
        live_error: None,
    })
}

fn is_forbidden(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::PermissionDenied
}

/// What the metrics of a run lack that has committed a checkpoint of this iteration.
fn damage(recorded: Result<Arc<Recorded>, ExitError>, committed: u64) -> Option<String> {
    match recorded {
        Err(error) => Some(error.message),
        Ok(recorded) if recorded.iterations() < committed => Some(format!(
            "{}: holds {} of {committed} iterations that are committed; put it back from a copy",
            recorded.path().display(),
            recorded.iterations(),
        )),
        Ok(_) => None,
    }
}

/// The iteration that a checkpoint of a run is named for.
fn iteration_of(dir: &Path) -> u64 {
    let name = dir.file_name().and_then(|name| name.to_str());
    name.and_then(|name| name.parse::<Name>().ok()?.iteration()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};
    use proto::run_dir::RunDir;

    use super::*;

    #[test]
    fn tables_fit() {
        let process = ProcessStatus {
            role: Role::Worker,
            worker: Some(255),
            pid: Some(4_194_304),
            state: "backing off".to_owned(),
            restarts: 12,
            resident_bytes: 9_999 << 20,
            cpu_s: 123_456.7,
            shards: (0..6).map(|shard| format!("12345/{shard}")).collect(),
            env_steps: 99_999,
            rollout_s: 1.0,
        };
        let run = RunStatus {
            run_dir: "runs/reorientation-20260101-120000-2".into(),
            state: "running",
            pid: Some(4_194_304),
            task: "reorientation",
            iterations: 1234,
            planned_iterations: 12_345,
            bucket: None,
            divergence: None,
            damage: None,
            lock_error: None,
            last: Some(serde_json::json!({ "env_steps": 99_999_999, "return_mean": -1234.56 })),
            checkpoint: None,
            live: None,
            live_error: None,
        };
        let of_processes = processes(&[process], 80);
        assert!(of_processes.contains("12345/0") && of_processes.contains("12345/5"));
        let of_runs = listed(&[run], 80);
        assert!(!of_runs.contains("\n\n"), "all columns stand beside each other:\n{of_runs}");
        for line in of_processes.lines().chain(of_runs.lines()) {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }

    /// It has a configuration as a run has, but `octopus resume` refuses it.
    #[test]
    fn a_checkpoint_is_no_stopped_run() {
        let dir = tempfile::tempdir().expect("tempdir");
        let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        std::fs::write(RunDir::new(dir.path()).config(), config.to_toml()).expect("writable");
        assert!(inspect(dir.path()).is_ok());
        std::fs::write(dir.path().join(store::checkpoint::MANIFEST), "{}").expect("writable");
        let told = inspect(dir.path()).expect_err("a checkpoint").to_string();
        assert!(told.contains("is a checkpoint, not a run directory"), "{told}");
        assert!(told.contains("octopus eval"), "{told}");
    }

    #[test]
    fn a_run_is_finished_when_its_last_checkpoint_is_there() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        let mut config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        config.run.env_steps = 2 * config.steps_per_iteration();
        std::fs::write(run_dir.config(), config.to_toml()).expect("writable");
        let lines = "{\"iteration\":0}\n{\"iteration\":1}\n";
        std::fs::write(run_dir.metrics_jsonl(), lines).expect("writable");
        let state = || inspect(dir.path()).expect("a run").state;
        assert_eq!(state(), "stopped", "without any checkpoint");
        for (name, expected) in
            [("iteration-00000001", "stopped"), ("iteration-00000002", "finished")]
        {
            std::fs::create_dir_all(run_dir.checkpoints().join(name)).expect("writable");
            assert_eq!(state(), expected, "{name}");
        }
    }

    /// It would be refused.
    #[test]
    fn a_run_without_its_metrics_is_not_told_to_go_on() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        std::fs::write(run_dir.config(), config.to_toml()).expect("writable");
        std::fs::create_dir_all(run_dir.checkpoints().join("iteration-00000001")).expect("made");
        let digest = "0".repeat(32);
        let whole = format!("{{\"iteration\":0,\"digest\":\"{digest}\"}}\n");
        for (text, damage) in [
            (&*whole, None),
            ("garbage", Some("holds 0 of 1 iterations")),
            ("{}\n", Some("line 1: is of iteration null")),
        ] {
            std::fs::write(run_dir.metrics_jsonl(), text).expect("writable");
            let status = inspect(dir.path()).expect("a run");
            let said = status.damage.as_deref();
            assert!(said.is_some() == damage.is_some(), "{said:?}");
            assert!(damage.is_none_or(|words| said.is_some_and(|said| said.contains(words))));
            assert_eq!(show(&status).contains("octopus resume"), damage.is_none());
        }
    }
}
