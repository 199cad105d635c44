//! One episode that someone takes hold of: goals move, bodies are pushed, arms change hands, and time goes back.
//!
//! It is the loop of a trial, a step at a time, for one environment in lone single precision: the same bits as in any lane. What is done to it are
//! [`Event`]s, so an episode can be written down as a [`Script`] and played again. Who plays may change between any two steps, so an episode
//! owns its policies.

use std::sync::Arc;

use proto::rng::Purpose;

use super::chunk::Chunk;
use super::event::{
    Control, Event, EventError, GoalPurpose, LONGEST_DELAY, Script, Start, finite, up_to, within,
};
use super::group::Group;
use super::stepper::{Aims, Stepper, draw_goals};
use super::{Effect, FixedGoals, Player, SensorNoise};
use crate::collision::Touching;
use crate::dynamics::Hand;
use crate::env::{EpisodeError, LIMITS, Physics, Push, step_options};
use crate::policy::Policy;
use crate::robot::{Joints, Robot};
use crate::rollout::World;
use crate::scalar::{Kernel, Real};
use crate::spatial::{Mat3, Vec3};
use crate::state::State;
use crate::step::StepOptions;
use crate::task::goal::GoalAddress;
use crate::task::{Errors, Goals};

/// A policy that takes part in an episode, with its world.
#[derive(Debug)]
pub struct Member {
    /// Its world.
    pub world: World,
    /// Its networks.
    pub policy: Policy,
}

/// Why a script does not play to its end.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScriptError {
    /// An event cannot be.
    #[error("step {step}: {error}")]
    Event {
        /// The control step that it comes before.
        step: usize,
        /// Why.
        error: EventError,
    },
    /// The start cannot be.
    #[error("the start: {0}")]
    Start(EventError),
    /// Policy or simulation diverge.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
}

/// An effect, and the control step at which it has ended.
#[derive(Debug, Clone)]
struct Happening {
    effect: Effect,
    until: usize,
}

/// What was done to an episode so far, as far as it goes on.
#[derive(Debug, Clone)]
struct Course {
    step: usize,
    arms: Vec<Control>,
    effects: Vec<Happening>,
    sensors: SensorNoise,
    base_mass: Option<f64>,
    /// The step from which on the present goal postures are told.
    told: usize,
    /// What the last step ended with.
    pushes: Vec<Push<f32>>,
    torques: Vec<f32>,
}

/// An episode on its way.
pub struct Episode {
    robot: Robot,
    options: StepOptions,
    members: Vec<Arc<Member>>,
    start: Start,
    course: Course,
    stepper: Stepper<f32>,
}

impl std::fmt::Debug for Episode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { robot, start, course, .. } = self;
        f.debug_struct("Episode")
            .field("robot", &robot.name)
            .field("start", start)
            .field("course", course)
            .finish_non_exhaustive()
    }
}

/// An episode at one moment, with everything that its future depends on.
#[derive(Clone)]
pub struct Snapshot {
    members: Vec<Arc<Member>>,
    start: Start,
    course: Course,
    group: Group<f32>,
}

impl std::fmt::Debug for Snapshot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Snapshot").field("course", &self.course).finish_non_exhaustive()
    }
}

impl Episode {
    /// An episode at its beginning: on the robot of the first member and integrated as its configuration says, every arm moved by the first member.
    ///
    /// # Panics
    /// If there are no members, or their robots have other joints.
    pub fn new(members: Vec<Arc<Member>>, start: Start) -> Result<Self, EventError> {
        let World { robot, config, .. } = &members[0].world;
        let (robot, options) = (robot.clone(), step_options(config));
        for member in &members {
            assert_eq!(member.world.dimensions.joints, robot.joints, "one robot for all");
        }
        let course = Course::new(&robot.joints);
        let players: Vec<Player<'_>> = members.iter().map(|member| member.player()).collect();
        let (envs, drawn) = addresses(&start);
        let goals = Aims { drawn, given: &[], fixed: &FixedGoals::default() };
        let stepper = Stepper::new((&robot, options), &players, envs, goals, 0);
        let mut episode =
            Self { robot, options, members, start: Start::default(), course, stepper };
        episode.reset(start)?;
        Ok(episode)
    }

    /// Begins another episode: goals are drawn by all members' tasks, nothing happens, the robot is as described.
    pub fn reset(&mut self, start: Start) -> Result<(), EventError> {
        let mut state = State::home(&self.robot);
        if let Some(numbers) = &start.state {
            set_state(&mut state, numbers)?;
        }
        let players = players(&self.members);
        let (envs, drawn) = addresses(&start);
        let aims = Aims { drawn, given: &[], fixed: &FixedGoals::default() };
        let goals = draw_goals(&players, aims, envs, 0);
        let remade = self.course.base_mass.is_some();
        let group = &mut self.stepper.groups[0];
        group.state = state;
        group.goals = goals;
        for errors in [&mut group.errors, &mut group.seen_errors] {
            // Who moves an arm tells them anew.
            errors.postures = None;
        }
        group.action.fill(0.0);
        group.command.fill(0.0);
        group.waiting.clear();
        self.stepper.envs = envs;
        self.course = Course::new(&self.robot.joints);
        self.start = start;
        if remade {
            self.stepper.physics = Physics::with_options(&self.robot, self.options);
        }
        self.read();
        Ok(())
    }

    /// Another policy takes part, or the one of index `at` gives its place to it.
    pub fn seat(&mut self, at: Option<usize>, member: Arc<Member>) -> Result<usize, EventError> {
        let (moved, there) = (member.world.dimensions.joints, self.robot.joints);
        if moved != there {
            return Err(EventError::Joints(Box::new([moved, there])));
        }
        let at = at.unwrap_or(self.members.len());
        up_to("policy", at, self.members.len())?;
        if at == self.members.len() {
            self.members.push(member);
        } else {
            self.members[at] = member;
        }
        self.stepper.seat(&players(&self.members));
        self.read();
        Ok(at)
    }

    /// The policy of index `at` leaves, also the moments that are `kept`, so that nothing holds it any more: the one of index `successor` has its places.
    pub fn retire(
        &mut self,
        at: usize,
        successor: usize,
        kept: &mut [Snapshot],
    ) -> Result<(), EventError> {
        for policy in [at, successor] {
            within("policy", policy, self.members.len())?;
        }
        let [leaving, successor] = [at, successor].map(|policy| Arc::clone(&self.members[policy]));
        let moments = kept.iter_mut().map(|moment| &mut moment.members);
        for members in std::iter::once(&mut self.members).chain(moments) {
            // It may have the place of one that left before it.
            for member in members.iter_mut().filter(|member| Arc::ptr_eq(member, &leaving)) {
                *member = Arc::clone(&successor);
            }
        }
        self.stepper.seat(&players(&self.members));
        self.read();
        Ok(())
    }

    /// Something happens from the next step on; after an error nothing has changed.
    pub fn apply(&mut self, event: &Event) -> Result<(), EventError> {
        let n_arms = self.robot.n_arms;
        match event {
            Event::HandGoal { arm, pose } => {
                within("arm", *arm, n_arms)?;
                finite("the goal", pose)?;
                let goals = &mut self.stepper.groups[0].goals;
                goals.hands[*arm] = pose.map(|x| x as f32);
                goals.attach_hand(*arm);
                self.ask_as_one();
            }
            Event::BaseGoal { attitude } => {
                finite("the goal", attitude)?;
                self.stepper.groups[0].goals.base = attitude.map(|x| x as f32);
            }
            Event::Arm { arm, control } => {
                within("arm", *arm, n_arms)?;
                if let Control::Policy(policy) = control {
                    within("policy", *policy, self.members.len())?;
                }
                self.course.arms[*arm] = *control;
                self.ask_as_one();
            }
            Event::Effect { effect, steps } => {
                effect.check(&self.robot.joints)?;
                let until =
                    steps.map_or(usize::MAX, |steps| self.course.step.saturating_add(steps));
                self.course.effects.push(Happening { effect: effect.clone(), until });
            }
            Event::ClearEffects => self.course.effects.clear(),
            Event::BaseMass { mass } => self.weigh(Some(*mass))?,
            Event::Delay { steps } => {
                if *steps > LONGEST_DELAY {
                    return Err(EventError::Delay(*steps));
                }
                self.stepper.groups[0].delay(*steps);
            }
            Event::Sensors(noise) => {
                let SensorNoise { position, angle, velocity, rate } = *noise;
                finite("the deviation", &[position, angle, velocity, rate])?;
                if !self.course.sensors.any() {
                    self.stepper.groups[0].seen_errors.forget_base();
                }
                self.course.sensors = *noise;
            }
        }
        self.read();
        Ok(())
    }

    /// Plays a control step.
    ///
    /// # Errors
    /// If a policy gives no number or the simulation diverges; the episode is of no use then until it is reset or a snapshot is taken back.
    pub fn step(&mut self) -> Result<(), EpisodeError> {
        f32::compiled(OneStep(self))
    }

    /// Plays a whole script from its start; `after` is called at the start and after every step.
    pub fn play(
        &mut self,
        script: &Script,
        after: &mut dyn FnMut(&Self),
    ) -> Result<(), ScriptError> {
        self.reset(script.start.clone()).map_err(ScriptError::Start)?;
        after(self);
        for step in 0..script.steps {
            for timed in script.events.iter().filter(|timed| timed.step == step) {
                self.apply(&timed.event).map_err(|error| ScriptError::Event { step, error })?;
            }
            self.step()?;
            after(self);
        }
        Ok(())
    }

    /// Keeps this moment.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            members: self.members.clone(),
            start: self.start.clone(),
            course: self.course.clone(),
            group: self.stepper.groups[0].clone(),
        }
    }

    /// Goes to a moment of this episode, or of another one on the same robot. Policies that came after it keep their places, so that they may
    /// take part from there on.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), EventError> {
        let Snapshot { members, start, course, group } = snapshot;
        self.weigh(course.base_mass)?;
        // Somebody who goes back to let another policy play named it before going back.
        let came_later = self.members.iter().skip(members.len()).cloned().collect::<Vec<_>>();
        self.members = members.iter().cloned().chain(came_later).collect();
        self.stepper.envs = addresses(start).0;
        self.stepper.groups[0].clone_from(group);
        self.stepper.seat(&players(&self.members));
        self.start = start.clone();
        self.course = course.clone();
        self.read();
        Ok(())
    }

    /// Gives the base's first box a mass (kg), or its own again.
    fn weigh(&mut self, mass: Option<f64>) -> Result<(), EventError> {
        if self.course.base_mass == mass {
            return Ok(());
        }
        self.stepper.physics = match mass {
            Some(mass) => Physics::with_options(&self.robot.with_base_mass(mass)?, self.options),
            None => Physics::with_options(&self.robot, self.options),
        };
        self.course.base_mass = mass;
        Ok(())
    }

    /// Goals and arms that are given one after the other in the step in which goal postures were told first are one question.
    fn ask_as_one(&mut self) {
        if self.course.told == self.course.step {
            let group = &mut self.stepper.groups[0];
            group.errors.forget();
            group.seen_errors.forget();
        }
    }

    fn read(&mut self) {
        if self.stepper.assign(&players(&self.members), &self.course.players()) {
            self.course.told = self.course.step;
        }
        f32::compiled(Read(&mut self.stepper));
    }

    /// The robot, with its own masses.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Who takes part.
    pub fn members(&self) -> &[Arc<Member>] {
        &self.members
    }

    /// How it began.
    pub fn start(&self) -> &Start {
        &self.start
    }

    /// Control steps since the start.
    pub fn steps(&self) -> usize {
        self.course.step
    }

    /// Length of a control step (s).
    pub fn control_period(&self) -> f64 {
        self.options.control_period
    }

    /// Effects in force in the next step.
    pub fn effects(&self) -> usize {
        self.course.effects.iter().filter(|happening| happening.until > self.course.step).count()
    }

    /// Control steps between an action and its execution.
    pub fn delay(&self) -> usize {
        self.group().waiting.len()
    }

    fn group(&self) -> &Group<f32> {
        &self.stepper.groups[0]
    }

    /// State of the robot.
    pub fn state(&self) -> &State<f32> {
        &self.group().state
    }

    /// Where hands and base shall go.
    pub fn goals(&self) -> &Goals<f32> {
        &self.group().goals
    }

    /// How far they are from there.
    pub fn errors(&self) -> &Errors<f32> {
        &self.group().errors
    }

    /// Clipped actions of the last step, before scaling, arm-major.
    pub fn actions(&self) -> &[f32] {
        &self.group().action
    }

    /// Joint rates commanded in the last step (rad/s), arm-major.
    pub fn commands(&self) -> &[f32] {
        &self.group().command
    }

    /// Torques of the servos at the end of the last step (N m), arm-major.
    pub fn torques(&self) -> &[f32] {
        &self.course.torques
    }

    /// Contacts that pushed at the end of the last step.
    pub fn pushes(&self) -> &[Push<f32>] {
        &self.course.pushes
    }

    /// What touches.
    pub fn touching(&self) -> &Touching<f32> {
        self.group().touching.as_ref().expect("an episode is read when it is made")
    }

    /// Hands of all arms.
    pub fn hands(&self) -> &[Hand<f32>] {
        self.stepper.physics.hands()
    }

    /// Axes in the world and origin (m) of a body's frame: 0 is the base, 1 + l is link l, arm-major.
    pub fn body(&self, body: usize) -> (Mat3<f32>, Vec3<f32>) {
        self.stepper.physics.body(self.state(), body.checked_sub(1))
    }
}

impl Member {
    /// A policy as it was trained.
    pub fn player(&self) -> Player<'_> {
        Player::new(&self.world, &self.policy)
    }
}

impl Course {
    fn new(joints: &Joints) -> Self {
        Self {
            step: 0,
            arms: vec![Control::Policy(0); joints.n_arms()],
            effects: Vec::new(),
            sensors: SensorNoise::NONE,
            base_mass: None,
            told: 0,
            pushes: Vec::new(),
            torques: vec![0.0; joints.n_joints()],
        }
    }

    /// The players that move arms, an entry an arm.
    fn players(&self) -> Vec<Option<usize>> {
        let by = |control: &Control| match control {
            Control::Policy(policy) => Some(*policy),
            Control::Hold | Control::Limp => None,
        };
        self.arms.iter().map(by).collect()
    }
}

fn players(members: &[Arc<Member>]) -> Vec<Player<'_>> {
    members.iter().map(|member| member.player()).collect()
}

fn addresses(start: &Start) -> (Chunk, GoalAddress) {
    let Start { seed, purpose, iteration, episode, .. } = *start;
    let purpose = match purpose {
        GoalPurpose::Evaluation => Purpose::EvaluationGoal,
        GoalPurpose::Training => Purpose::Goal,
    };
    let goals = GoalAddress { seed, purpose, iteration, env: episode };
    (Chunk { seed, first: episode, n_envs: 1 }, goals)
}

fn set_state(state: &mut State<f32>, numbers: &[f64]) -> Result<(), EventError> {
    let limit = 13 + 2 * state.q.len();
    if numbers.len() != limit {
        return Err(EventError::Beyond {
            what: "numbers of the state:",
            found: numbers.len(),
            limit,
        });
    }
    // Beyond these the first step would say that the simulation has diverged.
    let limits = state.parts().into_iter().zip(LIMITS);
    let limits = limits.flat_map(|(part, limit)| std::iter::repeat_n(limit, part.len()));
    for (index, (&found, (quantity, limit))) in numbers.iter().zip(limits).enumerate() {
        if !(-limit..=limit).contains(&found) {
            return Err(EventError::State { index, quantity, found, limit });
        }
    }
    let square = numbers[3..7].iter().map(|x| x * x).sum::<f64>();
    if (square - 1.0).abs() > 1e-3 {
        let what = "the square of the quaternion's length";
        return Err(EventError::Value { what, found: square, expected: "one" });
    }
    for (slot, &number) in state.parts_mut().into_iter().flatten().zip(numbers) {
        *slot = number as f32;
    }
    Ok(())
}

// Compiled with the processor's fused multiply-add, as what they call is.

struct Read<'a>(&'a mut Stepper<f32>);

impl Kernel<f32> for Read<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.read();
    }
}

struct OneStep<'a>(&'a mut Episode);

impl Kernel<f32> for OneStep<'_> {
    type Output = Result<(), EpisodeError>;
    #[inline(always)]
    fn run(self) -> Self::Output {
        let Episode { members, course, stepper, .. } = self.0;
        let players = players(members);
        let step = course.step;
        let arms = course.players();
        let limp = course.arms.iter().enumerate().filter(|(_, arm)| **arm == Control::Limp);
        let limp: Vec<Effect> = limp.map(|(arm, _)| Effect::Limp { arm }).collect();
        course.effects.retain(|happening| happening.until > step);
        let effects = course.effects.iter().map(|happening| &happening.effect).chain(&limp);
        stepper.think(&players, &arms, &course.sensors, step)?;
        stepper.advance(&players, &arms, &effects, step)?;
        course.step += 1;
        let Stepper { physics, groups, disturbance, .. } = stepper;
        let Group { state, command, .. } = &groups[0];
        physics.torques(command, &state.qd, &mut course.torques);
        for (torque, part) in course.torques.iter_mut().zip(&disturbance.servo) {
            *torque *= part;
        }
        physics.pushes(state, &mut course.pushes);
        stepper.read();
        Ok(())
    }
}

#[cfg(test)]
mod tests;
