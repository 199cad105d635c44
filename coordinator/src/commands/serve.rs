//! `octopus serve`: checkpoints of a directory over HTTP, without a run.

use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use output::counted;
use proto::{ExitCode, ExitError};
use run::signals::StopRequests;
use serde_json::json;
use service::http::{Limits, OwnToken, STORE_TOKEN_FILE, Service, ServiceSpec, Token};
use store::checkpoint::CheckpointStore;

use crate::cli::serve::ServeArgs;
use super::checkpoints::store_to_fill;

/// How often to look whether the user wants to stop.
const TICK: Duration = Duration::from_millis(50);

/// Serves until Ctrl-C.
pub fn run(args: &ServeArgs) -> anyhow::Result<()> {
    let token = Token::find(args.token_file.as_deref())?;
    let store = store(&args.store, args.create)?;
    let root = store.root().to_owned();
    let checkpoints = store.survey()?.entries.len();
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once").context("signals cannot be caught")?;
    let mut own = OwnToken::prepare(root.join(STORE_TOKEN_FILE))?;
    let service = Service::start(ServiceSpec {
        address: args.listen,
        token,
        limits: Limits { upload_bytes: args.max_upload, ..Limits::default() },
        ..ServiceSpec::new(store, own.token())
    })?;
    own.keep()?;
    let address = service.address();
    if args.json {
        output::json_line(&json!({
            "address": address,
            "store": root,
            "checkpoints": checkpoints,
            "token_file": own.path(),
        }))?;
    } else {
        let holds = counted(checkpoints as u64, "checkpoint");
        output::line(&format!(
            "http://{address} serves {}: {holds}; the token is in {}",
            root.display(),
            own.path().display()
        ))?;
    }
    while stop.count() == 0 {
        if !service.is_running() {
            return Err(ExitError::new(
                ExitCode::Failure,
                "the HTTP service has ended by itself; RUST_LOG=debug shows more",
            )
            .into());
        }
        std::thread::sleep(TICK);
    }
    service.stop();
    Ok(())
}

/// The store that `path` means, made if that is wanted. Files of the service and uploads go into it, so it is no
/// directory that holds other things.
fn store(path: &Path, create: bool) -> anyhow::Result<CheckpointStore> {
    let failure =
        |what: &str| ExitError::new(ExitCode::RunDirectory, format!("{}: {what}", path.display()));
    if path.exists() && !path.is_dir() {
        return Err(failure("is no directory").into());
    }
    if !path.exists() && !create {
        return Err(failure("does not exist; --create makes it").into());
    }
    let store = store_to_fill("--store", path, None)?;
    std::fs::create_dir_all(store.root())
        .map_err(|error| failure(&format!("cannot be made: {error}")))?;
    Ok(store)
}
