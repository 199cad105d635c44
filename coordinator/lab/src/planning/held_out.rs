//! How often plans are found: for the held-out goals that can be reached, one after the other.

use std::time::Duration;

use proto::config::{Layers, Preset, TaskName};
use proto::rng::Purpose;
use run::report::progress::Parts;
use serde::Serialize;
use simulator::experiment::EvaluationGoals;
use simulator::plan::{Obstacle, Question, Tolerance};
use simulator::robot::Robot;
use simulator::rollout::World;
use simulator::state::State;
use simulator::step::StepOptions;
use simulator::task::goal::GoalAddress;

use super::answer::answer;
use crate::evaluation::reachable;
use crate::threads::Threads;

/// How the planner did on held-out goals, each asked for alone, from home.
#[derive(Debug, Serialize)]
pub struct HeldOut {
    /// Seed of the goals.
    pub seed: u64,
    /// Episodes whose goals were asked for.
    pub episodes: usize,
    /// Time for each plan (s).
    pub time_limit_s: f64,
    /// Goals that a controller which knows the robot reaches when all hands move together.
    pub goals: usize,
    /// Of these, how many have a plan.
    pub planned: usize,
    /// How many were missed, by what was in the way.
    pub missed: Missed,
    /// Episode and arm of the missed, both counted from 0.
    pub missed_goals: Vec<(u32, usize)>,
    /// Half of the plans were found within (s); none where no goal can be reached.
    pub planning_s_p50: Option<f64>,
    /// 99 of 100 within.
    pub planning_s_p99: Option<f64>,
    /// The longest took.
    pub planning_s_max: Option<f64>,
    /// Half of the plans arrive after (s); none without a plan.
    pub arrived_s_p50: Option<f64>,
    /// Candidates, in the mean.
    pub candidates_mean: Option<f64>,
}

/// Goals without a plan, each counted where its answer says `obstacle`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Missed {
    /// No joint angles put the hand there.
    pub kinematics: usize,
    /// The arm does not reach it from where the base is.
    pub reach: usize,
    /// All that arrive touch something.
    pub contact: usize,
    /// Joint angles are known, but nothing arrives.
    pub motion: usize,
}

/// Plans for the reachable goals of `episodes` evaluation episodes.
///
/// # Errors
/// If the simulation diverges while it is looked for what can be reached.
pub fn held_out(
    robot: &Robot,
    options: &StepOptions,
    (seed, episodes): (u64, usize),
    (within, fastest): (Tolerance, f64),
    limit: Duration,
) -> anyhow::Result<HeldOut> {
    let config = Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).resolve()?;
    let world = World::new(&config, robot);
    let progress = Parts::new();
    let goals = EvaluationGoals::drawn(seed);
    let reached = reachable(&world, goals, episodes, Threads::available(), &progress)?;
    let goals: Vec<(u32, usize)> = reached
        .iter()
        .enumerate()
        .flat_map(|(episode, hands)| {
            let reached = hands.iter().enumerate().filter(|(_, hand)| hand.reached);
            reached.map(move |(arm, _)| (episode as u32, arm))
        })
        .collect();
    progress.begin("plans", goals.len() as u64);
    let (mut planned, mut missed, mut missed_goals) = (0, Missed::default(), Vec::new());
    let (mut seconds, mut arrived, mut candidates) = (Vec::new(), Vec::new(), 0);
    for &(env, arm) in &goals {
        let purpose = Purpose::EvaluationGoal;
        let address = GoalAddress { seed, purpose, iteration: 0, env };
        let mut hands = vec![None; robot.n_arms];
        hands[arm] = Some(world.task.goals.hand(arm, address));
        let start = State::home(robot);
        let question = Question { start, hands, hold_base: false, within, fastest, seed: 0 };
        let found = answer(robot, options, &question, None, limit)?;
        candidates += found.plan.tried;
        seconds.push(found.seconds);
        match found.plan.obstacle {
            None => {
                planned += 1;
                let step = found.plan.arrived.expect("a plan arrives");
                arrived.push((step + 1) as f64 * options.control_period);
            }
            Some(obstacle) => {
                missed_goals.push((env, arm));
                *match obstacle {
                    Obstacle::Kinematics { .. } => &mut missed.kinematics,
                    Obstacle::Reach { .. } => &mut missed.reach,
                    Obstacle::Contact => &mut missed.contact,
                    Obstacle::Motion => &mut missed.motion,
                } += 1;
            }
        }
        progress.advance();
    }
    seconds.sort_by(f64::total_cmp);
    arrived.sort_by(f64::total_cmp);
    let part = |values: &[f64], share: f64| {
        let last = values.len().saturating_sub(1);
        values.get((share * last as f64).round() as usize).copied()
    };
    let n = goals.len();
    Ok(HeldOut {
        seed,
        episodes,
        time_limit_s: limit.as_secs_f64(),
        goals: n,
        planned,
        missed,
        missed_goals,
        planning_s_p50: part(&seconds, 0.5),
        planning_s_p99: part(&seconds, 0.99),
        planning_s_max: part(&seconds, 1.0),
        arrived_s_p50: part(&arrived, 0.5),
        candidates_mean: (n > 0).then(|| candidates as f64 / n as f64),
    })
}

impl HeldOut {
    /// As a person reads it.
    pub fn table(&self) -> String {
        if self.goals == 0 {
            let episodes = output::counted(self.episodes as u64, "episode");
            return format!(
                "no goal of {episodes} can be reached by this robot; nothing was planned"
            );
        }
        let or_dash = |value: Option<f64>, digits: usize, unit: &str| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}{unit}"))
        };
        let seconds = |value| or_dash(value, 2, " s");
        let share = 100.0 * self.planned as f64 / self.goals.max(1) as f64;
        let Missed { kinematics, reach, contact, motion } = self.missed;
        let rows = [
            ["goals that can be reached".to_owned(), output::grouped(self.goals as u64)],
            [
                "with a plan".to_owned(),
                format!("{} ({share:.2} %)", output::grouped(self.planned as u64)),
            ],
            [
                "without".to_owned(),
                format!(
                    "kinematics {kinematics}, reach {reach}, contact {contact}, motion {motion}"
                ),
            ],
            [
                "planning".to_owned(),
                format!(
                    "median {}, 99 % within {}, longest {}",
                    seconds(self.planning_s_p50),
                    seconds(self.planning_s_p99),
                    seconds(self.planning_s_max)
                ),
            ],
            ["arrival, median".to_owned(), or_dash(self.arrived_s_p50, 1, " s")],
            ["candidates, mean".to_owned(), or_dash(self.candidates_mean, 0, "")],
        ];
        output::table(["what", "how many"], rows)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// An arm that is too short for every goal, and no shapes.
    const SHORT: &str = "\
name = \"short\"
home_position = [0.0, 0.0, 4.0]
base = [{ name = \"cube\", size = [0.5, 0.5, 0.5], mass = 100.0 }]
arms = [{ name = \"a\", mount_position = [0.0, 0.25, 0.0], mount_euler_deg = [-90.0, 0.0, 0.0], home = [0.0, 0.0] }]

[mount]
size = [0.01, 0.01, 0.01]
mass = 0.1
position = [0.0, 0.0, 0.0]

[pedestal]
euler_deg = [0.0, 0.0, 0.0]
mass = 0.1
com = [0.0, 0.0, 0.0]
inertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]

[[links]]
name = \"one\"
dh = { a = 0.05, d = 0.0, alpha_deg = 90.0 }
mass = 1.0
com = [0.0, 0.0, 0.0]
inertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
armature = 1.0
servo = { gain = 100.0, max_rate = 2.0, max_torque = 150.0 }

[[links]]
name = \"two\"
dh = { a = 0.05, d = 0.0, alpha_deg = 0.0 }
mass = 1.0
com = [0.0, 0.0, 0.0]
inertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
armature = 1.0
servo = { gain = 100.0, max_rate = 2.0, max_torque = 150.0 }

[tool]
position = [0.0, 0.0, 0.0]
";

    #[test]
    fn a_robot_that_reaches_no_goal_is_said_to_reach_none() {
        let robot = Robot::from_toml(SHORT, Path::new("short.toml")).expect("a robot");
        let within = Tolerance { position: 5e-3, orientation: 10e-3 };
        let options = StepOptions::default();
        let limit = Duration::from_millis(1);
        let found = held_out(&robot, &options, (0, 1), (within, 0.8), limit).expect("stable");
        assert_eq!((found.goals, found.planning_s_p50, found.candidates_mean), (0, None, None));
        let text = found.table();
        assert!(text.contains("no goal of 1 episode can be reached"), "{text}");
        // Goals without a plan have no time of arrival.
        let unplanned = HeldOut {
            goals: 1,
            missed: Missed { kinematics: 1, ..found.missed },
            planning_s_p50: Some(0.25),
            ..found
        };
        let json = serde_json::to_value(&unplanned).expect("plain data");
        let named = serde_json::json!({ "kinematics": 1, "reach": 0, "contact": 0, "motion": 0 });
        assert_eq!(json["missed"], named);
        let text = unplanned.table();
        assert!(text.contains("median 0.25 s") && !text.contains("NaN"), "{text}");
    }
}
