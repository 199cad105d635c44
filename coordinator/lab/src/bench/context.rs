//! What all measurements share: the configuration, a directory of their own, and what a report says beside the figures.

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
use store::provenance::Provenance;
use store::scratch::Scratch;

use super::load::Load;
use super::study::{Study, TRAINED};

/// What all measurements share.
pub(super) struct Bench {
    preset: Preset,
    /// The command line's configuration, open for changes.
    layers: Layers,
    pub(super) config: Config,
    pub(super) robot: Robot,
    pub(super) dimensions: Dimensions,
    pub(super) seconds: f64,
    /// Arguments of `octopus train` for the same configuration.
    pub(super) train_args: Vec<String>,
    pub(super) stop: StopRequests,
    /// A directory that goes away in the end.
    pub(super) scratch: Scratch,
    pub(super) stages: Stages,
}

impl Bench {
    /// Reads the configuration and its robot, and makes the directory. Ctrl-C ends measurements from now on.
    pub(super) fn new(study: &Study) -> anyhow::Result<Self> {
        let preset = study.preset;
        let workers = format!("[run]\nworkers = {}", study.workers);
        let mut layers = Layers::new(preset, None).text(&workers, "--workers")?;
        for assignment in &study.sets {
            layers = layers.set(assignment)?;
        }
        let config = precision::resolve(layers.resolve()?);
        let robot = run::robots::load_fit_robot(&config.robot.description, &step_options(&config))?;
        let mut train_args =
            vec![format!("--preset={}", preset.as_str()), format!("--workers={}", study.workers)];
        train_args.extend(study.sets.iter().map(|assignment| format!("--set={assignment}")));
        let stop = StopRequests::new();
        stop.listen().context("signals cannot be caught")?;
        let scratch = Scratch::new("bench");
        Ok(Self {
            dimensions: Dimensions::new(&config, robot.joints),
            preset,
            layers,
            config,
            robot,
            seconds: study.seconds,
            train_args,
            stop,
            scratch: scratch.context("a temporary directory cannot be made")?,
            stages: Stages::new(),
        })
    }

    /// The configuration with some keys changed.
    pub(super) fn config_with(&self, changes: &[&str]) -> Result<Config, ConfigError> {
        let layers =
            changes.iter().try_fold(self.layers.clone(), |layers, change| layers.set(change))?;
        layers.resolve().map(precision::resolve)
    }

    /// The configuration with some keys changed, in which updates leave nothing out: actors that diverge too much would be held
    /// back, and how often that happens on synthetic blocks says nothing.
    pub(super) fn whole(&self, changes: &[&str]) -> Result<Config, ConfigError> {
        self.config_with(&[changes, &["algorithm.max_kl=0"][..]].concat())
    }

    /// A table with what it depends on.
    pub(super) fn framed(&self, table: &str, load: &Load) -> String {
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
    pub(super) fn begin(&self, stage: &str) -> Result<(), ExitError> {
        self.stages.begin(&format!("measuring {stage}"));
        self.go_on()
    }

    /// An error after Ctrl-C.
    pub(super) fn go_on(&self) -> Result<(), ExitError> {
        if self.stop.count() == 0 {
            return Ok(());
        }
        Err(ExitError::new(ExitCode::Interrupted, "stopped; nothing is left of the measurement"))
    }

    /// The programs beside this one.
    pub(super) fn programs() -> Result<Programs, ExitError> {
        Programs::find()
    }

    /// A directory that a learner takes for a run's: with this configuration and the robot.
    pub(super) fn run_dir(&self, config: &Config) -> anyhow::Result<RunDir> {
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

    /// Adds what the figures depend on.
    pub(super) fn with_context(&self, mut figures: Value, load: &Load) -> Value {
        figures["preset"] = self.preset.as_str().into();
        figures["load"] = serde_json::to_value(load).unwrap_or_default();
        figures["provenance"] = serde_json::to_value(Provenance::gather()).unwrap_or_default();
        figures["config"] = serde_json::to_value(&self.config).unwrap_or_default();
        figures
    }
}
