//! A whole training, and the memory of its processes.

use std::fs::File;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use proto::ExitError;
use proto::config::Config;
use proto::run_dir::RunDir;
use run::environment;
use run::supervisor::{child_exit_code, log_tail};
use rustix::process::{Pid, Signal, kill_process};
use store::jsonl;

use super::child::Running;
use super::context::Bench;
use super::figures::{Figure, Figures};
use super::learner::BEST;
use super::peer::Peers;
use crate::threads::Threads;

/// Iterations that count, at least; the first one does not.
const ITERATIONS: usize = 3;
/// How often the metrics are looked at.
const LOOK: Duration = Duration::from_millis(20);
/// How long a run may take to end.
const PATIENCE: Duration = Duration::from_mins(1);

/// Figures `train.*` and `memory.*`.
pub(super) fn measure(
    bench: &Bench,
    peers: Option<&Peers>,
    figures: &mut Figures,
) -> anyhow::Result<()> {
    let workers = bench.config.run.workers;
    bench.begin("train")?;
    let measured = training(bench, workers)?;
    let cores = workers.min(Threads::available().count()) as f64;
    let parts = |rollout: f64, rest: f64| 1.0 / (1.0 / (cores * rollout) + rest);
    let floor = figures
        .value("rollout.env_steps_per_s_per_core")
        .zip(figures.value(BEST))
        .and_then(|(rollout, learner)| {
            let processors = Threads::available().count() as f64;
            floor(&bench.config, processors, 1.0 / (cores * rollout), 1.0 / learner)
        });
    let peer = match peers {
        None => None,
        Some(peers) => {
            let torch = peers.torch(bench)?;
            let mujoco = peers.known_mujoco(bench)?;
            Some(parts(mujoco, 1.0 / torch.learner + 1.0 / torch.inference))
        }
    };
    let figure = Figure::rate("train.env_steps_per_s", "env-steps/s", measured.env_steps_per_s);
    figures.push(figure.peer(peer).floor(floor));
    figures.push(Figure::rate("train.iterations", "iterations", measured.iterations as f64));
    figures.push(Figure::rate("train.workers", "processes", workers as f64));
    for (kind, of) in [("rss", Memory::rss as fn(&Memory) -> f64), ("pss", Memory::pss)] {
        let sum = measured.memory.iter().map(|(_, memory)| of(memory)).sum();
        figures.push(Figure::cost(format!("memory.{kind}_mib"), "MiB", sum));
        for (name, memory) in &measured.memory {
            let key = format!("memory.{name}.{kind}_mib");
            figures.push(Figure::cost(key, "MiB", of(memory)));
        }
    }
    Ok(())
}

/// Env-steps/s of a training that consists of nothing but its rollout and its update (s per env-step). None where the limit on the
/// divergence may hold actors back: what is not computed has no floor.
fn floor(config: &Config, processors: f64, rollout: f64, learner: f64) -> Option<f64> {
    let run = &config.run;
    if config.algorithm.max_kl > 0.0 {
        return None;
    }
    let one_after_the_other = rollout + learner;
    if run.overlap == 0 {
        return Some(1.0 / one_after_the_other);
    }
    // Side by side, as far as there are processors for both.
    let (workers, threads) = (run.workers as f64, run.learner_threads as f64);
    let work = rollout * workers.min(processors) + learner * threads.min(processors);
    Some(1.0 / rollout.max(learner).max(work / processors))
}

/// What a run did.
pub(super) struct Training {
    pub(super) env_steps_per_s: f64,
    iterations: usize,
    memory: Vec<(String, Memory)>,
}

/// Runs `octopus train` for as long as needed.
pub(super) fn training(bench: &Bench, workers: usize) -> anyhow::Result<Training> {
    let dir = tempfile::Builder::new()
        .prefix("train-")
        .tempdir_in(bench.scratch.path())
        .context("a temporary directory cannot be made")?;
    let run_dir = RunDir::new(dir.path().join("run"));
    let mut run = Run::start(bench, &run_dir, dir.path(), workers)?;
    let begun = Instant::now();
    let (env_steps_per_s, iterations) = loop {
        bench.go_on()?;
        run.check()?;
        let lines: Vec<(f64, f64)> = jsonl::read(&run_dir.metrics_jsonl())?
            .iter()
            .filter_map(|(_, line)| Some((line["env_steps"].as_f64()?, line["wall_s"].as_f64()?)))
            .collect();
        if let (Some(first), Some(last)) = (lines.first(), lines.last())
            && lines.len() > ITERATIONS
            && last.1 - first.1 >= bench.seconds
        {
            break ((last.0 - first.0) / (last.1 - first.1), lines.len() - 1);
        }
        if begun.elapsed() > Duration::from_hours(2) {
            anyhow::bail!("the training did not get through {ITERATIONS} iterations in two hours");
        }
        std::thread::sleep(LOOK);
    };
    let memory = processes(run_dir.path())
        .into_iter()
        .filter_map(|(pid, name)| Some((name, Memory::of(pid)?)))
        .collect();
    run.stop();
    Ok(Training { env_steps_per_s, iterations, memory })
}

/// A training that ends with its owner, and leaves no shared memory behind.
struct Run {
    process: Running,
    log: std::path::PathBuf,
    ended: bool,
}

impl Run {
    fn start(bench: &Bench, run_dir: &RunDir, dir: &Path, workers: usize) -> anyhow::Result<Self> {
        let log = dir.join("train.log");
        let file = File::create(&log).with_context(|| log.display().to_string())?;
        let mut command = Command::new(std::env::current_exe().context("no program")?);
        environment::clean(&mut command);
        let child = command
            .args(["train", "--no-eval", "--quiet", "--listen=off"])
            // Killed with this process; its janitor then cleans up.
            .args(["--parent", &std::process::id().to_string()])
            .arg("--run-dir")
            .arg(run_dir.path())
            .args(&bench.train_args)
            // The last one wins.
            .args([format!("--set=run.workers={workers}"), "--set=run.evaluate_every=0".to_owned()])
            .args(["--env-steps=1e15", "--set=run.checkpoint_every_s=1e6"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(file)
            .process_group(0)
            .spawn()
            .context("octopus cannot be started")?;
        Ok(Self { process: Running(child), log, ended: false })
    }

    /// Refuses a run that has ended by itself.
    fn check(&mut self) -> anyhow::Result<()> {
        let Some(status) = self.process.0.try_wait().context("a child cannot be waited for")?
        else {
            return Ok(());
        };
        self.ended = true;
        let end = log_tail(&self.log, 5);
        Err(ExitError::new(
            child_exit_code(status),
            format!("the training ended ({status}):\n{end}"),
        )
        .into())
    }

    fn signal(&self) {
        if let Some(pid) = i32::try_from(self.process.0.id()).ok().and_then(Pid::from_raw) {
            let _ = kill_process(pid, Signal::INT);
        }
    }

    /// Stops at once: the second request does. What does not obey is killed by the owner, and its
    /// janitor cleans up.
    fn stop(&mut self) {
        if std::mem::replace(&mut self.ended, true) {
            return;
        }
        let begun = Instant::now();
        let mut asked = 0;
        while begun.elapsed() < PATIENCE && matches!(self.process.0.try_wait(), Ok(None)) {
            // One by one: signals that come together are one signal.
            if asked < 2 {
                self.signal();
                asked += 1;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Processes of the run in `dir`: id, and what it is. All have the directory on their command line.
fn processes(dir: &Path) -> Vec<(u32, String)> {
    let dir = dir.display().to_string();
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Ok(pid) = entry.file_name().to_string_lossy().parse::<u32>() else { continue };
        let line = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).into_owned();
        let words: Vec<&str> = line.split('\0').collect();
        if !words.contains(&dir.as_str()) {
            continue;
        }
        let after =
            |flag: &str| words.iter().position(|w| *w == flag).and_then(|at| words.get(at + 1));
        let name = match (after("--worker"), words.get(1)) {
            (Some(worker), _) => format!("worker_{worker}"),
            (None, Some(&"train")) => "coordinator".to_owned(),
            _ => "learner".to_owned(),
        };
        found.push((pid, name));
    }
    found.sort_by(|a, b| a.1.cmp(&b.1));
    found
}

/// Memory of a process (MiB).
#[derive(Debug, Clone, Copy)]
struct Memory {
    /// Resident, shared memory and libraries in full.
    rss: f64,
    /// Resident, what is shared divided by who shares it.
    pss: f64,
}

impl Memory {
    fn of(pid: u32) -> Option<Self> {
        let read = |file: &str, key: &str| {
            let text = std::fs::read_to_string(format!("/proc/{pid}/{file}")).ok()?;
            let line = text.lines().find_map(|line| line.strip_prefix(key))?;
            Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0)
        };
        Some(Self { rss: read("status", "VmRSS:")?, pss: read("smaps_rollup", "Pss:")? })
    }

    fn rss(&self) -> f64 {
        self.rss
    }

    fn pss(&self) -> f64 {
        self.pss
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_training_takes_its_rollout_and_its_update_at_least() {
        use proto::config::{Layers, Preset};

        let floor = |overlap: u32, max_kl: f64, processors: f64| {
            let sets = [
                format!("run.overlap={overlap}"),
                format!("algorithm.max_kl={max_kl}"),
                "run.workers=2".to_owned(),
                "run.learner_threads=2".to_owned(),
            ];
            let layers = Layers::new(Preset::Tuned, None);
            let layers = sets.iter().try_fold(layers, |layers, set| layers.set(set));
            let config = layers.and_then(|layers| layers.resolve()).expect("valid");
            // A quarter and an eighth of a second an env-step.
            super::floor(&config, processors, 0.25, 0.125)
        };
        assert_eq!(floor(0, 0.0, 2.0), Some(1.0 / 0.375), "one after the other");
        assert_eq!(floor(1, 0.0, 4.0), Some(4.0), "side by side the longer one counts");
        // Two workers and two threads on two processors take turns.
        assert_eq!(floor(1, 0.0, 2.0), Some(1.0 / 0.375));
        // On three: (2 · 0.25 + 2 · 0.125) / 3 is a quarter.
        assert_eq!(floor(1, 0.0, 3.0), Some(4.0));
        assert_eq!(floor(0, 0.1, 2.0), None, "what is held back has no floor");
    }

    #[test]
    fn a_process_has_memory() {
        let memory = Memory::of(std::process::id()).expect("Linux tells");
        assert!(memory.rss >= memory.pss && memory.pss > 1.0, "{memory:?}");
    }
}
