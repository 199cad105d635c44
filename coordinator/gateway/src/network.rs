//! The network: how a session is opened, how something large is asked for and answered.

use std::sync::mpsc;
use std::time::Duration;

use proto::certificates::{AUTHORITY, CertificateDir, LEARNER};
use proto::gateway::pieces::{Assembly, Content, Payload, split};
use proto::message;
use proto::{ExitCode, ExitError};
use zenoh::bytes::ZBytes;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query};
use zenoh::{Config, Session, Wait as _};

use crate::access;

/// After so long without a sign of the other end a link is taken for cut (ms).
const LEASE_MS: u64 = 3000;

/// Which end of the network a session is.
#[derive(Debug, Clone, Copy)]
pub(crate) enum End<'a> {
    /// Waits for hosts there: at one endpoint, or at several with commas between them. With certificates only these are heard.
    Listen(&'a str, Option<(&'a CertificateDir, &'a [String])>),
    /// Connects there, within this time, and again whenever the link was cut. With certificates as this host.
    Connect(&'a str, Duration, Option<(&'a CertificateDir, &'a str)>),
}

/// Opens a session.
pub(crate) fn open(end: End<'_>) -> Result<Session, ExitError> {
    let config = configuration(end).map_err(|error| {
        let message = format!("the network cannot be set up: {}", plain(&error));
        ExitError::new(ExitCode::Failure, message)
    })?;
    zenoh::open(config).wait().map_err(|error| {
        tracing::error!(%error, ?end, "no network");
        match end {
            End::Listen(endpoint, _) => {
                let message = format!("{endpoint}: cannot be listened at: {}", plain(&error));
                ExitError::new(ExitCode::Environment, message)
            }
            End::Connect(endpoint, wait, _) => nobody(endpoint, wait),
        }
    })
}

/// Nobody was at `endpoint` for so long.
pub(crate) fn nobody(endpoint: &str, wait: Duration) -> ExitError {
    let seconds = wait.as_secs_f64();
    let message = format!(
        "{endpoint}: no run could be connected to for {seconds} s; it is started by `octopus train \
         --listen-workers`, and --wait says how long it is waited for"
    );
    ExitError::new(ExitCode::Failure, message)
}

/// An error of the network without the place in its sources.
fn plain(error: &zenoh::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or_default().to_owned()
}

fn configuration(end: End<'_>) -> zenoh::Result<Config> {
    let mut config = Config::default();
    let (mode, place, endpoint, wait) = match end {
        End::Listen(endpoint, _) => ("router", "listen/endpoints", endpoint, Duration::ZERO),
        End::Connect(endpoint, wait, _) => ("client", "connect/endpoints", endpoint, wait),
    };
    let endpoints = endpoint.split(',').collect::<serde_json::Value>().to_string();
    let wait = wait.as_millis().to_string();
    let lease = LEASE_MS.to_string();
    for (key, value) in [
        ("mode", text(mode).as_str()),
        (place, &endpoints),
        // Whoever has not been told the endpoint does not find it.
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        // What it would wait for when it opens is nobody.
        ("scouting/delay", "0"),
        // Of the first time; later it tries for ever.
        ("connect/timeout_ms", &wait),
        ("connect/exit_on_failure", "true"),
        ("connect/retry", "{period_init_ms: 100, period_max_ms: 1000, period_increase_factor: 2}"),
        ("listen/exit_on_failure", "true"),
        ("transport/link/tx/lease", &lease),
    ] {
        config.insert_json5(key, value)?;
    }
    match end {
        End::Listen(_, Some((dir, hosts))) => {
            let own = ("listen_certificate", "listen_private_key");
            secure(&mut config, dir, LEARNER, own)?;
            config.insert_json5("access_control", &access::rules(hosts).to_string())?;
        }
        End::Connect(_, _, Some((dir, name))) => {
            secure(&mut config, dir, name, ("connect_certificate", "connect_private_key"))?;
        }
        End::Listen(_, None) | End::Connect(_, _, None) => {}
    }
    Ok(config)
}

/// Both ends show a certificate and look at that of the other. Files are named and not quoted: what is quoted stands in
/// the network's own log.
fn secure(
    config: &mut Config,
    dir: &CertificateDir,
    name: &str,
    own: (&str, &str),
) -> zenoh::Result<()> {
    let (certificate, key) = own;
    for (which, path) in [
        ("root_ca_certificate", dir.certificate(AUTHORITY)),
        (certificate, dir.certificate(name)),
        (key, dir.key(name)),
    ] {
        let path = path.to_str().filter(|path| !path.contains(';'));
        let path = path.ok_or("a path of certificates is no UTF-8 text or has a semicolon")?;
        config.insert_json5(&format!("transport/link/tls/{which}"), &text(path))?;
    }
    for which in ["enable_mtls", "verify_name_on_connect"] {
        config.insert_json5(&format!("transport/link/tls/{which}"), "true")?;
    }
    Ok(())
}

/// A text as JSON has it.
fn text(value: &str) -> String {
    serde_json::Value::from(value).to_string()
}

/// A piece of an answer, where the network has put it.
#[derive(Debug)]
pub(crate) struct Piece(ZBytes);

impl Payload for Piece {
    fn slices(&self) -> impl Iterator<Item = &[u8]> {
        self.0.slices()
    }
}

/// What came of a question.
#[derive(Debug)]
pub(crate) struct Asked {
    /// The answer, as far as it has come.
    pub(crate) answer: Assembly<Piece>,
    /// What was wrong with what came, if anything was.
    pub(crate) trouble: Option<String>,
}

/// Asks for something of at most `most` bytes and waits for it, no longer than `patience`.
pub(crate) fn ask(
    session: &Session,
    key: &str,
    question: Vec<u8>,
    patience: Duration,
    most: usize,
) -> Asked {
    let mut asked = Asked { answer: Assembly::new(), trouble: None };
    let (replies, inbox) = mpsc::channel();
    let get = session
        .get(key)
        .payload(question)
        .consolidation(ConsolidationMode::None)
        .congestion_control(CongestionControl::Block)
        .timeout(patience)
        .callback(move |reply| {
            // Who asked may have given up.
            let _ = replies.send(reply);
        });
    if let Err(error) = get.wait() {
        asked.trouble = Some(error.to_string());
        return asked;
    }
    // It ends when the network has dropped the callback: after the last reply, or when patience is over.
    for reply in inbox {
        let taken = match reply.into_result() {
            Ok(sample) => {
                let head = sample.attachment().map(|head| head.to_bytes().into_owned());
                let piece = Piece(sample.payload().clone());
                asked.answer.add(&head.unwrap_or_default(), piece, most)
            }
            Err(error) => Err(error.payload().try_to_string().map_or_else(
                |_| "an error without words".to_owned(),
                std::borrow::Cow::into_owned,
            )),
        };
        if let Err(trouble) = taken {
            asked.trouble = Some(trouble);
        }
    }
    asked
}

/// Pieces of an answer, with their encoded heads.
pub(crate) type Pieces = Vec<(Vec<u8>, Vec<u8>)>;

/// Cuts an answer up.
pub(crate) fn cut(content: &Content, bytes: &[u8]) -> Pieces {
    let pieces = split(content, bytes).into_iter();
    pieces.map(|(head, piece)| (message::encode(&head), piece)).collect()
}

/// Answers a question, on a thread of its own: the network may have no room for a while.
pub(crate) fn answer(query: Query, pieces: Pieces) {
    let speak = move || {
        let key = query.key_expr().clone();
        for (head, piece) in pieces {
            let reply = query.reply(&key, piece).attachment(head);
            if let Err(error) = reply.wait() {
                tracing::warn!(%key, %error, "an answer did not get away whole");
                return;
            }
        }
    };
    if let Err(error) = std::thread::Builder::new().name("answer".to_owned()).spawn(speak) {
        tracing::error!(%error, "cannot start a thread");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_knows_all_that_it_is_told() {
        let dir = CertificateDir::new("some where");
        let hosts = ["lab-2".to_owned()];
        let wait = Duration::from_secs(30);
        for (end, secured) in [
            (End::Listen("tcp/127.0.0.1:7447", None), false),
            (End::Connect("tcp/127.0.0.1:7447", wait, None), false),
            (End::Listen("quic/127.0.0.1:7447", Some((&dir, &hosts))), true),
            (End::Connect("quic/localhost:7447", wait, Some((&dir, "lab-2"))), true),
        ] {
            let config = configuration(end).expect("known keys");
            let multicast = config.get_json("scouting/multicast/enabled").expect("a key");
            assert_eq!(multicast, "false", "{end:?}");
            let both = config.get_json("transport/link/tls/enable_mtls").expect("a key");
            assert_eq!(both == "true", secured, "{end:?}");
        }
    }

    #[test]
    fn a_path_that_the_network_would_cut_is_refused() {
        let dir = CertificateDir::new("a;b");
        let end = End::Connect("quic/localhost:7447", Duration::ZERO, Some((&dir, "lab-2")));
        assert!(configuration(end).is_err_and(|error| error.to_string().contains("semicolon")));
    }
}
