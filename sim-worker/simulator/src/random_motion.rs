//! The dynamics alone: control steps under random commands, to measure what they cost.

use crate::collision::count_contacts;
use crate::model::Model;
use crate::robot::Robot;
use crate::scalar::counted::{Counted, operations};
use crate::scalar::{LaneFn, Real, dispatch};
use crate::state::State;
use crate::step::{StepOptions, step};
use crate::workspace::Workspace;

/// Groups of lanes in flight, so that states come from the cache that a rollout would use.
const GROUPS: usize = 8;
/// Control steps of an episode.
const EPISODE: usize = 50;
/// Largest commanded rate (rad/s).
const MAX_RATE: f64 = 0.8;

/// What [`random_motion`] did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Control steps, of all environments together.
    pub env_steps: u64,
    /// Touching pairs after a control step, mean.
    pub touching_pairs: f64,
}

/// Moves a robot by random commands, an environment a lane, until `go_on` says no; it is asked after every episode.
///
/// # Panics
/// If the simulation diverges.
pub fn random_motion(
    robot: &Robot,
    options: StepOptions,
    go_on: &mut dyn FnMut() -> bool,
) -> Motion {
    dispatch(Run { robot, options, go_on })
}

/// Floating-point operations of a control step under random commands, counted by running the very
/// code on a number that counts. Counted are additions, multiplications, divisions and square roots;
/// comparisons, rounding and selecting are not.
pub fn operations_per_step(robot: &Robot, options: &StepOptions) -> f64 {
    let model = Model::<Counted>::new(robot);
    let mut ws = Workspace::new(&model);
    let n = robot.n_joints();
    let commands = commands::<Counted>(n, 1);
    let mut state = State::<Counted>::home(robot);
    let counted = operations(|| {
        for command in commands.chunks_exact(n) {
            step(&model, &mut ws, &mut state, command, options);
            if options.contacts {
                count_contacts(&model, &mut ws, &state);
            }
        }
    });
    counted as f64 / EPISODE as f64
}

struct Run<'a> {
    robot: &'a Robot,
    options: StepOptions,
    go_on: &'a mut dyn FnMut() -> bool,
}

impl LaneFn for Run<'_> {
    type Output = Motion;

    #[inline(always)]
    fn call<S: Real>(self) -> Motion {
        let Self { robot, options, go_on } = self;
        let model = Model::<S>::new(robot);
        let mut ws = Workspace::new(&model);
        let n = robot.n_joints();
        let commands = commands::<S>(n, GROUPS);
        let (mut steps, mut contacts) = (0, S::zero());
        loop {
            let group = steps / EPISODE % GROUPS;
            let mut state = State::<S>::home(robot);
            for t in 0..EPISODE {
                let at = (group * EPISODE + t) * n;
                step(&model, &mut ws, &mut state, &commands[at..at + n], &options);
                if options.contacts {
                    contacts += count_contacts(&model, &mut ws, &state);
                }
            }
            assert!(state.is_finite(), "the simulation diverged");
            steps += EPISODE;
            if !go_on() {
                break;
            }
        }
        let touching = (0..S::LANES).map(|lane| contacts.lane(lane)).sum::<f64>();
        let env_steps = (steps * S::LANES) as u64;
        Motion { env_steps, touching_pairs: touching / env_steps as f64 }
    }
}

/// Random commands for `groups` episodes of `n` joints.
#[inline(always)]
fn commands<S: Real>(n: usize, groups: usize) -> Vec<S> {
    let mut counter = 1;
    let mut commands = vec![S::zero(); n * EPISODE * groups];
    for command in &mut commands {
        for lane in 0..S::LANES {
            command.set_lane(lane, MAX_RATE * noise(&mut counter));
        }
    }
    commands
}

/// Uniform numbers in ±1 from a counter.
fn noise(counter: &mut u64) -> f64 {
    *counter = counter.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*counter >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_ends_when_it_is_told_to() {
        let robot = Robot::builtin("paper").expect("built in");
        let mut episodes = 0;
        let motion = random_motion(&robot, StepOptions::default(), &mut || {
            episodes += 1;
            episodes < 2
        });
        assert_eq!((episodes, motion.env_steps % (2 * EPISODE as u64)), (2, 0));
        assert!(motion.env_steps > 0 && motion.touching_pairs >= 0.0);
    }

    #[test]
    fn contacts_cost_operations() {
        let robot = Robot::builtin("paper").expect("built in");
        let count = |contacts| {
            operations_per_step(&robot, &StepOptions { contacts, ..StepOptions::default() })
        };
        let (without, with) = (count(false), count(true));
        // 27 substeps of three evaluations on 26 bodies: some hundred operations a body each time.
        assert!((27.0 * 3.0 * 26.0 * 100.0..1e8).contains(&without), "{without}");
        assert!(with > without, "{with}");
    }
}
