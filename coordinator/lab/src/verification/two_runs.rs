//! Compares two runs.

use std::path::Path;

use serde::Serialize;

use super::comparison::Comparison;
use super::differences::{self, ConfigDifference, ProvenanceDifference};
use super::record::Record;
use super::wording::{iterations, promise, provenance_table};

/// The result of comparing two runs, as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct TwoRuns<'a> {
    /// The directories.
    runs: [&'a Path; 2],
    /// Iterations recorded in each.
    iterations: [u64; 2],
    /// Iterations that only one has.
    only_in_one: [u64; 2],
    /// Whether all common iterations agree.
    same: bool,
    #[serde(flatten)]
    comparison: Comparison,
    /// Whether the promise extends over both.
    promised: bool,
    configuration: Vec<ConfigDifference>,
    provenance: Vec<ProvenanceDifference>,
    /// Whether one of them learned on a GPU.
    #[serde(skip)]
    gpu: bool,
}

/// Compares two runs.
pub fn compare<'a>(a: &'a Record, b: &'a Record) -> TwoRuns<'a> {
    let comparison = Comparison::of(&a.iterations, &b.iterations);
    let counts = [a, b].map(|run| run.iterations.len() as u64);
    let configuration = differences::of_configuration(a, b);
    let provenance = differences::of_provenance(&a.sessions, &b.sessions);
    let gpu = differences::on_gpu(a) || differences::on_gpu(b);
    TwoRuns {
        runs: [&a.path, &b.path],
        iterations: counts,
        only_in_one: counts.map(|count| count - comparison.common),
        same: comparison.parting.is_none(),
        comparison,
        promised: !gpu && provenance.is_empty() && configuration.iter().all(|d| !d.matters),
        configuration,
        provenance,
        gpu,
    }
}

impl TwoRuns<'_> {
    /// Whether all common iterations agree.
    pub fn is_same(&self) -> bool {
        self.same
    }

    /// As a person reads it.
    pub fn text(&self) -> String {
        describe(self, self.gpu)
    }
}

fn describe(result: &TwoRuns<'_>, gpu: bool) -> String {
    let names = result.runs.map(|path| path.display().to_string());
    let mut parts = vec![result.comparison.sentence([&names[0], &names[1]])];
    for (name, count) in names.iter().zip(result.only_in_one).filter(|(_, count)| *count > 0) {
        parts.push(format!("\n{} only in {name}", iterations(count)));
    }
    if !result.configuration.is_empty() {
        let or_none = |value: &Option<String>| value.clone().unwrap_or_else(|| "-".to_owned());
        let rows = result.configuration.iter().map(|difference| {
            let effect = if difference.matters { "changes what is learned" } else { "harmless" };
            [difference.key.clone(), or_none(&difference.a), or_none(&difference.b), effect.into()]
        });
        let header = ["configuration", "first", "second", "effect"];
        parts.push(format!("\n\n{}", output::table(header, rows)));
    }
    parts.push(provenance_table(&result.provenance, ["first", "second"]));
    parts.push(promise(result.promised, result.same, gpu));
    parts.concat()
}
