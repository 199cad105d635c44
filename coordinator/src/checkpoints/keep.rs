//! `prune`, `rebuild` and `delete`.

use bucket::Bucket;
use output::counted;
use proto::{ExitCode, ExitError};
use store::checkpoint::{CATALOGUE, Name, Retention, store_at};

use crate::checkpoints::from_bucket;
use crate::checkpoints::options::{DeleteArgs, PruneArgs, RebuildArgs};

/// Removes old checkpoints.
pub(super) fn prune(args: &PruneArgs) -> anyhow::Result<()> {
    let retention = Retention {
        latest: args.keep_latest as usize,
        every: args.keep_every.unwrap_or(0),
        best: true,
    };
    let removed = if Bucket::is_named_by(&args.store) {
        from_bucket::prune(&args.store, &retention, args.dry_run)?
    } else {
        let store = store_at(&args.store)?;
        if args.dry_run { store.doomed(&retention)? } else { store.retain(&retention)? }
    };
    if args.json {
        return output::json(&serde_json::json!({ "dry_run": args.dry_run, "removed": removed }));
    }
    let verb = if args.dry_run { "would remove" } else { "removed" };
    if removed.is_empty() {
        return output::line("nothing to remove");
    }
    let lines: Vec<String> = removed.iter().map(|name: &Name| format!("{verb} {name}")).collect();
    output::line(&lines.join("\n"))
}

/// Rebuilds the catalogue.
pub(super) fn rebuild(args: &RebuildArgs) -> anyhow::Result<()> {
    from_bucket::refuse(&args.store)?;
    let store = store_at(&args.store)?;
    let catalogue = store.root().join(CATALOGUE);
    if !catalogue.exists() && store.survey()?.is_empty() {
        let message = format!("{}: holds no checkpoint", store.root().display());
        return Err(ExitError::new(ExitCode::RunDirectory, message).into());
    }
    let checkpoints = store.rebuild()?;
    if args.json {
        return output::json(
            &serde_json::json!({ "catalogue": catalogue, "checkpoints": checkpoints }),
        );
    }
    output::line(&format!("{}: {}", catalogue.display(), counted(checkpoints as u64, "checkpoint")))
}

/// Removes one checkpoint.
pub(super) fn delete(args: &DeleteArgs) -> anyhow::Result<()> {
    let selector = &args.checkpoint;
    if !selector.is_explicit() {
        let message = format!(
            "{selector}: say which checkpoint to remove, as {selector}:50 or as its directory"
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    }
    if let Some((entry, name)) = from_bucket::change(selector, Bucket::delete)? {
        if args.json {
            return output::json(&serde_json::json!({ "removed": name }));
        }
        return output::line(&format!("removed {}", entry.dir.display()));
    }
    let (store, name) = selector.locate()?;
    if args.force {
        store.delete_even_newest(&name)?;
    } else {
        store.delete(&name)?;
    }
    if args.json {
        return output::json(&serde_json::json!({ "removed": name }));
    }
    output::line(&format!("removed {}", store.dir(&name).display()))
}
