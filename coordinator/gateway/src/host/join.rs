//! How a host becomes one.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use proto::gateway::Said;
use proto::gateway::wire::{Answer, Build, Hello, Welcome};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use zenoh::query::ConsolidationMode;
use zenoh::{Session, Wait as _};

use crate::arguments::HostArguments;
use crate::keys;

/// How long an answer may take.
const ANSWER_DEADLINE: Duration = Duration::from_secs(2);
/// Pause before the next try.
const PAUSE: Duration = Duration::from_millis(200);

/// Asks to be taken in, until there is an answer or patience ends, and puts configuration and robot down.
pub(super) fn join(arguments: &HostArguments, session: &Session) -> Result<Welcome, ExitError> {
    let build = File::open(&arguments.sim_worker).and_then(Build::of).map_err(|error| {
        let message = format!("{}: cannot be read: {error}", arguments.sim_worker.display());
        ExitError::new(ExitCode::Environment, message)
    })?;
    let hello = Hello {
        name: arguments.name.clone(),
        workers: arguments.workers,
        build,
        processor: arguments.processor.clone(),
    };
    let hello = serde_json::to_vec(&hello).map_err(|error| {
        ExitError::new(ExitCode::Failure, format!("the first words have no JSON form: {error}"))
    })?;
    let begun = Instant::now();
    let welcome = loop {
        match ask(session, &keys::hello(&arguments.name), &hello)
            .or_else(|| why(arguments, session))
        {
            Some(Answer::Welcome(welcome)) => break welcome,
            Some(Answer::Refused(reason)) => {
                let message =
                    format!("{}: the run refuses this machine: {reason}", arguments.connect);
                return Err(ExitError::new(ExitCode::Environment, message));
            }
            None if begun.elapsed().as_secs_f64() < arguments.wait => std::thread::sleep(PAUSE),
            None => {
                let message = format!(
                    "{}: no run has answered for {} s; it is started by `octopus train \
                     --listen-workers`, and --wait says how long it is waited for",
                    arguments.connect, arguments.wait
                );
                return Err(ExitError::new(ExitCode::Failure, message));
            }
        }
    };
    if welcome.digest != Welcome::digest_of(&welcome.config, &welcome.robot) {
        let message =
            format!("{}: configuration or robot were damaged on the way", arguments.connect);
        return Err(ExitError::new(ExitCode::Failure, message));
    }
    let run_dir = RunDir::new(&arguments.run_dir);
    let put = |path: PathBuf, text: &str| {
        std::fs::write(&path, text).map_err(|error| {
            let message = format!(
                "{}: cannot be written: {error}; TMPDIR names another place",
                path.display()
            );
            ExitError::new(ExitCode::Environment, message)
        })
    };
    put(run_dir.config(), &welcome.config)?;
    put(run_dir.robot(), &welcome.robot)?;
    Ok(welcome)
}

/// Asks why there is no answer: over QUIC whom the run does not know by name is not heard there.
fn why(arguments: &HostArguments, session: &Session) -> Option<Answer> {
    arguments.certificates.as_ref()?;
    ask(session, &keys::stranger(&arguments.name), &[])
}

fn ask(session: &Session, key: &str, hello: &[u8]) -> Option<Answer> {
    let (replies, inbox) = mpsc::channel();
    let get = session
        .get(key)
        .payload(hello)
        .consolidation(ConsolidationMode::None)
        .timeout(ANSWER_DEADLINE)
        .callback(move |reply| drop(replies.send(reply)));
    get.wait().ok()?;
    let reply = inbox.recv().ok()?.into_result().ok()?;
    let answer = serde_json::from_slice(&reply.payload().to_bytes());
    answer.inspect_err(|error| tracing::warn!(%error, "an answer cannot be read")).ok()
}

/// Says something to who started this program.
pub(super) fn say(what: &Said) -> Result<(), ExitError> {
    let mut out = std::io::stdout().lock();
    let written = serde_json::to_writer(&mut out, what).map_err(std::io::Error::from);
    let written = written.and_then(|()| writeln!(out)).and_then(|()| out.flush());
    written.map_err(|error| {
        ExitError::new(ExitCode::Failure, format!("standard output cannot be written: {error}"))
    })
}
