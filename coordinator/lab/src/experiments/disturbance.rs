//! What a disturbance does, and how soon it is over.

use std::ffi::OsString;
use std::fmt;
use std::ops::Range;

use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::evaluate::Course;
use simulator::experiment::{Effect, FixedGoals, Intervention, Recording};
use simulator::robot::JOINTS_PER_ARM;

use super::command_line::option;
use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{CourseOfMany, Figure, Goals, Report, Words, share, spread};
use super::{Experiment, Name};
use crate::statistics::{ErrorOf, Spread, Unit, milli, percent};
use crate::trained::Trained;

/// Steps in which the released script overwrites the actions of the base's task.
const BASE_STEPS: usize = 5;
/// What it overwrites them with, and the shoulder lift's action of the trajectory task (rad/s, before scaling).
const BASE_ACTION: f64 = 1.0;
const LIFT_ACTION: f64 = 1.3;
/// Errors below which the paper says that all axes come back: position (m), orientation (rad), attitude of the base (rad).
const POSITION: f32 = 0.015;
const ORIENTATION: f32 = 0.02;
const BASE: f32 = 0.03;

/// The authors' goals of the figures: of every arm's hand, and of the base.
const HAND_GOALS: [[f64; 6]; 4] = [
    [0.35695, 1.27752, 4.32081, 0.25147, -0.10136, 0.18484],
    [0.39634, -1.23843, 4.23199, -0.13400, -0.04476, 0.12608],
    [0.27815, 0.29938, 5.24606, -1.06882, 0.48948, 0.06324],
    [0.43091, 0.28067, 2.71313, -1.14632, -0.05982, -0.08541],
];
const BASE_GOAL: [f64; 3] = [0.02927, -0.03531, 0.19579];

/// What disturbs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Disturbance {
    /// Actions are overwritten.
    #[serde(rename = "override")]
    Override,
    /// Something from outside.
    #[serde(rename = "push")]
    Push,
    /// The same, and then the opposite.
    #[serde(rename = "push and pull")]
    PushAndPull,
}

impl Disturbance {
    /// All of them.
    pub(crate) const ALL: [Self; 3] = [Self::Override, Self::Push, Self::PushAndPull];
}

impl fmt::Display for Disturbance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Override => "override",
            Self::Push => "push",
            Self::PushAndPull => "push and pull",
        })
    }
}

/// A way to disturb.
struct Case {
    name: Disturbance,
    what: String,
    /// The steps in which it does.
    steps: Range<usize>,
    interventions: Vec<Intervention>,
}

/// What a disturbance led to.
#[derive(Debug, Serialize, Deserialize)]
pub struct Disturbed {
    pub(crate) task: TaskName,
    pub(crate) disturbance: Disturbance,
    pub(crate) what: String,
    /// First disturbed control step, and the first one after.
    pub(crate) steps: [usize; 2],
    /// The disturbed arm, counted from 1.
    arm: Option<usize>,
    pub(crate) errors: Vec<Recovery>,
    /// Largest angular velocity of the base from the disturbance on, and its mean over the last 20 steps (rad/s).
    base_rate_peak: Spread,
    base_rate_tail: Spread,
    /// Angle by which the base turns between the end of the disturbance and that of the episode (rad).
    #[serde(default)]
    base_turns: Option<Spread>,
    /// Share of episodes for whose goal of the disturbed hand inverse kinematics has a solution with the base where the episode ended.
    #[serde(default)]
    within_reach: Option<f64>,
    /// An episode with the authors' goals; none on robots with other arms than theirs.
    pub(crate) figure: Option<Figure>,
}

/// How an error went: the largest of its three axes.
#[derive(Debug, Serialize, Deserialize)]
pub struct Recovery {
    pub(crate) error: ErrorOf,
    pub(crate) unit: Unit,
    /// What counts as recovered.
    pub(crate) threshold: f32,
    /// After the last step before the disturbance.
    before: Spread,
    /// After its last step.
    at: Spread,
    /// Largest from its first step on.
    pub(crate) peak: Spread,
    /// Mean of the last 20 steps.
    pub(crate) tail: Spread,
    /// Share of episodes below the threshold before the disturbance.
    below_before: f64,
    /// Share of episodes that come below the threshold after it.
    pub(crate) recovered: f64,
    /// Steps after the disturbance until they do, of those that do.
    steps_to_recover: Option<Spread>,
    /// Share of episodes below the threshold in the mean of the last 20 steps.
    pub(crate) below_tail: f64,
    /// Mean of the last 20 steps of each episode.
    #[serde(skip)]
    tails: Vec<f32>,
    /// The same share of the episodes whose goal is within reach where they end.
    #[serde(default)]
    below_tail_within_reach: Option<f64>,
    pub(crate) course: CourseOfMany,
}

/// How it is disturbed.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The first disturbed control step.
    at: usize,
    /// The disturbed arm, counted from 1.
    arm: usize,
    force_n: f64,
    torque_n_m: f64,
    errors: Words,
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// The arm that is disturbed in the trajectory task, counted from 1.
    pub arm: usize,
    /// The control step that it begins with.
    pub at: usize,
    /// Force on the hand (N).
    pub force: f64,
    /// Torque on the base (N m).
    pub torque: f64,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self { common: Common::default(), arm: 2, at: 75, force: 50.0, torque: 5.0 }
    }
}

impl Experiment for Study {
    const NAME: Name = Name::Disturbance;
    const NEEDS: Needs = Needs::Any;
    type Settings = Settings;
    type Result = Disturbed;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        let Self { common: _, arm, at, force, torque } = self;
        vec![
            option("--arm", arm),
            option("--at", at),
            option("--force", force),
            option("--torque", torque),
        ]
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        lab.check_arm(self.arm)?;
        let longest = self.at + 2 * BASE_STEPS;
        if lab.steps <= longest {
            let message = format!(
                "--steps {} ends before the disturbance has: with --at {} it takes more than \
                 {longest}",
                lab.steps, self.at
            );
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
        Ok(Settings {
            at: self.at,
            arm: self.arm,
            force_n: self.force,
            torque_n_m: self.torque,
            errors: "the largest of the three axes".into(),
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        let cases = Disturbance::ALL.len() * lab.policies().len();
        lab.work(cases, if has_figures(lab) { cases } else { 0 })
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Disturbed>> {
        let mut results = Vec::new();
        for policy in lab.policies() {
            for case in cases(self, policy.task(), lab.robot.n_joints()) {
                results.push(measure(lab, policy, self.arm - 1, case)?);
            }
        }
        Ok(results)
    }

    fn table(columns: usize, report: &Report<Settings, Disturbed>) -> String {
        table(columns, &report.results, report.protocol.episodes)
    }
}

/// Whether the authors' goals are goals of the robot's arms.
fn has_figures(lab: &Lab) -> bool {
    lab.robot.n_arms == HAND_GOALS.len()
}

fn cases(study: &Study, task: TaskName, n_joints: usize) -> Vec<Case> {
    let first = study.at;
    let all_along = |steps: Range<usize>, effect| Intervention { steps, effect };
    // A force that is given and taken back leaves angular momentum, because the hand has moved meanwhile; a torque leaves none.
    let (unit, length, amount): (_, _, Box<dyn Fn(f64) -> Effect>) = match task {
        TaskName::Trajectory => {
            let (arm, force) = (study.arm - 1, study.force);
            let effect =
                move |sign: f64| Effect::HandForce { arm, force: [sign * force, 0.0, 0.0] };
            (format!("{} N on hand {}", study.force, study.arm), 1, Box::new(effect))
        }
        TaskName::Reorientation => {
            let torque = study.torque;
            let effect = move |sign: f64| Effect::BaseTorque([0.0, 0.0, sign * torque]);
            (format!("{} N m on the base", study.torque), BASE_STEPS, Box::new(effect))
        }
    };
    let (joints, value) = match task {
        TaskName::Trajectory => {
            let lift = (study.arm - 1) * JOINTS_PER_ARM + 1;
            (lift..lift + 1, LIFT_ACTION)
        }
        TaskName::Reorientation => (0..n_joints, BASE_ACTION),
    };
    let (once, twice) = (first..first + length, first + length..first + 2 * length);
    vec![
        Case {
            name: Disturbance::Override,
            what: match task {
                TaskName::Trajectory => format!("lift of arm {} at {value}", study.arm),
                TaskName::Reorientation => format!("all actions at {value}"),
            },
            steps: once.clone(),
            interventions: vec![all_along(once.clone(), Effect::Action { joints, value })],
        },
        Case {
            name: Disturbance::Push,
            what: unit.clone(),
            steps: once.clone(),
            interventions: vec![all_along(once.clone(), amount(1.0))],
        },
        Case {
            name: Disturbance::PushAndPull,
            what: format!("{unit}, then back"),
            steps: first..first + 2 * length,
            interventions: vec![all_along(once, amount(1.0)), all_along(twice, amount(-1.0))],
        },
    ]
}

fn measure(lab: &Lab, policy: &Trained, arm: usize, case: Case) -> anyhow::Result<Disturbed> {
    let task = policy.task();
    let mut trial = lab.trial(policy);
    trial.interventions.clone_from(&case.interventions);
    let what = format!("disturbance, {}, {}", task.as_str(), case.name);
    let recording = lab.play(&what, &trial)?;
    let figure = if has_figures(lab) {
        trial.episodes = 1;
        trial.fixed = FixedGoals {
            hands: HAND_GOALS.map(Some).to_vec(),
            base: (task == TaskName::Reorientation).then_some(BASE_GOAL),
        };
        let arms: &[usize] = if task == TaskName::Trajectory { &[arm] } else { &[] };
        let shown = lab.play(&format!("{what}, the authors' goals"), &trial)?;
        Some(Figure::of(&shown, Goals::Theirs, arms))
    } else {
        None
    };
    let axes = |[x, y, z]: [f32; 3]| x.abs().max(y.abs()).max(z.abs());
    let within_reach = (task == TaskName::Trajectory).then(|| lab.within_reach(policy, &recording));
    let of_arm = |hands: &[Vec<bool>]| hands.iter().map(|hands| hands[arm]).collect::<Vec<bool>>();
    let within_reach = within_reach.as_deref().map(of_arm);
    let mut errors = match task {
        TaskName::Trajectory => {
            let position = |episode, step| {
                let [x, y, z, ..] = recording.hand(episode, step, arm);
                axes([x, y, z])
            };
            let orientation = |episode, step| {
                let [.., a, b, c] = recording.hand(episode, step, arm);
                axes([a, b, c])
            };
            vec![
                Recovery::of(&recording, ErrorOf::Position, POSITION, &case.steps, position),
                Recovery::of(
                    &recording,
                    ErrorOf::Orientation,
                    ORIENTATION,
                    &case.steps,
                    orientation,
                ),
            ]
        }
        TaskName::Reorientation => {
            let base = |episode, step| axes(recording.base(episode, step));
            vec![Recovery::of(&recording, ErrorOf::Base, BASE, &case.steps, base)]
        }
    };
    let rate = |episode, step| {
        let [x, y, z] = recording.base_rate(episode, step);
        (x * x + y * y + z * z).sqrt()
    };
    let episodes = || 0..recording.episodes();
    let (first, steps) = (case.steps.start, recording.steps());
    if let Some(within_reach) = &within_reach {
        for error in &mut errors {
            error.below_tail_within_reach =
                share_of(within_reach, |e| error.tails[e] < error.threshold);
        }
    }
    let turns = |episode| {
        let [from, to] = [case.steps.end - 1, steps - 1]
            .map(|step| recording.pose(episode, step).base_quaternion);
        angle_between(from, to)
    };
    Ok(Disturbed {
        task,
        disturbance: case.name,
        what: case.what,
        steps: [case.steps.start, case.steps.end],
        arm: (task == TaskName::Trajectory).then_some(arm + 1),
        errors,
        base_rate_peak: spread(
            episodes().map(|e| (first..steps).map(|step| rate(e, step)).fold(0.0, f32::max)),
        ),
        base_rate_tail: spread(
            episodes().map(|e| Course::of((0..steps).map(move |step| rate(e, step))).tail),
        ),
        base_turns: Some(spread(episodes().map(turns))),
        within_reach: within_reach.map(|within| share(within.len(), |episode| within[episode])),
        figure,
    })
}

/// The share of the episodes that `of` names which satisfy a condition; none if it names none.
fn share_of(of: &[bool], holds: impl Fn(usize) -> bool) -> Option<f64> {
    let named: Vec<usize> = (0..of.len()).filter(|&episode| of[episode]).collect();
    (!named.is_empty()).then(|| share(named.len(), |index| holds(named[index])))
}

/// The angle from one attitude to another (rad), by the chord between their quaternions: exact for small ones, too.
fn angle_between(a: [f32; 4], b: [f32; 4]) -> f32 {
    let chord =
        |sign: f32| a.iter().zip(&b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f32>().sqrt();
    // A quaternion and its negative are one attitude.
    4.0 * (chord(1.0).min(chord(-1.0)) / 2.0).min(1.0).asin()
}

impl Recovery {
    /// What `value` says about an episode and a step, disturbed in `steps`.
    fn of(
        recording: &Recording,
        error: ErrorOf,
        threshold: f32,
        steps: &Range<usize>,
        value: impl Fn(usize, usize) -> f32 + Copy,
    ) -> Self {
        let (n, end) = (recording.episodes(), recording.steps());
        let tail = |episode| Course::of((0..end).map(move |step| value(episode, step))).tail;
        let tails: Vec<f32> = (0..n).map(tail).collect();
        let soonest: Vec<f32> = (0..n)
            .filter_map(|episode| {
                let mut after = (steps.end..end).enumerate();
                let (index, _) = after.find(|(_, step)| value(episode, *step) < threshold)?;
                Some((index + 1) as f32)
            })
            .collect();
        let before = steps.start - 1;
        Self {
            error,
            unit: error.unit(),
            threshold,
            before: spread((0..n).map(|episode| value(episode, before))),
            at: spread((0..n).map(|episode| value(episode, steps.end - 1))),
            peak: spread((0..n).map(|episode| {
                (steps.start..end).map(|step| value(episode, step)).fold(0.0, f32::max)
            })),
            tail: spread(tails.iter().copied()),
            below_before: share(n, |episode| value(episode, before) < threshold),
            recovered: soonest.len() as f64 / n.max(1) as f64,
            steps_to_recover: (!soonest.is_empty()).then(|| spread(soonest.into_iter())),
            below_tail: share(n, |episode| tails[episode] < threshold),
            below_tail_within_reach: None,
            tails,
            course: CourseOfMany::of(recording, value),
        }
    }
}

fn table(columns: usize, results: &[Disturbed], episodes: usize) -> String {
    let rows = results.iter().flat_map(|result| {
        result.errors.iter().map(move |error| {
            let soonest =
                error.steps_to_recover.map_or("–".to_owned(), |steps| steps.p50.to_string());
            [
                format!("{}, {} (m{})", result.what, error.error, error.unit),
                milli(error.before.p50),
                milli(error.at.p50),
                milli(error.peak.p50),
                milli(error.tail.p50),
                milli(error.tail.p90),
                milli(f64::from(error.threshold)),
                percent(error.recovered),
                soonest,
                percent(error.below_tail),
                result.base_turns.map_or("–".to_owned(), |turns| milli(turns.p50)),
            ]
        })
    });
    let header = [
        "worst axis, median",
        "before",
        "at",
        "peak",
        "tail",
        "tail p90",
        "below",
        "recovered",
        "steps",
        "below in tail",
        "base turns",
    ];
    format!(
        "{} each\n{}{}",
        output::counted(episodes as u64, "episode"),
        output::table_within(columns, header, rows),
        notes(results)
    )
}

/// What a push leaves, in words: where the base goes, and what that leaves to the hand.
fn notes(results: &[Disturbed]) -> String {
    let mut lines = Vec::new();
    for result in results {
        let (Some(turns), Some(within_reach)) = (result.base_turns, result.within_reach) else {
            continue;
        };
        let below: Vec<String> = result
            .errors
            .iter()
            .filter_map(|error| {
                Some(format!("{} in {}", percent(error.below_tail_within_reach?), error.error))
            })
            .collect();
        let below = match below.as_slice() {
            [] => String::new(),
            below => format!(";\n  of these end below: {}", below.join(", ")),
        };
        lines.push(format!(
            "{}: then the base turns by {} mrad, {} at 90 %;\n  {} of the goals are within the arm's reach at the end{below}",
            result.what,
            milli(turns.p50),
            milli(turns.p90),
            percent(within_reach),
        ));
    }
    if lines.is_empty() { String::new() } else { format!("\n\n{}", lines.join("\n")) }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn a_recovery_by_hand() {
        let recording = super::super::report::tests::resting(2, 30);
        // Episode 0: 10 before, 100 at step 4, then halved with every step; episode 1: 50 from step 4 on.
        let value = |episode: usize, step: usize| match (episode, step) {
            (_, 0..4) => 10.0,
            (0, _) => 100.0 * 0.5_f32.powi(step as i32 - 4),
            _ => 50.0,
        };
        let recovery = Recovery::of(&recording, ErrorOf::Base, 20.0, &(4..5), value);
        assert_eq!(
            (recovery.before.mean, recovery.at.mean, recovery.peak.mean),
            (10.0, 75.0, 75.0)
        );
        assert_eq!(
            (recovery.below_before, recovery.recovered, recovery.below_tail),
            (1.0, 0.5, 0.5)
        );
        // 50, 25, 12.5: the third step after.
        let steps = recovery.steps_to_recover.expect("one recovers");
        assert_eq!((steps.mean, steps.std), (3.0, 0.0));
        assert_eq!(share_of(&[true, false], |e| recovery.tails[e] < 20.0), Some(1.0));
        assert_eq!(share_of(&[false, true], |e| recovery.tails[e] < 20.0), Some(0.0));
        assert_eq!(share_of(&[false, false], |_| true), None);
        let never = Recovery::of(&recording, ErrorOf::Base, 1e-9, &(4..5), value);
        assert_eq!((never.recovered, never.steps_to_recover), (0.0, None));
    }

    /// So that the two disturbances of the base can be compared, in the authors' scale.
    #[test]
    fn the_torque_turns_the_base_as_far_as_the_overwritten_actions() {
        let study = Study { at: 1, ..Study::default() };
        let turned = |case: usize| {
            let task = TaskName::Reorientation;
            let recording = super::super::report::tests::changed(task, 1, 6, |trial| {
                trial.fixed.base = Some([0.0; 3]);
                trial.players[0].action_scale = 0.5;
                trial.interventions = cases(&study, task, 24).swap_remove(case).interventions;
            });
            assert_eq!(recording.attitude(0, 0), 0.0, "it rests before");
            recording.base(0, 5)[2].abs()
        };
        let (actions, torque) = (turned(0), turned(1));
        // ½ · 5 N m / 103 kg m² · (2 s)² = 97 mrad, and arms give way a little.
        assert!((actions / torque - 1.0).abs() < 0.1, "{actions} {torque}");
    }

    #[test]
    fn angles_between_attitudes_by_hand() {
        let about_x = |angle: f32| [(angle / 2.0).cos(), (angle / 2.0).sin(), 0.0, 0.0];
        for angle in [0.0, 1e-4, 0.3, 3.0] {
            let turned = angle_between(about_x(0.2), about_x(0.2 + angle));
            assert!((turned - angle).abs() < 1e-5, "{turned} {angle}");
            let negative = about_x(0.2 + angle).map(|x| -x);
            assert!((angle_between(about_x(0.2), negative) - angle).abs() < 1e-5);
        }
    }

    /// The hand has moved between push and pull, so that they leave angular momentum; a torque and its opposite leave none.
    #[test]
    fn a_force_that_is_taken_back_leaves_the_base_turning_and_a_torque_does_not() {
        let study = Study { at: 1, ..Study::default() };
        let turned = |task: TaskName, case: usize| {
            let recording = super::super::report::tests::changed(task, 1, 40, |trial| {
                trial.interventions = cases(&study, task, 24).swap_remove(case).interventions;
            });
            let [from, to] = [15, 39].map(|step| recording.pose(0, step).base_quaternion);
            angle_between(from, to)
        };
        let [push, pull] = [1, 2].map(|case| turned(TaskName::Trajectory, case));
        assert!(push > 1.0, "{push}");
        assert!(pull > 0.01 && pull < 0.5 * push, "{pull} of {push}");
        let [push, pull] = [1, 2].map(|case| turned(TaskName::Reorientation, case));
        assert!(push > 0.5, "{push}");
        assert!(pull < 1e-3, "{pull}");
    }

    #[test]
    fn the_released_overrides_and_pushes_that_are_taken_back() {
        let study = Study { arm: 3, force: 20.0, at: 10, ..Study::default() };
        let trajectory = cases(&study, TaskName::Trajectory, 24);
        // Arm 3's lift is joint 13.
        assert_eq!(
            trajectory[0].interventions[0].effect,
            Effect::Action { joints: 13..14, value: 1.3 }
        );
        assert_eq!(trajectory[0].steps, 10..11);
        let base = cases(&study, TaskName::Reorientation, 24);
        assert_eq!(base[0].interventions[0].effect, Effect::Action { joints: 0..24, value: 1.0 });
        assert_eq!(base[0].steps, 10..15);
        for cases in [trajectory, base] {
            let [push, back] = cases[2].interventions.as_slice() else { panic!("two parts") };
            assert_eq!(push.steps.len(), back.steps.len());
            assert_eq!(push.steps.end, back.steps.start);
            let impulse = |effect: &Effect| match effect {
                Effect::HandForce { force, arm: 2 } => *force,
                Effect::BaseTorque(torque) => *torque,
                other => panic!("{other:?}"),
            };
            let (there, back) = (impulse(&push.effect), impulse(&back.effect));
            for axis in 0..3 {
                assert_eq!(there[axis] + back[axis], 0.0);
            }
            assert_eq!(cases[1].interventions, cases[2].interventions[..1]);
        }
    }
}
