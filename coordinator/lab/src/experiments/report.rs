//! The form of results: what was done with what, courses over time, and numbers for tables.

use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use simulator::evaluate::Course;
use simulator::experiment::Recording;
use simulator::robot::Robot;
use store::provenance::Provenance;

use super::name::Name;
use crate::identity::Identity;
use crate::statistics::{ErrorOf, Spread, Unit};

/// Words of ours that a file may hold.
pub type Words = Cow<'static, str>;

/// What an experiment found, and how; the form of its JSON.
#[derive(Debug, Serialize, Deserialize)]
pub struct Report<S, R> {
    pub(crate) experiment: Name,
    pub(crate) protocol: Protocol<S>,
    pub(crate) robot: RobotIdentity,
    pub(crate) policies: Vec<Identity>,
    pub(crate) provenance: Provenance,
    pub(crate) results: Vec<R>,
    /// The first episode of each trial, as far as it can be played again.
    #[serde(default)]
    pub(crate) episodes: Vec<PlayedEpisode>,
}

/// An episode of an experiment, to be played again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlayedEpisode {
    /// Which trial it is of.
    pub(crate) what: String,
    /// What plays it again.
    pub(crate) recording: crate::script::Recording,
}

/// How it was done.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Protocol<S> {
    pub(crate) episodes: usize,
    pub(crate) steps: usize,
    pub(crate) seed: u64,
    /// The file of the goals, where they were not drawn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) goals: Option<PathBuf>,
    /// Time of a control step (s). The paper's plots count 0.1 s.
    pub(crate) control_period_s: f64,
    pub(crate) actions: Words,
    /// What this experiment has besides.
    pub(crate) settings: S,
}

/// Which robot it was.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotIdentity {
    pub(crate) name: String,
    /// BLAKE3 of its description as TOML.
    pub(crate) blake3: String,
}

impl RobotIdentity {
    pub(crate) fn of(robot: &Robot) -> Self {
        let hash = blake3::hash(robot.to_toml().as_bytes());
        Self { name: robot.name.clone(), blake3: hash.to_hex().to_string() }
    }
}

/// A number over the steps of an episode, over several episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CourseOfMany {
    pub(crate) mean: Vec<f32>,
    pub(crate) p50: Vec<f32>,
    pub(crate) p90: Vec<f32>,
    pub(crate) max: Vec<f32>,
}

impl CourseOfMany {
    /// Of what `value` says about an episode and a step.
    pub(crate) fn of(recording: &Recording, value: impl Fn(usize, usize) -> f32) -> Self {
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
pub(crate) fn spread(values: impl Iterator<Item = f32>) -> Spread {
    Spread::of(values.map(f64::from).collect())
}

/// An error of many episodes: the three numbers of each, and the course.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorOfMany {
    /// What it is of.
    pub(crate) error: ErrorOf,
    /// What it is measured in.
    pub(crate) unit: Unit,
    /// The arm whose hand it is, counted from 1; none where it is all of them or the base.
    pub(crate) arm: Option<usize>,
    /// Smallest of each episode.
    pub(crate) min: Spread,
    /// After the last step.
    #[serde(rename = "final")]
    pub(crate) last: Spread,
    /// Mean of the last 20 steps of each episode.
    pub(crate) tail: Spread,
    /// Over the steps.
    pub(crate) course: CourseOfMany,
}

impl ErrorOfMany {
    /// What `value` says about an episode and a step.
    pub(crate) fn of(
        recording: &Recording,
        error: ErrorOf,
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
            unit: error.unit(),
            arm,
            min: of(|course| course.min),
            last: of(|course| course.last),
            tail: of(|course| course.tail),
            course: CourseOfMany::of(recording, value),
        }
    }

    /// Position error of a hand.
    pub(crate) fn position(recording: &Recording, arm: usize) -> Self {
        let value = |episode, step| recording.position(episode, step, arm);
        Self::of(recording, ErrorOf::Position, Some(arm + 1), value)
    }

    /// Orientation error of a hand.
    pub(crate) fn orientation(recording: &Recording, arm: usize) -> Self {
        let value = |episode, step| recording.orientation(episode, step, arm);
        Self::of(recording, ErrorOf::Orientation, Some(arm + 1), value)
    }

    /// Attitude error of the base.
    pub(crate) fn base(recording: &Recording) -> Self {
        let value = |episode, step| recording.attitude(episode, step);
        Self::of(recording, ErrorOf::Base, None, value)
    }

    /// What it is called in a table.
    pub(crate) fn name(&self) -> String {
        match self.arm {
            Some(arm) => format!("arm {arm} {} (m{})", self.error, self.unit),
            None => format!("{} (m{})", self.error, self.unit),
        }
    }
}

/// Whose goals an episode has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goals {
    /// The authors'.
    #[serde(rename = "the authors'")]
    Theirs,
    /// Drawn ones that no training saw.
    #[serde(rename = "held out")]
    HeldOut,
    /// Those of a file that a person gave.
    #[serde(rename = "given")]
    Given,
}

impl Goals {
    /// What a trial is called with these goals.
    pub(crate) fn of_trial(self, what: &str) -> String {
        match self {
            Self::Theirs => format!("{what}, the authors' goals"),
            Self::HeldOut | Self::Given => what.to_owned(),
        }
    }
}

impl fmt::Display for Goals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Theirs => "the authors'",
            Self::HeldOut => "held out",
            Self::Given => "given",
        })
    }
}

/// Errors of one episode, each axis, after every step (goal − actual): what a figure shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Whose goals they are.
    pub(crate) goals: Goals,
    /// Hands, if the episode has goals for them.
    pub(crate) hands: Vec<HandFigure>,
    /// Attitude of the base (rad): Euler angles.
    pub(crate) base_rad: Vec<[f32; 3]>,
}

/// A hand's part of a figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandFigure {
    /// The arm, counted from 1.
    pub(crate) arm: usize,
    /// World axes (m).
    pub(crate) position_m: Vec<[f32; 3]>,
    /// Euler angles (rad).
    pub(crate) orientation_rad: Vec<[f32; 3]>,
}

impl Figure {
    /// Of the first episode of a recording, with the hands of `arms`.
    pub(crate) fn of(recording: &Recording, goals: Goals, arms: &[usize]) -> Self {
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
pub(crate) fn share(n: usize, holds: impl Fn(usize) -> bool) -> f64 {
    (0..n).filter(|&episode| holds(episode)).count() as f64 / n.max(1) as f64
}

#[cfg(test)]
pub(super) mod tests {
    use proto::config::{Layers, Preset, TaskName};
    use proto::layout::ActorLayout;
    use simulator::executor::InOrder;
    use simulator::experiment::{Player, Trial, play};
    use simulator::rollout::World;

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
        play(&trial, &InOrder, &|| {}).expect("a recording")
    }

    #[test]
    fn an_errors_numbers_by_hand() {
        let recording = resting(2, 4);
        // Episode 0: 0, 1, 2, 3; episode 1: 10, 11, 12, 13.
        let value = |episode: usize, step: usize| (10 * episode + step) as f32;
        let error = ErrorOfMany::of(&recording, ErrorOf::Base, None, value);
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
        let figure = Figure::of(&recording, Goals::HeldOut, &[2]);
        assert_eq!((figure.hands.len(), figure.hands[0].arm), (1, 3));
        let hand = recording.hand(0, 1, 2);
        assert_eq!(figure.hands[0].position_m[1], hand[..3]);
        assert_eq!(figure.hands[0].orientation_rad[1], hand[3..]);
        assert_eq!(figure.base_rad, [[0.0; 3]; 3], "it rests at home");
    }
}
