//! `octopus janitor`: removes what a killed coordinator leaves; started by every run beside it.

use std::io::BufReader;

use anyhow::Context as _;
use channels::Domain;
use clap::Args;
use run::janitor;

/// Options of the hidden `octopus janitor`.
#[derive(Debug, Clone, Args)]
pub struct JanitorArgs {
    /// The shared memory to remove.
    #[arg(long)]
    pub domain: String,
}

/// Cleans up when the coordinator is gone.
pub fn run(args: &JanitorArgs) -> anyhow::Result<()> {
    let domain = Domain::parse(&args.domain)?;
    janitor::run(&domain, BufReader::new(std::io::stdin())).context("cleaning up failed")
}
