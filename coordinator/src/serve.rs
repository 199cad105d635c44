//! `octopus serve`: checkpoints of a directory over HTTP, without a run.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use output::counted;
use proto::{ExitCode, ExitError};
use run::signals::StopRequests;
use serde_json::json;
use service::http::{Limits, OwnToken, STORE_TOKEN_FILE, Service, ServiceSpec, Token};
use store::checkpoint::CheckpointStore;

use crate::checkpoints::common::store_to_fill;
use crate::values::{address, positive};

const SERVE_EXAMPLES: &str = "\
Examples:
  octopus serve --store checkpoints --create
  octopus serve --store runs/trajectory-20260101-120000
  octopus serve --store checkpoints --listen 0.0.0.0:8270 --token-file token.txt
  curl -s -H \"Authorization: Bearer $(cat checkpoints/.http.token)\" \\
      http://127.0.0.1:8270/v1/checkpoints | jq .

GET /openapi.json describes all requests. They need a token in the header `Authorization: Bearer \
TOKEN`: the one that the service makes for itself and keeps in the store's file .http.token, which \
only you can read, or yours, from --token-file or the environment variable SPACEOCTOPUS_TOKEN. \
Beyond this machine it must be yours. There is no TLS: beyond a network that you trust, put a \
proxy with TLS in front. Ctrl-C ends the service.";

/// Options of `octopus serve`.
#[derive(Debug, Clone, Args)]
#[command(after_help = SERVE_EXAMPLES)]
pub struct ServeArgs {
    /// A directory of checkpoints, an empty one, or a run directory.
    #[arg(long, value_name = "DIR")]
    pub store: PathBuf,
    /// Make the directory if it does not exist.
    #[arg(long)]
    pub create: bool,
    /// Where to listen; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", allow_hyphen_values = true, default_value = "127.0.0.1:8270", value_parser = address)]
    pub listen: SocketAddr,
    /// A file with a token that clients may show beside the service's own; needed beyond this machine.
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Largest archive that may be uploaded.
    #[arg(long, value_name = "BYTES", default_value_t = 4 << 30, allow_hyphen_values = true, value_parser = positive)]
    pub max_upload: u64,
    /// Print the address as JSON.
    #[arg(long)]
    pub json: bool,
}

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
