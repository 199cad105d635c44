//! How well a policy does on goals it never saw.

mod errors;
mod held;
mod reach;
mod success;
mod summary;
mod table;
mod verdict;

use output::grouped;
use proto::{ExitCode, ExitError};
use run::report::progress::Parts;
use simulator::evaluate::{self, EvaluationOptions};
use simulator::experiment::{CHUNK, EvaluationGoals, MOST_RECORDED};
use store::checkpoint::Checkpoint;

pub use self::errors::ErrorSummary;
pub use self::held::HeldShare;
pub use self::reach::{GoalSubset, Reach, Reachable, WithinReach, reachable};
pub use self::success::Success;
pub use self::summary::{ContactRates, Summary};
pub use self::verdict::Verdict;
use crate::contender::Contender;
use crate::goals::OwnGoals;
use crate::threads::Threads;
use crate::trained::Trained;

/// Evaluates a checkpoint on held-out goals, and shows how far it has come.
pub fn evaluate(checkpoint: Checkpoint, options: &EvaluationOptions) -> anyhow::Result<Summary> {
    evaluate_on(&Trained::new(checkpoint, None)?.into(), options, None)
}

/// Evaluates a policy or a controller, on goals of a person's own, if there are some, and shows how far it has come.
pub fn evaluate_on(
    contender: &Contender,
    options: &EvaluationOptions,
    own: Option<&OwnGoals>,
) -> anyhow::Result<Summary> {
    let given = own.map_or(&[][..], |own| &own.given);
    let threads = Threads::available();
    let progress = Parts::new();
    let chunks = options.episodes.div_ceil(CHUNK);
    progress.begin("evaluation", (chunks * options.steps) as u64);
    let on_step = || progress.advance();
    let evaluation = evaluate::evaluate(contender.player(), options, given, &threads, &on_step)?;
    let goals = EvaluationGoals { seed: options.seed, given };
    let reach = Reach::of(&contender.world, &evaluation, goals, threads, &progress)?;
    Ok(Summary::new(contender.identity(), options.seed, own, evaluation, reach))
}

/// What [`check_recorded`] names on a command line that has both.
pub const EPISODES_OR_STEPS: &str = "--episodes or --steps";

/// Refuses episodes whose control steps, all of which are recorded, take more memory than there is. `asked` names what they were asked for by.
pub fn check_recorded(episodes: usize, steps: usize, asked: &str) -> Result<(), ExitError> {
    if episodes.saturating_mul(steps) <= MOST_RECORDED {
        return Ok(());
    }
    let message = format!(
        "{} of {} control steps are more than can be recorded: {} control steps in all; ask for fewer by \
         {asked}",
        output::counted(episodes as u64, "episode"),
        grouped(steps as u64),
        grouped(MOST_RECORDED as u64)
    );
    Err(ExitError::new(ExitCode::Usage, message))
}

#[cfg(test)]
mod tests {
    use proto::config::TaskName;
    use simulator::evaluate::{ContactSteps, Course, EpisodeResult, HandCourse};
    use simulator::experiment::Pose;

    use super::errors::agents;
    use super::success::success;
    use super::*;
    use crate::statistics::ErrorOf;

    /// An episode in which nothing was measured.
    pub(super) fn blank() -> EpisodeResult {
        EpisodeResult {
            hands: vec![],
            base: Course::default(),
            contact_steps: 0,
            contact_pairs: 0,
            contact_steps_by_kind: ContactSteps::default(),
            end: Pose {
                base_position: [0.0; 3],
                base_quaternion: [1.0, 0.0, 0.0, 0.0],
                joints: vec![],
            },
            held: None,
        }
    }

    #[test]
    fn a_goal_counts_when_both_errors_are_small_at_the_end() {
        let course = |last: f32| Course { min: 0.0, last, tail: last };
        let hand = |position, orientation| HandCourse {
            position: course(position),
            orientation: course(orientation),
        };
        let episode = |hands| EpisodeResult { hands, base: course(0.035), ..blank() };
        let episodes = [
            episode(vec![hand(0.01, 0.01), hand(0.03, 0.01)]),
            episode(vec![hand(0.01, 0.2), hand(0.01, 0.01)]),
        ];
        let loose = success(TaskName::Trajectory, &episodes);
        assert_eq!((loose[0].goals, loose[0].episodes), (0.75, 0.5));
        assert_eq!((loose[1].goals, loose[1].episodes), (0.5, 0.0));
        let base = success(TaskName::Reorientation, &episodes);
        assert_eq!((base[0].goals, base[1].goals), (1.0, 0.0));
        let subset = GoalSubset::of(&episodes, &[vec![true, false], vec![false, true]]);
        assert_eq!((subset.goals, subset.of), (2, 4));
        assert_eq!((subset.success[1].goals, subset.success[1].episodes), (1.0, 1.0));
        assert!((subset.overall[0].tail.mean - 0.01).abs() < 1e-9);
        // Of the second episode no goal was chosen: it neither reaches nor misses any.
        let subset = GoalSubset::of(&episodes, &[vec![false, true], vec![false, false]]);
        assert_eq!((subset.success[0].goals, subset.success[0].episodes), (1.0, 1.0));
        assert_eq!((subset.success[1].goals, subset.success[1].episodes), (0.0, 0.0));
        let none = GoalSubset::of(&episodes, &[vec![false; 2], vec![false; 2]]);
        assert!(none.success.iter().all(|share| share.goals.is_nan() && share.episodes.is_nan()));
        assert!(none.overall[0].tail.mean.is_nan());
        let agents = agents(TaskName::Trajectory, &episodes);
        assert_eq!(agents.len(), 4);
        assert_eq!((agents[1].error, agents[1].agent), (ErrorOf::Orientation, Some(1)));
    }
}
