//! A handshake before the network's own, which tells why two machines do not accept each other.
//!
//! The network tries to connect again and again and does not say what fails. Certificates that do not fit will not fit
//! the next time either, so a host shakes hands by itself first: with the same certificates, and then leaves. What it
//! finds is for people alone; the network checks everything once more.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::certificates::{AUTHORITY, CertificateDir};
use proto::{ExitCode, ExitError};
use quinn::crypto::rustls::QuicClientConfig;
use quinn::{ConnectionError, Endpoint, VarInt};
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::{CertificateError, RootCertStore};

use crate::network;
use crate::witness::Witness;

/// How long one try may take; of a run that has just come more is not needed.
const TRY: Duration = Duration::from_secs(3);
/// Pause before the next one.
const PAUSE: Duration = Duration::from_millis(200);
/// What the network's links speak, newest first.
const PROTOCOLS: [&[u8]; 3] = [b"zenoh-ms", b"zenoh", b"hq-29"];
/// Where codes of QUIC begin that are alerts of TLS (RFC 9001, section 4.8).
const ALERTS: u64 = 0x100;

/// Shakes hands with the run at `endpoint`, `quic/HOST:PORT`, as host `name`, until that is done. What is left of `wait`.
///
/// # Errors
/// If one end refuses the other ([`ExitCode::Environment`]), the files cannot be used ([`ExitCode::BadInput`]), or
/// nobody is there for as long as `wait` ([`ExitCode::Failure`]).
pub(crate) fn shake(
    endpoint: &str,
    dir: &CertificateDir,
    name: &str,
    wait: Duration,
) -> Result<Duration, ExitError> {
    let begun = Instant::now();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| {
        ExitError::new(ExitCode::Environment, format!("the network cannot be set up: {error}"))
    })?;
    let address = endpoint.trim_start_matches("quic/");
    let attempt = Attempt { address, dir, name };
    loop {
        let left = wait.saturating_sub(begun.elapsed());
        match runtime.block_on(attempt.make(TRY.min(left)))? {
            Outcome::Accepted => return Ok(wait.saturating_sub(begun.elapsed())),
            Outcome::Refused(why) => {
                return Err(ExitError::new(ExitCode::Environment, format!("{endpoint}: {why}")));
            }
            Outcome::Nobody(error) => tracing::debug!(endpoint, error, "nobody is there"),
        }
        if begun.elapsed() >= wait {
            return Err(network::nobody(endpoint, wait));
        }
        std::thread::sleep(PAUSE);
    }
}

/// What came of a try.
enum Outcome {
    Accepted,
    /// One of both does not accept the other, and why.
    Refused(String),
    /// No answer, or none of a run; the next may be another.
    Nobody(String),
}

struct Attempt<'a> {
    /// HOST:PORT.
    address: &'a str,
    dir: &'a CertificateDir,
    name: &'a str,
}

impl Attempt<'_> {
    async fn make(&self, patience: Duration) -> Result<Outcome, ExitError> {
        let witness = Arc::new(self.witness()?);
        let client = self.client(Arc::clone(&witness))?;
        let found: Vec<SocketAddr> = match tokio::net::lookup_host(self.address).await {
            Ok(found) => found.collect(),
            Err(error) => return Ok(Outcome::Nobody(error.to_string())),
        };
        let Some((&first, others)) = found.split_first() else {
            return Ok(Outcome::Nobody("the name has no address".to_owned()));
        };
        let at = async |to| {
            let outcome = self.connect(to, client.clone(), &witness);
            let outcome = tokio::time::timeout(patience, outcome).await;
            outcome.unwrap_or_else(|_| Outcome::Nobody("no answer".to_owned()))
        };
        let outcome = at(first).await;
        if matches!(outcome, Outcome::Nobody(_)) {
            // The network takes the first address alone.
            for &other in others {
                if matches!(at(other).await, Outcome::Accepted) {
                    return Ok(Outcome::Refused(format!(
                        "this name is {} first, where nobody answers, and the run is at {}; join it at that address, or have it \
                         listen at this name",
                        first.ip(),
                        other.ip()
                    )));
                }
            }
        }
        Ok(outcome)
    }

    async fn connect(
        &self,
        to: SocketAddr,
        client: quinn::ClientConfig,
        witness: &Witness,
    ) -> Outcome {
        let from = match to {
            SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
        };
        let mut endpoint = match Endpoint::client(from) {
            Ok(endpoint) => endpoint,
            Err(error) => return Outcome::Nobody(error.to_string()),
        };
        endpoint.set_default_client_config(client);
        let host = self.address.rsplit_once(':').map_or(self.address, |(host, _)| host);
        let connecting = match endpoint.connect(to, host) {
            Ok(connecting) => connecting,
            Err(error) => return Outcome::Refused(format!("cannot be connected to: {error}")),
        };
        let outcome = match connecting.await {
            Err(error) => self.judge(&error, witness),
            Ok(connection) => {
                // The other end looks at this one's certificate last. It acknowledges nothing before.
                let said = async {
                    let (mut stream, _) = connection.open_bi().await?;
                    let _ = stream.finish();
                    let _ = stream.stopped().await;
                    match connection.close_reason() {
                        Some(error) => Err(error),
                        None => Ok(()),
                    }
                };
                let outcome = match said.await {
                    // Accepted, and then sent away because it has nothing to say.
                    Ok(()) | Err(ConnectionError::ApplicationClosed(_)) => Outcome::Accepted,
                    Err(error) => self.judge(&error, witness),
                };
                connection.close(VarInt::from_u32(0), b"");
                outcome
            }
        };
        endpoint.wait_idle().await;
        outcome
    }

    fn judge(&self, error: &ConnectionError, witness: &Witness) -> Outcome {
        if let Some(why) = witness.verdict() {
            return Outcome::Refused(self.of_the_run(&why));
        }
        let code = match error {
            ConnectionError::ConnectionClosed(close) => u64::from(close.error_code),
            ConnectionError::VersionMismatch => {
                return Outcome::Refused(format!("is no run that this build can join: {error}"));
            }
            _ => return Outcome::Nobody(error.to_string()),
        };
        match code.checked_sub(ALERTS) {
            Some(alert @ 0..=255) => Outcome::Refused(self.of_this_machine(alert, error)),
            _ => Outcome::Nobody(error.to_string()),
        }
    }

    /// What is wrong with the certificate that the run shows.
    fn of_the_run(&self, error: &rustls::Error) -> String {
        let authority = self.dir.certificate(AUTHORITY);
        let rustls::Error::InvalidCertificate(error) = error else {
            return format!("the certificate of the run is refused: {error}");
        };
        match error {
            CertificateError::UnknownIssuer | CertificateError::BadSignature => format!(
                "the certificate of the run is of another authority than {}; all certificates of a \
                 run come from one directory of `octopus certificates`",
                authority.display()
            ),
            CertificateError::Expired => "the certificate of the run has expired".to_owned(),
            CertificateError::ExpiredContext { not_after, .. } => format!(
                "the certificate of the run has expired, on {}; `octopus certificates` makes another \
                 when learner.pem and learner.key are removed",
                date(*not_after)
            ),
            CertificateError::NotValidYet => {
                "the certificate of the run is not valid yet; compare the clocks".to_owned()
            }
            CertificateError::NotValidYetContext { not_before, .. } => format!(
                "the certificate of the run is not valid before {}; compare the clocks of both \
                 machines",
                date(*not_before)
            ),
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
                format!(
                    "the certificate of the run is for other addresses ({error}); it is made for \
                     this one by `octopus certificates --learner`"
                )
            }
            error => format!("the certificate of the run is refused: {error}"),
        }
    }

    /// What is wrong with the certificate of this machine, as far as the run says.
    fn of_this_machine(&self, alert: u64, error: &ConnectionError) -> String {
        let own = self.dir.certificate(self.name);
        let own = own.display();
        // RFC 8446, section 6.2.
        match alert {
            42 | 48 | 51 => format!(
                "the run does not accept {own}: it is of another authority than the run's own \
                 certificate; all certificates of a run come from one directory of `octopus \
                 certificates`"
            ),
            45 => format!(
                "the run does not accept {own}: by the run's clock it has expired, or is not valid yet"
            ),
            120 => format!("is no run that this build can join: {error}"),
            _ => format!("the run does not accept {own}: {error}"),
        }
    }

    /// Looks at the certificate of the run.
    fn witness(&self) -> Result<Witness, ExitError> {
        let path = self.dir.certificate(AUTHORITY);
        let unread = |error: &dyn std::fmt::Display| {
            let message = format!("{}: is no certificate: {error}", path.display());
            ExitError::new(ExitCode::BadInput, message)
        };
        let mut roots = RootCertStore::empty();
        let certificates = CertificateDer::pem_file_iter(&path).map_err(|error| unread(&error))?;
        for certificate in certificates {
            let certificate = certificate.map_err(|error| unread(&error))?;
            roots.add(certificate).map_err(|error| unread(&error))?;
        }
        Witness::new(roots).map_err(|error| unread(&error))
    }

    fn client(&self, witness: Arc<Witness>) -> Result<quinn::ClientConfig, ExitError> {
        let (path, key) = (self.dir.certificate(self.name), self.dir.key(self.name));
        let unread = |path: &std::path::Path, error: &dyn std::fmt::Display| {
            ExitError::new(
                ExitCode::BadInput,
                format!("{}: cannot be used: {error}", path.display()),
            )
        };
        let certificates: Vec<_> = CertificateDer::pem_file_iter(&path)
            .and_then(Iterator::collect)
            .map_err(|error| unread(&path, &error))?;
        let private = PrivateKeyDer::from_pem_file(&key).map_err(|error| unread(&key, &error))?;
        let provider = Arc::new(ring::default_provider());
        let mut config = rustls::ClientConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])
            .map_err(|error| unread(&path, &error))?
            .dangerous()
            .with_custom_certificate_verifier(witness)
            .with_client_auth_cert(certificates, private)
            .map_err(|error| unread(&path, &error))?;
        config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).into();
        let config = QuicClientConfig::try_from(config).map_err(|error| unread(&path, &error))?;
        Ok(quinn::ClientConfig::new(Arc::new(config)))
    }
}

/// A point of time (s since 1970) as people write it.
fn date(time: UnixTime) -> String {
    let seconds = i64::try_from(time.as_secs()).unwrap_or(i64::MAX);
    jiff::Timestamp::from_second(seconds).map_or_else(
        |_| "a date far away".to_owned(),
        |date| date.strftime("%F %R UTC").to_string(),
    )
}
