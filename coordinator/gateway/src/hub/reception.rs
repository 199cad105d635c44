//! Whether a host may join.

use std::path::PathBuf;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use zenoh::Wait as _;
use zenoh::query::Query;

use super::hosts::Hosts;
use crate::arguments::HubArguments;
use crate::wire::{Answer, Build, Hello, Welcome};

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
        let read =
            |path: PathBuf| process::input::read_text(&path).map_err(|error| unread(path, &error));
        let config_text = read(run_dir.config())?;
        let config =
            Config::from_resolved_toml(&config_text, &run_dir.config().display().to_string())
                .map_err(|error| ExitError::new(ExitCode::BadInput, error.to_string()))?;
        let build = Build::of(&arguments.sim_worker)
            .map_err(|error| unread(arguments.sim_worker.clone(), &error))?;
        let robot_text = read(run_dir.robot())?;
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
            Ok(hello) => self.judge(&hello, hosts),
            Err(error) => Answer::Refused(format!("its first words cannot be read: {error}")),
        };
        let Ok(text) = serde_json::to_vec(&answer) else { return };
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
