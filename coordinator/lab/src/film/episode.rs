//! An episode that is played to be shown.

use proto::tasks::Aim;
use proto::{ExitCode, ExitError};
use simulator::experiment::{FixedGoals, Pose, Recording, Trial, play};
use simulator::model::ContactKind;
use simulator::robot::Robot;
use simulator::task::Goals;
use simulator::task::goal::GoalAddress;

use crate::threads::Threads;
use crate::trained::Trained;

/// Which episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeSettings {
    /// Seed of the goals.
    pub seed: u64,
    /// Which of that seed's episodes, as evaluations count them.
    pub episode: u32,
    /// Control steps.
    pub steps: usize,
    /// Goals of hands that are given instead of drawn.
    pub hands: Vec<HandGoal>,
    /// The base's goal, if it is given: Euler angles (rad).
    pub base: Option<[f64; 3]>,
}

/// The goal of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandGoal {
    /// The arm, counted from 1.
    pub arm: usize,
    /// Position in the world (m) and Euler angles (rad).
    pub goal: [f64; 6],
}

/// How far from their goals hands and base are at a moment; nothing of what has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct MomentErrors {
    /// Of each hand (m).
    pub(super) position: Vec<f32>,
    /// Of each hand (rad).
    pub(super) orientation: Vec<f32>,
    /// Of the base (rad).
    pub(super) attitude: Option<f32>,
}

/// What is to be shown.
#[derive(Debug)]
pub(super) struct Episode {
    /// Where the robot stands at the beginning and after every control step.
    pub(super) poses: Vec<Pose>,
    /// Errors after every control step.
    pub(super) errors: Vec<MomentErrors>,
    /// Touching pairs at the beginning and after every control step, by kind.
    pub(super) contacts: Vec<[u32; ContactKind::COUNT]>,
    /// Arms and the targets of their hands, position (m) and Euler angles (rad), at the beginning and after every control step; none if hands have none.
    pub(super) hands: Vec<Vec<(usize, [f64; 6])>>,
    /// Target attitude of the base: Euler angles (rad).
    pub(super) base: Option<[f64; 3]>,
    /// Length of a control step (s).
    pub(super) control_period: f64,
}

impl Episode {
    /// Plays it; `on_step` is called after every control step.
    pub(super) fn play(
        trained: &Trained,
        settings: &EpisodeSettings,
        on_step: &(dyn Fn() + Sync),
    ) -> anyhow::Result<Self> {
        let world = &trained.world;
        let mut fixed = FixedGoals { hands: Vec::new(), base: settings.base };
        for HandGoal { arm, goal } in &settings.hands {
            check_arm(&world.robot, *arm)?;
            fixed.hands.resize(fixed.hands.len().max(*arm), None);
            fixed.hands[arm - 1] = Some(*goal);
        }
        let mut trial = Trial::new(trained.player(), settings.seed, 1, settings.steps);
        trial.goals.env = settings.episode;
        trial.fixed = fixed;
        let recording = play(&trial, &Threads::new(1), on_step)?;
        Ok(Self::of(trained, &trial, &recording))
    }

    fn of(trained: &Trained, trial: &Trial<'_>, recording: &Recording) -> Self {
        let (robot, goals) = (&trained.world.robot, &trained.world.task.goals);
        let address: GoalAddress = trial.goals;
        let (reaches, turns) = (trained.task().reaches(), trained.task().turns());
        let mut moving = Goals::<f64>::at_home(goals);
        moving.draw(&trained.world.task, address, 0);
        for (slot, given) in moving.hands.iter_mut().zip(&trial.fixed.hands) {
            *slot = given.unwrap_or(*slot);
        }
        moving.attach();
        let aims = &trained.world.task.aims;
        let arms: Vec<usize> =
            (0..robot.n_arms).filter(|arm| reaches && aims[*arm] == Aim::Hand).collect();
        let mut hands = Vec::new();
        for _ in 0..=recording.steps() {
            hands.push(arms.iter().map(|arm| (*arm, moving.hands[*arm])).collect());
            moving.advance(trained.world.config.env.control_period);
        }
        let home = Pose {
            base_position: robot.home_position.map(|x| x as f32),
            base_quaternion: [1.0, 0.0, 0.0, 0.0],
            joints: robot.home_q().iter().map(|q| *q as f32).collect(),
        };
        let errors = |step: usize| MomentErrors {
            position: arms.iter().map(|arm| recording.position(0, step, *arm)).collect(),
            orientation: arms.iter().map(|arm| recording.orientation(0, step, *arm)).collect(),
            attitude: turns.then(|| recording.attitude(0, step)),
        };
        let steps = 0..recording.steps();
        Self {
            poses: [home].into_iter().chain(steps.clone().map(|s| recording.pose(0, s))).collect(),
            errors: steps.clone().map(errors).collect(),
            contacts: [[0; ContactKind::COUNT]]
                .into_iter()
                .chain(steps.map(|step| recording.contacts(0, step)))
                .collect(),
            hands,
            base: turns.then(|| trial.fixed.base.unwrap_or(moving.base)),
            control_period: trained.world.config.env.control_period,
        }
    }

    /// Errors of hands after the last step.
    pub(super) fn last_errors(&self, of: fn(&MomentErrors) -> &Vec<f32>) -> Vec<f32> {
        self.errors.last().map(|errors| of(errors).clone()).unwrap_or_default()
    }

    /// Error of the base after the last step.
    pub(super) fn last_attitude(&self) -> Option<f32> {
        self.errors.last().and_then(|errors| errors.attitude)
    }

    /// Control steps after which bodies touch.
    pub(super) fn steps_with_contact(&self) -> usize {
        self.contacts.iter().filter(|kinds| kinds.iter().any(|pairs| *pairs > 0)).count()
    }
}

/// Refuses an arm (counted from 1) that the robot does not have.
pub(super) fn check_arm(robot: &Robot, arm: usize) -> Result<(), ExitError> {
    if (1..=robot.n_arms).contains(&arm) {
        return Ok(());
    }
    let message = format!("there is no arm {arm}: the robot `{}` has {}", robot.name, robot.n_arms);
    Err(ExitError::new(ExitCode::BadInput, message))
}
