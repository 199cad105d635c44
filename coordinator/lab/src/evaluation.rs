//! How well a policy does on goals it never saw.

use std::path::PathBuf;

use proto::config::TaskName;
use run::report::progress::Parts;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{
    self, ContactSteps, Course, EpisodeResult, Evaluation, EvaluationOptions,
};
use simulator::experiment::CHUNK;
use simulator::reach::{self, HandReach};
use simulator::rollout::World;
use store::checkpoint::Checkpoint;

use crate::statistics::{ErrorOf, Spread, Unit, milli, number, papers, percent};
use crate::threads::Threads;
use crate::trained::Trained;
use crate::verdict::Verdict;

/// One kind of error, of one agent or of all together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// What it is of.
    pub error: ErrorOf,
    /// What it is measured in.
    pub unit: Unit,
    /// The agent that answers for it, if it is one alone.
    pub agent: Option<usize>,
    /// Smallest of each episode: flatters, but is what the released script reports.
    pub min: Spread,
    /// After the last step.
    #[serde(rename = "final")]
    pub last: Spread,
    /// Mean over the last 20 steps of each episode.
    pub tail: Spread,
}

/// Share of goals reached, judged after the last step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Success {
    /// Largest position error that counts (m); none in `reorientation`.
    pub position: Option<f64>,
    /// Largest orientation or attitude error that counts (rad).
    pub orientation: f64,
    /// Share of goals: of hands in `trajectory`, of the base in `reorientation`.
    #[serde(deserialize_with = "number")]
    pub goals: f64,
    /// Share of episodes that reached all their goals, of those that have any.
    #[serde(deserialize_with = "number")]
    pub episodes: f64,
}

/// Shares of control steps at whose end bodies touched, by what touched what.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContactRates {
    /// An arm and a box of the base.
    pub arm_base: f64,
    /// An arm and a mount or pedestal.
    pub arm_mount: f64,
    /// An arm and itself.
    pub arm_itself: f64,
    /// Two arms.
    pub arm_arm: f64,
}

/// What remains without the goals that cannot be reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reachable {
    /// Of the hand goals that a controller which knows the robot reaches; there may be more.
    #[serde(flatten)]
    pub subset: GoalSubset,
    /// How the controller did, `[episode][arm]`.
    pub controller: Vec<Vec<HandReach>>,
}

/// What remains without the goals that no joint angles reached with the base where the episode ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithinReach {
    /// Of the hand goals for which inverse kinematics has a solution there; fewer can be held, as arms touch.
    #[serde(flatten)]
    pub subset: GoalSubset,
    /// Which they are, `[episode][arm]`.
    pub hands: Vec<Vec<bool>>,
}

/// What an evaluation found of some of the hand goals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GoalSubset {
    /// So many goals.
    pub goals: usize,
    /// Of so many.
    pub of: usize,
    /// Errors of the hands with these goals.
    pub overall: Vec<ErrorSummary>,
    /// Shares of these goals.
    pub success: Vec<Success>,
}

/// What an evaluation found; the form of `eval --json` and `evaluation.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// What was evaluated.
    pub checkpoint: PathBuf,
    /// Iterations it was trained on.
    pub iteration: u64,
    /// Env-steps it was trained on.
    pub env_steps: u64,
    /// Its task.
    pub task: TaskName,
    /// Seed of the goals.
    pub seed: u64,
    /// Control steps of an episode.
    pub steps: usize,
    /// All agents together.
    pub overall: Vec<ErrorSummary>,
    /// Every agent alone; empty in `reorientation`, where all answer for the base.
    pub agents: Vec<ErrorSummary>,
    /// By threshold: the released code's and the paper's.
    pub success: Vec<Success>,
    /// The same for goals that can be reached; in `trajectory`, if it was asked for.
    pub reachable: Option<Reachable>,
    /// The same for goals that were within reach at the end; likewise.
    pub within_reach_at_end: Option<WithinReach>,
    /// Share of control steps at whose end any two bodies touched.
    pub contact_rate: f64,
    /// The same by what touched what.
    pub contact_rate_by_kind: ContactRates,
    /// Episodes with any contact.
    pub episodes_with_contact: usize,
    /// Every episode.
    pub episodes: Vec<EpisodeResult>,
}

/// Evaluates a checkpoint, and shows how far it has come.
pub fn evaluate(checkpoint: Checkpoint, options: &EvaluationOptions) -> anyhow::Result<Summary> {
    let trained = Trained::new(checkpoint, None)?;
    let threads = Threads::available();
    let progress = Parts::new();
    let chunks = options.episodes.div_ceil(CHUNK);
    progress.begin("evaluation", (chunks * options.steps) as u64);
    let on_step = || progress.advance();
    let evaluation =
        evaluate::evaluate(&trained.world, &trained.policy, options, &threads, &on_step)?;
    let reach = Reach::of(&trained.world, &evaluation, options, threads, &progress)?;
    Ok(Summary::new(&trained, options.seed, evaluation, reach))
}

/// Which hand goals of an evaluation could be reached, `[episode][arm]`.
#[derive(Debug, Clone)]
pub struct Reach {
    /// How a controller that knows the robot does.
    controller: Vec<Vec<HandReach>>,
    /// Whether a goal was within reach with the base where the episode ended.
    at_end: Vec<Vec<bool>>,
}

impl Reach {
    /// Of the goals of `options`, in whose episodes `evaluation` ended; none in `reorientation`.
    pub fn of(
        world: &World,
        evaluation: &Evaluation,
        options: &EvaluationOptions,
        threads: Threads,
        progress: &Parts,
    ) -> anyhow::Result<Option<Self>> {
        if world.task.name != TaskName::Trajectory {
            return Ok(None);
        }
        let EvaluationOptions { seed, episodes, .. } = *options;
        progress.begin("which goals can be reached", episodes as u64);
        let on_episodes = |n| (0..n).for_each(|_| progress.advance());
        let controller = reach::reach(world, seed, episodes, &threads, &on_episodes)?;
        let ends: Vec<_> = evaluation.episodes.iter().map(|episode| &episode.end).collect();
        let at_end = reach::within_reach(world, seed, &ends, &threads);
        Ok(Some(Self { controller, at_end }))
    }
}

impl Summary {
    /// What `evaluation` of a policy on the goals of `seed` says; `reach` as from [`Reach::of`].
    pub fn new(trained: &Trained, seed: u64, evaluation: Evaluation, reach: Option<Reach>) -> Self {
        let task = trained.task();
        let Evaluation { steps, episodes } = evaluation;
        let share = |contact_steps: fn(&EpisodeResult) -> u32| {
            let sum: f64 = episodes.iter().map(|episode| f64::from(contact_steps(episode))).sum();
            sum / (episodes.len() * steps).max(1) as f64
        };
        let of_kind = |kind: fn(&ContactSteps) -> u32| {
            let each =
                episodes.iter().map(|episode| f64::from(kind(&episode.contact_steps_by_kind)));
            each.sum::<f64>() / (episodes.len() * steps).max(1) as f64
        };
        let (reachable, within_reach_at_end) = reach
            .map(|Reach { controller, at_end }| {
                let reached: Vec<Vec<bool>> = controller
                    .iter()
                    .map(|hands| hands.iter().map(|hand| hand.reached).collect())
                    .collect();
                let reachable =
                    Reachable { subset: GoalSubset::of(&episodes, &reached), controller };
                let within_reach =
                    WithinReach { subset: GoalSubset::of(&episodes, &at_end), hands: at_end };
                (reachable, within_reach)
            })
            .unzip();
        Self {
            checkpoint: trained.checkpoint.dir.clone(),
            iteration: trained.checkpoint.manifest.iteration,
            env_steps: trained.checkpoint.manifest.env_steps,
            task,
            seed,
            steps,
            overall: overall(task, &episodes),
            agents: agents(task, &episodes),
            success: success(task, &episodes),
            reachable,
            within_reach_at_end,
            contact_rate: share(|episode| episode.contact_steps),
            contact_rate_by_kind: ContactRates {
                arm_base: of_kind(|kinds| kinds.arm_base),
                arm_mount: of_kind(|kinds| kinds.arm_mount),
                arm_itself: of_kind(|kinds| kinds.arm_itself),
                arm_arm: of_kind(|kinds| kinds.arm_arm),
            },
            episodes_with_contact: episodes
                .iter()
                .filter(|episode| episode.contact_steps > 0)
                .count(),
            episodes,
        }
    }
}

fn summarise(error: ErrorOf, agent: Option<usize>, courses: &[Course]) -> ErrorSummary {
    let spread = |read: fn(&Course) -> f32| {
        Spread::of(courses.iter().map(|course| f64::from(read(course))).collect())
    };
    ErrorSummary {
        error,
        unit: error.unit(),
        agent,
        min: spread(|course| course.min),
        last: spread(|course| course.last),
        tail: spread(|course| course.tail),
    }
}

impl GoalSubset {
    /// Of the hands that `chosen` names, `[episode][arm]`.
    fn of(episodes: &[EpisodeResult], chosen: &[Vec<bool>]) -> Self {
        let of_episode = |(episode, chosen): (&EpisodeResult, &Vec<bool>)| {
            let hands = episode.hands.iter().zip(chosen).filter(|(_, chosen)| **chosen);
            EpisodeResult { hands: hands.map(|(hand, _)| *hand).collect(), ..episode.clone() }
        };
        let of = chosen.iter().map(Vec::len).sum();
        let episodes: Vec<_> = episodes.iter().zip(chosen).map(of_episode).collect();
        Self {
            goals: episodes.iter().map(|episode| episode.hands.len()).sum(),
            of,
            overall: overall(TaskName::Trajectory, &episodes),
            success: success(TaskName::Trajectory, &episodes),
        }
    }
}

fn overall(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    let hands = || episodes.iter().flat_map(|episode| &episode.hands);
    match task {
        TaskName::Trajectory => vec![
            summarise(
                ErrorOf::Position,
                None,
                &hands().map(|hand| hand.position).collect::<Vec<_>>(),
            ),
            summarise(
                ErrorOf::Orientation,
                None,
                &hands().map(|hand| hand.orientation).collect::<Vec<_>>(),
            ),
        ],
        TaskName::Reorientation => {
            let courses: Vec<_> = episodes.iter().map(|episode| episode.base).collect();
            vec![summarise(ErrorOf::Base, None, &courses)]
        }
    }
}

/// Agent 2i moves the shoulder of arm i and answers for the hand's position, agent 2i + 1 moves
/// the wrist and answers for its orientation.
fn agents(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    if task == TaskName::Reorientation {
        return Vec::new();
    }
    let n_arms = episodes.first().map_or(0, |episode| episode.hands.len());
    (0..n_arms)
        .flat_map(|arm| {
            let hands = || episodes.iter().filter_map(move |episode| episode.hands.get(arm));
            let position: Vec<_> = hands().map(|hand| hand.position).collect();
            let orientation: Vec<_> = hands().map(|hand| hand.orientation).collect();
            [
                summarise(ErrorOf::Position, Some(2 * arm), &position),
                summarise(ErrorOf::Orientation, Some(2 * arm + 1), &orientation),
            ]
        })
        .collect()
}

/// By the released code's thresholds, and by the paper's. Where there are no goals the shares are NaN.
fn success(task: TaskName, episodes: &[EpisodeResult]) -> Vec<Success> {
    let judge = |(position, orientation): (f64, f64)| {
        let reached: Vec<Vec<bool>> = episodes
            .iter()
            .map(|episode| match task {
                TaskName::Trajectory => {
                    let hand = |hand: &evaluate::HandCourse| {
                        f64::from(hand.position.last) < position
                            && f64::from(hand.orientation.last) < orientation
                    };
                    episode.hands.iter().map(hand).collect()
                }
                TaskName::Reorientation => vec![f64::from(episode.base.last) < orientation],
            })
            // An episode without goals has neither reached nor missed them all.
            .filter(|reached: &Vec<bool>| !reached.is_empty())
            .collect();
        let goals = reached.iter().map(Vec::len).sum::<usize>() as f64;
        let hits = reached.iter().flatten().filter(|hit| **hit).count() as f64;
        let whole = reached.iter().filter(|goals| goals.iter().all(|hit| *hit)).count() as f64;
        Success {
            position: (task == TaskName::Trajectory).then_some(position),
            orientation,
            goals: hits / goals,
            episodes: whole / reached.len() as f64,
        }
    };
    [RELEASED, papers(task)].map(judge).to_vec()
}

/// Largest errors that count in the released code: of positions (m) and attitudes (rad).
const RELEASED: (f64, f64) = (0.05, 0.05);

/// What stands before rows of a table that are about goals that can be reached.
const REACHABLE: &str = "reachable ";
/// Likewise, about those that were within reach at the end.
const AT_END: &str = "in reach ";

impl Summary {
    /// The summary as a person reads it, in lines of `columns` characters: the verdict first, then the details; the
    /// errors of each agent if `agents` says so.
    pub fn table(&self, columns: usize, agents: bool) -> String {
        let verdict = Verdict::of(self.task, &self.overall);
        format!("{}\n\n{}", verdict.table(columns), self.details(columns, agents))
    }

    fn details(&self, columns: usize, agents: bool) -> String {
        let row = |(whose, summary): (&str, &ErrorSummary)| {
            let ErrorSummary { error, agent, min, last, tail, unit: _ } = summary;
            let name = match agent {
                Some(agent) => format!("agent {agent} {error}"),
                None => format!("{whose}{error}"),
            };
            [
                name,
                milli(min.mean),
                milli(last.mean),
                milli(tail.mean),
                milli(tail.std),
                milli(tail.p50),
                milli(tail.p90),
                milli(tail.p99),
            ]
        };
        let header = ["error (mm, mrad)", "min", "final", "tail", "std", "p50", "p90", "p99"];
        let all = self.overall.iter().map(|summary| ("", summary));
        let subsets = || {
            let reachable = self.reachable.iter().map(|reachable| (REACHABLE, &reachable.subset));
            let at_end = self.within_reach_at_end.iter().map(|within| (AT_END, &within.subset));
            reachable.chain(at_end)
        };
        let of_subsets = subsets()
            .flat_map(|(whose, subset)| subset.overall.iter().map(move |summary| (whose, summary)));
        let agents = self.agents.iter().filter(|_| agents).map(|summary| ("", summary));
        let rows = all.chain(of_subsets).chain(agents).map(row);
        let errors = output::table_within(columns, header, rows);
        let all = self.success.iter().map(|success| ("", success));
        let of_subsets = subsets()
            .flat_map(|(whose, subset)| subset.success.iter().map(move |success| (whose, success)));
        let success = output::table_within(
            columns,
            ["success within", "goals", "episodes"],
            all.chain(of_subsets).map(|(whose, success)| {
                let orientation = format!("{} mrad", 1e3 * success.orientation);
                let name = match success.position {
                    Some(position) => format!("{whose}{} mm and {orientation}", 1e3 * position),
                    None => orientation,
                };
                [name, percent(success.goals), percent(success.episodes)]
            }),
        );
        let episodes = output::counted(self.episodes.len() as u64, "episode");
        let reachable = self.reachable.as_ref().map_or_else(String::new, |reachable| {
            let GoalSubset { goals, of, .. } = reachable.subset;
            format!("a controller that knows the robot reaches {goals} of the {of} hand goals\n")
        });
        let at_end = self.within_reach_at_end.as_ref().map_or_else(String::new, |within| {
            let GoalSubset { goals, .. } = within.subset;
            format!("with the base where episodes ended, {goals} were within an arm's reach\n")
        });
        format!(
            "{} of {}, seed {}; std and percentiles are those of tail\n{errors}\n\n\
             {success}\n\n{reachable}{at_end}contact in {} of steps, in {} of {}: of an arm with\n\
             the base {}, a mount {}, itself {}, another arm {}",
            episodes,
            output::counted(self.steps as u64, "step"),
            self.seed,
            percent(self.contact_rate),
            self.episodes_with_contact,
            episodes,
            percent(self.contact_rate_by_kind.arm_base),
            percent(self.contact_rate_by_kind.arm_mount),
            percent(self.contact_rate_by_kind.arm_itself),
            percent(self.contact_rate_by_kind.arm_arm),
        )
    }
}

#[cfg(test)]
mod tests {
    use simulator::evaluate::HandCourse;
    use simulator::experiment::Pose;

    use super::*;

    #[test]
    fn the_table_begins_with_the_verdict_and_fits() {
        let spread = Spread { mean: 9.9999, std: 9.9999, p50: 9.9999, p90: 9.9999, p99: 9.9999 };
        let error = |error: ErrorOf, agent| ErrorSummary {
            error,
            unit: error.unit(),
            agent,
            min: spread,
            last: spread,
            tail: spread,
        };
        let overall = || vec![error(ErrorOf::Position, None), error(ErrorOf::Orientation, None)];
        let all = Success { position: Some(0.05), orientation: 0.05, goals: 1.0, episodes: 1.0 };
        let subset =
            || GoalSubset { goals: 4000, of: 4000, overall: overall(), success: vec![all; 2] };
        let summary = Summary {
            checkpoint: "runs/a".into(),
            iteration: 1,
            env_steps: 1,
            task: TaskName::Trajectory,
            seed: 12_345,
            steps: 100_000,
            overall: overall(),
            agents: (0..8).map(|agent| error(ErrorOf::Orientation, Some(agent))).collect(),
            success: vec![all; 2],
            reachable: Some(Reachable { subset: subset(), controller: Vec::new() }),
            within_reach_at_end: Some(WithinReach { subset: subset(), hands: Vec::new() }),
            contact_rate: 1.0,
            contact_rate_by_kind: ContactRates {
                arm_base: 1.0,
                arm_mount: 1.0,
                arm_itself: 1.0,
                arm_arm: 1.0,
            },
            episodes_with_contact: 1_000,
            episodes: Vec::new(),
        };
        let text = summary.table(80, true);
        assert!(text.starts_with("not within the paper's accuracy"), "{text}");
        assert!(text.contains("agent 7 orientation"), "{text}");
        assert!(!summary.table(80, false).contains("agent"), "{text}");
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}\nis too long in\n{text}");
        }
    }

    #[test]
    fn a_goal_counts_when_both_errors_are_small_at_the_end() {
        let course = |last: f32| Course { min: 0.0, last, tail: last };
        let hand = |position, orientation| HandCourse {
            position: course(position),
            orientation: course(orientation),
        };
        let episode = |hands| EpisodeResult {
            hands,
            base: course(0.035),
            contact_steps: 0,
            contact_pairs: 0,
            contact_steps_by_kind: ContactSteps::default(),
            end: Pose {
                base_position: [0.0; 3],
                base_quaternion: [1.0, 0.0, 0.0, 0.0],
                joints: vec![],
            },
        };
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
