//! `compose`.

use output::counted;
use proto::{ExitCode, ExitError};
use store::checkpoint::{Composition, Name, Part, Parts};
use store::provenance::Provenance;

use super::common::{refused, report, store_to_fill};
use crate::checkpoints::options::{ComposeArgs, given_twice};

/// Builds one policy set from the arms of several checkpoints.
pub(super) fn compose(args: &ComposeArgs) -> anyhow::Result<()> {
    let usage = |message: String| ExitError::new(ExitCode::Usage, message);
    let out = &args.out;
    let name = out.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let name: Name =
        name.parse().map_err(|error| usage(format!("--out {}: {error}", out.display())))?;
    // A name alone would make this directory a store, which few mean.
    let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) else {
        return Err(usage(format!(
            "--out {name}: wants STORE/NAME, such as shared/{name}; ./{name} makes this directory \
             the store"
        ))
        .into());
    };
    let arms: Vec<usize> = args.arms.iter().flat_map(|from| from.arms.clone()).collect();
    if let Some(arm) = given_twice(&arms) {
        let message = format!("--arm: arm {} is given twice; give every arm once", arm + 1);
        return Err(usage(message).into());
    }
    let store = store_to_fill("--out", out, parent, Some(args.force))?;
    let mut parts = Vec::new();
    for from in &args.arms {
        parts.push(Part { arms: from.arms.clone(), checkpoint: from.checkpoint.open()? });
    }
    let parts = Parts::new(parts).map_err(refused(ExitCode::Usage))?;
    let composition = Composition::new(&parts).map_err(refused(ExitCode::BadInput))?;
    if !composition.notes.is_empty() {
        let first = parts.parts()[0].checkpoint.dir.display();
        output::note(&format!(
            "note: the parts differ in {}; {first} decides",
            composition.notes.join(", ")
        ));
    }
    let provenance = serde_json::to_value(Provenance::gather())?;
    // It refuses names only.
    let entry =
        store.compose(&name, &composition, &provenance).map_err(refused(ExitCode::Usage))?;
    report(
        &entry,
        args.json,
        &format!("composed of {}", counted(args.arms.len() as u64, "checkpoint")),
    )
}
