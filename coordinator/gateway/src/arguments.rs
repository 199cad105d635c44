//! What a gateway is started with.

use proto::agents::Joints;
use proto::{ExitCode, ExitError};
use std::path::PathBuf;

/// Carries orders, blocks and policies between machines; started by `octopus`, not by hand.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "gateway", version)]
pub struct Arguments {
    /// Which end of the network it is.
    #[command(subcommand)]
    pub role: Role,
}

/// Which end of the network it is.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Role {
    /// The learner's end.
    Hub(HubArguments),
    /// The end where the workers are.
    Host(HostArguments),
}

/// Options of the learner's end.
#[derive(Debug, Clone, clap::Args)]
pub struct HubArguments {
    /// Where hosts are waited for: quic/ADDRESS:PORT or tcp/ADDRESS:PORT, several with commas between them.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: String,
    /// Certificates of the run and of the hosts that may join, for quic.
    #[arg(long, value_name = "DIR")]
    pub certificates: Option<PathBuf>,
    /// Joints of each arm of the robot.
    #[arg(long, value_name = "N,…", value_delimiter = ',')]
    pub joints: Vec<usize>,
    /// The program that hosts must have, too.
    #[arg(long, value_name = "FILE")]
    pub sim_worker: PathBuf,
    /// The type of this machine's processor.
    #[arg(long, value_name = "TEXT")]
    pub processor: String,
    /// How often this gateway was started before.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub incarnation: u32,
    /// Run directory, holding config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Name under which the run's shared memory lives.
    #[arg(long, value_name = "NAME")]
    pub domain: String,
    /// Process that started this one: the gateway does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

/// Options of the workers' end. What it says to who started it stands in [`proto::gateway`].
#[derive(Debug, Clone, clap::Args)]
pub struct HostArguments {
    /// Where the run is: quic/HOST:PORT or tcp/ADDRESS:PORT.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: String,
    /// Certificates of the authority and of this machine, for quic.
    #[arg(long, value_name = "DIR")]
    pub certificates: Option<PathBuf>,
    /// Workers of this machine.
    #[arg(long, value_name = "N")]
    pub workers: u32,
    /// What this machine calls itself.
    #[arg(long, value_name = "NAME")]
    pub name: String,
    /// The type of this machine's processor.
    #[arg(long, value_name = "TEXT")]
    pub processor: String,
    /// How long the run may be silent (s).
    #[arg(long, value_name = "S")]
    pub wait: f64,
    /// The program that the workers run.
    #[arg(long, value_name = "FILE")]
    pub sim_worker: PathBuf,
    /// Directory in which config.toml and robot.toml of the run are put down.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Process that started this one: the gateway does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

/// What it was told of the robot's joints.
pub(crate) fn joints_of(told: &[usize]) -> Result<Joints, ExitError> {
    Joints::of_outside(told).ok_or_else(|| {
        let found = format!("arms of {told:?} joints, expected 1 to 8 arms of 2 to 7 each");
        ExitError::new(ExitCode::BadInput, found)
    })
}
