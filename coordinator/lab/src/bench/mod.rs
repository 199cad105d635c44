//! How fast this machine simulates, learns and transports.

mod arithmetic;
mod child;
mod figures;
mod growth;
mod learner;
mod load;
mod peer;
mod physics;
mod picture;
mod processor;
mod rollout;
mod train;
mod transport;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::config::{Config, Layers, Preset};
use proto::layout::Dimensions;
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use run::precision;
use run::report::progress::Stages;
use run::signals::StopRequests;
use run::supervisor::Programs;
use serde_json::Value;
use simulator::env::step_options;
use simulator::robot::Robot;
use store::outputs::Output;
use store::provenance::Provenance;
use tempfile::TempDir;

use self::figures::Figures;
use self::load::{Load, Watch};
use self::peer::Peers;

/// What `octopus train` trains unless told otherwise.
pub const TRAINED: Preset = Preset::Tuned;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// Everything but growth.
    All,
    /// The simulator alone.
    Physics,
    /// Whole rollouts.
    Rollout,
    /// Updates.
    Learner,
    /// A block from a worker to the learner.
    Transport,
    /// A whole training.
    Train,
    /// How the figures change with sizes.
    Growth,
}

/// What is asked of a measurement.
#[derive(Debug, Clone)]
pub struct Study {
    /// What is measured.
    pub subject: Subject,
    /// The configuration to start from.
    pub preset: Preset,
    /// Keys that are changed, `key=value`.
    pub sets: Vec<String>,
    /// Workers of a training.
    pub workers: u64,
    /// How long each figure is measured (s).
    pub seconds: f64,
    /// The Python that has the peers, if these are measured, too.
    pub peers: Option<PathBuf>,
    /// Where pictures of growth go.
    pub pictures: Option<PathBuf>,
    /// Whether pictures may replace what others made.
    pub force: bool,
}

/// What was measured.
#[derive(Debug)]
pub struct Measured {
    /// As a person reads it.
    pub table: String,
    /// As programs do, with what the figures depend on.
    pub json: Value,
}

/// Measures.
pub fn measure(study: &Study) -> anyhow::Result<Measured> {
    let bench = Bench::new(study)?;
    let load = Watch::begin();
    if study.subject == Subject::Growth {
        let curves = growth::measure(&bench)?;
        let load = load.so_far();
        if let Some(dir) = &study.pictures {
            picture::draw_all(dir, &curves)?;
        }
        bench.stages.end();
        let table = bench.framed(&growth::table(&curves), &load);
        return Ok(Measured { table, json: bench.with_context(growth::to_json(&curves), &load) });
    }
    let mut figures = Figures::default();
    let wants = |subject| study.subject == Subject::All || study.subject == subject;
    if wants(Subject::Physics) {
        physics::measure(&bench, &mut figures)?;
    }
    if wants(Subject::Rollout) {
        rollout::measure(&bench, &mut figures)?;
    }
    if wants(Subject::Learner) {
        learner::measure(&bench, &mut figures)?;
    }
    if wants(Subject::Transport) {
        transport::measure(&bench, &mut figures)?;
    }
    if wants(Subject::Train) {
        train::measure(&bench, &mut figures)?;
    }
    bench.stages.end();
    let load = load.so_far();
    figures.check(&load.sentence())?;
    let table = bench.framed(&figures.table(), &load);
    Ok(Measured { table, json: bench.with_context(figures.to_json(), &load) })
}

/// What all measurements share.
struct Bench {
    preset: Preset,
    /// The command line's configuration, open for changes.
    layers: Layers,
    config: Config,
    robot: Robot,
    dimensions: Dimensions,
    seconds: f64,
    /// Arguments of `octopus train` for the same configuration.
    train_args: Vec<String>,
    peers: Option<Peers>,
    stop: StopRequests,
    /// A directory that goes away in the end.
    scratch: TempDir,
    stages: Stages,
}

impl Bench {
    fn new(study: &Study) -> anyhow::Result<Self> {
        let preset = study.preset;
        let workers = format!("[run]\nworkers = {}", study.workers);
        let mut layers = Layers::new(preset, None).text(&workers, "--workers")?;
        for assignment in &study.sets {
            layers = layers.set(assignment)?;
        }
        let config = precision::resolve(layers.resolve()?);
        for name in study.pictures.iter().flat_map(|_| growth::NAMES) {
            let dir = study.pictures.as_deref().unwrap_or(Path::new("."));
            let path = picture::path(dir, name);
            let read = ("--set robot.description", Path::new(&config.robot.description));
            let mark = b"<svg";
            Output { flag: "--pictures", path: &path, mark, force: study.force }.check(&[read])?;
        }
        let robot = run::robots::load_fit_robot(&config.robot.description, &step_options(&config))?;
        let mut train_args =
            vec![format!("--preset={}", preset.as_str()), format!("--workers={}", study.workers)];
        train_args.extend(study.sets.iter().map(|assignment| format!("--set={assignment}")));
        let peers = study.peers.as_deref().map(Peers::find).transpose()?;
        let stop = StopRequests::new();
        stop.listen().context("signals cannot be caught")?;
        let scratch = tempfile::Builder::new().prefix("octopus-bench-").tempdir();
        Ok(Self {
            dimensions: Dimensions::new(&config, robot.n_arms),
            preset,
            layers,
            config,
            robot,
            seconds: study.seconds,
            train_args,
            peers,
            stop,
            scratch: scratch.context("a temporary directory cannot be made")?,
            stages: Stages::new(),
        })
    }

    /// The configuration with some keys changed.
    fn config_with(&self, changes: &[&str]) -> Result<Config, ConfigError> {
        let layers =
            changes.iter().try_fold(self.layers.clone(), |layers, change| layers.set(change))?;
        layers.resolve().map(precision::resolve)
    }

    /// The configuration with some keys changed, in which updates leave nothing out: actors that diverge too much would be held
    /// back, and how often that happens on synthetic blocks says nothing.
    fn whole(&self, changes: &[&str]) -> Result<Config, ConfigError> {
        self.config_with(&[changes, &["algorithm.max_kl=0"][..]].concat())
    }

    /// A table with what it depends on.
    fn framed(&self, table: &str, load: &Load) -> String {
        let run = &self.config.run;
        let other = if self.preset == TRAINED {
            String::new()
        } else {
            format!("; `octopus train` takes {} unless told otherwise", TRAINED.as_str())
        };
        let header = format!(
            "preset {}, {}, learner in {}{other}",
            self.preset.as_str(),
            output::counted(run.workers as u64, "worker"),
            precision::name(run.precision),
        );
        format!("{}\n\n{table}\n\n{}", output::wrap(&header), output::wrap(&load.sentence()))
    }

    /// Says what is measured now; an error after Ctrl-C.
    fn begin(&self, stage: &str) -> Result<(), ExitError> {
        self.stages.begin(&format!("measuring {stage}"));
        self.go_on()
    }

    /// An error after Ctrl-C.
    fn go_on(&self) -> Result<(), ExitError> {
        if self.stop.count() == 0 {
            return Ok(());
        }
        Err(ExitError::new(ExitCode::Interrupted, "stopped; nothing is left of the measurement"))
    }

    fn programs() -> Result<Programs, ExitError> {
        Programs::find()
    }

    /// A directory that a learner takes for a run's: with this configuration and the robot.
    fn run_dir(&self, config: &Config) -> anyhow::Result<RunDir> {
        // Beside the trainings, none of which may lie in a run.
        let run_dir = RunDir::new(self.scratch.path().join("learner"));
        std::fs::create_dir_all(run_dir.path())
            .with_context(|| format!("{}: cannot be made", run_dir.path().display()))?;
        for (path, text) in
            [(run_dir.config(), config.to_toml()), (run_dir.robot(), self.robot.to_toml())]
        {
            std::fs::write(&path, text)
                .with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        Ok(run_dir)
    }

    /// Processors that this process may use.
    fn processors() -> usize {
        std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
    }

    /// Adds what the figures depend on.
    fn with_context(&self, mut figures: Value, load: &Load) -> Value {
        figures["preset"] = self.preset.as_str().into();
        figures["load"] = serde_json::to_value(load).unwrap_or_default();
        figures["provenance"] = serde_json::to_value(Provenance::gather()).unwrap_or_default();
        figures["config"] = serde_json::to_value(&self.config).unwrap_or_default();
        figures
    }
}
