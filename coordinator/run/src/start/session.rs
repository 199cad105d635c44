//! A session of a run, from its first word to its last.

use anyhow::Context as _;
use channels::Domain;
use output::grouped;
use proto::config::Config;
use proto::run_dir::RunDir;
use simulator::robot::Robot;
use store::checkpoint::Checkpoint;
use store::lock::RunLock;
use store::provenance::Provenance;

use super::bucket;
use super::service::{Listening, RunService};
use crate::report::Reporter;
use crate::session::{self, RunResult, SessionSpec, StoppedBy};
use crate::signals::StopRequests;
use crate::supervisor::{GatewaySpec, Programs};

/// What a session starts from, of a new run or of an old one.
#[derive(Debug)]
pub struct Start {
    /// Where results land; it exists, and is locked.
    pub run_dir: RunDir,
    /// The resolved configuration.
    pub config: Config,
    /// The robot.
    pub robot: Robot,
    /// Where to go on from.
    pub resume: Option<Checkpoint>,
    /// The children's programs.
    pub programs: Programs,
    /// Where it is open to other machines, if it is.
    pub gateway: Option<GatewaySpec>,
    /// The name of the run's shared memory.
    pub domain: Domain,
    /// Which program and machine this is.
    pub provenance: Provenance,
    /// The run's HTTP service.
    pub service: RunService,
    /// Iterations of the whole run after which the session pauses; none where it goes to the end of the budget.
    pub pause_at: Option<u64>,
}

/// A session that has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its directory.
    pub run_dir: RunDir,
    /// How it ended.
    pub outcome: RunResult,
    /// Who asked it to stop.
    pub stop: StopRequests,
}

/// Runs a session to its end.
pub fn run_session(start: Start, mut lock: RunLock, quiet: bool) -> anyhow::Result<Ended> {
    let Start {
        run_dir,
        config,
        robot,
        resume,
        programs,
        gateway,
        domain,
        provenance,
        service,
        pause_at,
    } = start;
    let stop = StopRequests::new();
    stop.listen_and_insist(ABANDONED).context("signals cannot be caught")?;
    let resume_from = resume.as_ref().map(|checkpoint| checkpoint.manifest.iteration);
    let reporter = Reporter::create(&run_dir, &config, resume_from, quiet)?;
    let mut reporter = reporter.watched(service.live.clone());
    if !quiet {
        reporter.note(&introduction(&config, &run_dir, resume_from));
    }
    if let Some(note) = idle_workers(&config) {
        reporter.note(&note);
    }
    let mirror = bucket::start(&config, &run_dir, &service.live)?;
    if let Some(gateway) = &gateway
        && !quiet
    {
        reporter.note(&format!(
            "other machines help by `octopus join {}`, with the address of this one",
            gateway.listen
        ));
        if config.run.workers == 0 {
            reporter.note("there are no workers here: the run waits until a machine has joined");
        }
    }
    let RunService { live, mut listening } = service;
    if let Some(Listening { service, token }) = &mut listening {
        // Whoever reads the address finds the token.
        token.keep()?;
        lock.announce(&service.address().to_string())
            .with_context(|| format!("{}: cannot be written", run_dir.lock().display()))?;
        if !quiet && service::page::is_built() {
            // Without the token: what a training prints may lie where others read it.
            let (place, address) = (output::quoted(run_dir.path()), service.address());
            reporter.note(&format!(
                "`octopus view {place}` prints the address that shows it in a browser, at http://{address}/"
            ));
        }
    }
    let spec = SessionSpec {
        run_dir: run_dir.clone(),
        config,
        robot,
        resume,
        programs,
        gateway,
        provenance: serde_json::to_value(provenance).context("provenance has no JSON form")?,
        domain,
        stop: stop.clone(),
        until: pause_at,
        live,
    };
    let result = session::run(&spec, &mut reporter);
    if let Some(Listening { service, .. }) = listening {
        service.stop();
    }
    // What was committed until then is worth sending, whatever ended the run.
    if let Some(note) = bucket::finish(mirror, &spec.config, &run_dir, || stop.count() < 2) {
        reporter.note(&note);
    }
    // Also after a failure: what was measured until then is worth keeping.
    let finished = reporter.finish();
    let outcome = result?;
    finished?;
    Ok(Ended { run_dir, outcome, stop })
}

/// What a second request to stop says if something in this process does not end.
pub const ABANDONED: &str = "stopped at once; what was being written is abandoned; `octopus resume` goes on from the last \
     checkpoint, if there is one";

fn introduction(config: &Config, run_dir: &RunDir, resume_from: Option<u64>) -> String {
    let task = config.task.name.as_str();
    let planned = config.planned_iterations();
    let what = match resume_from {
        // Counted from 1, as the lines below it are.
        Some(done) if done + 1 == planned => format!("{task}: iteration {planned}"),
        Some(done) => format!("{task}: iterations {} to {planned}", done + 1),
        None => format!("{task}: {}", output::counted(planned, "iteration")),
    };
    let workers = config.run.workers;
    format!(
        "{what} of {} env-steps, {workers} worker{}, in {}",
        grouped(config.steps_per_iteration()),
        if workers == 1 { "" } else { "s" },
        run_dir.path().display()
    )
}

impl Ended {
    /// Of a run that was where it should end already, with its last checkpoint.
    pub fn before(run_dir: RunDir, last: &Checkpoint) -> Self {
        let is_whole = last.manifest.iteration >= last.config.planned_iterations();
        let outcome = RunResult {
            iterations: last.manifest.iteration,
            env_steps: last.manifest.env_steps,
            stopped_by: if is_whole { StoppedBy::Budget } else { StoppedBy::Pause },
            checkpoint: last.dir.clone(),
        };
        Self { run_dir, outcome, stop: StopRequests::new() }
    }

    /// Whether anybody asked it to stop, also where it was about to end anyway.
    pub fn was_interrupted(&self) -> bool {
        self.stop.count() > 0
    }
}

/// Says so if there are more workers than an iteration has shards.
fn idle_workers(config: &Config) -> Option<String> {
    let (workers, shards) = (config.run.workers, config.env.n_shards);
    (workers > shards).then(|| {
        format!(
            "note: an iteration has {}, so that {} of the {workers} workers will be idle; \
             --envs N --set env.n_shards={workers} makes work for all, and another training",
            output::counted(shards as u64, "shard"),
            workers - shards
        )
    })
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn more_workers_than_shards_are_said_to_be_idle() {
        let note = |workers: &str| {
            let sets = [workers, "env.n_shards=4"];
            let layers =
                sets.iter().try_fold(Layers::new(Preset::Tuned, None), |l, set| l.set(set));
            idle_workers(&layers.and_then(|layers| layers.resolve()).expect("valid"))
        };
        let five = note("run.workers=5").expect("one is idle");
        assert!(five.contains("4 shards, so that 1 of the 5 workers"), "{five}");
        assert_eq!(note("run.workers=4"), None);
    }

    /// The progress shows `iteration 2/3` for the first that is made after one is done.
    #[test]
    fn a_session_that_goes_on_says_what_it_makes() {
        let mut config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        config.run.env_steps = 3 * config.steps_per_iteration();
        let said = |done| introduction(&config, &RunDir::new("runs/a"), done);
        assert!(said(None).starts_with("trajectory: 3 iterations of "), "{}", said(None));
        assert!(
            said(Some(1)).starts_with("trajectory: iterations 2 to 3 of "),
            "{}",
            said(Some(1))
        );
        assert!(said(Some(2)).starts_with("trajectory: iteration 3 of "), "{}", said(Some(2)));
    }
}
