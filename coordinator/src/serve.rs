//! `octopus serve`: checkpoints of a directory over HTTP, without a run.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use bucket::replica::Replica;
use bucket::{Bucket, BucketError};
use clap::Args;
use output::counted;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::signals::StopRequests;
use serde_json::json;
use service::http::{
    Limits, OwnToken, STORE_TOKEN_FILE, Service, ServiceSpec, TOKEN_VARIABLE, Token,
};
use store::checkpoint::CheckpointStore;
use store::runs::runs_in;

use crate::checkpoints::common::store_to_fill;
use crate::checkpoints::from_bucket;
use crate::values::{address, positive};

const SERVE_EXAMPLES: &str = "\
Examples:
  octopus serve --store checkpoints --create
  octopus serve --store runs/trajectory-20260101-120000
  octopus serve --runs runs
  octopus serve --store s3://bucket/prefix
  octopus serve --store checkpoints --listen 0.0.0.0:8270 --token-file token.txt
  curl -s -H \"Authorization: Bearer $(cat checkpoints/.http.token)\" \\
      http://127.0.0.1:8270/v1/checkpoints | jq .

GET /openapi.json describes all requests. They need a token in the header `Authorization: Bearer \
TOKEN`: the one that the service makes for itself and keeps in the store's file .http.token, which \
only you can read, or yours, from --token-file or the environment variable SPACEOCTOPUS_TOKEN. \
Beyond this machine it must be yours. With --read-only or --runs, and a token of yours, it writes \
none. There is no TLS: beyond a network that you trust, put a proxy with TLS in front. Of a bucket \
a copy is shown, which follows it and which nobody can change. Ctrl-C ends the service.";

/// Options of `octopus serve`.
#[derive(Debug, Clone, Args)]
#[command(after_help = SERVE_EXAMPLES)]
pub struct ServeArgs {
    /// A directory of checkpoints, an empty one, a run directory, or a bucket.
    #[arg(long, value_name = "DIR|BUCKET", required_unless_present = "runs")]
    pub store: Option<PathBuf>,
    /// Make the directory if it does not exist.
    #[arg(long, conflicts_with = "runs")]
    pub create: bool,
    /// A directory of runs, which are shown side by side, for looking only.
    #[arg(long, value_name = "DIR", conflicts_with = "store")]
    pub runs: Option<PathBuf>,
    /// Show everything and change nothing, whoever asks.
    #[arg(long)]
    pub read_only: bool,
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

/// What helps where the token of a service that only shows cannot be kept.
const CURE: &str = "; give a token by --token-file FILE, and none is written";

/// How often to look whether the user wants to stop.
const TICK: Duration = Duration::from_millis(50);

/// Serves until Ctrl-C.
pub fn run(args: &ServeArgs) -> anyhow::Result<()> {
    let token = Token::find(args.token_file.as_deref())?;
    let Served { store, root, runs, holds, replica } = served(args)?;
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once").context("signals cannot be caught")?;
    let mut own = OwnToken::prepare(root.join(STORE_TOKEN_FILE))?;
    let (changes_nothing, is_chosen) = (args.read_only || runs.is_some(), token.is_some());
    let service = Service::start(ServiceSpec {
        address: args.listen,
        token,
        runs,
        read_only: args.read_only || replica.is_some(),
        limits: Limits { upload_bytes: args.max_upload, ..Limits::default() },
        ..ServiceSpec::new(store, own.token())
    })?;
    let token_file = if changes_nothing && is_chosen && !own.is_kept() {
        // Whoever has a token may look, and nothing is written where perhaps nothing can be.
        args.token_file.clone()
    } else {
        own.keep().map_err(|error| {
            let cure = if changes_nothing { CURE } else { "" };
            ExitError::new(error.code, format!("{}{cure}", error.message))
        })?;
        Some(own.path().to_owned())
    };
    let address = service.address();
    let (what, count) = holds;
    let shown = match &replica {
        Some(replica) => PathBuf::from(replica.bucket().address()),
        None => root,
    };
    if args.json {
        let place = if args.runs.is_some() { "runs_dir" } else { "store" };
        output::json_line(&json!({
            "address": address,
            place: shown,
            (format!("{what}s")): count,
            "token_file": token_file,
        }))?;
    } else {
        let place =
            token_file.map_or_else(|| TOKEN_VARIABLE.to_owned(), |path| path.display().to_string());
        output::line(&format!(
            "http://{address} serves {}: {}; the token is in {place}",
            shown.display(),
            counted(count as u64, what),
        ))?;
    }
    let follower = replica.map(Follower::start);
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
    drop(follower);
    Ok(())
}

/// How often a bucket is looked at.
const FOLLOW: Duration = Duration::from_secs(10);

/// The thread that keeps a copy of a bucket as the bucket is. It ends when this is dropped.
struct Follower(Option<(Sender<()>, JoinHandle<()>)>);

impl Follower {
    fn start(mut replica: Replica) -> Self {
        let (end, ended) = channel();
        let thread = std::thread::spawn(move || {
            let mut trouble = None;
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(FOLLOW) {
                let now = match replica.refresh() {
                    Ok(damaged) => damaged.into_iter().next(),
                    Err(error) => Some(error.to_string()),
                };
                // Once each.
                if now != trouble
                    && let Some(told) = &now
                {
                    tracing::warn!("the bucket is not shown as it is now: {told}");
                }
                trouble = now;
            }
        });
        Self(Some((end, thread)))
    }
}

impl Drop for Follower {
    fn drop(&mut self) {
        if let Some((end, thread)) = self.0.take() {
            drop(end);
            // Its copy goes away with it; a panic was its own.
            let _ = thread.join();
        }
    }
}

/// What is served.
struct Served {
    store: CheckpointStore,
    root: PathBuf,
    runs: Option<PathBuf>,
    /// How many of what it is.
    holds: (&'static str, usize),
    /// The bucket that the store is a copy of.
    replica: Option<Replica>,
}

fn served(args: &ServeArgs) -> anyhow::Result<Served> {
    if let Some(dir) = &args.runs {
        let there = RunDir::new(dir);
        // Somebody's own configuration may lie beside runs.
        if there.config().is_file() && there.robot().is_file() {
            let message = format!(
                "--runs {}: is a run itself, not a directory of them; `octopus view {run}` shows it, and `octopus \
                 serve --store {run}` serves its checkpoints",
                dir.display(),
                run = output::quoted(dir)
            );
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        }
        let runs = runs_in(dir).map_err(|error| {
            let message = format!("{}: cannot be read: {error}", dir.display());
            ExitError::new(ExitCode::RunDirectory, message)
        })?;
        let store = no_store(dir);
        return Ok(Served {
            store,
            root: dir.clone(),
            runs: Some(dir.clone()),
            holds: ("run", runs.len()),
            replica: None,
        });
    }
    let path = args.store.as_ref().context("clap wants one of the two")?;
    if Bucket::is_named_by(path) {
        let mut replica = from_bucket::look(path)?;
        for damaged in replica.fetch_all().map_err(BucketError::exit)? {
            output::note(&format!("warning: {damaged}; it is not shown"));
        }
        let store = replica.store();
        let (root, count) = (store.root().to_owned(), store.survey()?.entries.len());
        let holds = ("checkpoint", count);
        return Ok(Served { store, root, runs: None, holds, replica: Some(replica) });
    }
    let store = store(path, args.create)?;
    let root = store.root().to_owned();
    let count = store.survey()?.entries.len();
    Ok(Served { store, root, runs: None, holds: ("checkpoint", count), replica: None })
}

/// A directory of runs has no checkpoints of its own.
pub(crate) fn no_store(dir: &Path) -> CheckpointStore {
    CheckpointStore::new(RunDir::new(dir).checkpoints())
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
    let store = store_to_fill("--store", path, path, None)?;
    std::fs::create_dir_all(store.root())
        .map_err(|error| failure(&format!("cannot be made: {error}")))?;
    Ok(store)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: ServeArgs,
    }

    #[test]
    fn hidden_directories_are_no_runs_and_a_run_is_no_directory_of_them() {
        let dir = tempfile::tempdir().expect("tempdir");
        for run in ["a", ".b"] {
            std::fs::create_dir(dir.path().join(run)).expect("made");
            std::fs::write(RunDir::new(dir.path().join(run)).config(), "").expect("written");
        }
        let served = |dir: &Path| {
            let runs = format!("--runs={}", dir.display());
            served(&Line::try_parse_from(["serve", &runs]).expect("valid").args)
        };
        assert_eq!(served(dir.path()).expect("runs").holds, ("run", 1));
        std::fs::write(RunDir::new(dir.path()).config(), "").expect("written");
        assert_eq!(served(dir.path()).expect("runs").holds, ("run", 1));
        std::fs::write(RunDir::new(dir.path().join("a")).robot(), "").expect("written");
        let told = served(&dir.path().join("a")).map(|_| ()).expect_err("a run").to_string();
        assert!(told.contains("is a run itself") && told.contains("octopus view"), "{told}");
    }
}
