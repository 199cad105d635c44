//! The file of a sweep: what is tried, read with care. Whatever is wrong is said with the file's name and the key.

use std::path::{Path, PathBuf};

use proto::config::{AlgorithmName, Preset, TaskName, parse};
use proto::{ConfigError, ExitCode, ExitError};
use store::regular_files;
use toml::{Table, Value};

use super::keys::{Keys, number, whole};
use crate::names::Named;

/// A key of the configuration and its value.
pub(super) type Assignment = (String, Value);

/// Keys that the sweep sets itself, and by what.
const OWN: [(&str, &str); 2] =
    [("run.seed", "`seeds`"), ("run.env_steps", "`iterations` or `env_steps`")];

/// Combinations of a grid, at most: more are a slip of the pen.
const MOST_CONFIGURATIONS: usize = 10_000;

/// What a file says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SweepFile {
    /// Where it was read.
    pub(super) path: PathBuf,
    /// Its text.
    pub(super) text: String,
    /// As `octopus train` takes them.
    pub(super) task: Option<Named<TaskName>>,
    pub(super) preset: Option<Named<Preset>>,
    pub(super) algorithm: Option<Named<AlgorithmName>>,
    pub(super) config: Option<PathBuf>,
    /// The whole budget of a trial, if it is another than that of the configuration.
    pub(super) budget: Option<Budget>,
    pub(super) seeds: Vec<u64>,
    pub(super) jobs: Option<usize>,
    /// What all trials have.
    pub(super) set: Vec<Assignment>,
    /// What each configuration has beside that.
    pub(super) configurations: Vec<Vec<Assignment>>,
    pub(super) halving: Option<Halving>,
    pub(super) evaluation: Evaluation,
}

/// The budget of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Budget {
    Iterations(u64),
    EnvSteps(u64),
}

/// Successive halving.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Halving {
    /// Shares of the budget at which trials are scored, ascending, between 0 and 1.
    pub(super) rungs: Vec<f64>,
    /// The best 1 of so many configurations go on.
    pub(super) reduction: f64,
}

/// The evaluation at the end of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Evaluation {
    pub(super) episodes: u64,
    pub(super) steps: u64,
    pub(super) seed: u64,
}

impl SweepFile {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let text = regular_files::read_text(path, regular_files::TEXT)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        // One training of what is the default is a slip: the file was not saved, say.
        let says_nothing = |line: &str| line.is_empty() || line.starts_with('#');
        if text.lines().map(str::trim).all(says_nothing) {
            let message = format!(
                "{}: is empty; a sweep wants [grid], [[trials]] or seeds (`octopus sweep --help`)",
                path.display()
            );
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
        Self::parse(path, text)
    }

    /// What the text of the file at `path` says.
    pub(super) fn parse(path: &Path, text: String) -> anyhow::Result<Self> {
        let origin = path.display().to_string();
        let table = parse(&text, &origin)?;
        let mut keys = Keys::new(&origin, "", table);
        let named = (keys.named("task")?, keys.named("preset")?, keys.named("algorithm")?);
        let (task, preset, algorithm) = named;
        // Beside the file, wherever this program was started.
        let beside = |config: String| path.parent().unwrap_or(Path::new("")).join(config);
        let config = keys.text("config")?;
        if config.as_deref() == Some("") {
            return Err(keys.wrong("config", "the name of a file", "\"\"").into());
        }
        let config = config.map(beside);
        let budget = match (keys.whole("iterations", 1)?, keys.whole("env_steps", 1)?) {
            (None, None) => None,
            (Some(iterations), None) => Some(Budget::Iterations(iterations)),
            (None, Some(env_steps)) => Some(Budget::EnvSteps(env_steps)),
            (Some(_), Some(_)) => {
                return Err(keys
                    .refuse("`iterations` and `env_steps` are both given; one is the budget")
                    .into());
            }
        };
        let seeds = seeds(&mut keys)?;
        let jobs = keys.whole("jobs", 1)?.map(|jobs| jobs as usize);
        let set = keys
            .table("set")?
            .map_or(Ok(Vec::new()), |table| assignments(&origin, "set", table))?;
        let grid = keys.table("grid")?.map(|grid| combinations(&origin, grid)).transpose()?;
        let listed = listed(&mut keys)?;
        if let Some(listed) = &listed
            && listed.is_empty()
        {
            return Err(keys.refuse("`trials` is empty; nothing would be tried").into());
        }
        let configurations = match (grid, listed) {
            // Seeds alone.
            (None, None) => vec![Vec::new()],
            (grid, listed) => grid.into_iter().chain(listed).flatten().collect(),
        };
        let halving =
            keys.table("halving")?.map(|table| Halving::of(&origin, table)).transpose()?;
        let evaluation = Evaluation::of(&origin, keys.table("evaluation")?.unwrap_or_default())?;
        keys.end(&[
            "task",
            "preset",
            "algorithm",
            "config",
            "iterations",
            "env_steps",
            "seeds",
            "jobs",
            "set",
            "grid",
            "trials",
            "halving",
            "evaluation",
        ])?;
        Ok(Self {
            path: path.to_owned(),
            text,
            task,
            preset,
            algorithm,
            config,
            budget,
            seeds,
            jobs,
            set,
            configurations,
            halving,
            evaluation,
        })
    }
}

impl Halving {
    fn of(origin: &str, table: Table) -> anyhow::Result<Self> {
        let mut keys = Keys::new(origin, "halving.", table);
        let expected = "a list of shares of the budget above 0 and below 1, each larger than the one before, such as [0.25, 0.5]";
        let rungs = keys.take("rungs");
        let found = rungs.as_ref().map_or_else(|| "nothing".to_owned(), ToString::to_string);
        let shares: Option<Vec<f64>> = rungs
            .and_then(|rungs| rungs.as_array().cloned())
            .and_then(|rungs| rungs.iter().map(number).collect());
        let shares = shares.filter(|shares| {
            !shares.is_empty()
                && shares.iter().all(|share| 0.0 < *share && *share < 1.0)
                && shares.windows(2).all(|pair| pair[0] < pair[1])
        });
        let Some(rungs) = shares else { return Err(keys.wrong("rungs", expected, found).into()) };
        let reduction = match keys.take("reduction") {
            None => 2.0,
            Some(value) => number(&value)
                .filter(|reduction| *reduction > 1.0 && reduction.is_finite())
                .ok_or_else(|| {
                    keys.wrong("reduction", "a number above 1, such as 2", value.to_string())
                })?,
        };
        keys.end(&["rungs", "reduction"])?;
        Ok(Self { rungs, reduction })
    }
}

impl Evaluation {
    fn of(origin: &str, table: Table) -> anyhow::Result<Self> {
        let mut keys = Keys::new(origin, "evaluation.", table);
        let episodes = keys.whole("episodes", 1)?.unwrap_or(100);
        let steps = keys.whole("steps", 1)?.unwrap_or(200);
        let seed = keys.whole("seed", 0)?.unwrap_or(0);
        for (key, value, most) in [("episodes", episodes, 1_000_000), ("steps", steps, 100_000)] {
            if value > most {
                let expected = format!("at most {most}");
                return Err(keys.wrong(key, &expected, value.to_string()).into());
            }
        }
        keys.end(&["episodes", "steps", "seed"])?;
        Ok(Self { episodes, steps, seed })
    }
}

/// The seeds of every configuration.
fn seeds(keys: &mut Keys<'_>) -> Result<Vec<u64>, ConfigError> {
    let Some(value) = keys.take("seeds") else { return Ok(vec![1]) };
    let seeds: Option<Vec<u64>> =
        value.as_array().and_then(|seeds| seeds.iter().map(whole).collect());
    let differ = |seeds: &Vec<u64>| (1..seeds.len()).all(|at| !seeds[..at].contains(&seeds[at]));
    let seeds = seeds.filter(|seeds| !seeds.is_empty() && differ(seeds));
    let expected = "a list of whole numbers, none of them twice, such as [0, 1, 2]";
    seeds.ok_or_else(|| keys.wrong("seeds", expected, value.to_string()))
}

/// Configurations that are listed one by one.
fn listed(keys: &mut Keys<'_>) -> anyhow::Result<Option<Vec<Vec<Assignment>>>> {
    let Some(value) = keys.take("trials") else { return Ok(None) };
    let expected = "tables of keys and values, [[trials]]";
    let Value::Array(listed) = &value else {
        return Err(keys.wrong("trials", expected, value.to_string()).into());
    };
    let trial = |trial: &Value| match trial {
        Value::Table(table) => assignments(keys.origin, "trials", table.clone()),
        other => Err(keys.wrong("trials", expected, other.to_string()).into()),
    };
    listed.iter().map(trial).collect::<anyhow::Result<_>>().map(Some)
}

/// The keys of `table` with their values; those of the sweep's own are refused.
fn assignments(origin: &str, group: &str, table: Table) -> anyhow::Result<Vec<Assignment>> {
    let mut flat = Vec::new();
    flatten("", table, &mut flat);
    for (at, (key, _)) in flat.iter().enumerate() {
        // Dotted and in quotes: two keys to TOML, one to a configuration.
        if flat[..at].iter().any(|(before, _)| before == key) {
            let message = format!("{origin}: key `{key}` is in [{group}] twice; leave one of them");
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
        if let Some((_, cure)) = OWN.iter().find(|(own, _)| own == key) {
            let message = format!("{origin}: `{key}` in [{group}]: {cure} of the sweep set it");
            return Err(ExitError::new(ExitCode::BadInput, message).into());
        }
    }
    Ok(flat)
}

/// Every combination of the values in `[grid]`; those of the last key change fastest.
fn combinations(origin: &str, grid: Table) -> anyhow::Result<Vec<Vec<Assignment>>> {
    let keys = assignments(origin, "grid", grid)?;
    let refuse = |what: String| ExitError::new(ExitCode::BadInput, format!("{origin}: {what}"));
    if keys.is_empty() {
        return Err(refuse("[grid] has no keys; nothing would be varied".to_owned()).into());
    }
    let mut all = vec![Vec::new()];
    for (key, value) in keys {
        let values = value.as_array().filter(|values| !values.is_empty()).ok_or_else(|| {
            ConfigError::WrongType {
                origin: origin.to_owned(),
                key: format!("grid.{key}"),
                expected: "a list of the values to try, one at least".to_owned(),
                found: value.to_string(),
            }
        })?;
        if all.len() * values.len() > MOST_CONFIGURATIONS {
            let what = format!("[grid] has more than {MOST_CONFIGURATIONS} combinations");
            return Err(refuse(what).into());
        }
        let with = |before: &Vec<Assignment>| -> Vec<Vec<Assignment>> {
            let one = |value: &Value| {
                let mut all = before.clone();
                all.push((key.clone(), value.clone()));
                all
            };
            values.iter().map(one).collect()
        };
        all = all.iter().flat_map(with).collect();
    }
    Ok(all)
}

/// Dotted keys and their values, in the order of their names.
fn flatten(prefix: &str, table: Table, into: &mut Vec<Assignment>) {
    for (name, value) in table {
        let key = if prefix.is_empty() { name } else { format!("{prefix}.{name}") };
        match value {
            Value::Table(inner) => flatten(&key, inner, into),
            value => into.push((key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> anyhow::Result<SweepFile> {
        SweepFile::parse(Path::new("dir/sweep.toml"), text.to_owned())
    }

    fn shown(configurations: &[Vec<Assignment>]) -> Vec<String> {
        let one = |(key, value): &Assignment| format!("{key}={value}");
        configurations.iter().map(|all| all.iter().map(one).collect::<Vec<_>>().join(" ")).collect()
    }

    #[test]
    fn a_file_that_says_nothing_is_refused() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("x.toml");
        for text in ["", "\n# [grid]\n"] {
            std::fs::write(&path, text).expect("written");
            let told = SweepFile::read(&path).expect_err("nothing is tried").to_string();
            assert!(told.contains("x.toml: is empty; a sweep wants [grid]"), "{told}");
        }
        std::fs::write(&path, "seeds = [1]").expect("written");
        assert!(SweepFile::read(&path).is_ok());
    }

    #[test]
    fn a_grid_has_all_combinations_and_a_list_stands_behind_them() {
        let file = parse(
            "seeds = [3, 0]\nenv_steps = 2e6\nconfig = \"base.toml\"\nalgorithm = \"ppo\"\n\
             [set]\nrun.evaluate_every = 5\n\"network.layer_norm\" = true\n\
             [grid]\nalgorithm.gamma = [0.9, 0.95]\nnetwork.hidden = [[8], [16, 16]]\n\
             [[trials]]\noptimizer = { actor_lr = 1e-3, critic_lr = 1e-3 }\n\
             [halving]\nrungs = [0.25, 0.5]\n[evaluation]\nepisodes = 300\nseed = 5\n",
        )
        .expect("valid");
        assert_eq!(file.seeds, [3, 0]);
        assert_eq!(file.budget, Some(Budget::EnvSteps(2_000_000)));
        assert_eq!(file.config, Some("dir/base.toml".into()));
        assert_eq!(file.algorithm, Some(Named(AlgorithmName::Ppo)));
        assert_eq!(
            shown(&file.configurations),
            [
                "algorithm.gamma=0.9 network.hidden=[8]",
                "algorithm.gamma=0.9 network.hidden=[16, 16]",
                "algorithm.gamma=0.95 network.hidden=[8]",
                "algorithm.gamma=0.95 network.hidden=[16, 16]",
                "optimizer.actor_lr=0.001 optimizer.critic_lr=0.001",
            ]
        );
        assert_eq!(shown(&[file.set]), ["network.layer_norm=true run.evaluate_every=5"]);
        assert_eq!(file.halving, Some(Halving { rungs: vec![0.25, 0.5], reduction: 2.0 }));
        assert_eq!(file.evaluation, Evaluation { episodes: 300, steps: 200, seed: 5 });
        let plain = parse("").expect("one configuration with one seed");
        assert_eq!((plain.configurations, plain.seeds), (vec![Vec::new()], vec![1]));
    }

    #[test]
    fn what_is_wrong_is_said_with_file_and_key() {
        for (text, words) in [
            ("seeds = [", "dir/sweep.toml: not valid TOML: line 1, `seeds = [`: "),
            ("sedes = [1]", "unknown key `sedes`; did you mean `seeds`?"),
            ("seeds = []", "key `seeds` wants a list of whole numbers"),
            ("seeds = [1, 1]", "none of them twice"),
            ("seeds = [-1]", "got [-1]"),
            ("iterations = 0", "key `iterations` wants a whole number, 1 or more, got 0"),
            ("env_steps = -5.0", "key `env_steps` wants a whole number"),
            ("iterations = 1\nenv_steps = 1", "both given"),
            ("jobs = \"many\"", "key `jobs` wants a whole number"),
            ("config = \"\"", "key `config` wants the name of a file, got \"\""),
            ("task = \"walk\"", "key `task` wants one of `trajectory`, `reorientation`"),
            ("preset = 1", "key `preset` wants one of `guided`, `tuned`"),
            ("grid = 3", "key `grid` wants a table, [grid]"),
            ("[grid]", "[grid] has no keys"),
            ("[grid]\nalgorithm.gamma = 0.9", "key `grid.algorithm.gamma` wants a list"),
            ("[grid]\nalgorithm.gamma = []", "one at least"),
            ("[grid]\nrun.seed = [1]", "`run.seed` in [grid]: `seeds` of the sweep set it"),
            ("[set]\nrun.env_steps = 3", "`iterations` or `env_steps`"),
            (
                "[grid]\n\"algorithm.gamma\" = [0.9]\nalgorithm.gamma = [0.8]",
                "key `algorithm.gamma` is in [grid] twice",
            ),
            ("env_steps = 1e30", "key `env_steps` wants a whole number, 9"),
            ("trials = []", "`trials` is empty"),
            ("trials = [1]", "key `trials` wants tables"),
            ("[halving]", "key `halving.rungs` wants a list of shares"),
            ("[halving]\nrungs = [0.5, 1.5]", "above 0 and below 1"),
            ("[halving]\nrungs = [0.5, 0.5]", "each larger than the one before"),
            ("[halving]\nrungs = [0.5]\nreduction = 1", "key `halving.reduction` wants"),
            ("[halving]\nrungs = [0.5]\nrung = 1", "did you mean `halving.rungs`?"),
            ("[evaluation]\nepisodes = 0", "key `evaluation.episodes` wants"),
            ("[evaluation]\nsteps = 100001", "key `evaluation.steps` wants at most"),
        ] {
            let error = parse(text).expect_err(text);
            assert_eq!(run::errors::exit_code(&error), ExitCode::BadInput, "{text}");
            assert!(error.to_string().contains(words), "{text}: {error}");
            assert!(error.to_string().contains("dir/sweep.toml"), "{text}: {error}");
        }
    }
}
