//! `octopus bench`: how fast this machine simulates, learns and transports.

use std::path::PathBuf;

use clap::Args;
use lab::bench::{Study, Subject, measure};
use proto::config::Preset;
use proto::{ExitCode, ExitError};

use crate::names::{Named, Names};
use crate::values::{assignment, measuring_time, workers};

const EXAMPLES: &str = "\
Examples:
  octopus bench
  octopus bench --peer --json > bench.json
  octopus bench physics --peer
  octopus bench learner --preset tuned --set network.hidden=[128,128]
  octopus bench growth --seconds 2 --pictures pictures
  octopus bench python

Rates of physics and rollout are per second of processor time of one thread, so that other load \
on the machine hardly matters; all others are per second of wall time and want a machine that is \
idle.
  physics    control steps under random commands of ±0.8 rad/s, contacts counted
             and pushing
  rollout    the same with actors as training initialises them, observations,
             rewards and the block
  learner    updates on synthetic blocks, in bf16 and f32 and with smaller
             networks
  transport  a block from `send` in one process to its tensors in another, which
             asks for one block at a time and sleeps until it comes; the run's
             own channel, in which nothing is copied
  train      a real run in a directory that goes away; env-steps/s after the
             first iteration, memory
  python     batches of 1, 16 and 1,024 environments in Python, beside a rollout
             without its policy and beside MuJoCo's own rollout in Python, which
             is always measured; wants the wheel of `make wheel` where the peers
             are; not part of `all`
  growth     the same over environments (episodes of 16 steps), workers, arms
             (more than the robot has are its own, mirrored) and hidden width;
             not part of `all`

Floor is what this machine allows at best: for physics and rollout, the operations counted in the \
source at the rate of fused multiply-adds of one core; for the learner, its matrix products at \
the best rate of libtorch's own; for the transport, the fastest waking of a process through a \
pipe; for the training, its own rollout and fastest update without anything around them (if they \
were measured, and unless algorithm.max_kl may hold actors back, which the updates of `learner` \
never are).

Peers run in Python, `make venv-benches` installs them: MuJoCo with the same robot, commands and \
contacts (400 Euler steps of 1 ms), and MAPPO as it is commonly written in PyTorch (f32). A \
peer's rollout is 1 / (1 / MuJoCo + threads / its inference), its training 1 / (1 / (workers · \
MuJoCo) + 1 / its learner + 1 / its inference), with no more workers than processors. The \
transport's peers are a pipe and a Unix socket, always measured, each with the same bytes.

What else the machine did meanwhile is said below the table. Measurements that contradict each \
other end with exit code 1 and no table: something that is faster than its floor, or products \
beyond the peak of the processor (cores × ports × lanes × 2 × the highest clock). That happens on \
a machine that does other work at the same time.

Ctrl-C stops at once and leaves nothing behind.";

/// Options of `octopus bench`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// What to measure.
    #[arg(value_enum, default_value_t = Named(Subject::All))]
    pub subject: Named<Subject>,
    /// Also measure MuJoCo and PyTorch on the same work.
    #[arg(long)]
    pub peer: bool,
    /// How long each measurement takes, at least.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, allow_hyphen_values = true, value_parser = measuring_time)]
    pub seconds: f64,
    /// The configuration to measure. `paper`, as its peers do the same work; `octopus train` takes `tuned` unless told otherwise.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Preset::Paper))]
    pub preset: Named<Preset>,
    /// Change one key; may be given again: --set algorithm.epochs=10.
    #[arg(long = "set", value_name = "KEY=VALUE", allow_hyphen_values = true, value_parser = assignment)]
    pub sets: Vec<String>,
    /// Simulator processes of the training, `auto` for one a processor.
    #[arg(long, value_name = "N|auto", default_value = "2", allow_hyphen_values = true, value_parser = workers)]
    pub workers: u64,
    /// The Python that has the peers.
    #[arg(long, value_name = "FILE", default_value = ".venv-benches/bin/python")]
    pub python: PathBuf,
    /// Draw the curves of `growth` there, as SVG.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Draw also over files that are no pictures, and into a run's directory.
    #[arg(long, requires = "pictures")]
    pub force: bool,
    /// Print as one JSON object.
    #[arg(long)]
    pub json: bool,
}

impl Names for Subject {
    const ALL: &'static [Named<Self>] = &[
        Named(Self::Physics),
        Named(Self::Rollout),
        Named(Self::Learner),
        Named(Self::Transport),
        Named(Self::Train),
        Named(Self::Python),
        Named(Self::Growth),
        Named(Self::All),
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Physics => "physics",
            Self::Rollout => "rollout",
            Self::Learner => "learner",
            Self::Transport => "transport",
            Self::Train => "train",
            Self::Python => "python",
            Self::Growth => "growth",
            Self::All => "all",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::Physics => "The dynamics",
            Self::Rollout => "Simulation with a policy, as a worker does it",
            Self::Learner => "The update",
            Self::Transport => "Blocks from process to process",
            Self::Train => "A whole training, and its memory",
            Self::Growth => "How all of it grows",
            Self::Python => "Batches of the module for Python",
            Self::All => "All but python and growth",
        }
    }
}

/// Measures and prints.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let growth = args.subject.0 == Subject::Growth;
    let in_python = args.subject.0 == Subject::Python;
    for (given, flag, cure) in [
        ((growth || in_python) && args.peer, "--peer", "leave it out"),
        (!growth && args.pictures.is_some(), "--pictures", "it is for `octopus bench growth`"),
    ] {
        if given {
            let message = format!("{flag} has no meaning here; {cure}");
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
    }
    let measured = measure(&Study {
        subject: args.subject.0,
        preset: args.preset.0,
        sets: args.sets.clone(),
        workers: args.workers,
        seconds: args.seconds,
        peers: (args.peer || in_python).then(|| args.python.clone()),
        pictures: args.pictures.clone(),
        force: args.force,
    })?;
    if args.json { output::json(&measured.json) } else { output::line(&measured.table) }
}

#[cfg(test)]
mod option_tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    fn parse(line: &str) -> Result<BenchArgs, clap::Error> {
        let cli = Cli::try_parse_from(line.split(' '))?;
        let Command::Bench(args) = cli.command else { panic!("not bench") };
        Ok(args)
    }

    #[test]
    fn without_options_all_of_the_paper_is_measured() {
        let args = parse("octopus bench").expect("valid");
        assert_eq!((args.subject, args.preset), (Named(Subject::All), Named(Preset::Paper)));
        assert_eq!((args.seconds, args.workers), (5.0, 2));
        assert!(!args.peer && !args.json && args.sets.is_empty());
        assert_eq!(args.python, PathBuf::from(".venv-benches/bin/python"));
    }

    #[test]
    fn subjects_and_numbers_are_checked() {
        let args = parse("octopus bench growth --seconds 0.05 --set env.n_envs=8").expect("valid");
        assert_eq!((args.subject, args.seconds), (Named(Subject::Growth), 0.05));
        for wrong in
            ["speed", "--seconds 0", "--seconds -1", "--workers 0", "--set x", "--preset a"]
        {
            let error = parse(&format!("octopus bench {wrong}")).expect_err(wrong);
            assert_eq!(error.exit_code(), 2, "{wrong}");
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;
    use lab::bench::TRAINED;

    use crate::cli::{Cli, Command};

    #[test]
    fn the_preset_that_a_table_names_is_the_one_that_is_trained_by_default() {
        let cli = Cli::try_parse_from(["octopus", "train"]).expect("valid");
        let Command::Train(args) = cli.command else { panic!("not train") };
        assert_eq!(args.preset.0, TRAINED);
    }
}
