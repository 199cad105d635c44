//! `octopus join`: this machine helps a run of another one.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use ::certificates::examine;
use clap::Args;
use run::join::{JoinSpec, Left, join};
use run::signals::StopRequests;
use run::supervisor::Programs;

use crate::certificates;
use crate::endpoint::{Carrier, Endpoint, endpoint};
use crate::values::{duration, workers};

const JOIN_EXAMPLES: &str = "\
Examples:
  octopus join quic/192.168.1.2:7447 --certificates certs
  octopus join quic/learner.example:7447 --certificates certs --wait 1h
  octopus join tcp/127.0.0.1:7447 --name lab-2

The run is one that `octopus train --listen-workers` or `octopus resume --listen-workers` opened. \
Its configuration and robot come from there; the programs must be of the same build, or the machine \
is refused with exit code 4. So is one whose certificate the run does not accept. It may come and go at any time, and changes nothing that is learned. \
It ends when the run does. One that was stopped by a signal before its budget was done, or is not heard of, is waited for; \
after --wait it is given up with exit code 1. One Ctrl-C leaves.";

/// Options of `octopus join`.
#[derive(Debug, Clone, Args)]
#[command(after_help = JOIN_EXAMPLES)]
pub struct JoinArgs {
    /// Where the run waits for other machines: quic/HOST:PORT or tcp/HOST:PORT.
    #[arg(value_name = "ENDPOINT", allow_hyphen_values = true, value_parser = endpoint)]
    pub endpoint: Endpoint,
    /// Simulator processes, `auto` for one a processor.
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, default_value = "auto", value_parser = workers)]
    pub workers: u64,
    /// What the run calls this machine [default: its host name; with certificates, the only host in DIR
    /// of which there is a key].
    #[arg(long, value_name = "NAME", allow_negative_numbers = true)]
    pub name: Option<String>,
    /// How long a run is waited for, at first and when it is not heard any more.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, default_value = "30s", value_parser = duration)]
    pub wait: Duration,
    /// A directory with authority.pem and this machine's certificate and key, for quic.
    #[arg(long, value_name = "DIR")]
    pub certificates: Option<PathBuf>,
    /// Allow tcp to another machine: nothing is encrypted, and nobody shows who they are.
    #[arg(long)]
    pub insecure: bool,
}

/// Helps until the run is over.
pub fn run(args: &JoinArgs) -> anyhow::Result<()> {
    args.endpoint.check(args.insecure, args.certificates.as_ref())?;
    args.endpoint.check_name()?;
    let name = match args.endpoint.carrier {
        Carrier::Tcp => args.name.clone().unwrap_or_else(host_name),
        Carrier::Quic => {
            let dir = certificates::wanted(args.certificates.as_ref(), &args.endpoint.to_string())?;
            let name = examine::own_host(&dir, args.name.as_deref())?;
            examine::check(&dir, &name, SystemTime::now())?;
            name
        }
    };
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once")?;
    let spec = JoinSpec {
        endpoint: args.endpoint.to_string(),
        certificates: args.certificates.clone(),
        workers: args.workers as usize,
        name,
        wait: args.wait,
        gateway: Programs::gateway()?,
        programs: Programs::without_learner()?,
        stop,
    };
    let left = join(&spec, &mut |text| output::note(text))?;
    output::note(match left {
        Left::Over => "the run is over",
        Left::Asked => "left the run",
    });
    Ok(())
}

fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}
