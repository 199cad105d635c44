//! Whether a host may join.

use std::fs::File;
use std::path::PathBuf;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use process::originals;
use proto::config::Config;
use proto::gateway::wire::{Answer, Build, Hello, Welcome};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use zenoh::Wait as _;
use zenoh::query::Query;

use super::hosts::Hosts;
use crate::arguments::HubArguments;
use crate::keys;

/// Longest name that a host may have (bytes).
const LONGEST_NAME: usize = 255;

/// What hosts must have, and what they are given.
pub(super) struct Reception {
    /// Name of the hub's life.
    pub(super) session: String,
    /// The run's configuration.
    pub(super) config: Config,
    config_text: String,
    robot_text: String,
    build: Build,
    /// The type of this machine's processor.
    processor: String,
}

impl Reception {
    /// Reads what the run directory says.
    pub(super) fn read(arguments: &HubArguments) -> Result<Self, ExitError> {
        let run_dir = RunDir::new(&arguments.run_dir);
        let unread = |path: PathBuf, error: &dyn std::fmt::Display| {
            let message = format!("{}: cannot be read: {error}", path.display());
            ExitError::new(ExitCode::RunDirectory, message)
        };
        let config_text =
            originals::config(&run_dir).map_err(|error| unread(run_dir.config(), &error))?;
        let config =
            Config::from_resolved_toml(&config_text, &run_dir.config().display().to_string())
                .map_err(|error| ExitError::new(ExitCode::BadInput, error.to_string()))?;
        let build = File::open(&arguments.sim_worker)
            .and_then(Build::of)
            .map_err(|error| unread(arguments.sim_worker.clone(), &error))?;
        let robot_text =
            originals::robot(&run_dir).map_err(|error| unread(run_dir.robot(), &error))?;
        // No other hub has had the same domain, process and time.
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        let seed = format!("{}-{}-{now}", arguments.domain, std::process::id());
        let session = blake3::hash(seed.as_bytes()).to_hex()[..12].to_owned();
        let processor = arguments.processor.clone();
        Ok(Self { session, config, config_text, robot_text, build, processor })
    }

    /// Answers a host that wants to join.
    pub(super) fn receive(&self, query: Query, hosts: &mut Hosts) {
        let bytes = query.payload().map(|payload| payload.to_bytes().into_owned());
        let answer = match serde_json::from_slice::<Hello>(&bytes.unwrap_or_default()) {
            Ok(hello) if !keys::is_of_name(query.key_expr(), &hello.name) => {
                Answer::Refused(format!("its name is not {}", hello.name))
            }
            Ok(hello) if hello.name.len() > LONGEST_NAME => {
                Answer::Refused(format!("its name is longer than {LONGEST_NAME} bytes"))
            }
            Ok(hello) => self.judge(&hello, hosts),
            Err(error) => Answer::Refused(format!("its first words cannot be read: {error}")),
        };
        speak(query, &answer);
    }

    /// Answers a host that asks why it has no answer. It is one whose certificate is good, and whose name is none of
    /// `names`; one that is there has asked too early.
    pub(super) fn explain(query: Query, names: &[String]) {
        let Some(name) = names.iter().find(|name| keys::is_of_name(query.key_expr(), name)) else {
            let key = query.key_expr().to_string();
            tracing::warn!(key, "a host is refused that has no certificate in the directory");
            let why = "its certificate is none of those in the directory that the run was given \
                       by --certificates; its .pem file belongs there, and the run need not be \
                       started again";
            return speak(query, &Answer::Refused(why.to_owned()));
        };
        tracing::debug!(name, "asks too early");
    }

    fn judge(&self, hello: &Hello, hosts: &mut Hosts) -> Answer {
        let name = &hello.name;
        if let Some(difference) = self.build.difference(&hello.build) {
            tracing::warn!(name, difference, "a host is refused");
            return Answer::Refused(format!(
                "{difference}; all programs of a run must come from the same build: copy octopus, \
                 gateway and sim-worker from the machine of the run"
            ));
        }
        let (here, there) = (&self.processor, &hello.processor);
        let is_other = here != there;
        match hosts.join(name, hello.workers, is_other, Instant::now()) {
            Ok(host) => {
                if is_other {
                    tracing::warn!(host, name, here, there, "has another type of processor");
                }
                tracing::info!(host, name, workers = hello.workers, "has joined");
                Answer::Welcome(Welcome {
                    session: self.session.clone(),
                    host,
                    config: self.config_text.clone(),
                    robot: self.robot_text.clone(),
                    digest: Welcome::digest_of(&self.config_text, &self.robot_text),
                })
            }
            Err(reason) => {
                tracing::warn!(name, reason, "a host is refused");
                Answer::Refused(reason)
            }
        }
    }
}

/// Answers a query, on a thread of its own: the network may have no room for a while.
fn speak(query: Query, answer: &Answer) {
    let Ok(text) = serde_json::to_vec(answer) else { return };
    let speak = move || {
        let key = query.key_expr().clone();
        if let Err(error) = query.reply(&key, text).wait() {
            tracing::warn!(%error, "a host that wants to join has no answer");
        }
    };
    if let Err(error) = std::thread::Builder::new().name("welcome".to_owned()).spawn(speak) {
        tracing::error!(%error, "cannot start a thread");
    }
}
