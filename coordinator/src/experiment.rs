//! `octopus experiment`: the paper's experiments.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum as _};
use lab::experiments::common::{Beside, Common};
use lab::experiments::{
    Experiment, arm_failure, base_mass, disturbance, noise, perform, precision, reassembly,
};
use lab::identity::ControllerName;
use lab::script;
use lab::trained::open_checkpoint;
use simulator::simulate::Precision;
use simulator::step::StepOptions;
use store::files;
use store::outputs::{self, Input, Output};

use crate::names::Named;
use crate::trajectories::{MARK, write_table};
use crate::values::{Amounts, above_zero, all_above_zero, amount, amounts, whole};

const GROUP_EXAMPLES: &str = "\
Examples:
  octopus experiment precision --policies trained
  octopus experiment disturbance --trajectory runs/a:best
  octopus experiment COMMAND --help

The paper's experiments, with deterministic actions. --policies DIR takes DIR/trajectory and \
DIR/reorientation, each a run directory, a directory of checkpoints or a checkpoint. --trajectory \
and --reorientation name single ones, as `octopus checkpoints --help` lists them. With --json the \
result is one object: the protocol, digests of policies and robot, and every number of the \
figures, with errors after each control step (0.4 s; the paper's plots count it as 0.1 s).";

const PRECISION_EXAMPLES: &str = "\
Examples:
  octopus experiment precision --policies trained
  octopus experiment precision --trajectory runs/a:best --episodes 300 \\
      --json > precision.json

What `octopus eval` measures, of both tasks, with the courses of the errors: the minimum over \
time, which is the released script's measure, beside the mean of the last 20 steps.";

const DISTURBANCE_EXAMPLES: &str = "\
Examples:
  octopus experiment disturbance --policies trained
  octopus experiment disturbance --trajectory runs/a:best --arm 3 --force 20

The released scripts overwrite actions: arm 2's shoulder lift with 1.3 in one step, or all \
actions of the base's task with 1 in five steps. Beside that something acts from outside: a force \
on the hand for one step (0.4 s, along the world's x axis), or a torque on the base for five \
steps (about the world's z axis). Nothing inside the robot takes their momentum away again, so \
what is pushed drifts for ever. `push and pull` follows with the opposite. After a torque and \
its opposite no momentum is left. After a force and its opposite an angular one is, as the hand \
has moved in between: the base keeps turning until goals, which stand still, are out of reach. \
Recovery is mostly before that, the tail after; the lines below the table say how far the base \
turns and who can still reach. In its five steps 5 N m turn the base by 100 mrad when the arms are held, as the \
overwritten actions do from home in the authors' scale of 0.5. Errors are the largest of the \
three axes. An episode has recovered when its error falls below 15 mm and 20 mrad, or 30 mrad \
of the base, the paper's claims.";

const ARM_FAILURE_EXAMPLES: &str = "\
Examples:
  octopus experiment arm-failure --policies trained
  octopus experiment arm-failure --reorientation runs/b:best --arm all --json

The base is turned with one arm failed from the beginning: held by its servos (its actions are \
zero, as in the released script), or limp (its servos give no torque).";

const BASE_MASS_EXAMPLES: &str = "\
Examples:
  octopus experiment base-mass --policies trained
  octopus experiment base-mass --reorientation runs/b:best \\
      --masses 200,400,800 --thresholds 0.05

The mass is that of the cube (400 kg in training); its inertia scales along, mounts stay. A goal \
is reached if the attitude error after the last step is below the threshold.";

const REASSEMBLY_EXAMPLES: &str = "\
Examples:
  octopus experiment reassembly --policies trained
  octopus experiment reassembly --policies trained --action-scale 0.5

Arm 2 reaches with the trajectory policy, the others turn the base with the reorientation policy; \
in `dual` arm 3 reaches too, from step 70 on. Goals are the authors', then held-out ones. Each \
policy sees what it saw in training and acts in its own scale; --action-scale 0.5 is the authors' \
run.";

const NOISE_EXAMPLES: &str = "\
Examples:
  octopus experiment noise --policies trained
  octopus experiment noise --trajectory runs/a:best --sensors 0,10,100 \\
      --episodes 10
  octopus experiment noise --policies trained --beside runs/robust \\
      --beside jacobian

One thing at a time is made worse. Sensors of strength 1 err by 1 mm, 1 mrad, 1 mm/s and 1 mrad/s \
(standard deviation, each axis, each step); torques disturb every joint, drawn anew in each step; \
commands come a number of steps late; arms have a multiple of their mass.";

const EPISODE_USAGE: &str = "\
octopus experiment episode [OPTIONS] --script <FILE.json>
                                  --policy <CHECKPOINT>...";

const EPISODE_EXAMPLES: &str = "\
Examples:
  octopus experiment episode --script episode.json --policy runs/a:best
  octopus experiment episode --script episode.json --policy runs/a \\
      --policy runs/b:best --out states.csv --json

The page (`octopus view`) saves what somebody did to a robot: how the episode began, and every goal \
that was moved, push, mass, delay and change of policy, with its control step. Here it is played \
again, with the same bits as in the page. Policies count from 0, in the order in which they are \
named; a recording that knows their digests is refused with others.";

/// Options of `octopus experiment`.
#[derive(Debug, Clone, Args)]
#[command(after_help = GROUP_EXAMPLES)]
pub struct ExperimentArgs {
    /// Which.
    #[command(subcommand)]
    pub command: ExperimentCommand,
}

/// The experiments.
#[derive(Debug, Clone, Subcommand)]
pub enum ExperimentCommand {
    /// How near hands and base come to held-out goals.
    Precision(PrecisionArgs),
    /// What a disturbance does, and how soon it is over.
    Disturbance(DisturbanceArgs),
    /// Turning the base with an arm held or limp.
    ArmFailure(ArmFailureArgs),
    /// Turning bases of other masses.
    BaseMass(BaseMassArgs),
    /// Some arms reach while the others hold the base.
    Reassembly(ReassemblyArgs),
    /// Errors against noise, disturbing torques, delay and mass of the arms.
    Noise(NoiseArgs),
    /// Play an episode again that somebody changed in the page.
    Episode(EpisodeArgs),
}

/// What all experiments share.
#[derive(Debug, Clone, Args)]
pub struct CommonArgs {
    /// A directory that holds `trajectory` and `reorientation`.
    #[arg(long, value_name = "DIR", help_heading = "Policies")]
    pub policies: Option<PathBuf>,
    /// The trajectory policy.
    #[arg(long, value_name = "CHECKPOINT", help_heading = "Policies")]
    pub trajectory: Option<PathBuf>,
    /// The reorientation policy.
    #[arg(long, value_name = "CHECKPOINT", help_heading = "Policies")]
    pub reorientation: Option<PathBuf>,
    /// A controller that is not learned, instead of policies.
    #[arg(long, allow_negative_numbers = true, value_enum, value_name = "NAME", conflicts_with_all = ["policies", "trajectory", "reorientation"], help_heading = "Policies")]
    pub controller: Option<Named<ControllerName>>,
    /// Another robot than the policies' own: `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Episodes with goals of their own [default: 30; of base-mass 50 for each mass].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Goals of your own instead of held-out ones: a file as `octopus eval --save-goals` writes.
    #[arg(long, value_name = "FILE.csv|FILE.json")]
    pub goals: Option<PathBuf>,
    /// Seed of goals and noise.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Print the result as JSON, with the errors after every control step.
    #[arg(long)]
    pub json: bool,
}

/// Options of `precision`.
#[derive(Debug, Clone, Args)]
#[command(after_help = PRECISION_EXAMPLES)]
pub struct PrecisionArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Show the errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
}

/// Options of `disturbance`.
#[derive(Debug, Clone, Args)]
#[command(after_help = DISTURBANCE_EXAMPLES)]
pub struct DisturbanceArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The arm that is disturbed in the trajectory task, counted from 1.
    #[arg(long, value_name = "N", default_value_t = 2, allow_hyphen_values = true, value_parser = whole::<usize>(1, 8))]
    pub arm: usize,
    /// The control step that it begins with.
    #[arg(long, value_name = "N", default_value_t = 75, allow_hyphen_values = true, value_parser = whole::<usize>(1, 100_000))]
    pub at: usize,
    /// Force on the hand (N). Not the --force of other commands: nothing is written over.
    #[arg(long, value_name = "N", default_value_t = 50.0, allow_hyphen_values = true, value_parser = amount)]
    pub force: f64,
    /// Torque on the base (N m).
    #[arg(long, value_name = "N·M", default_value_t = 5.0, allow_hyphen_values = true, value_parser = amount)]
    pub torque: f64,
}

/// Options of `arm-failure`.
#[derive(Debug, Clone, Args)]
#[command(after_help = ARM_FAILURE_EXAMPLES)]
pub struct ArmFailureArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The arm that fails, counted from 1, or `all` for every one in turn.
    #[arg(long, value_name = "N|all", default_value = "4", allow_hyphen_values = true, value_parser = failing)]
    pub arm: Failing,
}

/// Which arm fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failing {
    /// This one, counted from 1.
    One(usize),
    /// Every one in turn.
    Each,
}

/// Options of `base-mass`.
#[derive(Debug, Clone, Args)]
#[command(after_help = BASE_MASS_EXAMPLES)]
pub struct BaseMassArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Masses of the cube (kg).
    #[arg(long, value_name = "M,M,…", default_value = "100,200,300,400,500,600,700,800,900,1000", allow_hyphen_values = true, value_parser = all_above_zero)]
    pub masses: Amounts,
    /// Attitude errors that count as reached (rad).
    #[arg(long, value_name = "E,E,…", default_value = "0.01,0.02,0.03,0.05,0.1", allow_hyphen_values = true, value_parser = all_above_zero)]
    pub thresholds: Amounts,
}

/// Options of `reassembly`.
#[derive(Debug, Clone, Args)]
#[command(after_help = REASSEMBLY_EXAMPLES)]
pub struct ReassemblyArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Factor from the actions of all arms to their commands [default: each policy's own].
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = above_zero)]
    pub action_scale: Option<f64>,
    /// A policy of task `mixed`: it and the two policies play its task on the same goals, too.
    #[arg(long, value_name = "RUN_DIR|CHECKPOINT")]
    pub mixed: Option<PathBuf>,
}

/// Options of `noise`.
#[derive(Debug, Clone, Args)]
#[command(after_help = NOISE_EXAMPLES)]
pub struct NoiseArgs {
    /// What all share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Strengths of the sensors' errors.
    #[arg(long, value_name = "K,K,…", default_value = "0,1,2,5,10,20,50", allow_hyphen_values = true, value_parser = amounts)]
    pub sensors: Amounts,
    /// Standard deviations of the joints' torques (N m).
    #[arg(long, value_name = "N·M,…", default_value = "0,1,2,5,10,20,50", allow_hyphen_values = true, value_parser = amounts)]
    pub torques: Amounts,
    /// Control steps that commands come late.
    #[arg(long, value_name = "N,N,…", default_value = "0,1,2", allow_hyphen_values = true, value_parser = amounts)]
    pub delays: Amounts,
    /// Multiples of the arms' mass.
    #[arg(long, value_name = "F,F,…", default_value = "0.5,0.75,1,1.5,2,3", allow_hyphen_values = true, value_parser = all_above_zero)]
    pub arm_masses: Amounts,
    /// Another policy to measure beside them, or a controller: `jacobian` or `postures`. Once for each.
    #[arg(long, value_name = "CHECKPOINT|NAME")]
    pub beside: Vec<PathBuf>,
}

/// Options of `episode`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = EPISODE_USAGE, after_help = EPISODE_EXAMPLES)]
pub struct EpisodeArgs {
    /// What the page saved.
    #[arg(long, value_name = "FILE.json")]
    pub script: PathBuf,
    /// A policy that takes part, once for each of them, in their order.
    #[arg(long = "policy", value_name = "RUN_DIR|CHECKPOINT", required = true)]
    pub policies: Vec<PathBuf>,
    /// Another robot than the first policy's, on which all play: `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// The states, as `octopus simulate` writes them.
    #[arg(long, value_name = "FILE.csv")]
    pub out: Option<PathBuf>,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
    /// Print what came of it as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Reads which arm fails.
fn failing(text: &str) -> Result<Failing, String> {
    if text == "all" {
        return Ok(Failing::Each);
    }
    let arm = text.parse().ok().filter(|arm| (1..=8).contains(arm));
    arm.map(Failing::One).ok_or_else(|| "wants an arm, counted from 1, or `all`".to_owned())
}

/// Runs one and prints.
pub fn run(args: &ExperimentArgs) -> anyhow::Result<()> {
    match args.command.clone() {
        ExperimentCommand::Precision(args) => {
            let (common, agents) = (study(&args.common), args.agents);
            print(&precision::Study { common, agents }, args.common.json)
        }
        ExperimentCommand::Disturbance(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            let (arm, at, force, torque) = (args.arm, args.at, args.force, args.torque);
            print(&disturbance::Study { common, arm, at, force, torque }, json)
        }
        ExperimentCommand::ArmFailure(args) => {
            let arm = match args.arm {
                Failing::One(arm) => arm_failure::Failing::One(arm),
                Failing::Each => arm_failure::Failing::Each,
            };
            print(&arm_failure::Study { common: study(&args.common), arm }, args.common.json)
        }
        ExperimentCommand::BaseMass(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            let (masses, thresholds) = (args.masses.0, args.thresholds.0);
            print(&base_mass::Study { common, masses, thresholds }, json)
        }
        ExperimentCommand::Reassembly(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            let (action_scale, mixed) = (args.action_scale, args.mixed);
            print(&reassembly::Study { common, action_scale, mixed }, json)
        }
        ExperimentCommand::Noise(args) => {
            let study = noise::Study {
                common: study(&args.common),
                sensors: args.sensors.0,
                torques: args.torques.0,
                delays: args.delays.0,
                arm_masses: args.arm_masses.0,
                beside: args.beside.into_iter().map(beside).collect(),
            };
            print(&study, args.common.json)
        }
        ExperimentCommand::Episode(args) => episode(&args),
    }
}

/// A controller by its name, or where a policy is.
fn beside(path: PathBuf) -> Beside {
    let named = path.to_str().and_then(|name| Named::<ControllerName>::from_str(name, false).ok());
    named.map_or(Beside::Policy(path), |name| Beside::Controller(name.0))
}

/// Plays what somebody did in the page.
fn episode(args: &EpisodeArgs) -> anyhow::Result<()> {
    let mut inputs: Vec<Input<'_>> = vec![("--script", &args.script)];
    inputs.extend(args.policies.iter().map(|path| ("--policy", path.as_path())));
    inputs.extend(args.robot.as_deref().map(|robot| ("--robot", Path::new(robot))));
    outputs::check_stdout(args.json, args.out.as_deref())?;
    if let Some(path) = &args.out {
        Output { flag: "--out", path, mark: MARK, force: args.force }.check_or_stdout(&inputs)?;
    }
    let recording = script::read(&args.script)?;
    let load = |name| run::robots::load_fit_robot(name, &StepOptions::default());
    let robot = args.robot.as_deref().map(load).transpose()?;
    let checkpoints = args.policies.iter().map(|path| open_checkpoint(path));
    let checkpoints = checkpoints.collect::<anyhow::Result<Vec<_>>>()?;
    let policies = script::on_one_robot(checkpoints, robot.as_ref())?;
    let played = script::play(&recording, policies, &args.script)?;
    if let Some(path) = &args.out {
        let table = write_table(&played.robot, &played.rows, Precision::F32)?;
        if path == Path::new("-") {
            return output::write(&table);
        }
        files::replace_output(path, &table)?;
    }
    if args.json { output::json(&played) } else { output::line(&played.table()) }
}

/// What all experiments are asked for with.
fn study(args: &CommonArgs) -> Common {
    Common {
        policies: args.policies.clone(),
        trajectory: args.trajectory.clone(),
        reorientation: args.reorientation.clone(),
        controller: args.controller.map(|name| name.0),
        robot: args.robot.clone(),
        episodes: args.episodes,
        steps: args.steps,
        seed: args.seed,
        goals: args.goals.clone(),
    }
}

fn print<E: Experiment>(experiment: &E, json: bool) -> anyhow::Result<()> {
    let lab = experiment.lab()?;
    let report = perform(experiment, &lab)?;
    lab.end();
    if json {
        return output::json(&report);
    }
    if let Some(own) = lab.own_goals() {
        let episodes = output::counted(own.given.len() as u64, "episode");
        let file = own.file.display();
        output::line(&format!("goals of {file}, {episodes}, instead of held-out ones\n"))?;
    }
    output::line(&experiment.printed(output::columns(), &report))
}

#[cfg(test)]
mod option_tests {
    use clap::{CommandFactory as _, Parser as _};

    use super::*;
    use crate::cli::{Cli, Command};

    fn parse(line: &str) -> Result<ExperimentCommand, clap::Error> {
        let cli = Cli::try_parse_from(format!("octopus experiment {line}").split(' '))?;
        let Command::Experiment(args) = cli.command else { panic!("not an experiment") };
        Ok(args.command)
    }

    #[test]
    fn defaults_are_the_papers_protocols() {
        let Ok(ExperimentCommand::Disturbance(args)) = parse("disturbance --policies trained")
        else {
            panic!("valid");
        };
        assert_eq!((args.arm, args.at, args.force, args.torque), (2, 75, 50.0, 5.0));
        assert_eq!((args.common.steps, args.common.seed, args.common.episodes), (200, 0, None));
        let Ok(ExperimentCommand::ArmFailure(args)) = parse("arm-failure") else { panic!("valid") };
        assert_eq!(args.arm, Failing::One(4));
        let Ok(ExperimentCommand::BaseMass(args)) = parse("base-mass") else { panic!("valid") };
        assert_eq!((args.masses.0.len(), args.masses.0[9]), (10, 1000.0));
        assert!(args.thresholds.0.contains(&0.05));
    }

    /// Every other `--force` of the program writes over files.
    #[test]
    fn help_tells_the_force_of_a_disturbance_from_that_of_other_commands() {
        let cli = Cli::command();
        let path = ["experiment", "disturbance"];
        let command = path.iter().try_fold(&cli, |cli, name| cli.find_subcommand(name));
        let mut options = command.expect("there").get_arguments();
        let force = options.find(|option| option.get_long() == Some("force")).expect("there");
        let help = force.get_help().expect("some").to_string();
        assert!(help.contains("(N)") && help.contains("Not the --force of other commands"));
    }

    #[test]
    fn what_is_no_number_is_refused() {
        for wrong in [
            "arm-failure --arm 0",
            "arm-failure --arm none",
            "disturbance --arm 9",
            "disturbance --force inf",
            "disturbance --at 0",
            "base-mass --masses 100,x",
            "base-mass --masses -1",
            "base-mass --thresholds 0.05,",
            "noise --delays nan",
            "reassembly --action-scale -1",
            "precision --episodes 0",
            "reachability",
        ] {
            assert_eq!(parse(wrong).expect_err(wrong).exit_code(), 2, "{wrong}");
        }
    }
}
