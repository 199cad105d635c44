//! The environments of one lane group: where they are, where they shall go, and what they were told.

use super::conditions::Conditions;
use super::extremes::Extremes;
use super::randomization::Randomized;
use super::start::scatter;
use crate::env::Physics;
use crate::posture::Guidance;
use crate::robot::Robot;
use crate::scalar::{Kernel, Real};
use crate::state::State;
use crate::task::goal::GoalAddress;
use crate::task::{Errors, Goals, Readings, Task};

/// One lane group.
pub(crate) struct LaneGroup<S: Real> {
    pub(crate) state: State<S>,
    pub(crate) readings: Readings<S>,
    pub(crate) goals: Goals<S>,
    pub(crate) errors: Errors<S>,
    /// Clipped actions of the step and of the one before, one a joint.
    pub(crate) action: Vec<S>,
    pub(crate) last_action: Vec<S>,
    pub(crate) command: Vec<S>,
    pub(crate) guidance: Guidance<S>,
    pub(crate) extremes: Extremes<S>,
    /// What errs, if anything does.
    pub(crate) randomized: Option<Randomized<S>>,
}

impl<S: Real> LaneGroup<S> {
    /// The group whose first lane is local environment `first` of `n_envs`, with goals drawn and robots where episodes begin.
    ///
    /// Lanes beyond the last environment repeat it. `goals` is the address of the first environment's.
    #[inline(always)]
    pub(crate) fn new(
        (robot, task): (&Robot, &Task),
        conditions: &Conditions,
        physics: &mut Physics<S>,
        goals: GoalAddress,
        (first, n_envs): (usize, usize),
    ) -> Self {
        S::compiled(Begin { robot, task, conditions, physics, goals, first, n_envs })
    }
}

struct Begin<'a, S: Real> {
    robot: &'a Robot,
    task: &'a Task,
    conditions: &'a Conditions,
    physics: &'a mut Physics<S>,
    goals: GoalAddress,
    first: usize,
    n_envs: usize,
}

impl<S: Real> Kernel<S> for Begin<'_, S> {
    type Output = LaneGroup<S>;

    #[inline(always)]
    fn run(self) -> LaneGroup<S> {
        let Self { robot, task, conditions, physics, goals, first, n_envs } = self;
        let mut drawn = Goals::at_home(&task.goals);
        let env_of = |lane: usize| goals.env + (first + lane).min(n_envs - 1) as u32;
        for lane in 0..S::LANES {
            let address = GoalAddress { env: env_of(lane), ..goals };
            drawn.draw(task, address, lane);
        }
        drawn.attach();
        let mut state = State::home(robot);
        let mut readings = Readings::new(&robot.joints);
        let randomized =
            Randomized::draw(&conditions.randomization, (robot, task), (goals, env_of));
        if let Some(masses) = randomized.as_ref().and_then(|erring| erring.masses.as_ref()) {
            physics.weigh(masses);
        }
        scatter(&conditions.start, robot, physics, &mut readings, (goals, env_of), &mut state);
        let mut errors = Errors::of(task, robot);
        if conditions.rest {
            errors.give_rest();
        }
        let joints = vec![S::zero(); robot.n_joints()];
        LaneGroup {
            state,
            readings,
            goals: drawn,
            errors,
            action: joints.clone(),
            guidance: Guidance::none(robot.n_joints()),
            last_action: joints.clone(),
            command: joints,
            extremes: Extremes::new(robot.n_arms),
            randomized,
        }
    }
}
