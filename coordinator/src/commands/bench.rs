//! `octopus bench`: how fast this machine simulates, learns and transports.

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

use std::path::Path;

use anyhow::Context as _;
use proto::config::{Config, Layers, Preset};
use proto::layout::Dimensions;
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use serde_json::Value;
use simulator::env::step_options;
use simulator::robot::Robot;
use tempfile::TempDir;

use self::figures::Figures;
use self::load::{Load, Watch};
use self::peer::Peers;
use crate::cli::bench::{BenchArgs, Subject};
use crate::outputs::Output;
use crate::provenance::Provenance;
use crate::report::progress::Stages;
use crate::signals::StopRequests;
use crate::supervisor::Programs;
use crate::{output, precision};

/// What `octopus train` trains unless told otherwise.
const TRAINED: Preset = Preset::Tuned;

/// Measures and prints.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let bench = Bench::new(args)?;
    let load = Watch::begin();
    if args.subject == Subject::Growth {
        let curves = growth::measure(&bench)?;
        let load = load.so_far();
        if let Some(dir) = &args.pictures {
            picture::draw_all(dir, &curves)?;
        }
        bench.stages.end();
        return if args.json {
            output::json(&bench.with_context(growth::to_json(&curves), &load))
        } else {
            output::line(&bench.framed(&growth::table(&curves), &load))
        };
    }
    let mut figures = Figures::default();
    let wants = |subject| args.subject == Subject::All || args.subject == subject;
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
    if args.json {
        output::json(&bench.with_context(figures.to_json(), &load))
    } else {
        output::line(&bench.framed(&figures.table(), &load))
    }
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
    fn new(args: &BenchArgs) -> anyhow::Result<Self> {
        let growth = args.subject == Subject::Growth;
        for (given, flag, cure) in [
            (growth && args.peer, "--peer", "leave it out"),
            (!growth && args.pictures.is_some(), "--pictures", "it is for `octopus bench growth`"),
        ] {
            if given {
                let message = format!("{flag} has no meaning here; {cure}");
                return Err(ExitError::new(ExitCode::Usage, message).into());
            }
        }
        let preset: Preset = args.preset.into();
        let workers = format!("[run]\nworkers = {}", args.workers);
        let mut layers = Layers::new(preset, None).text(&workers, "--workers")?;
        for assignment in &args.sets {
            layers = layers.set(assignment)?;
        }
        let config = precision::resolve(layers.resolve()?);
        for name in args.pictures.iter().flat_map(|_| growth::NAMES) {
            let dir = args.pictures.as_deref().unwrap_or(Path::new("."));
            let path = picture::path(dir, name);
            let read = ("--set robot.description", Path::new(&config.robot.description));
            let mark = b"<svg";
            Output { flag: "--pictures", path: &path, mark, force: args.force }.check(&[read])?;
        }
        let robot = super::load_fit_robot(&config.robot.description, &step_options(&config))?;
        let mut train_args =
            vec![format!("--preset={}", preset.as_str()), format!("--workers={}", args.workers)];
        train_args.extend(args.sets.iter().map(|assignment| format!("--set={assignment}")));
        let peers = args.peer.then(|| Peers::find(&args.python)).transpose()?;
        let stop = StopRequests::new();
        stop.listen().context("signals cannot be caught")?;
        let scratch = tempfile::Builder::new().prefix("octopus-bench-").tempdir();
        Ok(Self {
            dimensions: Dimensions::new(&config, robot.n_arms),
            preset,
            layers,
            config,
            robot,
            seconds: args.seconds,
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
        self.stages.begin(format!("measuring {stage}"));
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

/// The middle one of an odd number of values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    proto::statistics::percentile(&values, 0.5)
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    fn the_preset_that_a_table_names_is_the_one_that_is_trained_by_default() {
        let cli = Cli::try_parse_from(["octopus", "train"]).expect("valid");
        let Command::Train(args) = cli.command else { panic!("not train") };
        assert_eq!(Preset::from(args.preset), TRAINED);
    }
}
