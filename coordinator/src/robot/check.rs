//! `octopus robot check`: what a robot is, and whether it can be trained.

use clap::Args;
use lab::evaluation::reachable;
use lab::threads::Threads;
use proto::config::{Layers, Preset, TaskName};
use run::report::progress::Parts;
use run::robots::load_robot;
use run::shakedown::shakedown;
use serde_json::json;
use simulator::env::step_options;
use simulator::experiment::EvaluationGoals;
use simulator::rollout::World;

use crate::values::whole;

const EXAMPLES: &str = "\
Examples:
  octopus robot check my-robot.toml
  octopus robot check paper --episodes 300 --json

The robot moves a little from home, in single precision as it would be trained and in double \
precision with finer steps. It must touch nothing at home, keep its momentum and follow its \
servos; if not, the message says which part is to blame, and the exit code is 3. Then a \
controller that knows the robot tries to reach held-out goals of task `trajectory`. For each goal \
it tries the solutions of the arm's inverse kinematics, the nearest first.";

/// Options of `octopus robot check`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct CheckArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(value_name = "NAME|FILE")]
    pub robot: String,
    /// Episodes whose goals are tried, one goal for each arm.
    #[arg(long, value_name = "N", default_value_t = 30, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub episodes: u32,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Checks and says.
pub(super) fn run(args: &CheckArgs) -> anyhow::Result<()> {
    let robot = load_robot(&args.robot)?;
    let config = Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).resolve()?;
    shakedown(&robot, &args.robot, &step_options(&config))?;
    let world = World::new(&config, &robot);
    let progress = Parts::new();
    let (goals, episodes) = (EvaluationGoals::drawn(args.seed), args.episodes as usize);
    let hands = reachable(&world, goals, episodes, Threads::available(), &progress)?.concat();
    progress.end();
    let reached = hands.iter().filter(|hand| hand.reached).count();
    let masses: Vec<f64> = (0..robot.n_arms).map(|arm| robot.type_of(arm).mass()).collect();
    let reach = robot.reach();
    let joints: Vec<usize> = robot.joints.by_arm().collect();
    if args.json {
        return output::json(&json!({
            "robot": robot.name,
            "arms": robot.n_arms,
            "joints": robot.n_joints(),
            "joints_by_arm": joints,
            "mass": robot.total_mass(),
            "base_mass": robot.base.mass,
            "arm_mass": masses,
            "reach_at_most": reach,
            "goals": hands.len(),
            "reachable": reached,
        }));
    }
    let rows = [
        ("robot".to_owned(), robot.name.clone()),
        ("arms".to_owned(), robot.joints.to_string()),
        (
            "mass".to_owned(),
            format!("{:.1} kg, {:.1} of them the base", robot.total_mass(), robot.base.mass),
        ),
        ("reach".to_owned(), format!("{reach:.2} m at most, the arm stretched")),
        ("at home".to_owned(), "touches nothing, and moves as finer steps say".to_owned()),
        ("goals".to_owned(), format!("{reached} of {} can be reached", hands.len())),
    ];
    let lines: Vec<String> = rows.iter().map(|(what, value)| format!("{what:10}{value}")).collect();
    output::line(&lines.join("\n"))?;
    if let Some(remark) = remark(reached, hands.len()) {
        output::note(remark);
    }
    Ok(())
}

/// What may be wrong where most goals are out of reach. They are drawn around where hands are at home.
fn remark(reached: usize, goals: usize) -> Option<&'static str> {
    (2 * reached < goals).then_some(
        "note: most goals are out of reach; they lie around the hands at home, so a home with bent arms may \
         bring more (`home` of each arm, `octopus robot import --home`), and arms with fewer than six joints reach few",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_reaches_few_goals_is_remarked() {
        assert!(remark(59, 120).is_some_and(|remark| remark.contains("home")));
        assert_eq!(remark(60, 120), None);
    }
}
