//! `verify` and `diff`.

use proto::{ExitCode, ExitError};

use super::listing::size;
use crate::checkpoint::{Difference, Selector, Verification, compare, store_at};
use crate::cli::checkpoints::{DiffArgs, VerifyArgs};
use crate::commands::NotTheSame;
use crate::output;
use crate::output::counted;

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
    let message = match found.len() {
        1 => "the checkpoint is damaged".to_owned(),
        all => {
            let are = if damaged == 1 { "is" } else { "are" };
            format!("{damaged} of {all} checkpoints {are} damaged")
        }
    };
    Err(ExitError::new(ExitCode::RunDirectory, message).into())
}

/// Checks what a selector means: one checkpoint, or all of a store.
fn examine(selector: &Selector) -> anyhow::Result<Vec<Verification>> {
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
    let (a, b) = (args.a.open()?, args.b.open()?);
    let difference = compare(&a, &b)?;
    if args.json {
        output::json(&difference)?;
    } else {
        output::line(&tell(&difference))?;
    }
    if difference.same {
        return Ok(());
    }
    Err(NotTheSame.into())
}

fn tell(difference: &Difference) -> String {
    let Difference { same, config, same_robot, equal_tensors, tensors } = difference;
    if *same {
        return format!("the same: configuration, robot and all {equal_tensors} tensors");
    }
    let or_dash = |value: &Option<String>| value.clone().unwrap_or_else(|| "-".to_owned());
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |x| format!("{x:.3e}"));
    let mut parts = Vec::new();
    if !config.is_empty() {
        let rows = config.iter().map(|key| [key.key.clone(), or_dash(&key.a), or_dash(&key.b)]);
        parts.push(output::table(["configuration", "A", "B"], rows));
    }
    if !same_robot {
        parts.push("the robots differ".to_owned());
    }
    if !tensors.is_empty() {
        let rows = tensors.iter().map(|tensor| {
            let shape = if tensor.a == tensor.b {
                or_dash(&tensor.a)
            } else {
                format!("{} | {}", or_dash(&tensor.a), or_dash(&tensor.b))
            };
            [tensor.tensor.clone(), shape, number(tensor.max_abs), number(tensor.norm)]
        });
        parts.push(output::table(["tensor", "type and shape (A | B)", "max |Δ|", "‖Δ‖"], rows));
    }
    let are = if *equal_tensors == 1 { "is" } else { "are" };
    let differ = if tensors.len() == 1 { "differs" } else { "differ" };
    let equal = counted(*equal_tensors as u64, "tensor");
    parts.push(format!("{equal} {are} equal, {} {differ}", tensors.len()));
    parts.join("\n\n")
}
