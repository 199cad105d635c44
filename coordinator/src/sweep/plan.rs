//! The trials of a sweep, all of them checked before the first begins.

use std::collections::BTreeMap;
use std::path::Path;

use lab::evaluation::check_recorded;
use lab::sweep::study::{Study, Trial};
use proto::config::{Config, Preset};
use proto::{ExitCode, ExitError};
use run::errors;
use simulator::evaluate::EvaluationOptions;
use store::checkpoint::flatten;
use toml::Value;

use super::file::{Assignment, Budget, Evaluation, SweepFile};
use crate::names::Names as _;
use crate::planned_run::PlannedRun;

/// Longest name of a trial that is not cut.
const LONGEST: usize = 100;
/// Of a configuration in which nothing is changed.
const PLAIN: &str = "default";

/// What is to be done.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) file: SweepFile,
    pub(super) study: Study,
    /// The runs of the trials, in their order.
    pub(super) runs: Vec<PlannedRun>,
    /// Processors that one of them takes.
    pub(super) processors: usize,
}

impl Plan {
    /// The trials of `file`, whose runs land in `dir`. Nothing is written.
    pub(super) fn new(file: SweepFile, dir: &Path) -> anyhow::Result<Self> {
        let origin = file.path.display().to_string();
        let refuse = |what: String| ExitError::new(ExitCode::BadInput, format!("{origin}: {what}"));
        let short = ShortKeys::new()?;
        let shares = file.halving.as_ref().map_or(&[][..], |halving| &halving.rungs);
        let mut runs = Vec::new();
        let mut trials: Vec<Trial> = Vec::new();
        let mut configurations: Vec<String> = Vec::new();
        let mut names: BTreeMap<String, String> = BTreeMap::new();
        let mut processors = 1;
        // Episodes, and control steps of each, by which trials are scored at rungs.
        let mut at_rungs = None;
        for (index, keys) in file.configurations.iter().enumerate() {
            let label = short.label(keys);
            if configurations.contains(&label) {
                return Err(refuse(format!("configuration {label} is there twice")).into());
            }
            configurations.push(label.clone());
            for seed in &file.seeds {
                let whole = format!("{label}, seed={seed}");
                let name = file_name(keys, &label, *seed);
                if let Some(other) = names.insert(name.clone(), whole.clone()) {
                    let what = format!("trials {other} and {whole} would have one name, {name}");
                    return Err(refuse(what).into());
                }
                let dir = dir.join(&name);
                let mut run = PlannedRun { dir: dir.clone(), words: words(&file, keys, *seed) };
                let config = checked(&run).map_err(|error| in_trial(&origin, &whole, &error))?;
                if !config.run.checkpoints.is_empty() {
                    // A prefix in a bucket is of one run.
                    let shared = config.run.checkpoints.trim_end_matches('/');
                    let own = Value::String(format!("{shared}/{name}"));
                    run.words.push(format!("--set=run.checkpoints={own}"));
                }
                if config.run.time_limit().is_some() {
                    let what = format!(
                        "trial {whole}: run.time_limit_s = {} would end it too early; leave it out: `iterations` or `env_steps` says \
                         how long trials train",
                        config.run.time_limit_s
                    );
                    return Err(refuse(what).into());
                }
                if config.run.workers == 0 {
                    let what = format!(
                        "trial {whole}: run.workers = 0 leaves its rollouts to other machines, which trials of a sweep do not \
                         listen for; give it 1 at least"
                    );
                    return Err(refuse(what).into());
                }
                if file.halving.is_some() {
                    let evaluated = [config.run.evaluation_episodes, config.run.evaluation_steps];
                    let evaluated = evaluated.map(u64::from);
                    if *at_rungs.get_or_insert(evaluated) != evaluated {
                        let what = format!(
                            "trial {whole}: run.evaluation_episodes and run.evaluation_steps must be the same in all trials, as rungs \
                             compare what they give; say them in [set]"
                        );
                        return Err(refuse(what).into());
                    }
                }
                processors = processors.max(needed(&config));
                let planned = config.planned_iterations();
                let at = |share: &f64| rung(*share, planned);
                let rungs: Vec<u64> = shares.iter().map(at).chain([planned]).collect();
                let met = rungs.windows(2).find(|pair| pair[0] >= pair[1]).map(|pair| pair[0]);
                if let Some(rung) = met {
                    let what = format!(
                        "two rungs fall on iteration {rung} of trial {whole}, which has {planned}; give it a larger budget or \
                         fewer `halving.rungs`"
                    );
                    return Err(refuse(what).into());
                }
                trials.push(Trial {
                    name,
                    configuration: index,
                    seed: *seed,
                    task: config.task.name,
                    run: dir,
                    rungs,
                    steps_per_iteration: config.steps_per_iteration(),
                });
                runs.push(run);
            }
        }
        check_alike(&runs, &trials, &configurations).map_err(refuse)?;
        let at_end = Some([file.evaluation.episodes, file.evaluation.steps]);
        let scored = [
            (at_end, "evaluation.episodes or evaluation.steps"),
            (at_rungs, "run.evaluation_episodes or run.evaluation_steps in [set]"),
        ];
        for (evaluated, asked) in scored {
            let Some([episodes, steps]) = evaluated else { continue };
            check_recorded(episodes as usize, steps as usize, asked)
                .map_err(|error| refuse(error.message))?;
        }
        let reduction = file.halving.as_ref().map_or(1.0, |halving| halving.reduction);
        let study = Study { text: file.text.clone(), configurations, trials, reduction };
        Ok(Self { file, study, runs, processors })
    }

    /// The evaluation at the end of a trial.
    pub(super) fn evaluation(&self) -> EvaluationOptions {
        let Evaluation { episodes, steps, seed } = self.file.evaluation;
        EvaluationOptions { seed, episodes: episodes as usize, steps: steps as usize }
    }
}

/// The configuration of a trial, if it can be trained.
fn checked(run: &PlannedRun) -> anyhow::Result<Config> {
    let config = run.config()?;
    run::robots::load_robot_of(&config)?;
    Ok(config)
}

fn in_trial(origin: &str, trial: &str, error: &anyhow::Error) -> ExitError {
    let message = format!("{origin}: trial {trial}: {}", errors::told(error));
    ExitError::new(errors::exit_code(error), message)
}

/// Refuses trials that would come to the same: a value may be the one that the preset has.
fn check_alike(
    runs: &[PlannedRun],
    trials: &[Trial],
    configurations: &[String],
) -> Result<(), String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for (index, run) in runs.iter().enumerate() {
        let mut config = run.config().map_err(|error| errors::told(&error))?;
        // Each has another one.
        config.run.checkpoints.clear();
        if let Some(before) = seen.insert(config.to_toml(), index) {
            let [one, other] = [before, index].map(|at| &configurations[trials[at].configuration]);
            return Err(format!("configurations {one} and {other} are the same"));
        }
    }
    Ok(())
}

/// Processors that a run has work for. Workers and learner take turns unless iterations overlap.
fn needed(config: &Config) -> usize {
    let (workers, learner) = (config.run.workers, config.run.learner_threads);
    if config.run.overlap == 0 { workers.max(learner) } else { workers + learner }
}

/// What stands behind `octopus train`.
fn words(file: &SweepFile, keys: &[Assignment], seed: u64) -> Vec<String> {
    let mut words = Vec::new();
    words.extend(file.task.map(|task| task.0.name().to_owned()));
    words.extend(file.preset.map(|preset| format!("--preset={}", preset.0.name())));
    words.extend(file.config.as_ref().map(|config| format!("--config={}", config.display())));
    words.extend(file.algorithm.map(|name| format!("--algorithm={}", name.0.name())));
    let set = |(key, value): &Assignment| format!("--set={key}={value}");
    words.extend(file.set.iter().chain(keys).map(set));
    words.push(format!("--seed={seed}"));
    words.extend(file.budget.map(|budget| match budget {
        Budget::Iterations(n) => format!("--iterations={n}"),
        Budget::EnvSteps(n) => format!("--env-steps={n}"),
    }));
    words
}

/// Keys by their last part, where no other key of a configuration ends so. Which keys that are does not depend on the sweep, so
/// that trials keep their names when others are added.
struct ShortKeys(BTreeMap<String, usize>);

impl ShortKeys {
    fn new() -> anyhow::Result<Self> {
        let config = proto::config::Layers::new(Preset::Tuned, None).resolve()?;
        let mut ends = BTreeMap::new();
        for key in flatten(&config.to_toml().parse()?).keys() {
            *ends.entry(last(key).to_owned()).or_default() += 1;
        }
        Ok(Self(ends))
    }

    fn short<'a>(&self, key: &'a str) -> &'a str {
        match key {
            "algorithm.name" => "algorithm",
            "task.name" => "task",
            key if self.0.get(last(key)) == Some(&1) => last(key),
            key => key,
        }
    }

    /// What a configuration is called.
    fn label(&self, keys: &[Assignment]) -> String {
        if keys.is_empty() {
            return PLAIN.to_owned();
        }
        let shown = |(key, value): &Assignment| format!("{}={}", self.short(key), bare(value));
        keys.iter().map(shown).collect::<Vec<_>>().join(", ")
    }
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// A value as a person writes it.
fn bare(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string().replace(", ", ","),
    }
}

/// The iteration after which a share of the planned ones is done. Products of decimal shares may lie a little above what is meant, as 0.07 · 100 does.
fn rung(share: f64, planned: u64) -> u64 {
    (share * planned as f64 * (1.0 - 1e-12)).ceil() as u64
}

/// The name of a trial's directory. If its label had to be cut or changed, a hash of its keys tells it from others.
fn file_name(keys: &[Assignment], label: &str, seed: u64) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._=+-,".contains(c) { c } else { '-' };
    let (label, seed) = (label.replace(", ", ","), format!(",seed={seed}"));
    let short: String = label.chars().map(plain).take(LONGEST - seed.len()).collect();
    if short == label && !short.starts_with('.') {
        return short + &seed;
    }
    let hash = blake3::hash(format!("{keys:?}").as_bytes()).to_hex();
    format!("{}{seed}-{}", short.trim_start_matches('.'), &hash[..8])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> anyhow::Result<Plan> {
        let file = SweepFile::parse(Path::new("sweep.toml"), text.to_owned())?;
        Plan::new(file, Path::new("out/trials"))
    }

    #[test]
    fn trials_are_runs_with_names_of_their_own() {
        let plan = plan(
            "iterations = 40\nseeds = [1, 2]\n[grid]\nalgorithm.gamma = [0.9]\n\
             network.hidden = [[8, 8]]\n[[trials]]\noptimizer.epsilon = 1e-6\n\
             [halving]\nrungs = [0.1, 0.51]\nreduction = 3",
        )
        .expect("valid");
        let names: Vec<&str> = plan.study.trials.iter().map(|trial| &*trial.name).collect();
        assert!(names[0].starts_with("gamma=0.9,hidden=-8,8-,seed=1-"), "{names:?}");
        assert_eq!(
            names[2..],
            ["optimizer.epsilon=0.000001,seed=1", "optimizer.epsilon=0.000001,seed=2"]
        );
        let labels = ["gamma=0.9, hidden=[8,8]", "optimizer.epsilon=0.000001"];
        assert_eq!(plan.study.configurations, labels);
        assert_eq!(plan.study.trials[3].rungs, [4, 21, 40]);
        assert_eq!(plan.study.trials[3].run, Path::new("out/trials").join(names[3]));
        let config = plan.runs[1].config().expect("valid");
        assert_eq!((config.run.seed, config.algorithm.gamma), (2, 0.9));
        assert_eq!(
            (config.network.hidden.as_slice(), config.planned_iterations()),
            (&[8, 8][..], 40)
        );
        assert_eq!(plan.processors, config.run.workers.max(config.run.learner_threads));
    }

    #[test]
    fn trials_with_long_names_are_told_apart_by_their_seeds() {
        let text = "seeds = [1, 2]\n[grid]\nnetwork.hidden = [[128, 128, 128, 128, 128, 128, 128]]\n\
                    network.critic_hidden = [[128, 128, 128, 128, 128, 128, 128]]\n\
                    algorithm.gamma = [0.95]\noptimizer.epsilon = [1e-6]\nrun.learner_threads = [1]";
        let plan = plan(text).expect("valid");
        let names: Vec<&str> = plan.study.trials.iter().map(|trial| &*trial.name).collect();
        assert!(names.iter().all(|name| name.len() <= LONGEST + 9), "{names:?}");
        assert!(names[0].contains(",seed=1-") && names[1].contains(",seed=2-"), "{names:?}");
    }

    #[test]
    fn trials_send_their_checkpoints_to_prefixes_of_their_own() {
        for address in ["file:///tmp/bucket/rates", "file:///tmp/bucket/rates/"] {
            let text = format!(
                "seeds = [1, 2]\n[set]\nrun.checkpoints = \"{address}\"\n\
                 [grid]\nalgorithm.gamma = [0.9]\nnetwork.hidden = [[8, 8]]"
            );
            let plan = plan(&text).expect("valid");
            for (run, trial) in plan.runs.iter().zip(&plan.study.trials) {
                let config = run.config().expect("valid");
                let expected = format!("file:///tmp/bucket/rates/{}", trial.name);
                assert_eq!(config.run.checkpoints, expected);
            }
        }
        let config = plan("").expect("valid").runs[0].config().expect("valid");
        assert_eq!(config.run.checkpoints, "");
        let twice = "[set]\nrun.checkpoints = \"file:///tmp/b\"\n[[trials]]\n\
                     algorithm.gamma = 0.95\n[[trials]]\nnetwork.layer_norm = false";
        assert!(plan(twice).expect_err("twice").to_string().contains("are the same"));
    }

    #[test]
    fn rungs_are_the_first_iterations_with_their_share() {
        for (share, planned, iteration) in [
            (0.07, 100, 7),
            (0.55, 100, 55),
            (0.14, 100, 14),
            (0.51, 40, 21),
            (0.5, 3, 2),
            (0.01, 10, 1),
        ] {
            assert_eq!(rung(share, planned), iteration, "{share} of {planned}");
        }
    }

    #[test]
    fn names_do_not_depend_on_other_trials() {
        let few = plan("[grid]\nalgorithm.gamma = [0.9]").expect("valid");
        let more =
            plan("[grid]\nalgorithm.gamma = [0.9]\n[[trials]]\nrun.overlap = 1").expect("valid");
        assert_eq!(few.study.trials[0].name, "gamma=0.9,seed=1");
        assert_eq!(few.study.trials[0].name, more.study.trials[0].name);
        assert_eq!(more.processors, 4, "two workers and two threads at once");
    }

    #[test]
    fn all_configurations_are_checked_and_differ() {
        for (text, words) in [
            ("[grid]\nalgorithm.gama = [0.9]", "did you mean `algorithm.gamma`?"),
            (
                "[grid]\nalgorithm.gamma = [0.9, \"x\"]",
                "trial gamma=x, seed=1: --set algorithm.gamma=",
            ),
            ("[grid]\nalgorithm.gamma = [0.9, 7.0]", "trial gamma=7.0, seed=1: "),
            ("[grid]\nalgorithm.gamma = [0.9, 0.9]", "gamma=0.9 is there twice"),
            ("[grid]\nalgorithm.gamma = [0.9]\n[[trials]]\nalgorithm.gamma = 0.90", "twice"),
            (
                "[[trials]]\nalgorithm.gamma = 0.95\n[[trials]]\nnetwork.layer_norm = false",
                "are the same",
            ),
            ("iterations = 10\n[halving]\nrungs = [0.01, 0.05]", "fall on iteration 1"),
            ("iterations = 9000000000000000", "key `iterations`: 9000000000000000 are too many"),
            ("iterations = 9000000000000000000", "key `iterations` wants a whole number"),
            ("iterations = 1\n[halving]\nrungs = [0.5]", "fall on iteration 1"),
            ("[set]\nrun.time_limit_s = 60.0", "run.time_limit_s = 60 would end it too early"),
            ("[grid]\nrun.workers = [1, 0]", "trial workers=0, seed=1: run.workers = 0 leaves"),
            ("[set]\nrobot.description = \"none.toml\"", "none.toml"),
            ("config = \"none.toml\"", "none.toml"),
            (
                "[evaluation]\nepisodes = 1000000\nsteps = 1000",
                "ask for fewer by evaluation.episodes or evaluation.steps",
            ),
            (
                "iterations = 9\n[halving]\nrungs = [0.5]\n[set]\nrun.evaluation_episodes = 10000\nrun.evaluation_steps = 10000",
                "ask for fewer by run.evaluation_episodes or run.evaluation_steps in [set]",
            ),
            (
                "iterations = 9\n[halving]\nrungs = [0.5]\n[grid]\nrun.evaluation_steps = [50, 200]",
                "must be the same in all trials",
            ),
        ] {
            let error = plan(text).expect_err(text);
            assert_eq!(errors::exit_code(&error), ExitCode::BadInput, "{text}: {error}");
            let told = errors::told(&error);
            assert!(told.starts_with("sweep.toml: ") && told.contains(words), "{text}: {told}");
        }
    }
}
