//! `verify` and `diff`.

use bucket::{Bucket, BucketError};
use output::{counted, size};
use proto::{ExitCode, ExitError};
use store::checkpoint::{Checkpoint, Difference, Name, Selector, Verification, compare, store_at};

use crate::checkpoints::from_bucket::{self, Found};
use crate::checkpoints::options::{DiffArgs, VerifyArgs};
use crate::not_the_same::NotTheSame;

/// Checks checkpoints thoroughly.
pub(super) fn verify(args: &VerifyArgs) -> anyhow::Result<()> {
    let mut found = Vec::new();
    for selector in &args.checkpoints {
        found.extend(examine(selector)?);
    }
    if args.json {
        output::json(&found)?;
    } else {
        let lines: Vec<String> = found.iter().map(describe).collect();
        output::line(&lines.join("\n"))?;
    }
    let damaged = found.iter().filter(|checkpoint| !checkpoint.is_whole()).count();
    if damaged == 0 {
        return Ok(());
    }
    let (message, them) = match found.len() {
        1 => ("the checkpoint is damaged".to_owned(), "it"),
        all => {
            let are = if damaged == 1 { "is" } else { "are" };
            (format!("{damaged} of {all} checkpoints {are} damaged"), "those")
        }
    };
    let message =
        format!("{message}; copy {them} again, or take another one (`octopus checkpoints list`)");
    Err(ExitError::new(ExitCode::RunDirectory, message).into())
}

/// Checks what a selector means: one checkpoint, or all of a store.
fn examine(selector: &Selector) -> anyhow::Result<Vec<Verification>> {
    if Bucket::is_named_by(selector.path()) {
        return examine_bucket(selector);
    }
    if selector.is_explicit() {
        let (store, name) = selector.locate()?;
        return Ok(vec![store.verify(&name)?]);
    }
    let store = store_at(selector.path())?;
    let survey = store.survey()?;
    let names = survey.entries.iter().map(|entry| &entry.name);
    let names: Vec<_> = names.chain(survey.damaged.iter().map(|entry| &entry.name)).collect();
    if names.is_empty() {
        let message = format!("{}: holds no checkpoint", store.root().display());
        return Err(ExitError::new(ExitCode::RunDirectory, message).into());
    }
    Ok(names.into_iter().map(|name| store.verify(name)).collect::<Result<_, _>>()?)
}

/// The same of a bucket: every file is brought, and what is not as it was sent is a problem.
fn examine_bucket(selector: &Selector) -> anyhow::Result<Vec<Verification>> {
    let mut replica = from_bucket::look(selector.path())?;
    let survey = replica.survey().map_err(BucketError::exit)?;
    let names: Vec<Name> = match selector.choice() {
        Some(_) => vec![replica.locate(selector).map_err(BucketError::exit)?],
        None => survey.entries.iter().map(|entry| entry.name.clone()).collect(),
    };
    let unreadable = survey.damaged.iter().filter(|_| selector.choice().is_none());
    let problem = |dir, problem| Verification {
        dir,
        files: 0,
        bytes: 0,
        tensors: 0,
        problems: vec![problem],
    };
    let mut found: Vec<Verification> =
        unreadable.map(|entry| problem(entry.dir.clone(), entry.reason.clone())).collect();
    for name in names {
        let dir = replica.bucket().place(&name);
        match replica.fetch(&name) {
            Ok(()) => found.push(Verification { dir, ..replica.store().verify(&name)? }),
            Err(error @ BucketError::Away { .. }) => return Err(error.exit().into()),
            Err(error) => found.push(problem(dir, error.to_string())),
        }
    }
    if found.is_empty() {
        let message = format!("{}: holds no checkpoint", selector.path().display());
        return Err(ExitError::new(ExitCode::RunDirectory, message).into());
    }
    Ok(found)
}

fn describe(found: &Verification) -> String {
    let dir = found.dir.display();
    if found.is_whole() {
        let Verification { files, bytes, tensors, .. } = found;
        return format!(
            "{dir}: whole, {files} files, {}, {}",
            size(*bytes),
            counted(*tensors as u64, "tensor")
        );
    }
    let problems: Vec<String> =
        found.problems.iter().map(|problem| format!("\n  {problem}")).collect();
    format!("{dir}: damaged{}", problems.concat())
}

/// Shows what differs between two checkpoints.
pub(super) fn diff(args: &DiffArgs) -> anyhow::Result<()> {
    let (found_a, found_b) = (open(&args.a)?, open(&args.b)?);
    let (a, b) = (&found_a.0, &found_b.0);
    let difference = compare(a, b)?;
    if args.json {
        output::json(&difference)?;
    } else {
        output::line(&tell(&difference, output::columns()))?;
    }
    if difference.same {
        return Ok(());
    }
    Err(NotTheSame.into())
}

/// A checkpoint, and what was brought for it.
fn open(selector: &Selector) -> anyhow::Result<(Checkpoint, Option<Found>)> {
    if !Bucket::is_named_by(selector.path()) {
        return Ok((selector.open()?, None));
    }
    let found = Found::of(selector)?;
    Ok((found.store.load(&found.store.dir(&found.name))?, Some(found)))
}

/// What differs: first in a sentence, then key by key and tensor by tensor.
fn tell(difference: &Difference, columns: usize) -> String {
    let Difference { config, tensors, .. } = difference;
    let or_dash = |value: &Option<String>| value.clone().unwrap_or_else(|| "-".to_owned());
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |x| format!("{x:.3e}"));
    let mut parts = vec![summary(difference)];
    if !config.is_empty() {
        let rows = config.iter().map(|key| [key.key.clone(), or_dash(&key.a), or_dash(&key.b)]);
        parts.push(output::table_within(columns, ["configuration", "A", "B"], rows));
    }
    if !tensors.is_empty() {
        let rows = tensors.iter().map(|tensor| {
            let shape = if tensor.a == tensor.b {
                or_dash(&tensor.a)
            } else {
                format!("{} | {}", or_dash(&tensor.a), or_dash(&tensor.b))
            };
            let name = tensor.tensor.replacen(".safetensors/", "/", 1);
            [name, shape, number(tensor.max_abs), number(tensor.norm)]
        });
        let header = ["tensor", "type and shape (A | B)", "max |Δ|", "‖Δ‖"];
        parts.push(output::table_within(columns, header, rows));
    }
    parts.join("\n\n")
}

/// All differences in a few words.
fn summary(difference: &Difference) -> String {
    let Difference { same, config, same_robot, equal_tensors, tensors } = difference;
    if *same {
        return format!("the same: configuration, robot and all {equal_tensors} tensors");
    }
    let of = counted((equal_tensors + tensors.len()) as u64, "tensor");
    let largest = tensors.iter().filter_map(|tensor| tensor.max_abs).reduce(f64::max);
    let by = largest.map_or_else(String::new, |largest| format!(", by {largest:.3e} at most"));
    let tensors = match tensors.len() {
        0 => format!("all {of} are the same"),
        differing => format!("{differing} of {of} differ{by}"),
    };
    let config = match config.len() as u64 {
        0 => "the same".to_owned(),
        keys => format!("{} with other values", counted(keys, "key")),
    };
    let robot = if *same_robot { "the same" } else { "another" };
    format!("different\ntensors        {tensors}\nconfiguration  {config}\nrobot          {robot}")
}

#[cfg(test)]
mod tests {
    use store::checkpoint::{KeyDifference, TensorDifference};

    use super::*;

    /// The longest names and shapes that there are.
    fn difference() -> Difference {
        let shape = || Some("F32 [8, 1024, 1024]".to_owned());
        let tensor = |tensor: &str, b: Option<String>, max_abs| TensorDifference {
            tensor: tensor.to_owned(),
            a: shape(),
            b,
            max_abs,
            norm: max_abs,
        };
        let key = "algorithm.maddpg.updates_per_step";
        let paths = ["robots/of-somebody/with-a-long-name.toml", "robots/of-another/other.toml"];
        let of = |key: &str, [a, b]: [&str; 2]| KeyDifference {
            key: key.to_owned(),
            a: Some(a.to_owned()),
            b: Some(b.to_owned()),
        };
        Difference {
            same: false,
            config: vec![of(key, ["0.015625", "0.25"]), of("robot.description", paths)],
            same_robot: false,
            equal_tensors: 3,
            tensors: vec![
                tensor(
                    "state.safetensors/critic.adam.second.hidden.12.weight",
                    shape(),
                    Some(0.25),
                ),
                tensor("policy.safetensors/head.weight", None, None),
            ],
        }
    }

    #[test]
    fn the_summary_stands_first() {
        let text = tell(&difference(), 80);
        let first: Vec<&str> = text.lines().take(5).collect();
        let expected = [
            "different",
            "tensors        2 of 5 tensors differ, by 2.500e-1 at most",
            "configuration  2 keys with other values",
            "robot          another",
            "",
        ];
        assert_eq!(first, expected);
        let nothing = Difference { tensors: Vec::new(), ..difference() };
        assert!(tell(&nothing, 80).contains("all 3 tensors are the same"));
    }

    #[test]
    fn the_tables_fit() {
        let text = tell(&difference(), 80);
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }
}
