//! `octopus bench`: how fast this machine simulates, learns and transports.

mod arithmetic;
mod child;
mod figures;
mod growth;
mod learner;
mod peer;
mod physics;
mod picture;
mod rollout;
mod train;
mod transport;

use anyhow::Context as _;
use proto::config::{Config, Layers};
use proto::layout::Dimensions;
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use serde_json::Value;
use simulator::robot::Robot;
use tempfile::TempDir;

use self::figures::Figures;
use self::peer::Peers;
use crate::cli::bench::{BenchArgs, Subject};
use crate::output;
use crate::provenance::Provenance;
use crate::report::progress::Stages;
use crate::signals::StopRequests;
use crate::supervisor::Programs;

/// Measures and prints.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let bench = Bench::new(args)?;
    if args.subject == Subject::Growth {
        let curves = growth::measure(&bench)?;
        if let Some(dir) = &args.pictures {
            picture::draw_all(dir, &curves)?;
        }
        bench.stages.end();
        return if args.json {
            output::json(&bench.with_context(growth::to_json(&curves)))
        } else {
            output::line(&growth::table(&curves))
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
    if args.json {
        output::json(&bench.with_context(figures.to_json()))
    } else {
        output::line(&figures.table())
    }
}

/// What all measurements share.
struct Bench {
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
        let preset = args.preset.into();
        let workers = format!("[run]\nworkers = {}", args.workers);
        let mut layers = Layers::new(preset, None).text(&workers, "--workers")?;
        for assignment in &args.sets {
            layers = layers.set(assignment)?;
        }
        let config = layers.resolve()?;
        let robot = super::load_robot(&config.robot.description)?;
        let mut train_args =
            vec![format!("--preset={}", preset.as_str()), format!("--workers={}", args.workers)];
        train_args.extend(args.sets.iter().map(|assignment| format!("--set={assignment}")));
        let peers = args.peer.then(|| Peers::find(&args.python)).transpose()?;
        let stop = StopRequests::new();
        stop.listen().context("signals cannot be caught")?;
        let scratch = tempfile::Builder::new().prefix("octopus-bench-").tempdir();
        Ok(Self {
            dimensions: Dimensions::new(&config, robot.n_arms),
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
        changes.iter().try_fold(self.layers.clone(), |layers, change| layers.set(change))?.resolve()
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
        let run_dir = RunDir::new(self.scratch.path());
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
    fn with_context(&self, mut figures: Value) -> Value {
        figures["provenance"] = serde_json::to_value(Provenance::gather()).unwrap_or_default();
        figures["config"] = serde_json::to_value(&self.config).unwrap_or_default();
        figures
    }
}

/// The middle one of an odd number of values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    proto::clock::percentile(&values, 0.5)
}
