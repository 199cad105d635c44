//! The form of results: what was done with what, courses over time, and numbers for tables.

use serde::Serialize;
use sim_worker::evaluate::Course;
use sim_worker::experiment::Recording;
use sim_worker::robot::Robot;

use crate::commands::eval::Spread;
use crate::commands::trained::PolicyIdentity;
use crate::provenance::Provenance;

/// An experiment as JSON.
#[derive(Debug, Serialize)]
pub(super) struct Report<S, R> {
    pub(super) experiment: &'static str,
    pub(super) protocol: Protocol<S>,
    pub(super) robot: RobotIdentity,
    pub(super) policies: Vec<PolicyIdentity>,
    pub(super) provenance: Provenance,
    pub(super) results: R,
}

/// How it was done.
#[derive(Debug, Serialize)]
pub(super) struct Protocol<S> {
    pub(super) episodes: usize,
    pub(super) steps: usize,
    pub(super) seed: u64,
    /// Time of a control step (s). The paper's plots count 0.1 s.
    pub(super) control_period_s: f64,
    pub(super) actions: &'static str,
    /// What this experiment has besides.
    pub(super) settings: S,
}

/// Which robot it was.
#[derive(Debug, Serialize)]
pub(super) struct RobotIdentity {
    pub(super) name: String,
    /// BLAKE3 of its description as TOML.
    pub(super) blake3: String,
}

impl RobotIdentity {
    pub(super) fn of(robot: &Robot) -> Self {
        let hash = blake3::hash(robot.to_toml().as_bytes());
        Self { name: robot.name.clone(), blake3: hash.to_hex().to_string() }
    }
}

/// A number over the steps of an episode, over several episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct CourseOfMany {
    pub(super) mean: Vec<f32>,
    pub(super) p50: Vec<f32>,
    pub(super) p90: Vec<f32>,
    pub(super) max: Vec<f32>,
}

impl CourseOfMany {
    /// Of what `value` says about an episode and a step.
    pub(super) fn of(recording: &Recording, value: impl Fn(usize, usize) -> f32) -> Self {
        let steps = recording.steps();
        let mut out = Self {
            mean: Vec::with_capacity(steps),
            p50: Vec::with_capacity(steps),
            p90: Vec::with_capacity(steps),
            max: Vec::with_capacity(steps),
        };
        for step in 0..steps {
            let values: Vec<f32> =
                (0..recording.episodes()).map(|episode| value(episode, step)).collect();
            let spread = spread(values.iter().copied());
            out.mean.push(spread.mean as f32);
            out.p50.push(spread.p50 as f32);
            out.p90.push(spread.p90 as f32);
            out.max.push(values.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        }
        out
    }
}

/// Mean, deviation and percentiles of some numbers.
pub(super) fn spread(values: impl Iterator<Item = f32>) -> Spread {
    Spread::of(values.map(f64::from).collect())
}

/// An error of many episodes: the three numbers of each, and the course.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct ErrorOfMany {
    /// `position`, `orientation` or `base`.
    pub(super) error: &'static str,
    /// `m` or `rad`.
    pub(super) unit: &'static str,
    /// The arm whose hand it is, counted from 1; none where it is all of them or the base.
    pub(super) arm: Option<usize>,
    /// Smallest of each episode.
    pub(super) min: Spread,
    /// After the last step.
    #[serde(rename = "final")]
    pub(super) last: Spread,
    /// Mean of the last 20 steps of each episode.
    pub(super) tail: Spread,
    /// Over the steps.
    pub(super) course: CourseOfMany,
}

impl ErrorOfMany {
    /// What `value` says about an episode and a step.
    pub(super) fn of(
        recording: &Recording,
        (error, unit): (&'static str, &'static str),
        arm: Option<usize>,
        value: impl Fn(usize, usize) -> f32 + Copy,
    ) -> Self {
        let steps = recording.steps();
        let courses: Vec<Course> = (0..recording.episodes())
            .map(|episode| Course::of((0..steps).map(move |step| value(episode, step))))
            .collect();
        let of = |number: fn(&Course) -> f32| spread(courses.iter().map(number));
        Self {
            error,
            unit,
            arm,
            min: of(|course| course.min),
            last: of(|course| course.last),
            tail: of(|course| course.tail),
            course: CourseOfMany::of(recording, value),
        }
    }

    /// Position error of a hand.
    pub(super) fn position(recording: &Recording, arm: usize) -> Self {
        let value = |episode, step| recording.position(episode, step, arm);
        Self::of(recording, ("position", "m"), Some(arm + 1), value)
    }

    /// Orientation error of a hand.
    pub(super) fn orientation(recording: &Recording, arm: usize) -> Self {
        let value = |episode, step| recording.orientation(episode, step, arm);
        Self::of(recording, ("orientation", "rad"), Some(arm + 1), value)
    }

    /// Attitude error of the base.
    pub(super) fn base(recording: &Recording) -> Self {
        let value = |episode, step| recording.attitude(episode, step);
        Self::of(recording, ("base", "rad"), None, value)
    }

    /// What it is called in a table.
    pub(super) fn name(&self) -> String {
        match self.arm {
            Some(arm) => format!("arm {arm} {} (m{})", self.error, self.unit),
            None => format!("{} (m{})", self.error, self.unit),
        }
    }
}

/// Errors of one episode, each axis, after every step (goal − actual): what a figure shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Figure {
    /// Whose goals they are.
    pub(super) goals: &'static str,
    /// Hands, if the episode has goals for them.
    pub(super) hands: Vec<HandFigure>,
    /// Attitude of the base (rad): Euler angles.
    pub(super) base_rad: Vec<[f32; 3]>,
}

/// A hand's part of a figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct HandFigure {
    /// The arm, counted from 1.
    pub(super) arm: usize,
    /// World axes (m).
    pub(super) position_m: Vec<[f32; 3]>,
    /// Euler angles (rad).
    pub(super) orientation_rad: Vec<[f32; 3]>,
}

impl Figure {
    /// Of the first episode of a recording, with the hands of `arms`.
    pub(super) fn of(recording: &Recording, goals: &'static str, arms: &[usize]) -> Self {
        let steps = 0..recording.steps();
        let hands = arms.iter().map(|&arm| {
            let errors: Vec<[f32; 6]> =
                steps.clone().map(|step| recording.hand(0, step, arm)).collect();
            HandFigure {
                arm: arm + 1,
                position_m: errors.iter().map(|&[x, y, z, ..]| [x, y, z]).collect(),
                orientation_rad: errors.iter().map(|&[.., a, b, c]| [a, b, c]).collect(),
            }
        });
        Self {
            goals,
            hands: hands.collect(),
            base_rad: steps.clone().map(|step| recording.base(0, step)).collect(),
        }
    }
}

/// The share of `n` episodes that satisfy a condition.
pub(super) fn share(n: usize, holds: impl Fn(usize) -> bool) -> f64 {
    (0..n).filter(|&episode| holds(episode)).count() as f64 / n.max(1) as f64
}

/// A number in thousandths: mm or mrad.
pub(super) fn milli(value: f64) -> String {
    format!("{:.1}", 1e3 * value)
}

/// A share as a person reads it.
pub(super) fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

#[cfg(test)]
pub(super) mod tests {
    use proto::config::{Layers, Preset, TaskName};
    use proto::layout::ActorLayout;
    use sim_worker::experiment::{Player, Trial, play};
    use sim_worker::rollout::World;

    use super::*;

    /// A recording of a robot that rests.
    pub(in super::super) fn resting(episodes: usize, steps: usize) -> Recording {
        changed(TaskName::Trajectory, episodes, steps, |_| {})
    }

    /// A recording of a trial that is changed by `change`, with a policy whose actions are zero.
    pub(in super::super) fn changed(
        task: TaskName,
        episodes: usize,
        steps: usize,
        change: impl FnOnce(&mut Trial<'_>),
    ) -> Recording {
        let layers = Layers::new(Preset::Tuned, Some(task)).set("network.hidden=[4]");
        let layers = layers.expect("valid");
        let robot = Robot::builtin("paper").expect("built in");
        let world = World::new(&layers.resolve().expect("valid"), &robot);
        let zeros = vec![0.0; ActorLayout::new(&world.config, &world.dimensions).len];
        let policy = world.policy(&zeros).expect("a policy");
        let mut trial = Trial::new(Player::new(&world, &policy), 0, episodes, steps);
        change(&mut trial);
        play(&trial, 1, &|| {}).expect("a recording")
    }

    #[test]
    fn an_errors_numbers_by_hand() {
        let recording = resting(2, 4);
        // Episode 0: 0, 1, 2, 3; episode 1: 10, 11, 12, 13.
        let value = |episode: usize, step: usize| (10 * episode + step) as f32;
        let error = ErrorOfMany::of(&recording, ("base", "rad"), None, value);
        assert_eq!((error.min.mean, error.last.mean, error.tail.mean), (5.0, 8.0, 6.5));
        assert_eq!(error.course.mean, [5.0, 6.0, 7.0, 8.0]);
        assert_eq!(error.course.max, [10.0, 11.0, 12.0, 13.0]);
        // Between the two, nine tenths of the way.
        assert_eq!(error.course.p90, [9.0, 10.0, 11.0, 12.0]);
        assert_eq!(error.name(), "base (mrad)");
        assert_eq!(share(4, |episode| episode > 0), 0.75);
    }

    #[test]
    fn a_figure_shows_each_axis_of_the_hands_asked_for() {
        let recording = resting(1, 3);
        let figure = Figure::of(&recording, "drawn", &[2]);
        assert_eq!((figure.hands.len(), figure.hands[0].arm), (1, 3));
        let hand = recording.hand(0, 1, 2);
        assert_eq!(figure.hands[0].position_m[1], hand[..3]);
        assert_eq!(figure.hands[0].orientation_rad[1], hand[3..]);
        assert_eq!(figure.base_rad, [[0.0; 3]; 3], "it rests at home");
    }
}
