//! `octopus bench`: how fast this machine simulates, learns and transports.

use std::path::PathBuf;

use clap::Args;
use lab::bench::{Study, Subject, measure};
use lab::scale::{Machines, Scale};
use proto::config::Preset;
use proto::{ExitCode, ExitError};

use crate::names::{Named, Names};
use crate::planned_run::options;
use crate::values::{above_zero, amount, assignment, measuring_time, whole, workers};

const EXAMPLES: &str = "\
Examples:
  octopus bench
  octopus bench --peer --json > bench.json
  octopus bench physics --peer
  octopus bench learner --preset tuned --set network.hidden=[128,128]
  octopus bench growth --seconds 2 --pictures pictures
  octopus bench python
  octopus bench scale --preset tuned --hosts 1,8,100 --gbit 25

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
  scale      a training on many machines, simulated event by event from what a
             rollout and an update take here: env-steps/s, what goes over the
             network, what holds it back and what to buy; a run takes 24 hosts
             with 256 workers at most, and one learner: what is beyond is to
             come; not part of `all`

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
    /// The configuration to measure. `paper`, as its peers do the same work; `octopus train` takes `guided` unless told otherwise.
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
    /// The machines of `scale`. Last, as their heading holds for all options after it.
    #[command(flatten)]
    pub scale: ScaleArgs,
}

/// Options of `octopus bench scale`.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Options of scale")]
pub struct ScaleArgs {
    /// Numbers of hosts.
    #[arg(long, value_name = "N,…", value_delimiter = ',', allow_hyphen_values = true, value_parser = whole::<u32>(1, 10_000), default_value = "1,2,4,8,16,32,100,300,1000")]
    pub hosts: Vec<u32>,
    /// Workers of each host.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u32>(1, 1024), default_value_t = 8)]
    pub host_workers: u32,
    /// Workers on the learner's machine, which take nothing from the learner.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u32>(0, 1024), default_value_t = 0)]
    pub local_workers: u32,
    /// Numbers of learners, each a machine with its share of the agents.
    #[arg(long, value_name = "N,…", value_delimiter = ',', allow_hyphen_values = true, value_parser = whole::<u32>(1, 8), default_value = "1,2,4,8")]
    pub learners: Vec<u32>,
    /// What the link of a machine carries, each way (Gbit/s).
    #[arg(long, value_name = "GBIT", allow_hyphen_values = true, value_parser = above_zero, default_value_t = 10.0)]
    pub gbit: f64,
    /// From one machine to another (ms).
    #[arg(long, value_name = "MS", allow_hyphen_values = true, value_parser = amount, default_value_t = 0.1)]
    pub delay: f64,
    /// What gateways take at the learner and at a host: ms of a core for a MB of blocks.
    #[arg(long, value_name = "MS", num_args = 2, value_names = ["LEARNER", "HOST"], allow_negative_numbers = true, value_parser = amount, default_values_t = [1.8, 2.8])]
    pub gateways: Vec<f64>,
}

impl ScaleArgs {
    /// A flag whose value is another than the one that it has by itself.
    fn given(&self) -> anyhow::Result<Option<&'static str>> {
        let plain: Self = options(["octopus bench".to_owned()])?;
        let flags = [
            ("--hosts", self.hosts != plain.hosts),
            ("--host-workers", self.host_workers != plain.host_workers),
            ("--local-workers", self.local_workers != plain.local_workers),
            ("--learners", self.learners != plain.learners),
            ("--gbit", self.gbit != plain.gbit),
            ("--delay", self.delay != plain.delay),
            ("--gateways", self.gateways != plain.gateways),
        ];
        Ok(flags.into_iter().find_map(|(flag, is_given)| is_given.then_some(flag)))
    }

    fn scale(&self) -> Scale {
        Scale {
            hosts: self.hosts.clone(),
            learners: self.learners.clone(),
            machines: Machines {
                local_workers: self.local_workers,
                hosts: 0,
                host_workers: self.host_workers,
                learners: 1,
                bandwidth: 1e9 / 8.0 * self.gbit,
                delay: 1e-3 * self.delay,
            },
        }
    }
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
        Named(Self::Scale),
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
            Self::Scale => "scale",
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
            Self::Scale => "How a training grows with machines, simulated",
            Self::Python => "Batches of the module for Python",
            Self::All => "All but python, growth and scale",
        }
    }
}

/// Measures and prints.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let growth = args.subject.0 == Subject::Growth;
    let in_python = args.subject.0 == Subject::Python;
    let scale = args.subject.0 == Subject::Scale;
    let of_scale = args.scale.given()?;
    for (given, flag, cure) in [
        (
            !scale && of_scale.is_some(),
            of_scale.unwrap_or_default(),
            "it is for `octopus bench scale`",
        ),
        ((growth || in_python || scale) && args.peer, "--peer", "leave it out"),
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
        scale: args.scale.scale(),
        gateways: [0, 1].map(|end| args.scale.gateways[end]),
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
    fn machines_of_scale_are_for_scale_alone() {
        for flag in ["--hosts=3", "--gbit=1", "--gateways 1 2"] {
            let args = parse(&format!("octopus bench physics {flag}")).expect("valid");
            let told = run(&args).expect_err(flag).to_string();
            assert!(told.contains("it is for `octopus bench scale`"), "{told}");
        }
        assert_eq!(
            parse("octopus bench physics").expect("valid").scale.given().expect("valid"),
            None
        );
        assert!(parse("octopus bench scale --hosts 0").is_err(), "there would be nothing to show");
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
