//! The command line of `octopus`.

pub mod bench;
pub mod checkpoints;
pub mod experiment;
pub mod named;
pub mod plot;
pub mod reproduce;
pub mod rollout;
pub mod serve;
mod values;
pub mod verify;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use proto::config::{AlgorithmName, Preset, TaskName};

use self::values::{assignment, duration, listen, positive, seconds, whole, workers};

/// Exit codes, as `octopus --help` lists them.
const EXIT_CODES: &str = "\
Exit codes:
  0    all went well
  1    something failed while running; the message says what. Or what was
       compared is not the same
  2    the command line is wrong
  3    a configuration, robot, actions or other input file is wrong
  4    the machine lacks something: shared memory, descriptors, libtorch, a
       device
  5    a run directory, checkpoint or result exists already, is in use, is
       missing or is damaged
  6    the learner or a worker failed for good
  130  stopped at once: by a second Ctrl-C where a run is going on, by the first
       one elsewhere

Results go to standard output, progress and logs to standard error (RUST_LOG=info shows more). \
`octopus COMMAND --help` shows options and examples.";

const TRAIN_EXAMPLES: &str = "\
Examples:
  octopus train
  octopus train reorientation --time-limit 10m
  octopus train --preset paper --seed 7 --run-dir runs/paper-7
  octopus train --preset paper --algorithm ppo
  octopus train --set network.hidden=[64,64] --set algorithm.gamma=0.97 \\
      --iterations 20

Configuration is merged in layers, later ones win: the preset, --config, the flags above, --set. \
Its groups are task, robot, env, network, algorithm, optimizer and run; the resolved whole is \
written to RUN_DIR/config.toml. One Ctrl-C finishes the iteration, commits a checkpoint and ends \
cleanly; a second one stops at once. `octopus resume RUN_DIR` goes on.";

const RESUME_EXAMPLES: &str = "\
Examples:
  octopus resume runs/trajectory-20260101-120000
  octopus resume runs/trajectory-20260101-120000 --workers 4
  octopus resume runs/trajectory-20260101-120000 --env-steps 4e6

--iterations and --env-steps are those of the whole run, not of what is left; --time-limit is \
that of this session. The number of workers changes nothing that is learned; another budget does \
when the learning rate falls over it.";

const EVAL_EXAMPLES: &str = "\
Examples:
  octopus eval runs/trajectory-20260101-120000
  octopus eval runs/trajectory-20260101-120000:best
  octopus eval runs/trajectory-20260101-120000:500 --episodes 200
  octopus eval runs/trajectory-20260101-120000 --json | jq .overall

Of every episode three numbers are taken for each error: its minimum over time (`min`), its value \
after the last step (`final`) and its mean over the last 20 steps (`tail`).";

const SIMULATE_USAGE: &str = "\
octopus simulate [OPTIONS] --robot <NAME|FILE> --actions <IN.csv>
                        --out <OUT.csv>";

const SIMULATE_EXAMPLES: &str = "\
Examples:
  octopus simulate --robot paper --actions in.csv --out out.csv
  octopus simulate --robot release --actions in.csv --out - | head
  octopus simulate --robot release --actions in.csv --out out.csv \\
      --precision f64 --integrator euler --substep 0.001

IN.csv has no header and one row per control step: joint velocity commands in rad/s, arm after \
arm (24 numbers for four arms). OUT.csv has a header and one row per control step, after it: t, \
base position (m) and quaternion (w first), joint angles (rad), velocity of the base (m/s, world \
axes; rad/s, body axes), joint rates (rad/s), hand positions (m), touching pairs. The last \
example is the scheme of the robot's authors.";

const MJCF_EXAMPLES: &str = "\
Examples:
  octopus mjcf --robot release --out release.xml
  octopus mjcf --robot my-robot.toml --out my-robot.xml
  python -m mujoco.viewer --mjcf=my-robot.xml";

const STATUS_EXAMPLES: &str = "\
Examples:
  octopus status
  octopus status runs/trajectory-20260101-120000 --watch
  octopus status runs/trajectory-20260101-120000 --json | jq .live.stages
  octopus status runs/trajectory-20260101-120000 --token-file token.txt

Processes, shards and stages come from the run's HTTP service; if it cannot be asked, standard \
error and the key `live_error` say why.";

const DOCTOR_EXAMPLES: &str = "\
Examples:
  octopus doctor
  octopus doctor --json | jq '.[] | select(.verdict != \"good\")'

Exits with 4 if anything stands in the way of a training.";

const CLEAN_EXAMPLES: &str = "\
Examples:
  octopus clean --dry-run
  octopus clean

A run that is killed is cleaned up after by its janitor; this is for what is left when that was \
killed, too. What a living process uses is never touched.";

/// Trains, evaluates and simulates multi-arm space robots.
#[derive(Debug, Clone, Parser)]
#[command(name = "octopus", version, after_help = EXIT_CODES, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Clone, Subcommand)]
pub enum Command {
    /// Train the arms of a robot on a task.
    Train(TrainArgs),
    /// Go on with a stopped run from its last checkpoint.
    Resume(ResumeArgs),
    /// Measure a policy on goals it never saw.
    Eval(EvalArgs),
    /// Repeat the paper's experiments.
    Experiment(experiment::ExperimentArgs),
    /// Repeat all of the paper's experiments and make a page of them.
    Reproduce(reproduce::ReproduceArgs),
    /// Draw learning curves of runs side by side.
    Plot(plot::PlotArgs),
    /// Integrate given joint commands, open loop.
    Simulate(SimulateArgs),
    /// Write a robot as a MuJoCo model file.
    Mjcf(MjcfArgs),
    /// Check whether this machine can run a training, and say what cures what cannot.
    Doctor(DoctorArgs),
    /// Measure how fast this machine simulates, learns and transports.
    Bench(bench::BenchArgs),
    /// Show how a run is doing, or list all runs.
    Status(StatusArgs),
    /// Change the number of workers of a live run.
    Scale(serve::ScaleArgs),
    /// Make one block of a run again, alone.
    Rollout(rollout::RolloutArgs),
    /// Compare two runs bit by bit, or a run with its own repetition.
    Verify(verify::VerifyArgs),
    /// List, compare, pin, copy and compose checkpoints.
    Checkpoints(checkpoints::CheckpointsArgs),
    /// Serve the checkpoints of a directory over HTTP.
    Serve(serve::ServeArgs),
    /// Remove what killed runs of this user left in shared memory.
    Clean(CleanArgs),
    /// Removes what a killed coordinator leaves; started by every run beside it.
    #[command(hide = true)]
    Janitor(JanitorArgs),
}

/// When to stop; at most one of them.
#[derive(Debug, Clone, Default, Args)]
#[group(multiple = false)]
pub struct Limits {
    /// Stop after this many iterations.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = positive, help_heading = "Limits")]
    pub iterations: Option<u64>,
    /// Stop after this many env-steps, rounded up to whole iterations: 2000000, 2e6.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = positive, help_heading = "Limits")]
    pub env_steps: Option<u64>,
    /// Stop after this much time: 90s, 10m, 1h30m. Changes nothing that is learned until then.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = duration, help_heading = "Limits")]
    pub time_limit: Option<Duration>,
}

/// Options of `octopus train`.
#[derive(Debug, Clone, Args)]
#[command(after_help = TRAIN_EXAMPLES)]
pub struct TrainArgs {
    /// The task [default: trajectory, unless --config says otherwise].
    #[arg(value_enum)]
    pub task: Option<TaskArg>,
    /// The configuration to start from.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = PresetArg::Tuned)]
    pub preset: PresetArg,
    /// A TOML file with the keys to change.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The learning algorithm, with what the preset changes for it [default: mappo, unless --config says
    /// otherwise].
    #[arg(long, allow_negative_numbers = true, value_name = "NAME", value_enum)]
    pub algorithm: Option<AlgorithmArg>,
    /// Change one key; may be given again: --set algorithm.gamma=0.97.
    #[arg(long = "set", value_name = "KEY=VALUE", allow_hyphen_values = true, value_parser = assignment)]
    pub sets: Vec<String>,
    /// Simulator processes, `auto` for one a processor; changes nothing that is learned.
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, value_parser = workers)]
    pub workers: Option<u64>,
    /// Fix each worker to a processor.
    #[arg(long)]
    pub pin: bool,
    /// Environments of the whole run, one episode each per iteration.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX))]
    pub envs: Option<u64>,
    /// Seed of every random number.
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = whole::<u64>(0, i64::MAX as u64))]
    pub seed: Option<u64>,
    /// When to stop.
    #[command(flatten)]
    pub limits: Limits,
    /// Where results land; must not exist yet, or be empty [default: runs/TASK-TIME].
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
    /// 1 rolls out the next iteration while the learner trains on this one.
    #[arg(long, value_name = "0|1", allow_hyphen_values = true, value_parser = whole::<u64>(0, 1))]
    pub overlap: Option<u64>,
    /// Where the learner computes: cpu, cuda:0.
    #[arg(long, allow_negative_numbers = true, value_name = "DEVICE")]
    pub device: Option<String>,
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// The run's HTTP service.
    #[command(flatten)]
    pub http: HttpArgs,
    /// Check what is asked for, print the whole configuration as TOML (or JSON), and train nothing.
    #[arg(long)]
    pub dry_run: bool,
    /// What happens around the training.
    #[command(flatten)]
    pub ending: Ending,
    /// The process that started this one and that it shall not outlive.
    #[arg(long, value_name = "PID", hide = true)]
    pub parent: Option<i32>,
}

/// The HTTP service beside a run, by which `octopus status` and `octopus scale` reach it.
#[derive(Debug, Clone, Args)]
pub struct HttpArgs {
    /// Where it listens; port 0 takes a free one; `off` has none.
    #[arg(long, value_name = "ADDRESS:PORT|off", allow_hyphen_values = true, default_value = "127.0.0.1:0", value_parser = listen, help_heading = "Service")]
    pub listen: Listen,
    /// A file with a token that clients may show beside the run's own; needed beyond this machine.
    #[arg(long, value_name = "FILE", help_heading = "Service")]
    pub token_file: Option<PathBuf>,
}

/// Where to listen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listen {
    /// Nowhere.
    Off,
    /// There.
    At(std::net::SocketAddr),
}

/// What happens around a training.
#[derive(Debug, Clone, Copy, Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
pub struct Ending {
    /// Evaluate the final policy (the default; undoes an earlier --no-eval).
    #[arg(long, overrides_with = "no_eval")]
    pub eval: bool,
    /// Leave the evaluation of the final policy out.
    #[arg(long)]
    pub no_eval: bool,
    /// Show the final errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
    /// Show no progress.
    #[arg(long, short)]
    pub quiet: bool,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus resume`.
#[derive(Debug, Clone, Args)]
#[command(after_help = RESUME_EXAMPLES)]
pub struct ResumeArgs {
    /// The run directory.
    pub run_dir: PathBuf,
    /// Simulator processes, `auto` for one a processor; changes nothing that is learned.
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, value_parser = workers)]
    pub workers: Option<u64>,
    /// When to stop.
    #[command(flatten)]
    pub limits: Limits,
    /// The run's HTTP service.
    #[command(flatten)]
    pub http: HttpArgs,
    /// What happens around the training.
    #[command(flatten)]
    pub ending: Ending,
}

/// Options of `octopus eval`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EVAL_EXAMPLES)]
pub struct EvalArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub path: PathBuf,
    /// Episodes, each with a goal of its own.
    #[arg(long, value_name = "N", default_value_t = 30, allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: u32,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Show the errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
    /// Print the result as JSON, every episode included.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus simulate`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = SIMULATE_USAGE, after_help = SIMULATE_EXAMPLES)]
pub struct SimulateArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The commands; `-` reads standard input.
    #[arg(long, value_name = "IN.csv")]
    pub actions: PathBuf,
    /// The trajectory; `-` writes standard output.
    #[arg(long, value_name = "OUT.csv")]
    pub out: PathBuf,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
    /// Arithmetic.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = PrecisionArg::F32)]
    pub precision: PrecisionArg,
    /// Integration scheme.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = IntegratorArg::Rk3)]
    pub integrator: IntegratorArg,
    /// Duration of an integration step; divides the control period.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.016, allow_hyphen_values = true, value_parser = seconds)]
    pub substep: f64,
    /// Duration of a control step.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.4, allow_hyphen_values = true, value_parser = seconds)]
    pub control_period: f64,
    /// Whether touching bodies push each other.
    #[arg(long, allow_negative_numbers = true, value_name = "on|off", value_enum, default_value_t = Switch::On)]
    pub contacts: Switch,
}

/// Options of `octopus mjcf`.
#[derive(Debug, Clone, Args)]
#[command(after_help = MJCF_EXAMPLES)]
pub struct MjcfArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The model file [default: standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
    /// Whether shapes of the model collide.
    #[arg(long, allow_negative_numbers = true, value_name = "on|off", value_enum, default_value_t = Switch::On)]
    pub contacts: Switch,
}

/// Options of `octopus doctor`.
#[derive(Debug, Clone, Copy, Args)]
#[command(after_help = DOCTOR_EXAMPLES)]
pub struct DoctorArgs {
    /// Print the checks as JSON.
    #[arg(long)]
    pub json: bool,
}

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

/// Options of `octopus clean`.
#[derive(Debug, Clone, Copy, Args)]
#[command(after_help = CLEAN_EXAMPLES)]
pub struct CleanArgs {
    /// Only say what would be removed.
    #[arg(long)]
    pub dry_run: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of the hidden `octopus janitor`.
#[derive(Debug, Clone, Args)]
pub struct JanitorArgs {
    /// The shared memory to remove.
    #[arg(long)]
    pub domain: String,
}

/// A task on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TaskArg {
    /// Every hand to a target pose.
    Trajectory,
    /// The base to a target attitude.
    Reorientation,
}

impl From<TaskArg> for TaskName {
    fn from(task: TaskArg) -> Self {
        match task {
            TaskArg::Trajectory => Self::Trajectory,
            TaskArg::Reorientation => Self::Reorientation,
        }
    }
}

/// A preset on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// The paper's robot, tasks and measures with whatever learns them fastest.
    Tuned,
    /// The paper's text; where it is silent, the released code.
    Paper,
    /// The authors' released code.
    Release,
}

impl From<PresetArg> for Preset {
    fn from(preset: PresetArg) -> Self {
        match preset {
            PresetArg::Tuned => Self::Tuned,
            PresetArg::Paper => Self::Paper,
            PresetArg::Release => Self::Release,
        }
    }
}

/// A learning algorithm on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AlgorithmArg {
    /// An actor and a critic for each agent; critics see everything.
    Mappo,
    /// Likewise, but each critic sees what its agent sees.
    Ippo,
    /// One actor and one critic for all agents together.
    Ppo,
    /// Deterministic actors, critics that see everything and all actions, a replay.
    Maddpg,
}

impl From<AlgorithmArg> for AlgorithmName {
    fn from(algorithm: AlgorithmArg) -> Self {
        match algorithm {
            AlgorithmArg::Mappo => Self::Mappo,
            AlgorithmArg::Ippo => Self::Ippo,
            AlgorithmArg::Ppo => Self::Ppo,
            AlgorithmArg::Maddpg => Self::Maddpg,
        }
    }
}

/// Arithmetic on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// Single precision, as training computes.
    F32,
    /// Double precision.
    F64,
}

/// An integration scheme on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum IntegratorArg {
    /// Classical Runge and Kutta.
    Rk4,
    /// Runge–Kutta of third order, as training integrates.
    Rk3,
    /// Semi-implicit Euler, as the robot's authors do.
    Euler,
}

/// On or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// On.
    On,
    /// Off.
    Off,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    /// What is proposed must be what the command takes, or whoever follows it ends with a usage error.
    #[test]
    fn remedies_have_flags_that_the_command_has() {
        for (name, remedy) in [
            ("train", &crate::commands::train::REMEDY),
            ("resume", &crate::commands::resume::REMEDY),
            ("verify", &lab::verification::REMEDY),
        ] {
            let command = Cli::command();
            let command = command.find_subcommand(name).expect("a command");
            let has = |flag: &str| {
                let flag = flag.trim_start_matches("--");
                command.get_arguments().any(|argument| argument.get_long() == Some(flag))
            };
            assert!(remedy.flags.iter().all(|flag| has(flag)), "{name}: {:?}", remedy.flags);
        }
    }

    #[test]
    fn at_most_one_limit() {
        let parse = |line: &str| Cli::try_parse_from(line.split(' '));
        assert!(parse("octopus train --iterations 3 --time-limit 1m").is_err());
        assert!(parse("octopus train --iterations 3").is_ok());
        assert!(parse("octopus train --no-eval --eval").is_ok());
    }

    #[test]
    fn what_is_watched_may_stand_before_or_after_the_flag() {
        let parse = |line: &str| {
            let Command::Status(args) = Cli::try_parse_from(line.split(' ')).expect(line).command
            else {
                panic!("{line} is another command")
            };
            (args.run_dir, args.watch)
        };
        let run = || Some(PathBuf::from("runs/x"));
        for (line, seconds) in [
            ("octopus status --watch runs/x", 2),
            ("octopus status runs/x --watch", 2),
            ("octopus status --watch=1m runs/x", 60),
            ("octopus status runs/x --watch=10", 10),
        ] {
            assert_eq!(parse(line), (run(), Some(Duration::from_secs(seconds))), "{line}");
        }
    }

    /// The guide promises it.
    #[test]
    fn every_command_has_examples() {
        fn check(command: &clap::Command, path: &str) {
            let shown = command.get_subcommands().filter(|command| !command.is_hide_set());
            for command in shown {
                let path = format!("{path} {}", command.get_name());
                let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
                assert!(after.contains("Examples:\n  octopus"), "{path}: {after}");
                check(command, &path);
            }
        }
        check(&Cli::command(), "octopus");
    }

    #[test]
    fn help_texts() {
        // Not that of the terminal that the test happens to run in.
        let mut command = Cli::command().term_width(100);
        insta::assert_snapshot!("help", command.render_help());
        let train = command.find_subcommand_mut("train").expect("exists");
        insta::assert_snapshot!("help_train", train.render_help());
    }

    /// Calls `check` with every command but the hidden ones, and how it is called.
    fn each_command(check: &mut dyn FnMut(&mut clap::Command, &str)) {
        fn below(
            command: &mut clap::Command,
            path: &str,
            check: &mut dyn FnMut(&mut clap::Command, &str),
        ) {
            check(command, path);
            for command in command.get_subcommands_mut().filter(|command| !command.is_hide_set()) {
                let path = format!("{path} {}", command.get_name());
                below(command, &path, check);
            }
        }
        let mut root = Cli::command();
        root.build();
        below(&mut root, "octopus", check);
    }

    #[test]
    fn help_fits_in_80_columns() {
        each_command(&mut |command, path| {
            let help = command.clone().term_width(80).render_long_help().to_string();
            for line in help.lines() {
                assert!(line.chars().count() <= 80, "{path}: {line}");
            }
        });
    }

    /// What is wrapped by hand as well as by the terminal's width ends in ragged lines: a paragraph is one
    /// line, and what begins with spaces is as wide as the narrowest terminal at most.
    #[test]
    fn help_is_wrapped_once() {
        each_command(&mut |command, path| {
            let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let lines: Vec<&str> = after.lines().collect();
            let prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
            for pair in lines.windows(2) {
                assert!(
                    !(prose(pair[0]) && prose(pair[1])),
                    "{path}: two lines of one paragraph: {pair:?}"
                );
            }
            for line in lines.iter().filter(|line| line.starts_with(' ')) {
                assert!(line.chars().count() <= 80, "{path}: {line}");
            }
        });
    }

    /// `--masses -1,2` is a wrong value, not an unknown flag. A path may be forgotten before another flag, and
    /// that one shall not be taken for it.
    #[test]
    fn a_value_may_begin_with_a_minus_sign() {
        use clap::builder::ValueParser;
        let paths = [ValueParser::path_buf().type_id(), ValueParser::string().type_id()];
        let mut seen = 0;
        each_command(&mut |command, path| {
            for option in command
                .get_opts()
                .filter(|option| !option.is_require_equals_set() && !option.is_hide_set())
            {
                let words = !option.get_possible_values().is_empty();
                let parser = option.get_value_parser().type_id();
                if parser == paths[0] {
                    continue;
                }
                if words || parser == paths[1] {
                    let taken = option.is_allow_negative_numbers_set()
                        || option.is_allow_hyphen_values_set();
                    assert!(taken, "{path} {option}");
                    continue;
                }
                let several = option.get_num_args().is_some_and(|range| range.max_values() > 1);
                assert!(several || option.is_allow_hyphen_values_set(), "{path} {option}");
                seen += 1;
            }
        });
        assert!(seen > 20, "{seen}");
        for (line, wanted) in [
            ("octopus experiment noise --sensors -0.3,1", "wants numbers, 0 or more"),
            ("octopus experiment disturbance --force -inf", "wants a number, 0 or more"),
            ("octopus train --time-limit -10m", "wants a time such as"),
            ("octopus train --seed --json", "wants a whole number"),
        ] {
            let error = Cli::try_parse_from(line.split(' ')).expect_err(line);
            assert_eq!(error.kind(), clap::error::ErrorKind::ValueValidation, "{line}");
            assert!(error.to_string().contains(wanted), "{error}");
        }
        for (line, said) in [
            ("octopus train --preset -1", "possible values: tuned, paper, release"),
            ("octopus mjcf --robot paper --contacts -1", "possible values: on, off"),
        ] {
            let error = Cli::try_parse_from(line.split(' ')).expect_err(line);
            assert_eq!(error.kind(), clap::error::ErrorKind::InvalidValue, "{line}");
            assert!(error.to_string().contains(said), "{error}");
        }
        assert!(Cli::try_parse_from(["octopus", "train", "--device", "-1"]).is_ok(), "a value");
        assert!(Cli::try_parse_from(["octopus", "train", "--device", "--json"]).is_err());
        for line in ["octopus train --set network.min_log_std=-3", "octopus train --run-dir --json"]
        {
            let parsed = Cli::try_parse_from(line.split(' '));
            assert_eq!(parsed.is_ok(), line.contains("--set"), "{line}");
        }
    }
}
