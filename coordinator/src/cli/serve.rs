//! Options of `octopus serve` and of commands that talk to a live run.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::values::{address, positive, workers_wanted};

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

const SCALE_EXAMPLES: &str = "\
Examples:
  octopus scale runs/trajectory-20260101-120000 8
  octopus scale runs/trajectory-20260101-120000 auto
  octopus scale runs/trajectory-20260101-120000 1 --json
  octopus scale runs/trajectory-20260101-120000 4 --token-file token.txt

The number of workers changes nothing that is learned. New workers start at once; surplus ones \
leave after the shards that they have begun. A run has room for 16 workers, or for twice as many \
as it was started or resumed with if that is more.";

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

/// Options of `octopus scale`.
#[derive(Debug, Clone, Args)]
#[command(after_help = SCALE_EXAMPLES)]
pub struct ScaleArgs {
    /// The run directory.
    pub run_dir: PathBuf,
    /// Workers from now on, `auto` for one a processor.
    #[arg(value_name = "N|auto", allow_negative_numbers = true, value_parser = workers_wanted)]
    pub workers: u64,
    /// A file with the token to show [default: http.token of the run directory].
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}
