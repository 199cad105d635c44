//! How a trial's policy does on held-out goals.

use proto::Digest;
use run::report::progress::Parts;
use run::selection::MeanErrors;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{EvaluationOptions, SELECTION_SEED, evaluate};
use simulator::experiment::EvaluationGoals;
use store::checkpoint::Checkpoint;

use crate::evaluation::{ErrorSummary, Reach, Summary};
use crate::statistics::{ErrorOf, number};
use crate::threads::Threads;
use crate::trained::Trained;

/// A hand that ends further than this from its goal has missed it (m, rad).
const MISSED: (f64, f64) = (0.03, 0.06);

/// What an evaluation says of a policy, in few numbers. Errors are means over the last 20 steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scored {
    /// Iterations that it was trained on.
    pub iteration: u64,
    /// Digest of the training state after these: it tells runs apart.
    pub digest: Digest,
    /// [`MeanErrors::score`]: the smaller, the better.
    #[serde(deserialize_with = "number")]
    pub score: f64,
    /// Episodes.
    pub episodes: usize,
    /// Error of the hands' positions (m); none where the task is about the base.
    pub position_m: Option<f64>,
    /// Error of the hands' orientations, or of the base's attitude (rad).
    #[serde(deserialize_with = "number")]
    pub angle_rad: f64,
    /// Share of control steps at whose end bodies touched.
    #[serde(deserialize_with = "number")]
    pub contact_rate: f64,
    /// Of the goals that can be reached, where it was found out which these are.
    pub reachable: Option<OfReachable>,
}

/// The same of the goals that a controller which knows the robot reaches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OfReachable {
    /// How many they are.
    pub goals: usize,
    /// Position error (m).
    #[serde(deserialize_with = "number")]
    pub position_m: f64,
    /// Orientation error (rad).
    #[serde(deserialize_with = "number")]
    pub orientation_rad: f64,
    /// Share whose hand ends further than 30 mm or 60 mrad away.
    #[serde(deserialize_with = "number")]
    pub missed: f64,
}

/// Scores a policy at a rung: on the goals by which its run chooses its best checkpoint.
pub fn score_at_rung(checkpoint: Checkpoint, threads: Threads) -> anyhow::Result<Scored> {
    let run = &checkpoint.config.run;
    let options = EvaluationOptions {
        seed: SELECTION_SEED,
        episodes: run.evaluation_episodes as usize,
        steps: run.evaluation_steps as usize,
    };
    score(checkpoint, &options, threads, false)
}

/// Scores a policy at the end of its budget, on other goals, and also on those alone that can be reached.
pub fn score_at_end(
    checkpoint: Checkpoint,
    options: &EvaluationOptions,
    threads: Threads,
) -> anyhow::Result<Scored> {
    score(checkpoint, options, threads, true)
}

fn score(
    checkpoint: Checkpoint,
    options: &EvaluationOptions,
    threads: Threads,
    with_reach: bool,
) -> anyhow::Result<Scored> {
    let digest = checkpoint.manifest.digest;
    let trained = Trained::new(checkpoint, None)?;
    let evaluation = evaluate(trained.player(), options, &[], &threads, &|| ())?;
    let reach = if with_reach {
        Reach::of(
            &trained.world,
            &evaluation,
            EvaluationGoals::drawn(options.seed),
            threads,
            &Parts::silent(),
        )?
    } else {
        None
    };
    let summary = Summary::new(&trained.identity(), options.seed, None, evaluation, reach);
    Ok(Scored::of(&summary, digest))
}

impl Scored {
    fn of(summary: &Summary, digest: Digest) -> Self {
        let [position, orientation, base] = tails(&summary.overall);
        let errors = MeanErrors { position, orientation, base };
        let reaches = summary.task.reaches();
        let (position_m, angle_rad) =
            if reaches { (Some(position), orientation) } else { (None, base) };
        let reachable = summary.reachable.as_ref().map(|reachable| {
            let [position_m, orientation_rad, _] = tails(&reachable.subset.overall);
            let goals = reachable.subset.goals;
            let hands = summary.episodes.iter().flat_map(|episode| &episode.hands);
            let reached = reachable.controller.iter().flatten().map(|hand| hand.reached);
            let missed = hands.zip(reached).filter(|(hand, reached)| {
                let (position, orientation) = MISSED;
                *reached
                    && !(f64::from(hand.position.last) <= position
                        && f64::from(hand.orientation.last) <= orientation)
            });
            let missed = missed.count() as f64 / goals as f64;
            OfReachable { goals, position_m, orientation_rad, missed }
        });
        Self {
            iteration: summary.iteration,
            digest,
            score: errors.score(summary.task),
            episodes: summary.episodes.len(),
            position_m,
            angle_rad,
            contact_rate: summary.contact_rate,
            reachable,
        }
    }
}

/// Mean errors of position, orientation and base over the last steps; NaN of what the task is not about.
fn tails(errors: &[ErrorSummary]) -> [f64; 3] {
    [ErrorOf::Position, ErrorOf::Orientation, ErrorOf::Base].map(|of| {
        let found = errors.iter().find(|summary| summary.error == of);
        found.map_or(f64::NAN, |summary| summary.tail.mean)
    })
}
