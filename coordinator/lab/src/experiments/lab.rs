//! What experiments share: policies, robot, episodes, progress.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context as _;
use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use run::report::progress::Parts;
use run::shakedown::shakedown;
use simulator::env::step_options;
use simulator::evaluate::Evaluation;
use simulator::experiment::{CHUNK, EvaluationGoals, Player, Pose, Recording, Trial, play};
use simulator::reach::within_reach;
use simulator::robot::Robot;
use simulator::step::StepOptions;
use store::provenance::Provenance;
#[cfg(test)]
use {
    proto::layout::ActorLayout,
    simulator::rollout::World,
    store::checkpoint::{Checkpoint, Manifest},
};

use super::common::{Beside, Common};
use super::name::Name;
use super::report::{Goals, PlayedEpisode, Protocol, Report, RobotIdentity};
use crate::contender::Contender;
use crate::evaluation::{EPISODES_OR_STEPS, Reach, check_recorded};
use crate::goals::OwnGoals;
use crate::identity::Identity;
use crate::script::{self, TookPart};
use crate::threads::Threads;
use crate::trained::{Trained, open_checkpoint};

/// Which policies an experiment needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// One of the two, or both.
    Any,
    /// The one for the base.
    Reorientation,
    /// Both.
    Both,
}

/// What an experiment is made with.
#[derive(Debug)]
pub struct Lab {
    /// The policies, trajectory first; those that the experiment needs and that were given.
    policies: Vec<Contender>,
    /// Who is measured beside them, with what tables and figures call each.
    beside: Vec<(String, Contender)>,
    /// The robot of all of them.
    pub(crate) robot: Robot,
    /// E: episodes of a setting.
    pub(crate) episodes: usize,
    /// Control steps of an episode.
    pub(crate) steps: usize,
    /// Seed of goals and noise.
    pub(crate) seed: u64,
    /// Goals instead of held-out ones.
    own_goals: Option<OwnGoals>,
    /// The robot on which all are put, whichever they learned on.
    given_robot: Option<Robot>,
    threads: Threads,
    progress: Arc<Parts>,
    /// The first episodes of the trials that were played.
    played: Mutex<Vec<PlayedEpisode>>,
}

/// The option that names the policy of a task.
fn flag(task: TaskName) -> &'static str {
    if task.reaches() { "--trajectory" } else { "--reorientation" }
}

impl Lab {
    /// Opens what the command line of an experiment names that needs such policies, and by itself does so many
    /// episodes of a setting.
    pub(super) fn new(args: &Common, needs: Needs, episodes: u32) -> anyhow::Result<Self> {
        let usage = |message: String| ExitError::new(ExitCode::Usage, message);
        let tasks: &[TaskName] = match needs {
            Needs::Any | Needs::Both => &[TaskName::Trajectory, TaskName::Reorientation],
            Needs::Reorientation => &[TaskName::Reorientation],
        };
        if needs == Needs::Reorientation && args.trajectory.is_some() {
            let message = "--trajectory has no meaning here: this experiment turns the base";
            return Err(usage(message.to_owned()).into());
        }
        let load = |name| run::robots::load_fit_robot(name, &StepOptions::default());
        let robot = args.robot.as_deref().map(load).transpose()?;
        let mut policies: Vec<Contender> = Vec::new();
        if let Some(name) = args.controller {
            let paper = || Robot::builtin("paper").expect("built in");
            let robot = robot.clone().unwrap_or_else(paper);
            let all = needs != Needs::Any;
            for &task in tasks.iter().filter(|task| all || name.controls(**task)) {
                policies.push(Contender::controller(name, task, &robot)?);
            }
        }
        for &task in tasks {
            let Some(path) = place(args, task, needs) else { continue };
            check_holds(args, task, &path)?;
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
            policies.push(trained.into());
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
        let robot_given = robot;
        let robot = policies[0].world.robot.clone();
        for pair in policies.windows(2) {
            together(&pair[0], &pair[1])?;
        }
        let read = |path: &PathBuf| OwnGoals::read(path, robot.n_arms);
        let own_goals = args.goals.as_ref().map(read).transpose()?;
        let episodes = match &own_goals {
            Some(own) => {
                own.check(policies.iter().map(Contender::task))?;
                own.episodes(args.episodes)?
            }
            None => args.episodes.unwrap_or(episodes),
        };
        // Of trials one is recorded at a time.
        check_recorded(episodes as usize, args.steps as usize, EPISODES_OR_STEPS)?;
        Ok(Self {
            policies,
            beside: Vec::new(),
            robot,
            episodes: episodes as usize,
            steps: args.steps as usize,
            seed: args.seed,
            own_goals,
            given_robot: robot_given,
            threads: Threads::available(),
            progress: Arc::default(),
            played: Mutex::default(),
        })
    }

    /// A lab on the paper's robot, with policies whose actions are zero.
    #[cfg(test)]
    pub(super) fn resting(args: &Common, needs: Needs, episodes: u32) -> Self {
        use proto::config::{Layers, Preset};

        let robot = Robot::builtin("paper").expect("built in");
        let policy = |task: TaskName| {
            let layers = Layers::new(Preset::Tuned, Some(task)).set("network.hidden=[4]");
            let config = layers.and_then(|layers| layers.resolve()).expect("valid");
            let world = World::new(&config, &robot);
            let len = ActorLayout::new(&world.config, &world.dimensions).len;
            let policy = world.policy(&vec![0.0; len]).expect("a policy");
            let manifest = Manifest {
                format: 1,
                iteration: 7,
                env_steps: 700,
                digest: proto::Digest::default(),
                created_unix_s: 0,
                provenance: serde_json::Value::Null,
                files: std::collections::BTreeMap::new(),
                origins: Vec::new(),
            };
            let dir = task.as_str().into();
            let robot_toml = robot.to_toml();
            Trained { checkpoint: Checkpoint { dir, manifest, config, robot_toml }, world, policy }
                .into()
        };
        let tasks = match needs {
            Needs::Any | Needs::Both => vec![TaskName::Trajectory, TaskName::Reorientation],
            Needs::Reorientation => vec![TaskName::Reorientation],
        };
        let policies = tasks.into_iter().map(policy).collect();
        Self {
            policies,
            beside: Vec::new(),
            robot,
            episodes: args.episodes.unwrap_or(episodes) as usize,
            steps: args.steps as usize,
            seed: args.seed,
            own_goals: None,
            given_robot: None,
            threads: Threads::new(1),
            progress: Arc::default(),
            played: Mutex::default(),
        }
    }

    /// The policies, trajectory first.
    pub fn policies(&self) -> &[Contender] {
        &self.policies
    }

    /// Who is measured beside them, with what tables and figures call each.
    pub(crate) fn beside(&self) -> &[(String, Contender)] {
        &self.beside
    }

    /// Has others measured beside the policies: a controller for every task of theirs that it controls, a policy for its own.
    ///
    /// # Errors
    /// If one cannot be opened, learned a task that no policy here has, or moves another robot.
    pub(super) fn measure_beside(mut self, others: &[Beside]) -> anyhow::Result<Self> {
        for other in others {
            match other {
                Beside::Controller(name) => {
                    let tasks = self.policies.iter();
                    for policy in tasks.filter(|policy| name.controls(policy.task())) {
                        let one = Contender::controller(*name, policy.task(), &self.robot)?;
                        self.beside.push((name.as_str().to_owned(), one));
                    }
                }
                Beside::Policy(path) => {
                    let one = self.open(path)?;
                    let Some(policy) = self.policies.iter().find(|p| p.task() == one.task()) else {
                        let message = format!(
                            "{}: learned `{}`, and no policy of that task is measured here",
                            one.shown(),
                            one.task().as_str()
                        );
                        return Err(ExitError::new(ExitCode::BadInput, message).into());
                    };
                    together(policy, &one)?;
                    let names = self.beside.iter().filter(|(_, other)| other.task() == one.task());
                    let name =
                        distinct(path, &names.map(|(name, _)| name.as_str()).collect::<Vec<_>>());
                    self.beside.push((name, one));
                }
            }
        }
        Ok(self)
    }

    /// Has a policy that learned to reach and to turn at the same time measured beside the pair.
    ///
    /// # Errors
    /// If it cannot be opened, learned one of both, or moves another robot.
    pub(super) fn measure_mixed(mut self, path: &Path) -> anyhow::Result<Self> {
        let one = self.open(path)?;
        let task = one.task();
        if task.moves() || !(task.reaches() && task.turns()) {
            let message = format!(
                "{}: learned `{}`; a policy is wanted some of whose arms reach while others turn the base, as of task `mixed`",
                one.shown(),
                task.as_str()
            );
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
        together(&self.policies[0], &one)?;
        self.beside.push((task.as_str().to_owned(), one));
        Ok(self)
    }

    /// A policy on the robot that is given, or on its own.
    fn open(&self, path: &Path) -> anyhow::Result<Contender> {
        Ok(Trained::new(open_checkpoint(path)?, self.given_robot.as_ref())?.into())
    }

    /// The policy of a task that the experiment needs.
    pub(crate) fn policy(&self, task: TaskName) -> &Contender {
        let found = self.policies.iter().find(|policy| policy.task() == task);
        found.expect("the experiment was refused without it")
    }

    /// Refuses an arm (counted from 1) that the robot does not have.
    pub(crate) fn check_arm(&self, arm: usize) -> Result<(), ExitError> {
        if (1..=self.robot.n_arms).contains(&arm) {
            return Ok(());
        }
        let message = format!(
            "there is no arm {arm}: the robot `{}` has {}",
            self.robot.name, self.robot.n_arms
        );
        Err(ExitError::new(ExitCode::BadInput, message))
    }

    /// Goals that are given instead of drawn.
    pub fn own_goals(&self) -> Option<&OwnGoals> {
        self.own_goals.as_ref()
    }

    /// Whose goals trials have, unless they say otherwise.
    pub(super) fn whose_goals(&self) -> Goals {
        if self.own_goals.is_some() { Goals::Given } else { Goals::HeldOut }
    }

    fn goals(&self) -> EvaluationGoals<'_> {
        let given = self.own_goals.as_ref().map_or(&[][..], |own| &own.given);
        EvaluationGoals { seed: self.seed, given }
    }

    /// A trial of one policy on held-out goals, or a person's own, in which nothing happens.
    pub(crate) fn trial<'a>(&'a self, policy: &'a Contender) -> Trial<'a> {
        let given = self.goals().given;
        Trial { given, ..Trial::new(policy.player(), self.seed, self.episodes, self.steps) }
    }

    /// Plays a trial of the policies and shows how far it has come. Its first episode can be watched afterwards.
    pub(crate) fn play(&self, what: &str, trial: &Trial<'_>) -> anyhow::Result<Recording> {
        let learned = self.policies.iter().all(|policy| policy.checkpoint().is_some());
        if let Some(script) = trial.script(0).filter(|_| learned) {
            let took_part = |player: &Player<'_>| {
                let name = player.world.task.name.as_str().to_owned();
                let policy =
                    self.policies.iter().find(|policy| policy.task() == player.world.task.name);
                let digest = policy.map(|policy| policy.identity().digest.to_string());
                TookPart { name, digest: digest.unwrap_or_default() }
            };
            let policies = trial.players.iter().map(took_part).collect();
            let recording = script::Recording { policies, script };
            let mut played = self.played.lock().unwrap_or_else(PoisonError::into_inner);
            played.push(PlayedEpisode { what: what.to_owned(), recording });
        }
        self.play_beside(what, trial)
    }

    /// Plays a trial of anybody and shows how far it has come.
    pub(crate) fn play_beside(&self, what: &str, trial: &Trial<'_>) -> anyhow::Result<Recording> {
        let chunks = trial.episodes.div_ceil(CHUNK);
        self.progress.begin(what, (chunks * trial.steps) as u64);
        play(trial, &self.threads, &|| self.progress.advance()).with_context(|| what.to_owned())
    }

    /// Which of the trial's hand goals could be reached; none in `reorientation`.
    pub(crate) fn reach(
        &self,
        policy: &Contender,
        evaluation: &Evaluation,
    ) -> anyhow::Result<Option<Reach>> {
        Reach::of(&policy.world, evaluation, self.goals(), self.threads, &self.progress)
    }

    /// Whether inverse kinematics has a solution for the goals of a trial's hands with the base where each episode ended: `[episode][arm]`.
    pub(crate) fn within_reach(&self, policy: &Contender, recording: &Recording) -> Vec<Vec<bool>> {
        let last = recording.steps() - 1;
        let ends: Vec<Pose> =
            (0..recording.episodes()).map(|episode| recording.pose(episode, last)).collect();
        let ends: Vec<&Pose> = ends.iter().collect();
        within_reach(&policy.world, self.goals(), &ends, &self.threads)
    }

    /// Refuses a robot that an option has made of the policies'.
    pub(crate) fn check_fit(&self, robot: &Robot, option: &str) -> anyhow::Result<()> {
        let name = format!("{} with {option}", self.robot.name);
        let options = step_options(&self.policies[0].world.config);
        Ok(shakedown(robot, &name, &options)?)
    }

    /// Shows progress there, together with others.
    pub(crate) fn share_progress(&mut self, progress: &Arc<Parts>) {
        self.progress = Arc::clone(progress);
    }

    /// Steps of progress of `trials` trials of all episodes and `shown` of one alone.
    pub(crate) fn work(&self, trials: usize, shown: usize) -> u64 {
        ((trials * self.episodes.div_ceil(CHUNK) + shown) * self.steps) as u64
    }

    /// Nothing more is played: the terminal is free.
    pub fn end(&self) {
        self.progress.end();
    }

    /// The protocol of an experiment with these settings.
    pub(crate) fn protocol<S>(&self, settings: S) -> Protocol<S> {
        Protocol {
            episodes: self.episodes,
            steps: self.steps,
            seed: self.seed,
            goals: self.own_goals.as_ref().map(|own| own.file.clone()),
            control_period_s: self.policies[0].world.config.env.control_period,
            actions: "deterministic".into(),
            settings,
        }
    }

    /// Which policies there are, trajectory first, then those beside them.
    pub(crate) fn identities(&self) -> Vec<Identity> {
        let beside = self.beside.iter().map(|(_, policy)| policy);
        self.policies.iter().chain(beside).map(|policy| policy.identity().clone()).collect()
    }

    /// Results with everything that they were made with.
    pub(crate) fn report<S, R>(
        &self,
        experiment: Name,
        settings: S,
        results: Vec<R>,
    ) -> Report<S, R> {
        Report {
            experiment,
            protocol: self.protocol(settings),
            robot: RobotIdentity::of(&self.robot),
            policies: self.identities(),
            provenance: Provenance::gather(),
            results,
            episodes: std::mem::take(
                &mut *self.played.lock().unwrap_or_else(PoisonError::into_inner),
            ),
        }
    }
}

/// Where the policy of a task is: its own option first, then its place in the directory of all.
fn place(args: &Common, task: TaskName, needs: Needs) -> Option<PathBuf> {
    let own = if task.reaches() { &args.trajectory } else { &args.reorientation };
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

/// Refuses a directory of all policies in which that of a task is missing.
fn check_holds(args: &Common, task: TaskName, path: &Path) -> Result<(), ExitError> {
    let own = if task.reaches() { &args.trajectory } else { &args.reorientation };
    let Some(dir) = args.policies.as_deref().filter(|_| own.is_none() && !path.exists()) else {
        return Ok(());
    };
    let (shown, name) = (dir.display(), task.as_str());
    let message = if dir.is_dir() {
        format!(
            "--policies {shown}: holds no `{name}`; wanted is a directory with `trajectory` and `reorientation`, each \
             a run directory, a directory of checkpoints or a checkpoint; {} of `octopus experiment` names a policy from elsewhere",
            flag(task)
        )
    } else {
        format!(
            "--policies {shown}: is no directory; wanted is one with `trajectory` and `reorientation`"
        )
    };
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// What a policy is called beside others: its folder, and where that is `taken` its whole path, with a number if need be.
fn distinct(path: &Path, taken: &[&str]) -> String {
    let folder = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let whole = path.to_string_lossy();
    let numbered = (2..).map(|number| format!("{whole} ({number})"));
    let mut names = [folder.into_owned(), whole.clone().into_owned()].into_iter().chain(numbered);
    names.find(|name| !taken.contains(&name.as_str())).expect("numbers do not end")
}

/// Refuses two policies that cannot move one robot at the same time.
fn together(one: &Contender, other: &Contender) -> Result<(), ExitError> {
    let refuse = |what: String| {
        let (a, b) = (one.shown(), other.shown());
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::ControllerName;

    /// It ended without a word of what was wrong where memory was used up.
    #[test]
    fn more_than_can_be_recorded_is_refused() {
        let opened = |episodes| {
            let controller = Some(ControllerName::Jacobian);
            let common = Common { controller, episodes, steps: 100_000, ..Common::default() };
            Lab::new(&common, Needs::Any, 30)
        };
        opened(Some(500)).expect("as many as an evaluation may have");
        let error = opened(Some(501)).expect_err("too many").to_string();
        assert!(error.contains("501 episodes of 100,000 control steps"), "{error}");
        assert!(error.contains("--episodes or --steps"), "{error}");
    }

    #[test]
    fn policies_beside_others_have_names_of_their_own() {
        let mut names = Vec::new();
        for path in ["a/robust", "robust", "b/robust", "robust", "a/robust", "c"] {
            let taken: Vec<&str> = names.iter().map(String::as_str).collect();
            let name = distinct(Path::new(path), &taken);
            names.push(name);
        }
        let wanted = ["robust", "robust (2)", "b/robust", "robust (3)", "a/robust", "c"];
        assert_eq!(names, wanted);
    }
}
