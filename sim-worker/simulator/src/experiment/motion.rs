//! A robot that executes given commands, seen whole after every control step.
//!
//! What a policy, a plan or a block has commanded is a list of joint rates, and the robot's motion a function of where it begins and of that
//! list. In lone single precision: the same bits as in any lane, so a motion is that of the episode, simulation or block that the commands are
//! from, as long as nothing acted from outside there.

use super::FixedGoals;
use crate::collision::Touching;
use crate::dynamics::Hand;
use crate::env::{EpisodeError, Physics, Push, check_state, home};
use crate::model::Masses;
use crate::robot::Robot;
use crate::scalar::{Kernel, Real};
use crate::spatial::{Mat3, Vec3};
use crate::state::State;
use crate::step::StepOptions;
use crate::task::{Errors, Goals, Readings};

/// A robot on its way.
pub struct Motion {
    robot: Robot,
    options: StepOptions,
    physics: Physics<f32>,
    state: State<f32>,
    goals: Goals<f32>,
    readings: Readings<f32>,
    errors: Errors<f32>,
    touching: Option<Touching<f32>>,
    /// Of the step before.
    commands: Vec<f32>,
    torques: Vec<f32>,
    pushes: Vec<Push<f32>>,
    steps: usize,
}

impl std::fmt::Debug for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Motion")
            .field("robot", &self.robot.name)
            .field("steps", &self.steps)
            .finish_non_exhaustive()
    }
}

impl Motion {
    /// A robot at its beginning. Goals that are not given are the home poses, so that errors are distances from home.
    ///
    /// # Panics
    /// If the state has another number of joints than the robot.
    pub fn new(robot: &Robot, options: StepOptions, state: State<f32>, given: &FixedGoals) -> Self {
        assert_eq!(state.q.len(), robot.n_joints(), "joints of the state");
        let home = home(robot);
        let hands = home.arms.iter().map(|home| {
            let ([x, y, z], [a, b, c]) = (home.position, home.euler);
            [x, y, z, a, b, c].map(|x| x as f32)
        });
        let base = given.base.unwrap_or(home.base_euler).map(|x| x as f32);
        let mut goals = Goals::fixed(hands.collect(), base);
        put(&mut goals, &given.hands);
        let zeros = vec![0.0; robot.n_joints()];
        let mut motion = Self {
            robot: robot.clone(),
            options,
            physics: Physics::with_options(robot, options),
            state,
            goals,
            readings: Readings::new(&robot.joints),
            errors: Errors::new(robot.n_arms),
            touching: None,
            commands: zeros.clone(),
            torques: zeros,
            pushes: Vec::new(),
            steps: 0,
        };
        f32::compiled(Look(&mut motion));
        motion
    }

    /// The same robot, with bodies that are so many times as heavy: a factor for the base, then one for each link of all types of arms; none leaves them.
    #[must_use]
    pub fn weighing(mut self, factors: &[f32]) -> Self {
        self.physics.weigh(&Masses::of(&self.robot).times(factors));
        self
    }

    /// [`Motion::step`] with goals that move: after it those of the hands are there, position in the world (m) and Euler angles (rad).
    ///
    /// # Errors
    /// As there.
    pub fn step_towards(
        &mut self,
        commands: &[f32],
        hands: &[Option<[f64; 6]>],
    ) -> Result<(), EpisodeError> {
        put(&mut self.goals, hands);
        self.step(commands)
    }

    /// Holds joint rates (rad/s, arm-major) for a control period.
    ///
    /// # Errors
    /// If the simulation diverges; the motion is of no use then.
    ///
    /// # Panics
    /// If there are more or fewer rates than joints.
    pub fn step(&mut self, commands: &[f32]) -> Result<(), EpisodeError> {
        self.commands.copy_from_slice(commands);
        f32::compiled(Advance(self))
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// How it is integrated.
    pub fn options(&self) -> &StepOptions {
        &self.options
    }

    /// Control steps since the beginning.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// State of the robot.
    pub fn state(&self) -> &State<f32> {
        &self.state
    }

    /// Where hands and base shall go.
    pub fn goals(&self) -> &Goals<f32> {
        &self.goals
    }

    /// How far they are from there.
    pub fn errors(&self) -> &Errors<f32> {
        &self.errors
    }

    /// Joint rates commanded in the last step (rad/s), arm-major.
    pub fn commands(&self) -> &[f32] {
        &self.commands
    }

    /// Torques of the servos at the end of the last step (N m), arm-major.
    pub fn torques(&self) -> &[f32] {
        &self.torques
    }

    /// Contacts that pushed at the end of the last step.
    pub fn pushes(&self) -> &[Push<f32>] {
        &self.pushes
    }

    /// What touches.
    pub fn touching(&self) -> &Touching<f32> {
        self.touching.as_ref().expect("a motion is read when it is made")
    }

    /// Hands of all arms.
    pub fn hands(&self) -> &[Hand<f32>] {
        self.physics.hands()
    }

    /// Axes in the world and origin (m) of a body's frame: 0 is the base, 1 + l is link l, arm-major.
    pub fn body(&self, body: usize) -> (Mat3<f32>, Vec3<f32>) {
        self.physics.body(&self.state, body.checked_sub(1))
    }
}

/// Has goals of hands be where they are given.
fn put(goals: &mut Goals<f32>, given: &[Option<[f64; 6]>]) {
    for (goal, given) in goals.hands.iter_mut().zip(given) {
        if let Some(given) = given {
            *goal = given.map(|x| x as f32);
        }
    }
}

// Compiled with the processor's fused multiply-add, as what they call is.

struct Look<'a>(&'a mut Motion);

impl Kernel<f32> for Look<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Motion { physics, state, goals, readings, errors, touching, .. } = self.0;
        *touching = Some(physics.read(state, readings));
        errors.update(readings, goals);
    }
}

struct Advance<'a>(&'a mut Motion);

impl Kernel<f32> for Advance<'_> {
    type Output = Result<(), EpisodeError>;
    #[inline(always)]
    fn run(self) -> Self::Output {
        let Motion { robot, physics, state, commands, torques, pushes, steps, .. } = &mut *self.0;
        physics.step(state, commands);
        check_state(&robot.joints, state, 0, 0, 1, *steps)?;
        *steps += 1;
        physics.torques(commands, &state.qd, torques);
        physics.pushes(state, pushes);
        Look(self.0).run();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proto::config::{Layers, Preset, TaskName};

    use super::*;
    use crate::experiment::{Episode, Member, Start};
    use crate::policy::tests::parameters;
    use crate::rollout::World;
    use crate::simulate::{Precision, simulate};

    fn member() -> Arc<Member> {
        let robot = Robot::builtin("paper").expect("built in");
        let layers = Layers::new(Preset::Tuned, Some(TaskName::Trajectory));
        let config = layers.set("network.hidden=[8]").expect("a key").resolve().expect("valid");
        let world = World::new(&config, &robot);
        let flat = parameters(&world.config, &world.dimensions, 5);
        let policy = world.policy(&flat).expect("a policy");
        Arc::new(Member { world, policy })
    }

    #[test]
    fn the_commands_of_an_episode_make_its_motion_to_the_bit() {
        let start = Start { seed: 5, episode: 2, ..Start::default() };
        let mut episode = Episode::new(vec![member()], start).expect("an episode");
        let wide = |pose: &[f32; 6]| Some(pose.map(f64::from));
        let goals = FixedGoals {
            hands: episode.goals().hands.iter().map(wide).collect(),
            base: Some(episode.goals().base.map(f64::from)),
        };
        let options = StepOptions::default();
        let mut motion = Motion::new(episode.robot(), options, episode.state().clone(), &goals);
        for step in 0..12 {
            assert_eq!(motion.steps(), step);
            assert_eq!(motion.state(), episode.state());
            assert_eq!(motion.torques(), episode.torques());
            assert_eq!(motion.commands(), episode.commands());
            assert_eq!(motion.errors().position_norm, episode.errors().position_norm);
            assert_eq!(motion.errors().base_norm, episode.errors().base_norm);
            assert_eq!(motion.hands()[3].position, episode.hands()[3].position);
            assert_eq!(motion.body(9), episode.body(9));
            assert_eq!(motion.pushes().len(), episode.pushes().len());
            episode.step().expect("stable");
            motion.step(episode.commands()).expect("stable");
        }
        assert!(motion.commands().iter().any(|&rate| rate != 0.0));
    }

    #[test]
    fn a_motion_from_home_is_a_simulation() {
        let robot = Robot::builtin("paper").expect("built in");
        let options = StepOptions::default();
        let actions = vec![vec![0.25; robot.n_joints()]; 4];
        let rows = simulate(&robot, &actions, Precision::F32, &options);
        let none = FixedGoals::default();
        let mut motion = Motion::new(&robot, options, State::home(&robot), &none);
        let at_home = motion.errors().position_norm.iter().all(|&error| error < 1e-6);
        assert!(at_home, "goals are at home: {:?}", motion.errors().position_norm);
        for row in rows {
            motion.step(&vec![0.25; robot.n_joints()]).expect("stable");
            assert_eq!(motion.state().lane(0), row.state);
        }
        assert!(motion.errors().position_norm.iter().all(|&error| error > 0.01));
    }
}
