//! In what two runs differ that could make, or excuse, different digests.

use std::collections::{BTreeMap, BTreeSet};

use proto::config::Run;
use serde::Serialize;
use serde_json::Value;
use store::budgets::Budget;
use store::checkpoint::flatten;
use store::provenance::PROMISED_FOR;

use super::record::Record;

/// A key of the configuration with two values; `robot.toml` stands for the robot's whole text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct ConfigDifference {
    /// The dotted key.
    pub(super) key: String,
    /// The value in the first run, as TOML; none if the key is absent.
    pub(super) a: Option<String>,
    /// The value in the second.
    pub(super) b: Option<String>,
    /// Whether it changes what is learned.
    pub(super) matters: bool,
}

/// A fact about program or machine that is not the same everywhere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct ProvenanceDifference {
    /// Its name in `provenance.json`.
    pub(super) field: &'static str,
    /// Its values over the sessions of the first run.
    pub(super) a: BTreeSet<String>,
    /// Its values over the sessions of the second.
    pub(super) b: BTreeSet<String>,
}

/// Compares what two runs were told to do.
pub(super) fn of_configuration(a: &Record, b: &Record) -> Vec<ConfigDifference> {
    let (mut left, mut right) = (flatten(&a.config), flatten(&b.config));
    let common = a.iterations.len().min(b.iterations.len()) as u64;
    let budgets = [a, b].map(|run| run.budgets_until(common));
    let undated = [a, b].iter().any(|run| !run.undated_budgets().is_empty());
    let other_budgets =
        (is_scheduled(&left) || is_scheduled(&right)) && (budgets[0] != budgets[1] || undated);
    if other_budgets {
        for (config, budgets) in [&mut left, &mut right].into_iter().zip(&budgets) {
            config.insert("run.env_steps".to_owned(), course(budgets));
        }
    }
    if a.robot == b.robot {
        // Two names of one robot.
        left.remove("robot.description");
        right.remove("robot.description");
    } else {
        left.insert("robot.toml".to_owned(), fingerprint(&a.robot));
        right.insert("robot.toml".to_owned(), fingerprint(&b.robot));
    }
    let keys: BTreeSet<&String> = left.keys().chain(right.keys()).collect();
    keys.into_iter()
        .filter(|key| {
            let budgets = other_budgets && *key == "run.env_steps";
            left.get(*key) != right.get(*key) || budgets || is_undecided(key, &left)
        })
        .map(|key| ConfigDifference {
            key: key.clone(),
            a: left.get(key).cloned(),
            b: right.get(key).cloned(),
            matters: match key.as_str() {
                // The learning rate falls over the budget that was in force.
                "run.env_steps" => other_budgets,
                key => !key.strip_prefix("run.").is_some_and(|key| Run::HARMLESS.contains(&key)),
            },
        })
        .collect()
}

/// Whether what is learned depends on the budget.
fn is_scheduled(config: &BTreeMap<String, String>) -> bool {
    config.get("optimizer.schedule").is_none_or(|schedule| schedule != "\"constant\"")
}

/// Whether what a run learns depends on the budget.
pub(super) fn depends_on_budget(run: &Record) -> bool {
    is_scheduled(&flatten(&run.config))
}

/// Budgets in the order in which they were in force: `2560, 2816 from iteration 20`.
fn course(budgets: &[Budget]) -> String {
    let shown = budgets.iter().map(|Budget { from, env_steps }| match from {
        0 => env_steps.to_string(),
        from => format!("{env_steps} from iteration {from}"),
    });
    shown.collect::<Vec<_>>().join(", ")
}

/// Whether a value says nothing: what an earlier version chose for `auto` may be another thing in each run.
fn is_undecided(key: &str, config: &BTreeMap<String, String>) -> bool {
    key == "run.precision" && config.get(key).is_some_and(|value| value == "\"auto\"")
}

/// Compares with what, and on what, two runs were made. A run whose own sessions differ is
/// reported, too: the promise does not extend over it either.
pub(super) fn of_provenance(a: &[Value], b: &[Value]) -> Vec<ProvenanceDifference> {
    let values = |sessions: &[Value], field: &str| -> BTreeSet<String> {
        sessions.iter().map(|session| shown(&session[field])).collect()
    };
    PROMISED_FOR
        .into_iter()
        .map(|field| ProvenanceDifference { field, a: values(a, field), b: values(b, field) })
        .filter(|difference| difference.a.union(&difference.b).count() > 1)
        .collect()
}

/// Whether a run's learner computed on a GPU, which the promise excludes.
pub(super) fn on_gpu(run: &Record) -> bool {
    flatten(&run.config).get("run.device").is_some_and(|device| device.starts_with("\"cuda"))
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "unknown".to_owned(),
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(shown).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

fn fingerprint(text: &str) -> String {
    format!("blake3:{}", &blake3::hash(text.as_bytes()).to_hex()[..16])
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use proto::Digest;
    use proto::config::{Layers, Preset};
    use serde_json::json;

    use super::super::record::Iteration;
    use super::*;

    fn record(sets: &[&str], robot: &str) -> Record {
        // As a run has it: decided.
        let config = ["run.precision=f32"]
            .iter()
            .chain(sets)
            .try_fold(Layers::new(Preset::Tuned, None), |layers, set| layers.set(set))
            .and_then(|layers| layers.resolve())
            .expect("valid");
        let line = |iteration| Iteration { iteration, env_steps: 8, digest: Digest([0; 16]) };
        Record {
            path: PathBuf::new(),
            iterations: (0..4).map(line).collect(),
            config: config.to_toml().parse().expect("TOML"),
            robot: robot.to_owned(),
            sessions: Vec::new(),
            budgets: Vec::new(),
        }
    }

    fn verdicts(a: &Record, b: &Record) -> Vec<(String, bool)> {
        of_configuration(a, b)
            .into_iter()
            .map(|difference| (difference.key, difference.matters))
            .collect()
    }

    #[test]
    fn keys_are_told_apart_by_whether_they_change_what_is_learned() {
        let plain = record(&[], "x");
        let other = record(&["run.workers=5", "run.seed=9", "network.hidden=[8]"], "y");
        let expected = [
            ("network.hidden", true),
            ("robot.toml", true),
            ("run.seed", true),
            ("run.workers", false),
        ];
        let expected = expected.map(|(key, matters)| (key.to_owned(), matters));
        assert_eq!(verdicts(&plain, &other), expected);
        assert_eq!(verdicts(&plain, &plain), []);
    }

    #[test]
    fn a_precision_that_was_left_undecided_excuses_other_digests() {
        let precision = [("run.precision".to_owned(), true)];
        let auto = || record(&["run.precision=auto"], "x");
        assert_eq!(verdicts(&auto(), &auto()), precision);
        assert_eq!(verdicts(&record(&["run.precision=bf16"], "x"), &auto()), precision);
        let decided = || record(&["run.precision=bf16"], "x");
        assert_eq!(verdicts(&decided(), &decided()), []);
    }

    #[test]
    fn a_budget_matters_where_the_learning_rate_falls_over_it() {
        let budget = ("run.env_steps".to_owned(), true);
        let (linear, longer) = (record(&[], "x"), record(&["run.env_steps=2e6"], "x"));
        assert_eq!(verdicts(&linear, &longer), [budget]);
        let constant = "optimizer.schedule=constant";
        let (constant, longer) =
            (record(&[constant], "x"), record(&[constant, "run.env_steps=2e6"], "x"));
        assert_eq!(verdicts(&constant, &longer), [("run.env_steps".to_owned(), false)]);
    }

    #[test]
    fn budgets_count_as_far_as_both_have_come() {
        let with = |budgets: &[(u64, u64)], env_steps: &str| {
            let mut run = record(&[&format!("run.env_steps={env_steps}")], "x");
            let budget = |&(from, env_steps)| Budget { from, env_steps };
            run.budgets = budgets.iter().map(budget).collect();
            run
        };
        // In the end both have the same one.
        let changed = with(&[(0, 1_000_000), (2, 2_000_000)], "2e6");
        let straight = with(&[(0, 2_000_000)], "2e6");
        let found = of_configuration(&changed, &straight);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].key.as_str(), found[0].matters), ("run.env_steps", true));
        assert_eq!(found[0].a.as_deref(), Some("1000000, 2000000 from iteration 2"));
        assert_eq!(verdicts(&changed, &changed), []);
        // What comes after the iterations that both have changes nothing in these.
        let later = with(&[(0, 1_000_000), (4, 2_000_000)], "2e6");
        let shorter = with(&[(0, 1_000_000)], "1e6");
        assert_eq!(verdicts(&later, &shorter), [("run.env_steps".to_owned(), false)]);
        // An earlier version wrote down that it was changed, but not when.
        let mut undated = with(&[], "2e6");
        undated.sessions = vec![json!({"overrides": ["run.env_steps is now 2, was 1"]})];
        assert_eq!(verdicts(&undated, &straight), [("run.env_steps".to_owned(), true)]);
    }

    #[test]
    fn sessions_on_two_machines_are_a_difference_within_one_run() {
        let session =
            |processor: &str| json!({"processor": processor, "version": "1", "host": "h"});
        let (one, two) = (session("Xeon"), session("EPYC"));
        assert_eq!(of_provenance(std::slice::from_ref(&one), std::slice::from_ref(&one)), []);
        let found = of_provenance(&[one.clone(), two], &[one]);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].field, "processor");
        assert_eq!(found[0].a.len(), 2);
    }
}
