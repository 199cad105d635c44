//! Some arms reach while the others hold the base.

use std::ffi::OsString;
use std::fmt;
use std::path::PathBuf;

use proto::config::TaskName;
use proto::tasks::{Aim, EpisodeGoals, GoalAddress, HomeArm};
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::env::step_options;
use simulator::experiment::{FixedGoals, Phase, Pose, Recording, Trial};
use simulator::robot::Robot;

use super::command_line::{option, path_option};
use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{ErrorOfMany, Figure, Goals, Report};
use super::{Experiment, Name};
use crate::contender::Contender;
use crate::statistics::milli;

/// The players, in the order of a trial's.
const REACHES: usize = 0;
const TURNS: usize = 1;
/// The step from which the second arm reaches, in the stage that has two.
const SECOND_FROM: usize = 70;

/// What a stage is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StageName {
    /// One arm reaches.
    Single,
    /// Two do, one after the other.
    Dual,
    /// The first half of the arms does, from the beginning, and the others turn the base: what task `mixed` trains together.
    Halves,
}

impl fmt::Display for StageName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Single => "single",
            Self::Dual => "dual",
            Self::Halves => "halves",
        })
    }
}

/// A stage of the authors' script.
struct Stage {
    name: StageName,
    /// The arms that reach, from which step on, and where to.
    reaching: &'static [(usize, usize, [f64; 6])],
    base: [f64; 3],
}

const ARM_2: [f64; 6] = [0.39634, -1.23843, 4.23199, 0.13400, -0.14476, 0.12608];
const ARM_3: [f64; 6] = [0.27815, 0.29938, 5.24606, -1.06882, 0.48948, 0.06324];

const STAGES: [Stage; 2] = [
    Stage {
        name: StageName::Single,
        reaching: &[(1, 0, ARM_2)],
        base: [-0.14199, 0.06260, -0.08740],
    },
    Stage {
        name: StageName::Dual,
        reaching: &[(1, 0, ARM_2), (2, SECOND_FROM, ARM_3)],
        base: [-0.01182, 0.00485, -0.14812],
    },
];

/// What a stage led to.
#[derive(Debug, Serialize, Deserialize)]
pub struct Staged {
    pub(crate) stage: StageName,
    /// Who, if it was not the pair of policies: see [`Study::mixed`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    by: Option<String>,
    pub(crate) goals: Goals,
    episodes: usize,
    /// The reaching arms, counted from 1, and the steps from which they do.
    pub(crate) reaching: Vec<(usize, usize)>,
    /// Of the reaching hands, then of the base.
    pub(crate) errors: Vec<ErrorOfMany>,
    /// The first episode.
    pub(crate) figure: Figure,
    /// Where the robot stood in it after every step.
    pub(crate) poses: Vec<Pose>,
}

/// The stages, and how far actions reach in them.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    action_scale: ActionScale,
    /// In their order.
    pub(crate) stages: Vec<StageGoals>,
}

/// Factors from actions to joint velocity commands (rad/s).
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct ActionScale {
    reaching: f64,
    turning: f64,
}

/// The authors' goals of a stage.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct StageGoals {
    stage: StageName,
    base_goal_rad: [f64; 3],
    /// Of the reaching arms.
    pub(crate) reaching: Vec<HandGoal>,
}

/// The goal of a hand.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct HandGoal {
    /// Counted from 1.
    arm: usize,
    from_step: usize,
    /// Position (m) and Euler angles (rad).
    pub(crate) goal: [f64; 6],
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// Factor from the actions of all arms to their commands; each policy's own if none is given.
    pub action_scale: Option<f64>,
    /// A policy that learned both together (task `mixed`): it and the pair play its task on the same goals.
    pub mixed: Option<PathBuf>,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self { common: Common::default(), action_scale: None, mixed: None }
    }
}

impl Experiment for Study {
    const NAME: Name = Name::Reassembly;
    const NEEDS: Needs = Needs::Both;
    type Settings = Settings;
    type Result = Staged;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        let scale = self.action_scale.map(|scale| option("--action-scale", scale));
        let mixed = self.mixed.as_ref().map(|path| path_option("--mixed", path));
        scale.into_iter().chain(mixed).collect()
    }

    fn lab(&self) -> anyhow::Result<Lab> {
        let lab = Lab::new(&self.common, Self::NEEDS, Self::EPISODES)?;
        match &self.mixed {
            Some(path) => lab.measure_mixed(path),
            None => Ok(lab),
        }
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        check_robot(&lab.robot)?;
        if lab.steps <= SECOND_FROM {
            let message =
                format!("--steps {}: the second arm reaches from step {SECOND_FROM} on", lab.steps);
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
        let own = |task| lab.policy(task).world.task.action_scale;
        let scale = |task| self.action_scale.unwrap_or_else(|| own(task));
        Ok(Settings {
            action_scale: ActionScale {
                reaching: scale(TaskName::Trajectory),
                turning: scale(TaskName::Reorientation),
            },
            stages: STAGES.iter().map(StageGoals::of).collect(),
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        // One policy of both tasks, and the pair.
        lab.work(STAGES.len() + 2 * lab.beside().len(), STAGES.len())
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Staged>> {
        let mut results = Vec::new();
        for stage in &STAGES {
            let mut trial = set_up(lab, stage, self.action_scale);
            let what = trial_of(stage.name);
            let drawn = lab.play(&what, &trial)?;
            trial.episodes = 1;
            trial.fixed = stage.goals(lab.robot.n_arms);
            let fixed = lab.play(&Goals::Theirs.of_trial(&what), &trial)?;
            results.push(Staged::of(stage, Goals::Theirs, &fixed));
            results.push(Staged::of(stage, lab.whose_goals(), &drawn));
        }
        if let Some((name, mixed)) = lab.beside().first() {
            results.extend(halves(lab, (name, mixed), self.action_scale)?);
        }
        Ok(results)
    }

    fn table(columns: usize, report: &Report<Settings, Staged>) -> String {
        table(columns, &report.results)
    }
}

impl StageGoals {
    fn of(stage: &Stage) -> Self {
        let reaching = stage.reaching.iter();
        Self {
            stage: stage.name,
            base_goal_rad: stage.base,
            reaching: reaching
                .map(|&(arm, from_step, goal)| HandGoal { arm: arm + 1, from_step, goal })
                .collect(),
        }
    }
}

/// Refuses a robot that has not the arms of the stages.
pub fn check_robot(robot: &Robot) -> Result<(), ExitError> {
    if robot.n_arms >= 4 {
        return Ok(());
    }
    let message =
        format!("the robot `{}` has {} arms; the stages take four", robot.name, robot.n_arms);
    Err(ExitError::new(ExitCode::BadInput, message))
}

/// A stage on held-out goals, or a person's own. The world is that of the base's task, as in the authors' script.
fn set_up<'a>(lab: &'a Lab, stage: &Stage, action_scale: Option<f64>) -> Trial<'a> {
    Trial { phases: stage.phases(lab.robot.n_arms), ..set_up_pair(lab, action_scale) }
}

/// The pair on such goals; who moves what is yet to be said.
fn set_up_pair(lab: &Lab, action_scale: Option<f64>) -> Trial<'_> {
    let (reach, turn) = (lab.policy(TaskName::Trajectory), lab.policy(TaskName::Reorientation));
    let mut trial = lab.trial(reach);
    trial.options = step_options(&turn.world.config);
    trial.players = vec![reach.player(), turn.player()];
    scale(&mut trial, action_scale);
    trial
}

/// Has the actions of all players reach so far, if it is said.
fn scale(trial: &mut Trial<'_>, action_scale: Option<f64>) {
    if let Some(scale) = action_scale {
        for player in &mut trial.players {
            player.action_scale = scale;
        }
    }
}

/// The task that a policy learned as a whole, by the pair and by itself, on the same goals.
fn halves(
    lab: &Lab,
    (name, mixed): (&str, &Contender),
    action_scale: Option<f64>,
) -> anyhow::Result<[Staged; 2]> {
    let world = &mixed.world;
    let reaches = |arm: &usize| world.task.aims[*arm] == Aim::Hand;
    let arms: Vec<usize> = (0..lab.robot.n_arms).filter(reaches).collect();
    let first = lab.trial(mixed).goals;
    let definition = mixed.task().definition();
    let goals = (0..lab.episodes as u32).map(|episode| {
        let address = GoalAddress { env: first.env + episode, ..first };
        let EpisodeGoals { hands, base, .. } = definition.goals(&world.task.goals, address);
        // Those that the task has no goals for stay at home, whatever a policy that reaches would draw for them.
        let home = |arm: usize| {
            let HomeArm { position: [x, y, z], euler: [a, b, c], .. } =
                world.task.goals.home.arms[arm];
            [x, y, z, a, b, c]
        };
        let hands = hands.iter().enumerate();
        let hands = hands.map(|(arm, hand)| Some(hand.unwrap_or_else(|| home(arm))));
        FixedGoals { hands: hands.collect(), base }
    });
    let mut goals: Vec<FixedGoals> = goals.collect();
    for (goals, given) in
        goals.iter_mut().zip(lab.own_goals().into_iter().flat_map(|own| &own.given))
    {
        for &arm in &arms {
            // Arms beyond the end of a list have no goals of a person.
            let own = given.hands.get(arm).copied().flatten();
            goals.hands[arm] = own.or(goals.hands[arm]);
        }
        goals.base = given.base.or(goals.base);
    }
    let who = |arm: usize| if arms.contains(&arm) { REACHES } else { TURNS };
    let phase = Phase { from: 0, arms: (0..lab.robot.n_arms).map(|arm| Some(who(arm))).collect() };
    let of_pair = Trial { phases: vec![phase], given: &goals, ..set_up_pair(lab, action_scale) };
    let mut of_mixed = Trial { given: &goals, ..lab.trial(mixed) };
    scale(&mut of_mixed, action_scale);
    let what = trial_of(StageName::Halves);
    let play = |by: Option<&str>, trial: &Trial<'_>| -> anyhow::Result<Staged> {
        let who = by.map_or_else(String::new, |by| format!(" by {by}"));
        let recording = lab.play_beside(&format!("{what}{who}"), trial)?;
        let reaching = arms.iter().map(|arm| (arm + 1, 0)).collect();
        let by = by.map(str::to_owned);
        Ok(Staged::measured((StageName::Halves, by, lab.whose_goals()), reaching, &recording))
    };
    Ok([play(None, &of_pair)?, play(Some(name), &of_mixed)?])
}

impl Stage {
    /// Who moves what: a phase begins with each arm that begins to reach.
    fn phases(&self, n_arms: usize) -> Vec<Phase> {
        let mut starts: Vec<usize> = self.reaching.iter().map(|(_, from, _)| *from).collect();
        starts.dedup();
        let phase = |from: usize| {
            let mut arms = vec![Some(TURNS); n_arms];
            for (arm, _, _) in self.reaching.iter().filter(|(_, begins, _)| *begins <= from) {
                arms[*arm] = Some(REACHES);
            }
            Phase { from, arms }
        };
        starts.into_iter().map(phase).collect()
    }

    fn goals(&self, n_arms: usize) -> FixedGoals {
        let mut hands = vec![None; n_arms];
        for (arm, _, goal) in self.reaching {
            hands[*arm] = Some(*goal);
        }
        FixedGoals { hands, base: Some(self.base) }
    }
}

/// What a trial is called.
fn trial_of(stage: StageName) -> String {
    format!("reassembly, {stage}")
}

impl Staged {
    /// What its trial is called.
    pub(crate) fn trial(&self) -> String {
        self.goals.of_trial(&trial_of(self.stage))
    }

    fn of(stage: &Stage, goals: Goals, recording: &Recording) -> Self {
        let reaching = stage.reaching.iter().map(|(arm, from, _)| (arm + 1, *from)).collect();
        Self::measured((stage.name, None, goals), reaching, recording)
    }

    /// `reaching` are the arms that do, counted from 1, and since when.
    fn measured(
        (stage, by, goals): (StageName, Option<String>, Goals),
        reaching: Vec<(usize, usize)>,
        recording: &Recording,
    ) -> Self {
        let arms: Vec<usize> = reaching.iter().map(|(arm, _)| arm - 1).collect();
        let hands = arms.iter().flat_map(|&arm| {
            [ErrorOfMany::position(recording, arm), ErrorOfMany::orientation(recording, arm)]
        });
        Self {
            stage,
            by,
            goals,
            episodes: recording.episodes(),
            reaching,
            errors: hands.chain([ErrorOfMany::base(recording)]).collect(),
            figure: Figure::of(recording, goals, &arms),
            poses: (0..recording.steps()).map(|step| recording.pose(0, step)).collect(),
        }
    }
}

fn table(columns: usize, results: &[Staged]) -> String {
    let rows = results.iter().flat_map(|result| {
        result.errors.iter().map(move |error| {
            let [min, last, tail] = [&error.min, &error.last, &error.tail].map(|s| milli(s.mean));
            let [p50, p90] = [error.tail.p50, error.tail.p90].map(milli);
            let who = result.by.as_ref().map_or_else(String::new, |by| format!(" by {by}"));
            let name = format!("{}{who}, {}: {}", result.stage, result.goals, error.name());
            [name, result.episodes.to_string(), min, last, tail, p50, p90]
        })
    });
    let header = ["stage", "episodes", "min", "final", "tail", "p50", "p90"];
    output::table_within(columns, header, rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_arm_takes_its_turn_at_step_70() {
        let [single, dual] = &STAGES;
        let turns = Some(TURNS);
        let one = vec![turns, Some(REACHES), turns, turns];
        assert_eq!(single.phases(4), [Phase { from: 0, arms: one.clone() }]);
        let two = vec![turns, Some(REACHES), Some(REACHES), turns];
        let phases = [Phase { from: 0, arms: one }, Phase { from: 70, arms: two }];
        assert_eq!(dual.phases(4), phases);
        let goals = dual.goals(4);
        assert_eq!(goals.hands, [None, Some(ARM_2), Some(ARM_3), None]);
        assert_eq!(single.goals(4).hands[2], None);
    }
}
