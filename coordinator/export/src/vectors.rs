//! States with goals, observations and commands as the simulator computes them, for whoever checks an export.

use std::sync::Arc;

use serde::Serialize;
use simulator::env::readings;
use simulator::experiment::{Episode, Member, Start};
use simulator::task::Goals;
use simulator::task::observation::observe;

use crate::error::ExportError;
use crate::source::Source;

/// Episodes, and steps of each: 256 states.
const EPISODES: u32 = 16;
const STATES: usize = 16;
/// Control steps from one state to the next: three quarters of a minute is when hands arrive. Goal postures are remembered, so whoever looks for
/// them has to see every step; arms that are guided arrive in ten.
const EVERY: usize = 3;
/// Seed of the goals: none of a training or an evaluation.
const SEED: u64 = 0x7ec70125;

/// One state.
///
/// The order of the fields is the order in the file, which `check.c` relies on.
#[derive(Debug, Serialize)]
pub(crate) struct Case {
    /// Where there are goal postures: 1 if an episode begins, which is when their memory is reset; else the step after the case before.
    #[serde(skip_serializing_if = "Option::is_none")]
    begins: Option<u32>,
    base_position: [f32; 3],
    base_attitude: [f32; 4],
    base_velocity: [f32; 3],
    base_angular_velocity: [f32; 3],
    joint_angles: Vec<f32>,
    joint_rates: Vec<f32>,
    last_command: Vec<f32>,
    last_action: Vec<f32>,
    /// Of tasks with one kind of goals: of the hands or of the base, ones that stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    goals: Option<Vec<f32>>,
    /// Of other tasks each kind by the name of its input, in the order of `octopus_goals`.
    #[serde(flatten)]
    kinds: Kinds,
    /// An arm each: good, free, left, with room for the joints of the longest arm.
    #[serde(skip_serializing_if = "Option::is_none")]
    postures: Option<Vec<Vec<f32>>>,
    observations: Vec<Vec<f32>>,
    command: Vec<f32>,
}

/// All goals of a state.
#[derive(Debug, Serialize)]
struct Kinds {
    #[serde(skip_serializing_if = "Option::is_none")]
    hand_goals: Option<Vec<f32>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hand_goal_velocities: Option<Vec<f32>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    base_goal: Option<Vec<f32>>,
}

impl Kinds {
    fn of(source: &Source<'_>, goals: &Goals<f32>) -> Self {
        let velocities = || goals.hand_velocities().expect("goals that move have a body").concat();
        Self {
            hand_goals: source.has_hand_goals().then(|| goals.hands.concat()),
            hand_goal_velocities: source.has_moving_goals().then(velocities),
            base_goal: source.has_base_goal().then(|| goals.base.to_vec()),
        }
    }

    /// The one kind there is, if it is one alone.
    fn take_single(&mut self) -> Option<Vec<f32>> {
        let Self { hand_goals, hand_goal_velocities, base_goal } = self;
        match (&hand_goals, &hand_goal_velocities, &base_goal) {
            (Some(_), None, None) => hand_goals.take(),
            (None, None, Some(_)) => base_goal.take(),
            _ => None,
        }
    }
}

/// `vectors.json`.
#[derive(Debug, Serialize)]
pub(crate) struct Vectors {
    format: u32,
    digest: String,
    task: &'static str,
    robot: String,
    /// Differences that are accepted of ONNX Runtime: of commands and actions (rad/s).
    onnx_tolerance: f64,
    /// Before them, so that a reader in C knows whether it has read all.
    n_cases: usize,
    pub(crate) cases: Vec<Case>,
}

impl Case {
    /// Numbers of the state by name, for the ranges that the contract gives.
    pub(crate) fn state(&self) -> [(&'static str, &[f32]); 6] {
        [
            ("base_position", &self.base_position),
            ("base_attitude", &self.base_attitude),
            ("base_velocity", &self.base_velocity),
            ("base_angular_velocity", &self.base_angular_velocity),
            ("joint_angles", &self.joint_angles),
            ("joint_rates", &self.joint_rates),
        ]
    }
}

/// Plays episodes and writes down what they pass.
pub(crate) fn vectors(source: &Source<'_>) -> Result<Vectors, ExportError> {
    let world = source.world;
    let member = Arc::new(Member { world: world.clone(), policy: source.policy.clone() });
    let diverged = |error: &dyn std::fmt::Display| ExportError::Episode(error.to_string());
    let start = |episode| Start { seed: SEED, episode, ..Start::default() };
    let mut episode = Episode::new(vec![member], start(0)).map_err(|error| diverged(&error))?;
    let mut cases = Vec::new();
    let every = if source.has_postures() { 1 } else { EVERY };
    for index in 0..EPISODES {
        episode.reset(start(index)).map_err(|error| diverged(&error))?;
        for step in 0..=(STATES - 1) * every {
            let state = episode.state().clone();
            let (action, command) = (episode.actions().to_vec(), episode.commands().to_vec());
            let (errors, goals) = (episode.errors().clone(), episode.goals().clone());
            episode.step().map_err(|error| diverged(&error))?;
            if !step.is_multiple_of(every) {
                continue;
            }
            let mut found = readings(&world.robot, &state);
            found.last_action.copy_from_slice(&action);
            let mut kinds = Kinds::of(source, &goals);
            let observations = (0..world.dimensions.n_agents).map(|agent| {
                let mut seen = vec![0.0; world.dimensions.observation];
                observe(&world.task, &found, &goals, &errors, agent, &mut seen);
                seen
            });
            let postures = errors.postures().map(|mut postures| {
                for of_arm in &mut postures {
                    of_arm.resize(2 + source.longest_arm(), 0.0);
                }
                postures
            });
            cases.push(Case {
                begins: postures.as_ref().map(|_| u32::from(step == 0)),
                postures,
                observations: observations.collect(),
                base_position: state.base_position,
                base_attitude: state.base_quaternion,
                base_velocity: state.base_linear_velocity,
                base_angular_velocity: state.base_angular_velocity,
                joint_angles: state.q,
                joint_rates: state.qd,
                last_command: command,
                last_action: action,
                goals: kinds.take_single(),
                kinds,
                command: episode.commands().to_vec(),
            });
        }
    }
    Ok(Vectors {
        format: 1,
        digest: source.origin.digest.clone(),
        task: source.task(),
        robot: world.robot.name.clone(),
        onnx_tolerance: source.onnx_tolerance(),
        n_cases: cases.len(),
        cases,
    })
}
