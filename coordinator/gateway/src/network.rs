//! The network: how a session is opened, how something large is asked for and answered.

use std::sync::mpsc;
use std::time::Duration;

use proto::message;
use proto::{ExitCode, ExitError};
use zenoh::bytes::ZBytes;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query};
use zenoh::{Config, Session, Wait as _};

use crate::pieces::{Assembly, Content, split};

/// After so long without a sign of the other end a link is taken for cut (ms).
const LEASE_MS: u64 = 3000;

/// Which end of the network a session is.
#[derive(Debug, Clone, Copy)]
pub(crate) enum End<'a> {
    /// Waits for hosts there.
    Listen(&'a str),
    /// Connects there, within this time, and again whenever the link was cut.
    Connect(&'a str, Duration),
}

/// Opens a session.
pub(crate) fn open(end: End<'_>) -> Result<Session, ExitError> {
    let config = configuration(end).map_err(|error| {
        ExitError::new(ExitCode::Failure, format!("the network cannot be set up: {error}"))
    })?;
    zenoh::open(config).wait().map_err(|error| {
        tracing::error!(%error, ?end, "no network");
        match end {
            End::Listen(endpoint) => {
                let message = format!("{endpoint}: cannot be listened at: {}", plain(&error));
                ExitError::new(ExitCode::Environment, message)
            }
            End::Connect(endpoint, wait) => {
                let seconds = wait.as_secs_f64();
                let message = format!(
                    "{endpoint}: no run could be connected to for {seconds} s; it is started by \
                     `octopus train --listen-workers`, and --wait says how long it is waited for"
                );
                ExitError::new(ExitCode::Failure, message)
            }
        }
    })
}

/// An error of the network without the place in its sources.
fn plain(error: &zenoh::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or_default().to_owned()
}

fn configuration(end: End<'_>) -> zenoh::Result<Config> {
    let mut config = Config::default();
    let (mode, place, endpoint, wait) = match end {
        End::Listen(endpoint) => ("router", "listen/endpoints", endpoint, Duration::ZERO),
        End::Connect(endpoint, wait) => ("client", "connect/endpoints", endpoint, wait),
    };
    let wait = wait.as_millis().to_string();
    let text = |value: &str| serde_json::Value::from(value).to_string();
    let lease = LEASE_MS.to_string();
    for (key, value) in [
        ("mode", text(mode).as_str()),
        (place, &format!("[{}]", text(endpoint))),
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
    Ok(config)
}

/// What came of a question.
#[derive(Debug)]
pub(crate) struct Asked {
    /// The answer, as far as it has come.
    pub(crate) answer: Assembly<ZBytes>,
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
                asked.answer.add(&head.unwrap_or_default(), sample.payload().clone(), most)
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
        for end in [
            End::Listen("tcp/127.0.0.1:7447"),
            End::Connect("tcp/127.0.0.1:7447", Duration::from_secs(30)),
        ] {
            let config = configuration(end).expect("known keys");
            let multicast = config.get_json("scouting/multicast/enabled").expect("a key");
            assert_eq!(multicast, "false", "{end:?}");
        }
    }
}
