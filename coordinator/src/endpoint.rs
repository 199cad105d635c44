//! Endpoints of the network between machines, and what must be said to open one.

use std::net::{SocketAddr, TcpListener};

use clap::Args;
use proto::{ExitCode, ExitError};
use run::supervisor::{GatewaySpec, Programs};

use crate::values::address;

/// Where a run meets other machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Endpoint(SocketAddr);

impl std::fmt::Display for Endpoint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "tcp/{}", self.0)
    }
}

/// Reads an endpoint.
pub(crate) fn endpoint(text: &str) -> Result<Endpoint, String> {
    let wanted = "wants tcp/ADDRESS:PORT, such as tcp/192.168.1.2:7447";
    match text.split_once('/') {
        Some(("tcp", rest)) => {
            let address = address(rest).map_err(|error| format!("{wanted}: {rest}: {error}"))?;
            if address.port() == 0 {
                return Err(format!("{wanted}: others must know the port, it cannot be 0"));
            }
            Ok(Endpoint(address))
        }
        Some(("quic" | "tls", _)) => Err(format!("{wanted}: encrypted links are not there yet")),
        _ => Err(wanted.to_owned()),
    }
}

impl Endpoint {
    /// Refuses one beyond this machine, unless that was said to be wanted.
    pub(crate) fn check(self, insecure: bool) -> Result<(), ExitError> {
        if insecure || self.0.ip().is_loopback() {
            return Ok(());
        }
        let message = format!(
            "{self}: leads beyond this machine, where links are neither encrypted nor is anybody asked who \
             they are: whoever reaches it can read the run and send it blocks. Within a network that you \
             trust, --insecure allows that; elsewhere use a tunnel (ssh -L, WireGuard) to an endpoint on \
             127.0.0.1"
        );
        Err(ExitError::new(ExitCode::Usage, message))
    }
}

/// Help from other machines.
#[derive(Debug, Clone, Default, Args)]
pub struct HostArgs {
    /// Let other machines help by `octopus join`: wait for them at tcp/ADDRESS:PORT.
    #[arg(long, value_name = "ENDPOINT", allow_hyphen_values = true, value_parser = endpoint, help_heading = "Other machines")]
    pub listen_workers: Option<Endpoint>,
    /// Let that be beyond this machine, although links are neither encrypted nor authenticated yet.
    #[arg(long, requires = "listen_workers", help_heading = "Other machines")]
    pub insecure: bool,
}

impl HostArgs {
    /// The gateway that they ask for, if they do; whether it can listen is tried.
    pub(crate) fn gateway(&self) -> Result<Option<GatewaySpec>, ExitError> {
        let Some(endpoint) = self.listen_workers else { return Ok(None) };
        endpoint.check(self.insecure)?;
        let program = Programs::gateway()?;
        if let Err(error) = TcpListener::bind(endpoint.0) {
            let message = format!(
                "--listen-workers {endpoint}: cannot be listened at: {error}; choose another port, or an \
                 address of this machine"
            );
            return Err(ExitError::new(ExitCode::Environment, message));
        }
        Ok(Some(GatewaySpec { program, listen: endpoint.to_string() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_are_tcp_with_an_address_and_a_port() {
        assert_eq!(
            endpoint("tcp/127.0.0.1:7447").expect("valid").to_string(),
            "tcp/127.0.0.1:7447"
        );
        assert_eq!(endpoint("tcp/[::1]:7447").expect("valid").to_string(), "tcp/[::1]:7447");
        for wrong in ["127.0.0.1:7447", "tcp/127.0.0.1", "tcp/", "udp/1.2.3.4:5", "tcp/1.2.3.4:0"] {
            assert!(
                endpoint(wrong).is_err_and(|wanted| wanted.contains("tcp/ADDRESS:PORT")),
                "{wrong}"
            );
        }
        let later = endpoint("quic/10.0.0.1:7447").expect_err("later");
        assert!(later.contains("not there yet"), "{later}");
    }

    #[test]
    fn beyond_this_machine_needs_a_word() {
        let here = endpoint("tcp/127.0.0.1:7447").expect("valid");
        let everywhere = endpoint("tcp/0.0.0.0:7447").expect("valid");
        assert!(here.check(false).is_ok() && everywhere.check(true).is_ok());
        let refused = everywhere.check(false).expect_err("beyond");
        assert_eq!(refused.code, ExitCode::Usage);
        assert!(refused.message.contains("--insecure"), "{refused}");
    }
}
