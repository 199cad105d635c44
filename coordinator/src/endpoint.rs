//! Endpoints of the network between machines, and what must be said to open one.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::path::PathBuf;
use std::time::SystemTime;

use ::certificates::examine;
use clap::Args;
use proto::certificates::LEARNER;
use proto::{ExitCode, ExitError};
use run::supervisor::{GatewaySpec, Programs};

use crate::certificates;
use crate::values::{addresses, preferred};

/// How a link is carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carrier {
    /// Encrypted, and both ends show certificates.
    Quic,
    /// As it is.
    Tcp,
}

/// Where a run meets other machines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// How links are carried.
    pub carrier: Carrier,
    /// HOST:PORT as it was given: a certificate is for a name or an address.
    place: String,
    /// All addresses of the name; hosts take any of them.
    addresses: Vec<SocketAddr>,
}

impl std::fmt::Display for Endpoint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.carrier {
            Carrier::Quic => write!(f, "quic/{}", self.place),
            Carrier::Tcp => write!(f, "tcp/{}", self.address()),
        }
    }
}

/// Reads an endpoint.
pub(crate) fn endpoint(text: &str) -> Result<Endpoint, String> {
    let wanted = "wants quic/HOST:PORT or tcp/HOST:PORT, such as quic/192.168.1.2:7447";
    let (carrier, place) = match text.split_once('/') {
        Some(("quic", place)) => (Carrier::Quic, place),
        Some(("tcp", place)) => (Carrier::Tcp, place),
        Some(("tls", _)) => {
            return Err(format!(
                "{wanted}: TLS over TCP is not offered, because the network's links of that kind are \
                 known to damage memory; quic is as safe, over UDP"
            ));
        }
        _ => return Err(wanted.to_owned()),
    };
    let addresses = addresses(place).map_err(|error| format!("{wanted}: {place}: {error}"))?;
    if addresses.iter().any(|address| address.port() == 0) {
        return Err(format!("{wanted}: others must know the port, it cannot be 0"));
    }
    Ok(Endpoint { carrier, place: place.to_owned(), addresses })
}

impl Endpoint {
    /// The address that stands for all of them.
    fn address(&self) -> SocketAddr {
        preferred(&self.addresses)
    }

    /// Refuses a plain one beyond this machine, unless that was said to be wanted, and options that are the other
    /// kind's.
    pub(crate) fn check(
        &self,
        insecure: bool,
        certificates: Option<&PathBuf>,
    ) -> Result<(), ExitError> {
        let message = match (self.carrier, certificates) {
            (Carrier::Quic, _) if insecure => {
                format!("{self}: is encrypted; --insecure is for tcp/HOST:PORT")
            }
            (Carrier::Tcp, Some(_)) => {
                format!("{self}: shows no certificates; --certificates is for quic/HOST:PORT")
            }
            (Carrier::Tcp, None) if !insecure && !self.address().ip().is_loopback() => format!(
                "{self}: leads beyond this machine, where links over TCP are neither encrypted nor is \
                 anybody asked who they are: whoever reaches it can read the run and send it blocks. \
                 Use quic/{} with --certificates, see `octopus certificates`; within a network that \
                 you trust, --insecure allows TCP",
                self.place
            ),
            _ => return Ok(()),
        };
        Err(ExitError::new(ExitCode::Usage, message))
    }

    /// Refuses what cannot be connected to with certificates: the network has no way to name an address of IPv6 in a
    /// certificate.
    pub(crate) fn check_name(&self) -> Result<(), ExitError> {
        if self.carrier == Carrier::Tcp || !self.place.starts_with('[') {
            return Ok(());
        }
        let message = format!(
            "{self}: an encrypted link has a name or an address of IPv4; give the machine a name \
             (/etc/hosts) that its certificate has, too (octopus certificates --learner NAME)"
        );
        Err(ExitError::new(ExitCode::Usage, message))
    }

    /// Where it can be listened at: at its addresses that this machine has. One of IPv6 is passed over where there is no IPv6.
    ///
    /// # Errors
    /// If one of them is taken, or there is none.
    fn listen(&self) -> std::io::Result<String> {
        // A host that is told a name connects by QUIC to its first address, by TCP to the one of IPv4.
        let addresses = match self.carrier {
            Carrier::Quic => self.addresses.clone(),
            Carrier::Tcp => vec![self.address()],
        };
        let mut places = Vec::new();
        let mut missing = None;
        for address in addresses {
            let (carrier, tried) = match self.carrier {
                Carrier::Quic => ("quic", UdpSocket::bind(address).map(drop)),
                Carrier::Tcp => ("tcp", TcpListener::bind(address).map(drop)),
            };
            match tried {
                Ok(()) => places.push(format!("{carrier}/{address}")),
                Err(error) if error.kind() == ErrorKind::AddrInUse => return Err(error),
                Err(error) => missing = Some(error),
            }
        }
        match missing {
            Some(error) if places.is_empty() => Err(error),
            _ => Ok(places.join(",")),
        }
    }
}

/// Help from other machines.
#[derive(Debug, Clone, Default, Args)]
pub struct HostArgs {
    /// Let other machines help by `octopus join`: wait for them at quic/HOST:PORT, or, unencrypted, at
    /// tcp/HOST:PORT.
    #[arg(long, value_name = "ENDPOINT", allow_hyphen_values = true, value_parser = endpoint, help_heading = "Other machines")]
    pub listen_workers: Option<Endpoint>,
    /// A directory of `octopus certificates`, for quic: the learner's pair, and the hosts that may join.
    #[arg(long, value_name = "DIR", requires = "listen_workers", help_heading = "Other machines")]
    pub certificates: Option<PathBuf>,
    /// Allow tcp to other machines: nothing is encrypted, and anybody may join.
    #[arg(long, requires = "listen_workers", help_heading = "Other machines")]
    pub insecure: bool,
}

impl HostArgs {
    /// The gateway that they ask for, if they do; whether it can listen is tried.
    pub(crate) fn gateway(&self) -> Result<Option<GatewaySpec>, ExitError> {
        let Some(endpoint) = &self.listen_workers else { return Ok(None) };
        endpoint.check(self.insecure, self.certificates.as_ref())?;
        if endpoint.carrier == Carrier::Quic {
            let dir = certificates::wanted(self.certificates.as_ref(), &endpoint.to_string())?;
            examine::check(&dir, LEARNER, SystemTime::now())?;
            if examine::hosts(&dir)?.is_empty() {
                output::note(&format!(
                    "note: {}: has no certificate of a host yet; `octopus certificates {} --host NAME` \
                     makes one, also while the run goes on",
                    dir.path().display(),
                    output::quoted(dir.path())
                ));
            }
        }
        let program = Programs::gateway()?;
        let listen = endpoint.listen().map_err(|error| {
            let message = format!(
                "--listen-workers {endpoint}: cannot be listened at: {error}; choose another port, or an \
                 address of this machine"
            );
            ExitError::new(ExitCode::Environment, message)
        })?;
        let certificates = self.certificates.clone();
        Ok(Some(GatewaySpec { program, listen, certificates }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_have_a_carrier_an_address_and_a_port() {
        for text in ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "quic/127.0.0.1:7447"] {
            assert_eq!(endpoint(text).expect("valid").to_string(), text);
        }
        let named = endpoint("quic/localhost:7447").expect("every machine has this name");
        assert_eq!(named.to_string(), "quic/localhost:7447", "a certificate is for a name");
        let place = UdpSocket::bind("127.0.0.1:0").expect("a free port").local_addr();
        let port = place.expect("an address").port();
        let listens = |text: &str| endpoint(&format!("{text}:{port}")).expect("valid").listen();
        let places = listens("quic/localhost").expect("free");
        assert!(places.split(',').any(|place| place.starts_with("quic/127.0.0.1")), "{places}");
        for wrong in ["127.0.0.1:7447", "tcp/127.0.0.1", "tcp/", "udp/1.2.3.4:5", "quic/1.2.3.4:0"]
        {
            assert!(
                endpoint(wrong).is_err_and(|wanted| wanted.contains("quic/HOST:PORT")),
                "{wrong}"
            );
        }
        let never = endpoint("tls/10.0.0.1:7447").expect_err("not offered");
        assert!(never.contains("damage memory") && never.contains("quic"), "{never}");
    }

    #[test]
    fn a_name_is_listened_at_with_all_addresses_that_this_machine_has() {
        let place = UdpSocket::bind("127.0.0.1:0").expect("a free port");
        let here = place.local_addr().expect("an address");
        // An address for documentation (RFC 5737): no machine has it.
        let away: SocketAddr = "192.0.2.1:9".parse().expect("an address");
        let of = |addresses: &[SocketAddr]| {
            let (carrier, place) = (Carrier::Quic, "name:1".to_owned());
            Endpoint { carrier, place, addresses: addresses.to_vec() }.listen()
        };
        assert_eq!(of(&[away, here]).expect_err("taken").kind(), ErrorKind::AddrInUse);
        drop(place);
        assert_eq!(of(&[away, here]).expect("free"), format!("quic/{here}"));
        let other = SocketAddr::new("127.0.0.2".parse().expect("loopback"), here.port());
        assert_eq!(of(&[other, here]).expect("free"), format!("quic/{other},quic/{here}"));
        assert!(of(&[away]).is_err());
    }

    #[test]
    fn beyond_this_machine_needs_a_word_or_certificates() {
        let of = |text| endpoint(text).expect("valid");
        let (here, everywhere) = (of("tcp/127.0.0.1:7447"), of("tcp/0.0.0.0:7447"));
        assert!(here.check(false, None).is_ok() && everywhere.check(true, None).is_ok());
        let refused = everywhere.check(false, None).expect_err("beyond");
        assert_eq!(refused.code, ExitCode::Usage);
        assert!(refused.message.contains("--insecure"), "{refused}");
        assert!(refused.message.contains("quic/0.0.0.0:7447"), "{refused}");
        let dir = PathBuf::from("certs");
        let encrypted = of("quic/0.0.0.0:7447");
        assert!(encrypted.check(false, Some(&dir)).is_ok());
        assert!(encrypted.check(true, Some(&dir)).is_err(), "--insecure is for tcp");
        assert!(here.check(false, Some(&dir)).is_err(), "--certificates are for quic");
        assert!(of("quic/[::1]:7447").check_name().is_err() && here.check_name().is_ok());
    }
}
