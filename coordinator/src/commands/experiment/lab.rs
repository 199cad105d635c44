//! What experiments share: policies, robot, episodes, progress.

use std::path::PathBuf;

use anyhow::Context as _;
use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use sim_worker::evaluate::EvaluationOptions;
use sim_worker::experiment::{CHUNK, Recording, Trial, play};
use sim_worker::reach::HandReach;
use sim_worker::robot::Robot;

use super::report::{Protocol, Report, RobotIdentity};
use crate::cli::experiment::CommonArgs;
use crate::commands::eval::controller;
use crate::commands::trained::{Trained, open_checkpoint};
use crate::output;
use crate::report::progress::Parts;

/// Episodes, if none are asked for.
const EPISODES: u32 = 30;

/// Which policies an experiment needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Needs {
    /// One of the two, or both.
    Any,
    /// The one for the base.
    Reorientation,
    /// Both.
    Both,
}

/// What an experiment is made with.
#[derive(Debug)]
pub(super) struct Lab {
    /// The policies, trajectory first; those that the experiment needs and that were given.
    policies: Vec<Trained>,
    /// The robot of all of them.
    pub(super) robot: Robot,
    /// E: episodes of a setting.
    pub(super) episodes: usize,
    /// Control steps of an episode.
    pub(super) steps: usize,
    /// Seed of goals and noise.
    pub(super) seed: u64,
    threads: usize,
    progress: Parts,
    json: bool,
}

/// The option that names the policy of a task.
fn flag(task: TaskName) -> &'static str {
    match task {
        TaskName::Trajectory => "--trajectory",
        TaskName::Reorientation => "--reorientation",
    }
}

impl Lab {
    /// Opens what was named on the command line; without `--episodes` there are `episodes`.
    pub(super) fn new(
        args: &CommonArgs,
        needs: Needs,
        episodes: Option<u32>,
    ) -> anyhow::Result<Self> {
        let usage = |message: String| ExitError::new(ExitCode::Usage, message);
        let tasks: &[TaskName] = match needs {
            Needs::Any | Needs::Both => &[TaskName::Trajectory, TaskName::Reorientation],
            Needs::Reorientation => &[TaskName::Reorientation],
        };
        if needs == Needs::Reorientation && args.trajectory.is_some() {
            let message = "--trajectory has no meaning here: this experiment turns the base";
            return Err(usage(message.to_owned()).into());
        }
        let robot = args.robot.as_deref().map(crate::commands::load_robot).transpose()?;
        let mut policies = Vec::new();
        for &task in tasks {
            let Some(path) = place(args, task, needs) else { continue };
            let checkpoint = open_checkpoint(&path)?;
            let trained = Trained::new(checkpoint, robot.as_ref())?;
            if trained.task() != task {
                let message = format!(
                    "{}: learned `{}`; a policy for `{}` is wanted, name it with {}",
                    trained.checkpoint.dir.display(),
                    trained.task().as_str(),
                    task.as_str(),
                    flag(task)
                );
                return Err(ExitError::new(ExitCode::BadInput, message).into());
            }
            policies.push(trained);
        }
        let wanted = match needs {
            Needs::Any => 1,
            Needs::Reorientation | Needs::Both => tasks.len(),
        };
        if policies.len() < wanted {
            let given = |task: &&TaskName| policies.iter().any(|policy| policy.task() == **task);
            let missing: Vec<&str> =
                tasks.iter().filter(|task| !given(task)).map(|task| flag(*task)).collect();
            let message = format!(
                "no policy: name one with {} CHECKPOINT, or all with --policies DIR, which holds \
                 `trajectory` and `reorientation`",
                missing.join(if needs == Needs::Any { " or " } else { " and " })
            );
            return Err(usage(message).into());
        }
        let robot = policies[0].world.robot.clone();
        for pair in policies.windows(2) {
            together(&pair[0], &pair[1])?;
        }
        Ok(Self {
            policies,
            robot,
            episodes: args.episodes.or(episodes).unwrap_or(EPISODES) as usize,
            steps: args.steps as usize,
            seed: args.seed,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            progress: Parts::new(),
            json: args.json,
        })
    }

    /// The policies, trajectory first.
    pub(super) fn policies(&self) -> &[Trained] {
        &self.policies
    }

    /// The policy of a task that the experiment needs.
    pub(super) fn policy(&self, task: TaskName) -> &Trained {
        let found = self.policies.iter().find(|policy| policy.task() == task);
        found.expect("the experiment was refused without it")
    }

    /// Refuses an arm (counted from 1) that the robot does not have.
    pub(super) fn check_arm(&self, arm: usize) -> Result<(), ExitError> {
        if (1..=self.robot.n_arms).contains(&arm) {
            return Ok(());
        }
        let message = format!(
            "there is no arm {arm}: the robot `{}` has {}",
            self.robot.name, self.robot.n_arms
        );
        Err(ExitError::new(ExitCode::BadInput, message))
    }

    /// A trial of one policy on held-out goals in which nothing happens.
    pub(super) fn trial<'a>(&self, policy: &'a Trained) -> Trial<'a> {
        Trial::new(policy.player(), self.seed, self.episodes, self.steps)
    }

    /// Plays a trial and shows how far it has come.
    pub(super) fn play(&self, what: &str, trial: &Trial<'_>) -> anyhow::Result<Recording> {
        let chunks = trial.episodes.div_ceil(CHUNK);
        self.progress.begin(what, (chunks * trial.steps) as u64);
        play(trial, self.threads, &|| self.progress.advance()).with_context(|| what.to_owned())
    }

    /// How a controller that knows the robot does on the trial's hand goals; none in `reorientation`.
    pub(super) fn controller(
        &self,
        policy: &Trained,
    ) -> anyhow::Result<Option<Vec<Vec<HandReach>>>> {
        let options = EvaluationOptions {
            seed: self.seed,
            episodes: self.episodes,
            steps: self.steps,
            threads: self.threads,
        };
        controller(&policy.world, &options, &self.progress)
    }

    /// Prints a result: `table` for people, `results` with everything else as JSON.
    pub(super) fn print(
        &self,
        experiment: &'static str,
        settings: impl Serialize,
        results: impl Serialize,
        table: &str,
    ) -> anyhow::Result<()> {
        self.progress.end();
        if !self.json {
            return output::line(table);
        }
        output::json(&Report {
            experiment,
            protocol: Protocol {
                episodes: self.episodes,
                steps: self.steps,
                seed: self.seed,
                control_period_s: self.policies[0].world.config.env.control_period,
                actions: "deterministic",
                settings,
            },
            robot: RobotIdentity::of(&self.robot),
            policies: self.policies.iter().map(Trained::identity).collect(),
            provenance: crate::provenance::Provenance::gather(),
            results,
        })
    }
}

/// Where the policy of a task is: its own option first, then its place in the directory of all.
fn place(args: &CommonArgs, task: TaskName, needs: Needs) -> Option<PathBuf> {
    let own = match task {
        TaskName::Trajectory => &args.trajectory,
        TaskName::Reorientation => &args.reorientation,
    };
    let of_all = || {
        let place = args.policies.as_ref()?.join(task.as_str());
        // Of two that may be missing, one that is not there is not asked for; if neither is, the first is missed.
        let other = args.policies.as_ref()?.join(TaskName::Reorientation.as_str());
        let left_out = needs == Needs::Any
            && !place.exists()
            && (task == TaskName::Reorientation || other.exists() || args.reorientation.is_some());
        (!left_out).then_some(place)
    };
    own.clone().or_else(of_all)
}

/// Refuses two policies that cannot move one robot at the same time.
fn together(one: &Trained, other: &Trained) -> Result<(), ExitError> {
    let refuse = |what: String| {
        let (a, b) = (one.checkpoint.dir.display(), other.checkpoint.dir.display());
        Err(ExitError::new(ExitCode::BadInput, format!("{a} and {b}: {what}")))
    };
    if one.world.robot != other.world.robot {
        return refuse(
            "they learned on different robots; --robot NAME|FILE puts both on one".to_owned(),
        );
    }
    let periods = [one, other].map(|policy| policy.world.config.env.control_period);
    if periods[0] != periods[1] {
        return refuse(format!(
            "their control periods are {} s and {} s; they must be equal",
            periods[0], periods[1]
        ));
    }
    Ok(())
}
