//! What a worker is started with.

use std::path::PathBuf;

/// Rolls out policies for a SpaceOctopus run; started by `octopus`, not by hand.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "sim-worker", version)]
pub struct Arguments {
    /// Run directory, holding config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Number of this worker.
    #[arg(long, value_name = "N")]
    pub worker: u32,
    /// How often this worker was started before.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub incarnation: u32,
    /// Name under which the run's shared memory lives.
    #[arg(long, value_name = "NAME")]
    pub domain: String,
    /// Process that started this one: the worker does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
    /// Processor to stay on, counted among those that this process may use.
    #[arg(long, value_name = "N")]
    pub pin: Option<usize>,
}
