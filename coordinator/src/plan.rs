//! `octopus plan`: a motion that brings hands to poses.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use export::{Commanded, Recording};
use lab::planning::{Report, answer, held_out, picture, sentence};
use lab::trained::{Trained, open_checkpoint};
use proto::{ExitCode, ExitError};
use simulator::experiment::FixedGoals;
use simulator::plan::{Frame, Question, Tolerance};
use simulator::robot::Robot;
use simulator::simulate::Precision;
use simulator::state::State;
use simulator::step::StepOptions;
use store::files;
use store::outputs::{self, Input, Output};

use crate::joint_commands;
use crate::names::{Named, Names};
use crate::trajectories::{MARK, last_state, write_table};
use crate::values::{duration, whole};

const EXAMPLES: &str = "\
Examples:
  octopus plan --goal 2=0.4,-1.1,4.2,1.6,0,1.5 --out plan.csv
  octopus plan --by --frame mount --goal 1=0.1,0,-0.2,0,0,0.3 --out plan.csv
  octopus plan --goal 1=... --goal 3=... --hold-base --picture plan.svg --json
  octopus plan --state before.csv --policy runs/a:best --goal 4=... \\
      --out plan.csv
  octopus plan --held-out 300 --seed 5 --time-limit 10s

A goal is a pose of the hand: position (m) and Euler angles (rad, R = Rx Ry Rz). With --by it is \
a change of the present pose instead: a shift along the axes of --frame and a turn about them.

Candidates are played in the simulator, contacts included: every set of joint angles that the \
arm has for the pose, straight or with a detour, the other arms at rest or moving, which moves \
the base. 32 are played at a time; of those that arrive and touch nothing the one that arrives \
first is the plan. Commands are joint rates \
(rad/s), a row a control step of 0.4 s: what `octopus simulate` reads, which ends in the same \
place. On machines with the same type of processor and C library the same question has the same \
answer, if it is found in time. \
Contacts are looked for in the motion itself, and by playing it again without them; distances \
between bodies are those at the ends of control steps.

Exit code 1 if no plan holds what --within asks. Nothing is written then.";

const USAGE: &str = "\
octopus plan [OPTIONS] --goal <HAND=X,Y,Z,A,B,C>...
       octopus plan [OPTIONS] --held-out <EPISODES>";

/// Options of `octopus plan`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = USAGE, after_help = EXAMPLES)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
pub struct PlanArgs {
    /// Where a hand shall go, hands counted from 1. Once for every hand that has a goal.
    #[arg(long = "goal", value_name = "HAND=X,Y,Z,A,B,C", allow_hyphen_values = true, value_parser = goal, required_unless_present = "held_out")]
    pub goals: Vec<Goal>,
    /// Axes of the goals.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Frame::World))]
    pub frame: Named<Frame>,
    /// Goals are changes of the hands' present poses.
    #[arg(long)]
    pub by: bool,
    /// How near is near enough.
    #[arg(long, value_name = "DISTANCE,ANGLE", default_value = "5mm,10mrad", allow_hyphen_values = true, value_parser = within)]
    pub within: Within,
    /// Arms without a goal keep the base where it is.
    #[arg(long)]
    pub hold_base: bool,
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE", default_value = "paper")]
    pub robot: String,
    /// Begin where the trajectory in this file ends, instead of at home.
    #[arg(long, value_name = "FILE.csv")]
    pub state: Option<PathBuf>,
    /// Try what this policy does first; it has to be one of `trajectory`.
    #[arg(long, alias = "policies", value_name = "RUN_DIR|CHECKPOINT")]
    pub policy: Option<PathBuf>,
    /// Fastest joint rate (rad/s). Trained policies may turn joints two to three times as fast.
    #[arg(long, value_name = "RATE", default_value_t = 0.8, allow_hyphen_values = true, value_parser = rate)]
    pub fastest: f64,
    /// When to give up. The first 32 candidates are always played.
    #[arg(long, value_name = "TIME", default_value = "1s", allow_hyphen_values = true, value_parser = duration)]
    pub time_limit: Duration,
    /// Tells the detours of one search from those of another; with --held-out, seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// The commands; `-` writes standard output, and no table.
    #[arg(long, value_name = "PLAN.csv")]
    pub out: Option<PathBuf>,
    /// The motion that they make, as `octopus simulate` writes it.
    #[arg(long, value_name = "FILE.csv")]
    pub trajectory: Option<PathBuf>,
    /// Errors, rates and distances over time.
    #[arg(long, value_name = "FILE.svg")]
    pub picture: Option<PathBuf>,
    /// The motion with goals and contacts for robot viewers, as `octopus record` writes it.
    #[arg(long, value_name = "FILE.mcap")]
    pub recording: Option<PathBuf>,
    /// Write over a plan that is there already, over files of another kind, and into a run's directory; what is
    /// read stays. Trajectory, picture and recording replace one of their kind without it.
    #[arg(long)]
    pub force: bool,
    /// Print what was found as JSON.
    #[arg(long)]
    pub json: bool,
    /// Plan, one after the other, for the held-out goals of so many evaluation episodes that can be reached, and say how many have a plan.
    #[arg(long, value_name = "EPISODES", allow_hyphen_values = true, value_parser = whole::<u64>(1, 100_000), conflicts_with_all = ["goals", "by", "frame", "hold_base", "state", "policy", "out", "trajectory", "picture", "recording"])]
    pub held_out: Option<u64>,
}

/// A goal as the command line has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Counted from 0.
    arm: usize,
    numbers: [f64; 6],
}

/// How near is near enough, as the command line has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Within(Tolerance);

impl Names for Frame {
    const ALL: &'static [Named<Self>] =
        &[Named(Self::World), Named(Self::Base), Named(Self::Mount)];

    fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Base => "base",
            Self::Mount => "mount",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::World => "Those of the world",
            Self::Base => "Those of the base, wherever it is",
            Self::Mount => "Those of the arm's mount, the first joint's axis last",
        }
    }
}

fn goal(text: &str) -> Result<Goal, String> {
    let wanted = "wants a hand, counted from 1, and six numbers, such as 2=0.4,-1.1,4.2,1.6,0,1.5";
    let read = || {
        let (hand, numbers) = text.split_once('=')?;
        let arm = hand.trim().parse::<usize>().ok()?.checked_sub(1)?;
        let number = |text: &str| text.trim().parse().ok().filter(|x: &f64| x.abs() <= 1000.0);
        let numbers: Option<Vec<f64>> = numbers.split(',').map(number).collect();
        Some(Goal { arm, numbers: numbers?.try_into().ok()? })
    };
    read().ok_or_else(|| wanted.to_owned())
}

fn within(text: &str) -> Result<Within, String> {
    let wanted = "wants a distance and an angle, such as 5mm,10mrad or 1cm,0.5deg, from 0.001mm to 10m and from 0.001mrad to 10rad";
    let amount = |text: &str, units: &[(&str, f64)]| {
        let (unit, number) = units.iter().find_map(|(unit, factor)| {
            Some((*factor, text.trim().strip_suffix(unit)?.trim().parse::<f64>().ok()?))
        })?;
        Some(unit * number).filter(|value| (1e-6..=10.0).contains(value))
    };
    let read = || {
        let (distance, angle) = text.split_once(',')?;
        let position = amount(distance, &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])?;
        let degree = std::f64::consts::PI / 180.0;
        let orientation = amount(angle, &[("mrad", 1e-3), ("rad", 1.0), ("deg", degree)])?;
        Some(Within(Tolerance { position, orientation }))
    };
    read().ok_or_else(|| wanted.to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate: &f64| (0.01..=10.0).contains(rate));
    rate.ok_or_else(|| "wants a rate from 0.01 to 10 rad/s".to_owned())
}

/// What an SVG begins with.
const SVG: &[u8] = b"<svg";

/// Plans.
pub fn run(args: &PlanArgs) -> anyhow::Result<()> {
    let options = StepOptions::default();
    let robot = run::robots::load_fit_robot(&args.robot, &options)?;
    if let Some(episodes) = args.held_out {
        let goals = (args.seed, episodes as usize);
        let how = (args.within.0, args.fastest);
        let found = held_out(&robot, &options, goals, how, args.time_limit)?;
        return if args.json { output::json(&found) } else { output::line(&found.table()) };
    }
    check_outputs(args)?;
    let question = question(args, &robot)?;
    let policy = args.policy.as_deref().map(|path| policy(path, &robot)).transpose()?;
    let found = answer(&robot, &options, &question, policy, args.time_limit)?;
    let report = Report::new(&question, &found, options.control_period);
    if let Some(reason) = sentence(&question, &found) {
        if args.json {
            output::json(&report)?;
        }
        return Err(ExitError::new(ExitCode::Failure, reason).into());
    }
    if let Some(path) = &args.trajectory {
        let table = write_table(&robot, &found.inspection.rows, Precision::F32)?;
        files::replace_output(path, &table)?;
    }
    if let Some(path) = &args.picture {
        let drawn = picture(&robot, &question, &found, options.control_period)?;
        files::replace_output(path, drawn.as_bytes())?;
    }
    if let Some(path) = &args.recording {
        let commands = found.plan.commands.clone();
        files::replace_output(path, &recording(&robot, &options, &question, commands)?)?;
    }
    if let Some(path) = &args.out {
        let table = joint_commands::write(&found.plan.commands)?;
        if path == Path::new("-") {
            return output::write(&table);
        }
        files::replace_output(path, &table)?;
    }
    // Last: what is said to be there is there.
    if args.json { output::json(&report) } else { output::line(&report.table()) }
}

/// The question, its goals in the world.
fn question(args: &PlanArgs, robot: &Robot) -> anyhow::Result<Question> {
    let usage = |message: String| Err(ExitError::new(ExitCode::Usage, message).into());
    let start = match &args.state {
        Some(path) => last_state(path, robot)?,
        None => State::home(robot),
    };
    let mut hands = vec![None; robot.n_arms];
    for &Goal { arm, numbers } in &args.goals {
        let hand = arm + 1;
        let Some(slot) = hands.get_mut(arm) else {
            return usage(format!(
                "--goal {hand}=…: the robot `{}` has {} hands",
                robot.name, robot.n_arms
            ));
        };
        let frame = args.frame.0;
        let pose = if args.by {
            frame.by(robot, &start, arm, numbers)
        } else {
            frame.to_world(robot, &start, arm, numbers)
        };
        if slot.replace(pose).is_some() {
            return usage(format!("--goal {hand}=…: is given twice; a hand has one goal"));
        }
    }
    if args.hold_base && hands.iter().all(Option::is_some) {
        return usage("--hold-base: wants an arm without a goal, which keeps the base".to_owned());
    }
    let (within, fastest, seed) = (args.within.0, args.fastest, args.seed);
    Ok(Question { start, hands, hold_base: args.hold_base, within, fastest, seed })
}

/// The motion as an MCAP file.
fn recording(
    robot: &Robot,
    options: &StepOptions,
    question: &Question,
    commands: Vec<Vec<f32>>,
) -> anyhow::Result<Vec<u8>> {
    let mut start = State::<f32>::home(robot);
    start.set_lane(0, &question.start);
    let goals = FixedGoals { hands: question.hands.clone(), base: None };
    let (robot, options, moved_goals) = (robot.clone(), *options, Vec::new());
    let mass_factors = Vec::new();
    let commanded = Commanded { robot, options, start, goals, moved_goals, mass_factors, commands };
    Ok(Recording::of(commanded, &[("origin", "octopus plan".to_owned())])?.mcap()?)
}

fn policy(path: &Path, robot: &Robot) -> anyhow::Result<Trained> {
    let trained = Trained::new(open_checkpoint(path)?, Some(robot))?;
    if !trained.task().only_reaches() || trained.task().moves() {
        let message = format!(
            "--policy {}: the policy learned `{}`; wanted is one of `trajectory`, which moves hands to poses",
            path.display(),
            trained.task().as_str()
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    }
    Ok(trained)
}

/// Refuses places that are taken, before anything is looked for.
fn check_outputs(args: &PlanArgs) -> Result<(), ExitError> {
    outputs::check_stdout(args.json, args.out.as_deref())?;
    let mut inputs: Vec<Input<'_>> = vec![("--robot", Path::new(&args.robot))];
    inputs.extend(args.state.as_deref().map(|path| ("--state", path)));
    inputs.extend(args.policy.as_deref().map(|path| ("--policy", path)));
    let named: [(&'static str, &Option<PathBuf>, &[u8]); 4] = [
        ("--out", &args.out, b""),
        ("--trajectory", &args.trajectory, MARK),
        ("--picture", &args.picture, SVG),
        ("--recording", &args.recording, Recording::MARK),
    ];
    let mut places = Vec::new();
    for (flag, path, mark) in named {
        let Some(path) = path else { continue };
        match flag {
            "--picture" => outputs::check_ending(flag, path, "svg")?,
            "--recording" => outputs::check_ending(flag, path, "mcap")?,
            _ => {}
        }
        let output = Output { flag, path, mark, force: args.force };
        if flag == "--out" { output.check_or_stdout(&inputs) } else { output.check(&inputs) }?;
        places.push((flag, path.as_path()));
    }
    outputs::check_distinct(&places)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goals_and_tolerances_are_read() {
        let read = goal("2=0.4,-1.1, 4.2,1.6,0,1.5").expect("a goal");
        assert_eq!(read, Goal { arm: 1, numbers: [0.4, -1.1, 4.2, 1.6, 0.0, 1.5] });
        for wrong in
            ["0=1,2,3,4,5,6", "1=1,2,3", "1,2,3,4,5,6", "1=1,2,3,4,5,nan", "1=1e9,0,0,0,0,0", ""]
        {
            assert!(goal(wrong).is_err_and(|wanted| wanted.contains("counted from 1")), "{wrong}");
        }
        let near = |text| within(text).map(|Within(t)| [t.position, t.orientation]);
        assert_eq!(near("5mm,10mrad"), Ok([5.0 * 1e-3, 10.0 * 1e-3]));
        assert_eq!(near("0.5cm, 0.01rad"), Ok([0.5 * 1e-2, 0.01]));
        let degrees = near("1m,1deg").expect("read")[1];
        assert!((degrees - 0.017_453).abs() < 1e-6);
        for wrong in ["5mm", "5,10", "5mm,10mm", "0mm,1mrad", "-1mm,1mrad", "nanmm,1rad", ""] {
            assert!(within(wrong).is_err(), "{wrong}");
        }
        let small = within("1e-30mm,1e-30mrad").map(|_| ()).expect_err("smaller than any");
        assert!(small.contains("from 0.001mm to 10m"), "{small}");
        assert!(rate("0").is_err() && rate("nan").is_err());
        assert_eq!(rate("0.8"), Ok(0.8));
    }
}
