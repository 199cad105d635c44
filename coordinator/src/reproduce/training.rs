//! The trainings of `octopus reproduce --train`: runs that the policies and the curves come from.
//!
//! Each run is asked for as on the command line of `octopus train`, one after the other, since every run uses the whole machine. Called again, finished
//! runs are left as they are, and one that was stopped goes on.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum as _;
use lab::experiments::command_line::typed;
use lab::reproduce::{MARK, POLICIES, RUNS, check_episodes, check_robot, refused};
use proto::config::{AlgorithmName, TaskName};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::signals;
use simulator::robot::Robot;
use store::checkpoint::{
    BEST, Checkpoint, CheckpointStore, Composition, Manifest, Name, Part, Parts,
};
use store::provenance::Provenance;
use store::{files, outputs, regular_files};

use super::options::ReproduceArgs;
use crate::names::Named;
use crate::planned_run::{PlannedRun, options};
use crate::{resume, train};

/// Tasks that are trained.
const TASKS: [TaskName; 2] = [TaskName::Trajectory, TaskName::Reorientation];

/// What the mark of a directory says in which this command trains.
const MARKED: &str =
    "Runs and policies beside this file are those of `octopus reproduce --train`.\n";

/// Refuses a directory that has runs or policies which were not made here.
pub(super) fn check_place(out: &Path, force: bool) -> Result<(), ExitError> {
    let mark = regular_files::read_text(&out.join(MARK), regular_files::TEXT);
    let is_marked = mark.is_ok_and(|text| text == MARKED);
    let ours = |name: &str| is_marked || ![RUNS, POLICIES].contains(&name);
    outputs::check_directory("--out", out, ours, Some(force))
}

/// Trains what is missing below `out`, and takes the best policies of it. Returns where they lie, and all runs.
pub(super) fn train(args: &ReproduceArgs, out: &Path) -> anyhow::Result<(PathBuf, Vec<PathBuf>)> {
    let runs = planned(args, out);
    // What would be refused after hours of training.
    check_episodes(args.episodes, args.steps)?;
    for run in &runs {
        run.check(args)?;
    }
    let is_new = !out.exists();
    std::fs::create_dir_all(out).map_err(|error| {
        let message = format!("{}: cannot be created: {error}", out.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })?;
    files::replace(&out.join(MARK), MARKED.as_bytes())?;
    for (index, run) in runs.iter().enumerate() {
        if !run.planned(args).is_finished()? {
            output::note(&format!("run {} of {}: {}", index + 1, runs.len(), run.dir.display()));
            let ended = run.go_on(args, out);
            // What was refused before anything began leaves nothing.
            if is_new && ended.is_err() && !out.join(RUNS).exists() {
                std::fs::remove_file(out.join(MARK))?;
                std::fs::remove_dir(out)?;
            }
            ended?;
        }
    }
    // The trainings ended at Ctrl-C by themselves; what follows is whole or not there at any time.
    signals::exit_when_asked(format!("stopped; `{}` goes on", typed(&again(args, out))))
        .context("signals cannot be caught")?;
    let policies = out.join(POLICIES);
    for task in TASKS {
        take_best(task, &runs, &policies)?;
    }
    Ok((policies, runs.into_iter().map(|run| run.dir).collect()))
}

/// One training.
struct Run {
    task: TaskName,
    algorithm: Named<AlgorithmName>,
    seed: u64,
    dir: PathBuf,
}

/// All trainings; those of MAPPO first, whose policies are wanted.
fn planned(args: &ReproduceArgs, out: &Path) -> Vec<Run> {
    let mut algorithms = vec![Named(AlgorithmName::Mappo)];
    for baseline in &args.baselines {
        if !algorithms.contains(baseline) {
            algorithms.push(*baseline);
        }
    }
    let mut runs = Vec::new();
    for algorithm in algorithms {
        for task in TASKS {
            for seed in 1..=args.seeds {
                let name = format!("{}-{}-{seed}", name(algorithm), task.as_str());
                runs.push(Run { task, algorithm, seed, dir: out.join(RUNS).join(name) });
            }
        }
    }
    runs
}

/// The algorithm as it is written on the command line.
fn name(algorithm: Named<AlgorithmName>) -> String {
    algorithm.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

impl Run {
    /// The command that begins it.
    fn planned(&self, args: &ReproduceArgs) -> PlannedRun {
        let (algorithm, seed) = (name(self.algorithm), self.seed.to_string());
        let line = [self.task.as_str(), "--algorithm", &algorithm, "--seed", &seed];
        let rest = ["--no-eval", "--listen=off"];
        let sets = args.sets.iter().map(|set| format!("--set={set}"));
        let words = line.iter().chain(&rest).map(ToString::to_string).chain(sets).collect();
        PlannedRun { dir: self.dir.clone(), words }
    }

    /// Refuses another run of its name, and one that ends without a policy that is the best where one is wanted.
    fn check(&self, args: &ReproduceArgs) -> anyhow::Result<()> {
        let planned = self.planned(args);
        planned.check(&[])?;
        let config = planned.config()?;
        check_robot(&run::robots::load_robot_of(&config)?)?;
        let env_steps = config.planned_iterations() * config.steps_per_iteration();
        let run = &config.run;
        if self.is_wanted() && !run.may_be_best(env_steps) {
            let message = format!(
                "with run.evaluate_every = {} and run.best_after = {} no policy of {} is evaluated, so that none would be the best; \
                 evaluate every 10 iterations, say, and after fewer env-steps than the {env_steps} that it trains for",
                run.evaluate_every,
                run.best_after,
                self.task.as_str()
            );
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
        Ok(())
    }

    /// Whether its policy may be taken.
    fn is_wanted(&self) -> bool {
        self.algorithm == Named(AlgorithmName::Mappo)
    }

    /// Begins it or goes on with it, until it is finished.
    fn go_on(&self, args: &ReproduceArgs, out: &Path) -> anyhow::Result<()> {
        let dir = self.dir.display().to_string();
        let planned = self.planned(args);
        let ended = if planned.has_begun()? {
            let words = ["octopus resume", &dir, "--no-eval", "--listen=off"];
            resume::resume(&options(words.map(str::to_owned))?)?.into_inner()
        } else {
            train::train(&planned.train_args()?)?
        };
        // Ctrl-C in the last iteration, too, is meant for the trainings that would follow.
        if !ended.was_interrupted() && planned.is_finished()? {
            return Ok(());
        }
        let message = format!("{dir}: stopped; `{}` goes on", typed(&again(args, out)));
        Err(ExitError::new(ExitCode::Interrupted, message).into())
    }

    /// Its best checkpoint, and that one's score: the lower, the better.
    fn best(&self) -> anyhow::Result<(f64, Checkpoint)> {
        let store = CheckpointStore::new(RunDir::new(&self.dir).checkpoints());
        let scored = store.entries()?.into_iter().filter_map(|entry| {
            let best = entry.labels.has_tag(BEST);
            entry
                .labels
                .score
                .as_ref()
                .filter(|_| best)
                .map(|score| (score.value, entry.dir.clone()))
        });
        let Some((score, dir)) = scored.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            let message = format!(
                "{}: no checkpoint was evaluated, so none is the best; it takes more than \
                 run.best_after env-steps, and run.evaluate_every must not be 0",
                self.dir.display()
            );
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        };
        Ok((score, store.load(&dir)?))
    }
}

/// The command that goes on below `out`, wherever that was named.
fn again(args: &ReproduceArgs, out: &Path) -> Vec<OsString> {
    let mut out_flag = OsString::from("--out=");
    out_flag.push(out);
    let baselines: Vec<String> = args.baselines.iter().map(|baseline| name(*baseline)).collect();
    let baselines = match &*baselines {
        [] => "--baselines".to_owned(),
        some => format!("--baselines={}", some.join(",")),
    };
    let mut words = vec!["octopus".into(), "reproduce".into(), "--train".into(), out_flag];
    words.extend([format!("--seeds={}", args.seeds), baselines].map(OsString::from));
    words.extend(args.sets.iter().map(|set| format!("--set={set}").into()));
    words.extend(args.episodes.map(|episodes| format!("--episodes={episodes}").into()));
    words.extend(
        [("--quick", args.quick), ("--json", args.json), ("--force", args.force)]
            .into_iter()
            .filter(|&(_, given)| given)
            .map(|(flag, _)| flag.into()),
    );
    words.extend(
        [format!("--steps={}", args.steps), format!("--seed={}", args.seed)].map(OsString::from),
    );
    words
}

/// Puts the policy of the best MAPPO run of `task` below `policies`.
fn take_best(task: TaskName, runs: &[Run], policies: &Path) -> anyhow::Result<()> {
    let wanted = runs.iter().filter(|run| run.task == task && run.is_wanted());
    let scored = wanted.map(Run::best).collect::<anyhow::Result<Vec<_>>>()?;
    let best = scored.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, checkpoint)) = best else { return Ok(()) };
    let name: Name = task.as_str().parse().context("a task is a name")?;
    std::fs::create_dir_all(policies).with_context(|| policies.display().to_string())?;
    let store = CheckpointStore::new(policies);
    let there = store.dir(&name);
    if there.exists() {
        let origins = Manifest::read(&there)?.origins;
        if origins.iter().all(|origin| origin.digest == checkpoint.manifest.digest) {
            return Ok(());
        }
        return Err(refused(&there, "is of another run than the one that is best now").into());
    }
    let robot = Robot::from_toml(&checkpoint.robot_toml, &checkpoint.dir.join("robot.toml"))?;
    let part = Part { arms: (0..robot.n_arms).collect(), checkpoint };
    let composition = Composition::new(&Parts::new(vec![part])?)?;
    store.compose(&name, &composition, &serde_json::to_value(Provenance::gather())?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    fn parse(words: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> ReproduceArgs {
        let Command::Reproduce(args) = Cli::try_parse_from(words).expect("valid").command else {
            panic!("another command")
        };
        args
    }

    #[test]
    fn runs_and_policies_are_its_own_where_it_has_put_its_mark() {
        let out = tempfile::tempdir().expect("tempdir");
        let check = |force| check_place(out.path(), force);
        check(false).expect("empty");
        for name in [RUNS, POLICIES] {
            std::fs::create_dir(out.path().join(name)).expect("made");
            let error = check(false).expect_err("somebody else's").to_string();
            assert!(error.contains(&format!("holds {name:?}")), "{error}");
            check(true).expect("wanted");
            std::fs::write(out.path().join(MARK), MARKED).expect("written");
            check(false).expect("its own");
            std::fs::write(out.path().join(MARK), "another text").expect("written");
            assert!(check(false).is_err());
            std::fs::remove_dir(out.path().join(name)).expect("empty");
        }
    }

    #[test]
    fn the_command_that_goes_on_asks_for_the_same_in_the_directory_that_was_made() {
        let out = Path::new("reproduction-20260101-120000");
        for line in [
            "octopus reproduce --train",
            "octopus reproduce --train --baselines --quick --json --force",
            "octopus reproduce --train --seeds 1 --baselines ippo --set run.workers=2 --episodes 3 --steps 9 --seed 8",
        ] {
            let args = parse(line.split(' '));
            let asked = ReproduceArgs { out: Some(out.to_owned()), ..args.clone() };
            let again = again(&args, out);
            assert!(typed(&again).contains("--train --out=reproduction-20260101-120000"));
            assert_eq!(format!("{:?}", parse(again)), format!("{asked:?}"), "{line}");
        }
    }
}
