//! What is played: players, phases, goals, and what happens.

use proto::layout::{AGENTS_PER_ARM, Dimensions};
use proto::rng::Purpose;

use super::event::{Control, Event, GoalPurpose, LONGEST_DELAY, Script, Start, TimedEvent};
use super::{FixedGoals, Intervention, SensorNoise};
use crate::controller::JacobianController;
use crate::env::step_options;
use crate::policy::Policy;
use crate::robot::Robot;
use crate::rollout::World;
use crate::scalar::Backend;
use crate::step::StepOptions;
use crate::task::goal::GoalAddress;

/// What decides.
#[derive(Debug, Clone, Copy)]
pub enum Driver<'a> {
    /// Networks, from what agents see.
    Policy(&'a Policy),
    /// A controller that knows the robot, from what sensors see.
    Jacobian(&'a JacobianController),
}

/// A policy, or a controller, with the world it was made for, which says what it sees and what its actions mean.
#[derive(Debug, Clone, Copy)]
pub struct Player<'a> {
    /// Its world.
    pub world: &'a World,
    /// What decides.
    pub driver: Driver<'a>,
    /// Factor from a clipped action to a joint velocity command (rad/s); in training that of the task.
    pub action_scale: f64,
}

impl<'a> Player<'a> {
    /// A policy as it was trained.
    pub fn new(world: &'a World, policy: &'a Policy) -> Self {
        Self { world, driver: Driver::Policy(policy), action_scale: world.task.action_scale }
    }

    /// Whether the arms that it moves go to goal postures.
    pub(super) fn goes_to_postures(&self) -> bool {
        matches!(self.driver, Driver::Policy(_)) && self.world.task.posture.seen
    }

    /// A controller in the world that it was made for.
    pub fn controlled(world: &'a World, controller: &'a JacobianController) -> Self {
        let driver = Driver::Jacobian(controller);
        Self { world, driver, action_scale: world.task.action_scale }
    }
}

/// Who moves the arms from a control step on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phase {
    /// The first control step.
    pub from: usize,
    /// For each arm the index of its player; without one the arm's actions are zero, so that the servos hold it.
    pub arms: Vec<Option<usize>>,
}

/// Whether `player` moves the joints of `agent`; `arms` is that of a [`Phase`].
pub(super) fn moves(arms: &[Option<usize>], player: usize, agent: usize) -> bool {
    arms[agent / AGENTS_PER_ARM] == Some(player)
}

/// The player's actors that move anything, an actor of all agents also if it moves but one arm.
pub(super) fn actors(
    arms: &[Option<usize>],
    player: usize,
    dimensions: &Dimensions,
) -> impl Iterator<Item = usize> {
    let agents_per_actor = dimensions.agents_per_actor();
    (0..dimensions.n_actors).filter(move |actor| {
        let first = actor * agents_per_actor;
        (first..first + agents_per_actor).any(|agent| moves(arms, player, agent))
    })
}

/// Episodes to be played.
#[derive(Debug, Clone)]
pub struct Trial<'a> {
    /// The robot that is simulated: that of the players, but for masses.
    pub robot: &'a Robot,
    /// How it is integrated.
    pub options: StepOptions,
    /// Who takes part, at least one.
    pub players: Vec<Player<'a>>,
    /// Who moves what, in the order of their first steps, which begin at zero.
    pub phases: Vec<Phase>,
    /// Address of the first episode's goals: every player's task draws those that it has; what none has stays at home.
    pub goals: GoalAddress,
    /// Goals that are given instead of drawn, an entry an episode; what is beyond the end is drawn.
    pub given: &'a [FixedGoals],
    /// Goals that are the same in every episode, whatever is drawn or given.
    pub fixed: FixedGoals,
    /// What happens.
    pub interventions: Vec<Intervention>,
    /// What the sensors add.
    pub sensors: SensorNoise,
    /// Control steps between an action and its execution.
    pub delay: usize,
    /// E: episodes.
    pub episodes: usize,
    /// Control steps of an episode.
    pub steps: usize,
    /// What computes; all give the same bits.
    pub backend: Backend,
}

impl<'a> Trial<'a> {
    /// All arms moved by `player`, in its own world, towards held-out goals; nothing happens.
    pub fn new(player: Player<'a>, seed: u64, episodes: usize, steps: usize) -> Self {
        let world = player.world;
        Self {
            robot: &world.robot,
            options: step_options(&world.config),
            players: vec![player],
            phases: vec![Phase { from: 0, arms: vec![Some(0); world.dimensions.n_arms] }],
            goals: GoalAddress { seed, purpose: Purpose::EvaluationGoal, iteration: 0, env: 0 },
            given: &[],
            fixed: FixedGoals::default(),
            interventions: Vec::new(),
            sensors: SensorNoise::NONE,
            delay: 0,
            episodes,
            steps,
            backend: Backend::detect(),
        }
    }

    /// Arms of the robot.
    pub fn n_arms(&self) -> usize {
        self.robot.n_arms
    }

    /// An episode of it as a script that plays the same; none where that cannot say what happens: arms of another mass, actions of
    /// another scale, another integration, a controller instead of a policy, commands that come later than a script may have them.
    pub fn script(&self, episode: u32) -> Option<Script> {
        let Player { world, .. } = self.players[0];
        let as_trained = |player: &Player<'_>| {
            let scale = player.world.task.action_scale;
            matches!(player.driver, Driver::Policy(_)) && player.action_scale == scale
        };
        if !self.players.iter().all(as_trained) || self.options != step_options(&world.config) {
            return None;
        }
        let purpose = match self.goals.purpose {
            Purpose::EvaluationGoal => GoalPurpose::Evaluation,
            Purpose::Goal => GoalPurpose::Training,
            _ => return None,
        };
        if self.delay > LONGEST_DELAY {
            return None;
        }
        let mut events = Vec::new();
        let mut at = |step: usize, event: Event| events.push(TimedEvent { step, event });
        if *self.robot != world.robot {
            let mass = self.robot.description().base[0].mass;
            let other = world.robot.with_base_mass(mass).ok()?;
            if *self.robot != other {
                return None;
            }
            at(0, Event::BaseMass { mass });
        }
        for goals in self.given.get(episode as usize).into_iter().chain([&self.fixed]) {
            for (arm, goal) in goals.hands.iter().enumerate() {
                if let Some(pose) = *goal {
                    at(0, Event::HandGoal { arm, pose });
                }
            }
            if let Some(attitude) = goals.base {
                at(0, Event::BaseGoal { attitude });
            }
        }
        if self.sensors != SensorNoise::NONE {
            at(0, Event::Sensors(self.sensors));
        }
        if self.delay > 0 {
            at(0, Event::Delay { steps: self.delay });
        }
        let mut before = vec![Some(0); self.n_arms()];
        for phase in self.phases.iter().filter(|phase| phase.from < self.steps) {
            for (arm, (player, before)) in phase.arms.iter().zip(&mut before).enumerate() {
                if player != before {
                    let control = player.map_or(Control::Hold, Control::Policy);
                    at(phase.from, Event::Arm { arm, control });
                    *before = *player;
                }
            }
        }
        for Intervention { steps, effect } in &self.interventions {
            let event = Event::Effect { effect: effect.clone(), steps: Some(steps.len()) };
            at(steps.start, event);
        }
        let GoalAddress { seed, iteration, env, .. } = self.goals;
        let start = Start { seed, purpose, iteration, episode: env + episode, state: None };
        Some(Script { start, steps: self.steps, events })
    }

    /// The phase that `step` lies in.
    pub(super) fn phase(&self, step: usize) -> &Phase {
        let next = self.phases.partition_point(|phase| phase.from <= step);
        &self.phases[next - 1]
    }

    /// Asserts what whoever makes a trial must see to.
    pub(super) fn check(&self) {
        let n_arms = self.n_arms();
        assert_eq!(self.phases.first().map(|phase| phase.from), Some(0), "a phase from step 0 on");
        for phase in &self.phases {
            assert_eq!(phase.arms.len(), n_arms, "one player or none an arm");
            let known = |player: &usize| *player < self.players.len();
            assert!(phase.arms.iter().flatten().all(known), "players of {phase:?}");
        }
        for Player { world, driver, .. } in &self.players {
            assert_eq!(world.dimensions.joints, self.robot.joints, "players know the robot");
            if let Driver::Policy(policy) = driver {
                let n_actors = world.dimensions.n_actors;
                assert_eq!(policy.n_actors(), n_actors, "the policy is of its world");
            }
        }
    }
}
