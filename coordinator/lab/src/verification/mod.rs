//! Whether two runs, or a run and its repetition, are the same to the bit.

mod differences;
mod record;
mod replay;

use std::path::Path;

use output::grouped;
use proto::Digest;
use serde::Serialize;

use self::differences::{ConfigDifference, ProvenanceDifference};
use self::record::Iteration;
pub use self::record::Record;
pub use self::replay::{REMEDY, Replay, replay};

/// How two sequences of digests compare.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Comparison {
    /// Iterations that both have.
    common: u64,
    /// Of these, how many agree before the first that does not.
    agreeing: u64,
    /// The first iteration that does not agree.
    parting: Option<Parting>,
}

/// Two training states that should be one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Parting {
    /// The iteration, from 0.
    iteration: u64,
    /// Env-steps trained on until then, on either side.
    env_steps: [u64; 2],
    /// The digests.
    digests: [Digest; 2],
}

impl Comparison {
    /// Compares what both have. Each side counts upwards without gaps; `b` may begin later.
    fn of(a: &[Iteration], b: &[Iteration]) -> Self {
        let from = b.first().map_or(u64::MAX, |first| first.iteration);
        let pairs = || a.iter().skip_while(|line| line.iteration < from).zip(b);
        let parting = pairs().find(|(a, b)| a.digest != b.digest).map(|(a, b)| Parting {
            iteration: a.iteration,
            env_steps: [a.env_steps, b.env_steps],
            digests: [a.digest, b.digest],
        });
        let common = pairs().count() as u64;
        let agreeing = parting.map_or(common, |parting| parting.iteration - from);
        Self { common, agreeing, parting }
    }

    fn sentence(&self, names: [&str; 2]) -> String {
        let Some(Parting { iteration, env_steps, digests }) = self.parting else {
            return format!("the same for {}; none differs", iterations(self.agreeing));
        };
        let width = names.map(|name| name.chars().count()).into_iter().max().unwrap_or(0);
        let side = |i: usize| {
            let state = format!("{}  {} env-steps", digests[i], grouped(env_steps[i]));
            // Beside long names there is no room.
            if width + state.len() + 4 <= output::COLUMNS {
                format!("  {:width$}  {state}", names[i])
            } else {
                format!("  {}\n    {state}", names[i])
            }
        };
        format!(
            "the same for {}, then they part at iteration {iteration}:\n{}\n{}",
            iterations(self.agreeing),
            side(0),
            side(1)
        )
    }
}

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

/// The differences of provenance as a table below an empty line, or nothing.
fn provenance_table(differences: &[ProvenanceDifference], sides: [&str; 2]) -> String {
    if differences.is_empty() {
        return String::new();
    }
    let joined = |values: &std::collections::BTreeSet<String>| {
        values.iter().map(String::as_str).collect::<Vec<_>>().join(" | ")
    };
    let rows = differences
        .iter()
        .map(|difference| [difference.field.into(), joined(&difference.a), joined(&difference.b)]);
    format!("\n\n{}", output::table(["provenance", sides[0], sides[1]], rows))
}

/// What the promise says to a result.
fn promise(promised: bool, same: bool, gpu: bool) -> String {
    let sentence = match (promised, same) {
        (true, true) => return String::new(),
        (true, false) => {
            "The same bits are promised here: either a file was changed, or this is a defect of \
             SpaceOctopus that its authors want to know of."
        }
        (false, true) if gpu => "The same bits are not promised on a GPU; here they are the same.",
        (false, false) if gpu => "The same bits are not promised on a GPU.",
        (false, true) => "With these differences the same bits are not promised; here they are.",
        (false, false) => "With these differences the same bits are not promised.",
    };
    format!("\n\n{}", output::wrap(sentence))
}

/// `1 iteration`, `2 iterations`.
fn iterations(count: u64) -> String {
    output::counted(count, "iteration")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Iterations from `first` on whose digests are filled with the given bytes.
    fn lines(first: u64, digests: &[u8]) -> Vec<Iteration> {
        let line = |(iteration, &byte): (u64, &u8)| Iteration {
            iteration,
            env_steps: 8 * (iteration + 1),
            digest: Digest([byte; 16]),
        };
        (first..).zip(digests).map(line).collect()
    }

    #[test]
    fn the_first_of_several_differences_is_named() {
        let comparison = Comparison::of(&lines(0, &[1, 2, 3, 4]), &lines(0, &[1, 2, 9, 4, 5]));
        assert_eq!((comparison.common, comparison.agreeing), (4, 2));
        let parting = comparison.parting.expect("they differ");
        assert_eq!((parting.iteration, parting.env_steps), (2, [24, 24]));
        assert_eq!(parting.digests, [Digest([3; 16]), Digest([9; 16])]);
    }

    #[test]
    fn a_repetition_that_begins_later_is_compared_from_there() {
        let all = lines(0, &[1, 2, 3, 4]);
        let comparison = Comparison::of(&all, &lines(2, &[3, 4]));
        assert_eq!(comparison, Comparison { common: 2, agreeing: 2, parting: None });
        let comparison = Comparison::of(&all, &lines(2, &[3, 9]));
        assert_eq!((comparison.agreeing, comparison.parting.map(|p| p.iteration)), (1, Some(3)));
    }

    #[test]
    fn a_difference_is_shown_with_both_digests() {
        let comparison = Comparison::of(&lines(0, &[1, 2]), &lines(0, &[1, 3]));
        let digest = |byte: &str| byte.repeat(16);
        assert_eq!(
            comparison.sentence(["runs/a", "b"]),
            format!(
                "the same for 1 iteration, then they part at iteration 1:\n  runs/a  {}  16 env-steps\n  \
                 b       {}  16 env-steps",
                digest("02"),
                digest("03")
            )
        );
        let long = "runs/trajectory-20261124-with-another-seed";
        let sentence = comparison.sentence([long, "b"]);
        assert!(sentence.contains(&format!("  {long}\n    {}", digest("02"))), "{sentence}");
        assert!(sentence.lines().all(|line| line.chars().count() <= 80), "{sentence}");
    }
}
