//! This machine helps a run of another one: `octopus join`.
//!
//! For the workers of this machine it is what the coordinator is at home: it creates the channels, starts the workers
//! and replaces those that die or fall silent. What they are ordered comes from a child, the gateway, which alone speaks
//! with the run; see the crate `gateway`.
//!
//! Nothing that happens here is for ever: configuration and robot come from the run and lie in a directory that goes
//! away with the membership. When the gateway dies, or the run has begun anew without this machine, the membership ends
//! and another one begins, with workers that know nothing of before.

mod gateway;
mod host;
mod spec;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use channels::{ChannelSizes, Channels, Domain};
use process::originals::Originals;
use proto::config::Config;
use proto::gateway::Place;
use proto::layout::Dimensions;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;
use store::scratch::{self, Scratch};

use self::gateway::{Gateway, Word};
use self::host::Host;
use self::spec::Ended;
pub use self::spec::{JoinSpec, Left};
use crate::preflight::{self, Verdict};
use crate::supervisor::Supervisor;

/// How long the answer of a run is waited for before Ctrl-C is looked for.
const WORD: Duration = Duration::from_millis(20);
/// Pause before this machine joins again.
const PAUSE: Duration = Duration::from_millis(500);
/// Memberships in a row without one block that end it.
const MAX_FRUITLESS: u32 = 20;

/// Helps until the run is over, Ctrl-C, or an error. Whatever happens, no process and no shared memory is left when
/// this returns. `note` tells the owner what happens.
pub fn join(spec: &JoinSpec, note: &mut dyn FnMut(&str)) -> Result<Left, ExitError> {
    let mut fruitless = 0;
    loop {
        let mut blocks = 0;
        match membership(spec, &mut blocks, note)? {
            Ended::Left(left) => return Ok(left),
            Ended::Lost(why) => {
                fruitless = if blocks > 0 { 0 } else { fruitless + 1 };
                if fruitless >= MAX_FRUITLESS {
                    let message = format!(
                        "{}: joined {fruitless} times in a row without making a block; the last \
                         time: {why}",
                        spec.endpoint
                    );
                    return Err(ExitError::new(ExitCode::Child, message));
                }
                note(&format!("{why}; joining again"));
                std::thread::sleep(PAUSE);
            }
        }
    }
}

/// From joining to whatever ends it. Counts the blocks that are made.
fn membership(
    spec: &JoinSpec,
    blocks: &mut u64,
    note: &mut dyn FnMut(&str),
) -> Result<Ended, ExitError> {
    let unmade = |error: std::io::Error| {
        let message = format!(
            "{}: no temporary directory can be made: {error}; TMPDIR names another place",
            scratch::place().display()
        );
        ExitError::new(ExitCode::Environment, message)
    };
    let dir = Scratch::new("join").map_err(unmade)?;
    let run_dir = RunDir::new(dir.path());
    std::fs::create_dir(run_dir.logs()).map_err(unmade)?;
    let mut gateway = Gateway::start(spec, &run_dir)?;
    let host = loop {
        match gateway.wait(WORD) {
            Some(Word::Joined(host)) => break host,
            Some(Word::Ended(code, why)) => return Err(ExitError::new(code, why)),
            None if spec.stop.count() > 0 => return Ok(Ended::Left(Left::Asked)),
            Some(Word::Scale(_)) | None => {}
        }
    };
    let (config, robot) = settle(spec, &run_dir)?;
    let dimensions = Dimensions::new(&config, robot.joints);
    let room = preflight::shared_memory(&config, &dimensions, 0, &["--workers"]);
    if room.verdict == Verdict::Failure {
        return Err(ExitError::new(ExitCode::Environment, room.sentence()));
    }
    let domain = Domain::fresh();
    let sizes = ChannelSizes::new(&config, &dimensions);
    let programs = spec.programs.clone();
    let originals = Originals::read(&run_dir)?;
    let (own, most) = (domain.clone(), sizes.max_workers);
    let mut supervisor = Supervisor::new(programs, run_dir, own, &config.run, most, originals)?;
    note(&format!(
        "host {host} of the run at {}, with {}",
        spec.endpoint,
        output::counted(spec.workers as u64, "worker")
    ));
    let place =
        Place { domain: domain.as_str().to_owned(), joints: robot.joints.by_arm().collect() };
    let (workers, heard) = (spec.workers, BTreeMap::new());
    let mut host = Host { spec, config: &config, workers, heard, blocks };
    let result = Channels::create(&domain, sizes)
        .map_err(ExitError::from)
        .and_then(|channels| host.serve(&channels, &place, &mut gateway, &mut supervisor, note));
    // Before its services are removed.
    drop(gateway);
    supervisor.close();
    result
}

/// Reads what the gateway has put down, and makes it that of this machine: what concerns processes is decided here.
fn settle(spec: &JoinSpec, run_dir: &RunDir) -> Result<(Config, Robot), ExitError> {
    let foreign = |error: &dyn std::fmt::Display| {
        let message = format!("{}: what the run has sent cannot be used: {error}", spec.endpoint);
        ExitError::new(ExitCode::BadInput, message)
    };
    let (path, robot) = (run_dir.config(), run_dir.robot());
    let text = process::input::read_text(&path).map_err(|error| foreign(&error))?;
    let mut config =
        Config::from_resolved_toml(&text, "its config.toml").map_err(|error| foreign(&error))?;
    config.run.workers = spec.workers;
    config.run.pin = false;
    std::fs::write(&path, config.to_toml()).map_err(|error| foreign(&error))?;
    let text = process::input::read_text(&robot).map_err(|error| foreign(&error))?;
    let robot = Robot::from_toml(&text, Path::new("its robot.toml"));
    Ok((config, robot.map_err(|error| foreign(&error))?))
}
