//! What a disturbance led to: the episodes of one case, and what is read from them.

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::Course;
use simulator::experiment::FixedGoals;

use super::super::lab::Lab;
use super::super::report::{Figure, Goals, share, spread};
use super::cases::{Case, Disturbance};
use super::recovery::Recovery;
use crate::contender::Contender;
use crate::statistics::{ErrorOf, Spread};

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

/// What its trial is called.
fn trial_of(task: TaskName, disturbance: Disturbance) -> String {
    format!("disturbance, {}, {disturbance}", task.as_str())
}

impl Disturbed {
    /// What its trial is called, with these goals.
    pub(crate) fn trial(&self, goals: Goals) -> String {
        goals.of_trial(&trial_of(self.task, self.disturbance))
    }
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
    pub(super) arm: Option<usize>,
    pub(crate) errors: Vec<Recovery>,
    /// Largest angular velocity of the base from the disturbance on, and its mean over the last 20 steps (rad/s).
    pub(super) base_rate_peak: Spread,
    pub(super) base_rate_tail: Spread,
    /// Angle by which the base turns between the end of the disturbance and that of the episode (rad).
    #[serde(default)]
    pub(super) base_turns: Option<Spread>,
    /// Share of episodes for whose goal of the disturbed hand inverse kinematics has a solution with the base where the episode ended.
    #[serde(default)]
    pub(super) within_reach: Option<f64>,
    /// An episode with the authors' goals; none on robots with other arms than theirs.
    pub(crate) figure: Option<Figure>,
}

/// Whether the authors' goals are goals of the robot's arms.
pub(super) fn has_figures(lab: &Lab) -> bool {
    lab.robot.n_arms == HAND_GOALS.len()
}

/// Plays a case of an arm, counted from 0.
pub(super) fn measure(
    lab: &Lab,
    policy: &Contender,
    arm: usize,
    case: Case,
) -> anyhow::Result<Disturbed> {
    let task = policy.task();
    let what = trial_of(task, case.name);
    let mut trial = lab.trial(policy);
    trial.interventions.clone_from(&case.interventions);
    let recording = lab.play(&what, &trial)?;
    let figure = if has_figures(lab) {
        trial.episodes = 1;
        trial.fixed = FixedGoals {
            hands: HAND_GOALS.map(Some).to_vec(),
            base: task.turns().then_some(BASE_GOAL),
        };
        let arms: &[usize] = if task.reaches() { &[arm] } else { &[] };
        let shown = lab.play(&Goals::Theirs.of_trial(&what), &trial)?;
        Some(Figure::of(&shown, Goals::Theirs, arms))
    } else {
        None
    };
    let axes = |[x, y, z]: [f32; 3]| x.abs().max(y.abs()).max(z.abs());
    let within_reach = task.reaches().then(|| lab.within_reach(policy, &recording));
    let of_arm = |hands: &[Vec<bool>]| hands.iter().map(|hands| hands[arm]).collect::<Vec<bool>>();
    let within_reach = within_reach.as_deref().map(of_arm);
    let mut errors = if task.reaches() {
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
            Recovery::of(&recording, ErrorOf::Orientation, ORIENTATION, &case.steps, orientation),
        ]
    } else {
        let base = |episode, step| axes(recording.base(episode, step));
        vec![Recovery::of(&recording, ErrorOf::Base, BASE, &case.steps, base)]
    };
    let rate = |episode, step| {
        let [x, y, z] = recording.base_rate(episode, step);
        (x * x + y * y + z * z).sqrt()
    };
    let episodes = || 0..recording.episodes();
    let (first, steps) = (case.steps.start, recording.steps());
    if let Some(within_reach) = &within_reach {
        for error in &mut errors {
            error.look_within_reach(within_reach);
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
        arm: task.reaches().then_some(arm + 1),
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

/// The angle from one attitude to another (rad), by the chord between their quaternions: exact for small ones, too.
fn angle_between(a: [f32; 4], b: [f32; 4]) -> f32 {
    let chord =
        |sign: f32| a.iter().zip(&b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f32>().sqrt();
    // A quaternion and its negative are one attitude.
    4.0 * (chord(1.0).min(chord(-1.0)) / 2.0).min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use super::super::super::report::tests::changed;
    use super::super::cases::cases;
    use super::super::study::Study;
    use proto::agents::Joints;

    use super::*;

    /// So that the two disturbances of the base can be compared, in the authors' scale.
    #[test]
    fn the_torque_turns_the_base_as_far_as_the_overwritten_actions() {
        let study = Study { at: 1, ..Study::default() };
        let turned = |case: usize| {
            let task = TaskName::Reorientation;
            let recording = changed(task, 1, 6, |trial| {
                trial.fixed.base = Some([0.0; 3]);
                trial.players[0].action_scale = 0.5;
                trial.interventions =
                    cases(&study, task, &Joints::of_sixes(4)).swap_remove(case).interventions;
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
            let recording = changed(task, 1, 40, |trial| {
                trial.interventions =
                    cases(&study, task, &Joints::of_sixes(4)).swap_remove(case).interventions;
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
}
