//! Another user of the machine beside a live run: nothing of what he tries gives him anything or changes a
//! bit. Only root can be somebody else, so that without root nothing is tried.

use std::io::{Read as _, Seek as _};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use run::signals::StopRequests;
use rustix::process::{Signal, geteuid};
use serde_json::{Value, json};

use super::dice::Dice;
use super::observe::{domain_of, everybody, iterations};
use super::restarts::wait_for;
use super::{PATIENCE, TICK, flags};
use crate::{Owned, Run, assert_nothing_left};

/// A user who owns nothing.
const NOBODY: u32 = 65534;

/// What he tries with a file or directory, as a shell has it; it must not succeed. `$1` is its path.
const WITH_FILE: &[&str] = &[
    "cat < \"$1\"",
    "echo x >> \"$1\"",
    ": > \"$1\"",
    "truncate -s 0 \"$1\"",
    "chmod 666 \"$1\"",
    "chown 65534 \"$1\"",
    "rm -f -- \"$1\" && [ ! -e \"$1\" ]",
    "mv -f -- \"$1\" /tmp/",
    "flock -n \"$1\" true",
];
/// What he tries with a directory.
const WITH_DIRECTORY: &[&str] = &[
    "ls \"$1\"",
    ": > \"$1/made-by-another\"",
    "ln -s /etc/passwd \"$1/made-by-another\"",
    "rm -rf -- \"$1\"",
    "chmod 777 \"$1\"",
];
/// What he tries with a process; `$1` is its number.
const WITH_PROCESS: &[&str] = &[
    "kill -KILL \"$1\"",
    "kill -STOP \"$1\"",
    "cat \"/proc/$1/environ\" | grep -q .",
    "ls -l \"/proc/$1/fd\"",
    "head -c 1 \"/proc/$1/mem\"",
    "renice -n 19 -p \"$1\"",
];
/// What he tries with the service; `$1` is its port.
const WITH_PORT: &[&str] = &[
    "GET /v1/status",
    "GET /v1/checkpoints",
    "GET /metrics",
    "PUT /v1/workers",
    "POST /v1/checkpoints",
    "PUT /v1/checkpoints/his",
    "DELETE /v1/checkpoints/latest",
];

/// What came of many attempts.
#[derive(Debug, Default)]
pub struct Report {
    /// Attempts that came to nothing; none where nobody else could be played.
    pub refused: usize,
    /// Iterations of the run meanwhile.
    pub iterations: usize,
}

impl Report {
    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({ "refused": self.refused, "iterations": self.iterations })
    }
}

/// Lets another user try `times` things that `seed` says with one live run; then stops the run and
/// compares it with one that was left alone.
pub fn run(
    times: usize,
    seed: u64,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Report> {
    if !geteuid().is_root() {
        narrate("not root: nobody else can be played, nothing is tried");
        return Ok(Report::default());
    }
    let flags = flags(1, 1_000_000);
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let mut run = Run::train(&flags);
    let lock = run.path().join("checkpoints/.lock");
    wait_for(&mut run, stop, |run| iterations(run) > 5 && lock.exists())?;
    let before = iterations(&run);
    let domain = domain_of(&run, run.pid()).context("a live run has a domain")?;
    // The way to the run is open to everybody: what is closed is closed by itself.
    let path = run.path();
    for place in [path.parent().context("a directory")?, &path] {
        std::fs::set_permissions(place, std::fs::Permissions::from_mode(0o755))?;
    }
    let holder: Value = serde_json::from_slice(&std::fs::read(path.join("run.lock"))?)?;
    let address = holder["http"].as_str().context("a service")?;
    let port = address.rsplit(':').next().context("a port")?.to_owned();

    let mut report = Report::default();
    for time in 0..times {
        ensure!(stop.count() == 0, "interrupted");
        let mut dice = Dice::of(seed, time as u32);
        let (script, object) = attempt(&mut dice, &run, &domain, &port)?;
        let (succeeded, said) = as_another(&script, &object)?;
        ensure!(
            !succeeded,
            "attempt {} of seed {seed} succeeded: `{script}` with {object}:\n{said}",
            time + 1
        );
        narrate(&format!("{:4}/{times} `{script}` with {object}: refused", time + 1));
        report.refused += 1;
    }
    let tried = iterations(&run);
    wait_for(&mut run, stop, |run| iterations(run) > tried + 1)?;
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);

    let digests = run.digests();
    report.iterations = digests.len() - before;
    narrate(&format!("comparing {} iterations with a calm run", digests.len()));
    let mut calm = Run::train(&flags);
    wait_for(&mut calm, stop, |calm| iterations(calm) >= digests.len())?;
    calm.signal(Signal::INT);
    calm.succeed();
    let part = calm.digests().iter().zip(&digests).position(|(calm, here)| calm != here);
    ensure!(part.is_none(), "the digests part at iteration {part:?}");
    Ok(report)
}

/// Draws what is tried and with what.
fn attempt(dice: &mut Dice, run: &Run, domain: &str, port: &str) -> Result<(String, String)> {
    let shared = Path::new("/dev/shm").join(domain);
    let path = run.path();
    Ok(match dice.between(0, 7) {
        0..=2 => {
            let mut files = files(&shared)?;
            files.sort();
            let file = files[dice.between(0, files.len() - 1)].display().to_string();
            (dice.one_of(WITH_FILE).to_owned(), file)
        }
        3 => {
            let secret = dice.one_of(&["run.lock", "http.token", "checkpoints/.lock"]);
            (dice.one_of(WITH_FILE).to_owned(), path.join(secret).display().to_string())
        }
        4 => (dice.one_of(WITH_DIRECTORY).to_owned(), shared.display().to_string()),
        5 => {
            // What may be read may not be changed.
            let change = dice.one_of(&WITH_DIRECTORY[1..]);
            let place = dice.one_of(&["", "checkpoints", "logs"]);
            (change.to_owned(), path.join(place).display().to_string())
        }
        6 => {
            let processes = everybody(run, &[domain.to_owned()]);
            (dice.one_of(WITH_PROCESS).to_owned(), dice.one_of(&processes).to_string())
        }
        _ => {
            let line = dice.one_of(WITH_PORT);
            let token = dice.word();
            let script = format!(
                "exec 3<> \"/dev/tcp/127.0.0.1/$1\" && printf '{line} HTTP/1.1\\r\\nHost: localhost\\r\\n\
                 Authorization: Bearer {token:032x}\\r\\nContent-Length: 0\\r\\nConnection: close\\r\\n\\r\\n' >&3 \
                 && head -c 12 <&3 | grep -qv 'HTTP/1.1 401'"
            );
            (script, port.to_owned())
        }
    })
}

/// All files below a directory; what goes meanwhile is left out.
fn files(directory: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory)?.flatten() {
        let path = entry.path();
        match entry.file_type() {
            Ok(kind) if kind.is_dir() => found.extend(files(&path)?),
            Ok(_) => found.push(path),
            Err(_) => {}
        }
    }
    Ok(found)
}

/// Whether a shell of another user succeeds with this, and what it says.
fn as_another(script: &str, object: &str) -> Result<(bool, String)> {
    let mut command = Command::new("bash");
    command.args(["-c", script, "bash", object]).uid(NOBODY).gid(NOBODY).current_dir("/");
    // A file, because nobody reads a pipe before the end.
    let mut errors = tempfile::tempfile()?;
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(errors.try_clone()?);
    let mut process = Owned::spawn(&mut command);
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = process.ended() {
            break status;
        }
        ensure!(begun.elapsed() < PATIENCE, "`{script}` with {object} does not end");
        std::thread::sleep(TICK);
    };
    errors.rewind()?;
    let mut said = String::new();
    errors.read_to_string(&mut said)?;
    Ok((status.success(), said))
}
