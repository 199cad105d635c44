//! What is asked of a plan, and how far a motion is from it.

use nalgebra::Isometry3;

use super::frame;
use crate::inverse_kinematics::pose;
use crate::robot::Robot;
use crate::state::State;
use crate::step::StepOptions;

/// How near to its pose a hand shall come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Distance (m).
    pub position: f64,
    /// Angle of the rotation that is left (rad).
    pub orientation: f64,
}

/// What is wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// Where the robot is, and how it moves.
    pub start: State<f64>,
    /// Pose of each hand, none for arms that may do as they like: position in the world (m), Euler angles (rad, R = Rx Ry Rz).
    pub hands: Vec<Option<[f64; 6]>>,
    /// Whether the arms that nobody asked for hold the base where it is.
    pub hold_base: bool,
    /// How near is near enough.
    pub within: Tolerance,
    /// Fastest joint rate (rad/s); no joint is commanded to move faster than its drive, either.
    pub fastest: f64,
    /// Tells the detours of one search from those of another.
    pub seed: u64,
}

/// Commands that somebody else proposes, such as those of a trained policy.
pub type Commands = Vec<Vec<f32>>;

/// How far a hand ended from its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miss {
    /// The arm.
    pub arm: usize,
    /// Distance (m).
    pub position: f64,
    /// Angle of the rotation that is left (rad).
    pub orientation: f64,
}

impl Question {
    /// Poses of the asked hands in the world, with their arms.
    pub(super) fn targets(&self) -> Vec<(usize, Isometry3<f64>)> {
        let asked = self.hands.iter().enumerate();
        asked.filter_map(|(arm, goal)| Some((arm, pose((*goal)?)))).collect()
    }

    /// How far the asked hands are from their poses in a state of the robot.
    pub fn misses(&self, robot: &Robot, state: &State<f64>) -> Vec<Miss> {
        let miss = |(arm, target): (usize, Isometry3<f64>)| {
            let hand = frame::hand(robot, state, arm);
            let position = (target.translation.vector - hand.translation.vector).norm();
            Miss { arm, position, orientation: target.rotation.angle_to(&hand.rotation) }
        };
        self.targets().into_iter().map(miss).collect()
    }

    /// The worst miss in a state, in parts of what is near enough; infinite where a hand is nowhere.
    pub(super) fn worst_miss(&self, robot: &Robot, state: &State<f64>) -> f64 {
        let Tolerance { position, orientation } = self.within;
        let part = |miss: f64, near: f64| if miss.is_nan() { f64::INFINITY } else { miss / near };
        let misses = self.misses(robot, state).into_iter();
        let parts =
            misses.flat_map(|m| [part(m.position, position), part(m.orientation, orientation)]);
        parts.fold(0.0, f64::max)
    }
}

/// A question with the robot that it is about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Search<'a> {
    pub(super) robot: &'a Robot,
    pub(super) options: &'a StepOptions,
    pub(super) question: &'a Question,
}

/// The same commands as the simulation reads them.
pub fn widen(commands: &[Vec<f32>]) -> Vec<Vec<f64>> {
    commands.iter().map(|row| row.iter().copied().map(f64::from).collect()).collect()
}
