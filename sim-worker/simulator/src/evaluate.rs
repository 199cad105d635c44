//! Evaluation: deterministic actions on goals that no training episode draws.

use proto::message::{EpisodeErrors, TaskErrors};
use serde::{Deserialize, Serialize};

use crate::env::EpisodeError;
use crate::executor::Executor;
use crate::experiment::{FixedGoals, Player, Pose, Recording, TAIL_STEPS, Trial, play, play_some};
use crate::model::ContactKind;
use crate::policy::Policy;
use crate::rollout::World;
use crate::task::Aim;

/// Seed of the goals by which a run chooses its best checkpoint: other goals than those of a final
/// evaluation, or the choice would flatter it.
pub const SELECTION_SEED: u64 = 0x5e1ec7;

/// How to evaluate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EvaluationOptions {
    /// Seed of the goals.
    pub seed: u64,
    /// E: episodes.
    pub episodes: usize,
    /// Control steps of an episode, one at least.
    pub steps: usize,
}

impl Default for EvaluationOptions {
    /// The released protocol: 30 episodes of 200 steps.
    fn default() -> Self {
        Self { seed: 0, episodes: 30, steps: 200 }
    }
}

/// Course of one error over an episode, in three numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Course {
    /// Smallest over the steps: the released script's measure, which flatters.
    pub min: f32,
    /// After the last step.
    pub last: f32,
    /// Mean over the last [`TAIL_STEPS`] steps (all, if the episode is shorter).
    pub tail: f32,
}

/// Errors of one hand over an episode.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct HandCourse {
    /// Norm of the position error (m).
    pub position: Course,
    /// Norm of the Euler-angle difference (rad).
    pub orientation: Course,
}

/// One episode of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeResult {
    /// One entry an arm; of hands without goals, distances from home.
    pub hands: Vec<HandCourse>,
    /// Attitude error of the base (rad); where it has no goal, distance from home.
    pub base: Course,
    /// Control steps at whose end any two bodies touched.
    pub contact_steps: u32,
    /// Touching pairs, summed over the steps.
    pub contact_pairs: u32,
    /// Control steps at whose end bodies of each kind touched.
    pub contact_steps_by_kind: ContactSteps,
    /// Where the robot stood after the last step.
    pub end: Pose,
    /// How goals were held, in tasks in which they have to be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<Held>,
}

/// How goals were held: all of them at once, as the task wants it ([`Hold`](proto::tasks::Hold)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// Control steps of the longest time in which they were.
    pub longest: u32,
    /// The control step, counted from 0, after which they had been for as long as the task wants, if they were.
    pub done: Option<u32>,
    /// Whether any two bodies touched until then, or at all where there is no then.
    pub touched_before: bool,
}

/// Control steps at whose end bodies touched, by what touched what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ContactSteps {
    /// An arm and a box of the base.
    pub arm_base: u32,
    /// An arm and a mount or pedestal.
    pub arm_mount: u32,
    /// An arm and itself.
    pub arm_itself: u32,
    /// Two arms.
    pub arm_arm: u32,
}

/// The result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Control steps of each episode.
    pub steps: usize,
    /// The episodes, in order of their index.
    pub episodes: Vec<EpisodeResult>,
}

/// Evaluates a player with deterministic actions on goals of
/// [`Purpose::EvaluationGoal`](proto::rng::Purpose::EvaluationGoal); `given` ones instead as far as there are; `executor` and `on_step` as in [`play`].
pub fn evaluate(
    player: Player<'_>,
    options: &EvaluationOptions,
    given: &[FixedGoals],
    executor: &dyn Executor,
    on_step: &(dyn Fn() + Sync),
) -> Result<Evaluation, EpisodeError> {
    let EvaluationOptions { seed, episodes, steps } = *options;
    let trial = Trial { given, ..Trial::new(player, seed, episodes, steps) };
    Ok(Evaluation::of_task(player.world, &play(&trial, executor, on_step)?))
}

/// How goals were held in an episode, if the task wants them held.
fn held(world: &World, recording: &Recording, episode: usize) -> Option<Held> {
    let definition = world.task.name.definition();
    let wanted = definition.hold(&world.config.task.target)?;
    let is_held = |step: usize| {
        let of_hand = |(arm, aim): (usize, &Aim)| {
            *aim == Aim::Base
                || f64::from(recording.position(episode, step, arm)) < wanted.position
                    && f64::from(recording.orientation(episode, step, arm)) < wanted.orientation
        };
        let base = f64::from(recording.attitude(episode, step)) < wanted.base;
        world.task.aims.iter().enumerate().all(of_hand) && (base || !world.task.name.turns())
    };
    let mut held = Held { longest: 0, done: None, touched_before: false };
    let mut now = 0;
    for step in 0..recording.steps() {
        now = if is_held(step) { now + 1 } else { 0 };
        held.longest = held.longest.max(now);
        if held.done.is_none() {
            held.touched_before |= recording.contacts(episode, step).iter().any(|pairs| *pairs > 0);
            held.done = (now >= wanted.steps as u32).then_some(step as u32);
        }
    }
    Some(held)
}

/// Plays episodes `first..first + episodes` of the evaluation by which a run chooses its best
/// checkpoint; `on_step` is called after every control step.
pub fn select(
    world: &World,
    policy: &Policy,
    first: u32,
    episodes: u32,
    on_step: &mut dyn FnMut(),
) -> Result<Vec<EpisodeErrors>, EpisodeError> {
    let (first, n) = (first as usize, episodes as usize);
    let steps = world.config.run.evaluation_steps as usize;
    let n_arms = world.dimensions.n_arms;
    let trial = Trial::new(Player::new(world, policy), SELECTION_SEED, first + n, steps);
    let mut recording = Recording::new(world.robot.joints, n, steps);
    play_some(&trial, first, n, recording.series_mut(), on_step)?;
    let measured: Vec<usize> =
        (0..n_arms).filter(|&arm| world.task.name.measures_hand(arm, n_arms)).collect();
    let errors = Evaluation::of(&recording).episodes.into_iter().map(|result| {
        let errors = |of: fn(&Course) -> f32| {
            let mean = |course: fn(&HandCourse) -> &Course| {
                let errors = measured.iter().map(|&arm| of(course(&result.hands[arm])));
                errors.sum::<f32>() / measured.len() as f32
            };
            let [position, orientation] =
                [mean(|hand| &hand.position), mean(|hand| &hand.orientation)];
            TaskErrors { position, orientation, base: of(&result.base) }
        };
        EpisodeErrors { tail: errors(|course| course.tail), min: errors(|course| course.min) }
    });
    Ok(errors.collect())
}

impl Course {
    /// Of an error's values after every step.
    pub fn of(values: impl Iterator<Item = f32> + Clone) -> Self {
        let n = values.clone().count();
        let tail = n.min(TAIL_STEPS);
        Self {
            min: values.clone().fold(f32::INFINITY, f32::min),
            last: values.clone().last().unwrap_or(f32::NAN),
            tail: values.skip(n - tail).sum::<f32>() / tail as f32,
        }
    }
}

impl Evaluation {
    /// What a recording of the task of `world` says in a few numbers: also how goals were held, where they have to be.
    pub fn of_task(world: &World, recording: &Recording) -> Self {
        let mut evaluation = Self::of(recording);
        for (index, episode) in evaluation.episodes.iter_mut().enumerate() {
            episode.held = held(world, recording, index);
        }
        evaluation
    }

    /// What a recording says in a few numbers.
    pub fn of(recording: &Recording) -> Self {
        let steps = recording.steps();
        let of_episode = |episode: usize| {
            let hand = |arm: usize| HandCourse {
                position: Course::of((0..steps).map(|step| recording.position(episode, step, arm))),
                orientation: Course::of(
                    (0..steps).map(|step| recording.orientation(episode, step, arm)),
                ),
            };
            let contacts = || (0..steps).map(|step| recording.contacts(episode, step));
            let steps_of = |kind: ContactKind| {
                contacts().filter(|pairs| pairs[kind as usize] > 0).count() as u32
            };
            EpisodeResult {
                hands: (0..recording.n_arms()).map(hand).collect(),
                base: Course::of((0..steps).map(|step| recording.attitude(episode, step))),
                contact_steps: contacts().filter(|pairs| pairs.iter().sum::<u32>() > 0).count()
                    as u32,
                contact_pairs: contacts().flatten().sum(),
                contact_steps_by_kind: ContactSteps {
                    arm_base: steps_of(ContactKind::Base),
                    arm_mount: steps_of(ContactKind::Mount),
                    arm_itself: steps_of(ContactKind::Own),
                    arm_arm: steps_of(ContactKind::Arms),
                },
                end: recording.pose(episode, steps - 1),
                held: None,
            }
        };
        Self { steps, episodes: (0..recording.episodes()).map(of_episode).collect() }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proto::config::{Layers, Preset};

    use super::*;
    use crate::executor::InOrder;
    use crate::executor::tests::Apart;
    use crate::policy::tests::parameters;
    use crate::robot::Robot;

    #[test]
    fn an_episodes_course_by_hand() {
        // 22 steps: 22, 21, …, 2, then 3. The last twenty: 20, 19, …, 2 (sum 209), 3: 212 / 20.
        let values = (0..22_u8).map(|step| if step == 21 { 3.0 } else { 22.0 - f32::from(step) });
        assert_eq!(Course::of(values), Course { min: 2.0, last: 3.0, tail: 10.6 });
        // Shorter than the tail.
        assert_eq!(Course::of([1.0, 3.0].into_iter()), Course { min: 1.0, last: 3.0, tail: 2.0 });
    }

    fn world(preset: Preset, robot: &Robot, steps: usize) -> World {
        let mut config = Layers::new(preset, None).resolve().expect("valid");
        config.network.hidden = vec![16];
        config.task.episode_steps = steps;
        World::new(&config, robot)
    }

    #[test]
    fn an_evaluation_does_not_depend_on_its_executor_and_knows_its_seed() {
        let world = world(Preset::Tuned, &Robot::builtin("paper").expect("built in"), 50);
        let flat = parameters(&world.config, &world.dimensions, 8);
        let policy = world.policy(&flat).expect("a policy");
        let player = Player::new(&world, &policy);
        let options = EvaluationOptions { seed: 3, episodes: 35, steps: 3 };
        let one = evaluate(player, &options, &[], &InOrder, &|| {}).expect("an evaluation");
        let apart = evaluate(player, &options, &[], &Apart, &|| {});
        assert_eq!(one, apart.expect("an evaluation"));
        let other =
            evaluate(player, &EvaluationOptions { seed: 4, ..options }, &[], &InOrder, &|| {});
        assert_ne!(one, other.expect("an evaluation"));
        assert_eq!((one.steps, one.episodes.len()), (3, 35));
        for EpisodeResult { end, .. } in &one.episodes {
            // Commands of an untrained policy are small and not nothing.
            let moved = end.joints.iter().zip(world.robot.home_q());
            assert_eq!(moved.len(), 24);
            assert!(moved.map(|(&q, home)| (f64::from(q) - home).abs()).fold(0.0, f64::max) > 1e-4);
            let length = end.base_quaternion.iter().map(|x| x * x).sum::<f32>();
            assert!((length - 1.0).abs() < 1e-5, "{length}");
        }
        for hand in one.episodes.iter().flat_map(|episode| &episode.hands) {
            // Goals are 0.15 to 0.55 m away, and an arm moves less than 0.3 m in 1.2 s.
            assert!(hand.position.last > 0.0 && hand.position.last < 1.0, "{hand:?}");
            assert!(hand.position.min <= hand.position.last);
        }
        // Without episodes there is nothing to say, but nothing to fail either.
        let none =
            evaluate(player, &EvaluationOptions { episodes: 0, ..options }, &[], &InOrder, &|| {});
        assert!(none.expect("an evaluation").episodes.is_empty());
    }

    #[test]
    fn a_selection_is_the_evaluation_in_means_whatever_the_chunks() {
        let mut world = world(Preset::Tuned, &Robot::builtin("paper").expect("built in"), 50);
        world.config.run.evaluation_steps = 3;
        let flat = parameters(&world.config, &world.dimensions, 8);
        let policy = world.policy(&flat).expect("a policy");
        let player = Player::new(&world, &policy);
        let options = EvaluationOptions { seed: SELECTION_SEED, episodes: 18, steps: 3 };
        let whole =
            evaluate(player, &options, &[], &InOrder, &|| {}).expect("an evaluation").episodes;
        let mut steps = 0;
        let mut play = |first, episodes| {
            select(&world, &policy, first, episodes, &mut || steps += 1).expect("a selection")
        };
        let mut errors = play(0, 16);
        errors.extend(play(16, 2));
        assert_eq!(steps, 6);
        assert_eq!(errors.len(), whole.len());
        for (errors, episode) in errors.iter().zip(&whole) {
            let tails = episode.hands.iter().map(|hand| hand.position.tail);
            assert_eq!(errors.tail.position, tails.sum::<f32>() / 4.0);
            assert_eq!(errors.tail.base, episode.base.tail);
            let least = episode.hands.iter().map(|hand| hand.orientation.min);
            assert_eq!(errors.min.orientation, least.sum::<f32>() / 4.0);
            assert_eq!(errors.min.base, episode.base.min);
        }
    }

    #[test]
    fn every_arm_of_any_robot_is_two_agents() {
        let two = include_str!("../robots/two-arm.toml");
        let seven = include_str!("../robots/seven-joints.toml");
        for (preset, text) in [
            (Preset::Tuned, two),
            (Preset::Release, two),
            (Preset::Guided, seven),
            (Preset::Release, seven),
        ] {
            let robot = Robot::from_toml(text, Path::new("robot.toml")).expect("valid");
            let world = world(preset, &robot, 50);
            assert_eq!(world.dimensions.n_agents, 2 * robot.n_arms);
            let flat = parameters(&world.config, &world.dimensions, 8);
            let policy = world.policy(&flat).expect("a policy");
            let player = Player::new(&world, &policy);
            let options = EvaluationOptions { seed: 3, episodes: 2, steps: 2 };
            let evaluation =
                evaluate(player, &options, &[], &InOrder, &|| {}).expect("an evaluation");
            assert_eq!(evaluation.episodes[0].hands.len(), robot.n_arms);
        }
    }
}
