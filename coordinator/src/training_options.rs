//! Options that `octopus train` and `octopus resume` share.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use proto::run_dir::RunDir;
use run::start::service::RunService;

use crate::values::{Listen, duration, listen, positive};

/// When to stop; at most one of them.
#[derive(Debug, Clone, Default, Args)]
#[group(multiple = false)]
pub struct Limits {
    /// Stop after this many iterations.
    #[arg(long, alias = "iters", value_name = "N", allow_hyphen_values = true, value_parser = positive, help_heading = "Limits")]
    pub iterations: Option<u64>,
    /// Stop after this many env-steps, rounded up to whole iterations: 2000000, 2e6.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = positive, help_heading = "Limits")]
    pub env_steps: Option<u64>,
    /// Stop after this much time: 90s, 10m, 1h30m. Changes nothing that is learned until then.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = duration, help_heading = "Limits")]
    pub time_limit: Option<Duration>,
}

/// A stop on the way to the limit.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct Pause {
    /// Pause when this many iterations of the run are done, with a checkpoint, from which `octopus
    /// resume` goes on. Schedules run over the whole budget all the same.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = positive, help_heading = "Limits")]
    pub pause_at: Option<u64>,
}

/// What a program says that starts a training.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct Parent {
    /// The process that started this one and that it shall not outlive.
    #[arg(long, value_name = "PID", hide = true)]
    pub parent: Option<i32>,
}

impl Parent {
    /// Ties this process to the one that started it, if that has said so.
    pub(crate) fn tie(self) -> anyhow::Result<()> {
        if self.parent.is_some() {
            process::child::die_with_parent(self.parent)?;
        }
        Ok(())
    }
}

/// The HTTP service beside a run, by which `octopus status` and `octopus scale` reach it.
#[derive(Debug, Clone, Args)]
pub struct HttpArgs {
    /// Where it listens; port 0 takes a free one; `off` has none.
    #[arg(long, value_name = "ADDRESS:PORT|off", allow_hyphen_values = true, default_value = "127.0.0.1:0", value_parser = listen, help_heading = "Service")]
    pub listen: Listen,
    /// A file with a token that clients may show beside the run's own; needed beyond this machine.
    #[arg(long, value_name = "FILE", help_heading = "Service")]
    pub token_file: Option<PathBuf>,
    /// Let it show everything and change nothing, whoever asks; `octopus scale` is refused, too.
    #[arg(long, help_heading = "Service")]
    pub read_only: bool,
}

/// What happens around a training.
#[derive(Debug, Clone, Copy, Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
pub struct Ending {
    /// Evaluate the final policy (the default; undoes an earlier --no-eval).
    #[arg(long, overrides_with = "no_eval")]
    pub eval: bool,
    /// Leave the evaluation of the final policy out.
    #[arg(long)]
    pub no_eval: bool,
    /// Show the final errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
    /// Show no progress.
    #[arg(long, short)]
    pub quiet: bool,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

impl HttpArgs {
    /// Opens the service that they ask for.
    pub(crate) fn open(&self, run_dir: &RunDir) -> anyhow::Result<RunService> {
        let address = match self.listen {
            Listen::Off => None,
            Listen::At(address) => Some(address),
        };
        RunService::open(address, self.token_file.as_deref(), self.read_only, run_dir)
    }
}
