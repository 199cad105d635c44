//! Evaluation: deterministic actions on goals that no training episode draws.

use proto::message::EpisodeErrors;
use proto::rng::Purpose;
use serde::Serialize;

use crate::env::{Batch, EpisodeError, Episodes, Output};
use crate::policy::Policy;
use crate::rollout::World;
use crate::scalar::{LANES, dispatch};
use crate::task::goal::GoalAddress;

/// Control steps that the mean over an episode's tail takes.
pub const TAIL_STEPS: usize = 20;

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
    /// Control steps of an episode.
    pub steps: usize,
    /// Threads; the result does not depend on them.
    pub threads: usize,
}

impl Default for EvaluationOptions {
    /// The released protocol: 30 episodes of 200 steps.
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self { seed: 0, episodes: 30, steps: 200, threads }
    }
}

/// Course of one error over an episode, in three numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Course {
    /// Smallest over the steps: the released script's measure, which flatters.
    pub min: f32,
    /// After the last step.
    pub last: f32,
    /// Mean over the last [`TAIL_STEPS`] steps (all, if the episode is shorter).
    pub tail: f32,
}

/// Errors of one hand over an episode.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct HandCourse {
    /// Norm of the position error (m).
    pub position: Course,
    /// Norm of the Euler-angle difference (rad).
    pub orientation: Course,
}

/// One episode of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeResult {
    /// One entry an arm; in `reorientation`, distances from home.
    pub hands: Vec<HandCourse>,
    /// Attitude error of the base (rad); in `trajectory`, distance from home.
    pub base: Course,
    /// Control steps at whose end any two bodies touched.
    pub contact_steps: u32,
    /// Touching pairs, summed over the steps.
    pub contact_pairs: u32,
}

/// The result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// Control steps of each episode.
    pub steps: usize,
    /// The episodes, in order of their index.
    pub episodes: Vec<EpisodeResult>,
}

/// Evaluates `policy` with its mean actions on goals of [`Purpose::EvaluationGoal`].
pub fn evaluate(
    world: &World,
    policy: &Policy,
    options: &EvaluationOptions,
) -> Result<Evaluation, EpisodeError> {
    // Two lane groups at a time: enough to feed the policy's registers, little enough to spread.
    const CHUNK: usize = 2 * LANES;
    let EvaluationOptions { seed, episodes, steps, threads } = *options;
    let width = series_width(world);
    let mut series = vec![0.0_f32; episodes * steps * width];
    let chunk_len = (CHUNK * steps * width).max(1);
    let mut chunks: Vec<(usize, &mut [f32])> = series.chunks_mut(chunk_len).enumerate().collect();
    let per_thread = chunks.len().div_ceil(threads.max(1)).max(1);
    std::thread::scope(|scope| {
        let handles: Vec<_> = chunks
            .chunks_mut(per_thread)
            .map(|share| {
                scope.spawn(move || {
                    share.iter_mut().try_for_each(|(index, series)| {
                        let first = *index * CHUNK;
                        let n_envs = CHUNK.min(episodes - first);
                        let played = Played { first: first as u32, n_envs, steps, seed };
                        run_chunk(world, policy, &played, series, &mut || {})
                    })
                })
            })
            .collect();
        handles.into_iter().try_for_each(|handle| match handle.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })?;
    let episodes = series
        .chunks_exact((steps * width).max(1))
        .map(|episode| summarise(episode, world.dimensions.n_arms))
        .collect();
    Ok(Evaluation { steps, episodes })
}

/// Numbers of a step in a series: each hand's two errors, the base's, touching pairs.
fn series_width(world: &World) -> usize {
    2 * world.dimensions.n_arms + 2
}

/// Some episodes of an evaluation.
struct Played {
    first: u32,
    n_envs: usize,
    steps: usize,
    seed: u64,
}

fn run_chunk(
    world: &World,
    policy: &Policy,
    played: &Played,
    series: &mut [f32],
    on_step: &mut dyn FnMut(),
) -> Result<(), EpisodeError> {
    let Played { first, n_envs, steps, seed } = *played;
    let episodes = Episodes {
        config: &world.config,
        robot: &world.robot,
        task: &world.task,
        dimensions: &world.dimensions,
        policy,
        batch: Batch { first, n_envs, n_steps: steps },
        goals: GoalAddress { seed, purpose: Purpose::EvaluationGoal, iteration: 0, env: first },
        noise: None,
        output: Output::Series(series),
        on_step,
    };
    dispatch(episodes).map(|_| ())
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
    let steps = world.config.run.evaluation_steps as usize;
    let n_arms = world.dimensions.n_arms;
    let width = series_width(world);
    let mut series = vec![0.0_f32; episodes as usize * steps * width];
    let played = Played { first, n_envs: episodes as usize, steps, seed: SELECTION_SEED };
    run_chunk(world, policy, &played, &mut series, on_step)?;
    let errors = series.chunks_exact(steps * width).map(|episode| {
        let result = summarise(episode, n_arms);
        let mean = |error: fn(&HandCourse) -> f32| {
            result.hands.iter().map(error).sum::<f32>() / n_arms as f32
        };
        EpisodeErrors {
            position: mean(|hand| hand.position.tail),
            orientation: mean(|hand| hand.orientation.tail),
            base: result.base.tail,
        }
    });
    Ok(errors.collect())
}

/// Reduces `[step][position errors, orientation errors, base error, pairs]`.
fn summarise(episode: &[f32], n_arms: usize) -> EpisodeResult {
    let width = 2 * n_arms + 2;
    let course = |column: usize| {
        let values = || episode.iter().skip(column).step_by(width).copied();
        let n = episode.len() / width;
        let tail = n.min(TAIL_STEPS);
        Course {
            min: values().fold(f32::INFINITY, f32::min),
            last: values().last().unwrap_or(f32::NAN),
            tail: values().skip(n - tail).sum::<f32>() / tail as f32,
        }
    };
    let pairs = || episode.iter().skip(width - 1).step_by(width);
    EpisodeResult {
        hands: (0..n_arms)
            .map(|arm| HandCourse { position: course(arm), orientation: course(n_arms + arm) })
            .collect(),
        base: course(2 * n_arms),
        contact_steps: pairs().filter(|&&pairs| pairs > 0.0).count() as u32,
        contact_pairs: pairs().sum::<f32>() as u32,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proto::config::{Layers, Preset};

    use super::*;
    use crate::policy::tests::parameters;
    use crate::robot::Robot;

    #[test]
    fn an_episodes_course_by_hand() {
        // One arm, 22 steps: position falls 22, 21, …, 1, rises to 3 at the end; pairs 2 at two steps.
        let mut episode = Vec::new();
        for step in 0..22 {
            let position = if step == 21 { 3.0 } else { 22.0 - step as f32 };
            let pairs = if step < 2 { 2.0 } else { 0.0 };
            episode.extend([position, 0.5, step as f32, pairs]);
        }
        let result = summarise(&episode, 1);
        // The last twenty: 20, 19, …, 2 (sum 209), 3: 212 / 20.
        assert_eq!(result.hands[0].position, Course { min: 2.0, last: 3.0, tail: 10.6 });
        assert_eq!(result.hands[0].orientation, Course { min: 0.5, last: 0.5, tail: 0.5 });
        // 2…21: mean 11.5.
        assert_eq!(result.base, Course { min: 0.0, last: 21.0, tail: 11.5 });
        assert_eq!((result.contact_steps, result.contact_pairs), (2, 4));
    }

    fn world(preset: Preset, robot: &Robot, steps: usize) -> World {
        let mut config = Layers::new(preset, None).resolve().expect("valid");
        config.network.hidden = vec![16];
        config.task.episode_steps = steps;
        World::new(&config, robot)
    }

    #[test]
    fn an_evaluation_does_not_depend_on_threads_and_knows_its_seed() {
        let world = world(Preset::Tuned, &Robot::builtin("paper").expect("built in"), 50);
        let flat = parameters(&world.config, &world.dimensions, 8);
        let policy = world.policy(&flat).expect("a policy");
        let options = EvaluationOptions { seed: 3, episodes: 35, steps: 3, threads: 1 };
        let one = evaluate(&world, &policy, &options).expect("an evaluation");
        let three = evaluate(&world, &policy, &EvaluationOptions { threads: 3, ..options });
        assert_eq!(one, three.expect("an evaluation"));
        let other = evaluate(&world, &policy, &EvaluationOptions { seed: 4, ..options });
        assert_ne!(one, other.expect("an evaluation"));
        assert_eq!((one.steps, one.episodes.len()), (3, 35));
        for hand in one.episodes.iter().flat_map(|episode| &episode.hands) {
            // Goals are 0.15 to 0.55 m away, and an arm moves less than 0.3 m in 1.2 s.
            assert!(hand.position.last > 0.0 && hand.position.last < 1.0, "{hand:?}");
            assert!(hand.position.min <= hand.position.last);
        }
        // Without episodes there is nothing to say, but nothing to fail either.
        let none = evaluate(&world, &policy, &EvaluationOptions { episodes: 0, ..options });
        assert!(none.expect("an evaluation").episodes.is_empty());
    }

    #[test]
    fn a_selection_is_the_evaluation_in_means_whatever_the_chunks() {
        let mut world = world(Preset::Tuned, &Robot::builtin("paper").expect("built in"), 50);
        world.config.run.evaluation_steps = 3;
        let flat = parameters(&world.config, &world.dimensions, 8);
        let policy = world.policy(&flat).expect("a policy");
        let options =
            EvaluationOptions { seed: SELECTION_SEED, episodes: 18, steps: 3, threads: 1 };
        let whole = evaluate(&world, &policy, &options).expect("an evaluation").episodes;
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
            assert_eq!(errors.position, tails.sum::<f32>() / 4.0);
            assert_eq!(errors.base, episode.base.tail);
        }
    }

    #[test]
    fn a_two_armed_robot_is_four_agents() {
        let text = include_str!("../robots/two-arm.toml");
        let robot = Robot::from_toml(text, Path::new("two-arm.toml")).expect("valid");
        for preset in [Preset::Tuned, Preset::Release] {
            let world = world(preset, &robot, 50);
            assert_eq!(world.dimensions.n_agents, 4);
            let flat = parameters(&world.config, &world.dimensions, 8);
            let policy = world.policy(&flat).expect("a policy");
            let options = EvaluationOptions { seed: 3, episodes: 2, steps: 2, threads: 1 };
            let evaluation = evaluate(&world, &policy, &options).expect("an evaluation");
            assert_eq!(evaluation.episodes[0].hands.len(), 2);
        }
    }
}
