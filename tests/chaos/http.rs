//! Clients of a live run, some of them hostile: they are answered or refused, and change no bit.

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use run::signals::StopRequests;
use rustix::process::Signal;
use serde_json::{Value, json};

use super::dice::Dice;
use super::flags;
use super::observe::{domain_of, iterations};
use super::restarts::wait_for;
use crate::{Run, assert_nothing_left};

/// Clients at a time.
const CLIENTS: usize = 8;
/// How long a client waits for an answer: longer than the service lets a request take.
const PATIENCE: Duration = Duration::from_mins(2);

/// What a client does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Reads something that is there.
    Read,
    /// Asks for a checkpoint or for other workers, which a run may refuse for now.
    Change,
    /// Asks well, but without the token or with another.
    Stranger,
    /// Asks for what is not there or may not be.
    Wrong,
    /// Sends what is no request.
    Noise,
    /// Goes in the middle of a request.
    Leave,
}

/// What a client sends, and what it may hear.
#[derive(Debug)]
struct Attempt {
    kind: Kind,
    bytes: Vec<u8>,
}

const READS: &[&str] = &[
    "/health",
    "/metrics",
    "/v1/status",
    "/v1/checkpoints",
    "/v1/checkpoints/latest",
    "/v1/checkpoints/latest/files/state.safetensors",
    "/v1/checkpoints/latest/files/manifest.json",
    "/v1/checkpoints/latest/archive",
];
const WRONG: &[&str] = &[
    "GET /v1/checkpoints/latest/files/..%2f..%2f..%2frun.lock",
    "GET /v1/checkpoints/%2e%2e/files/http.token",
    "GET /v1/checkpoints/latest/files/%2fetc%2fpasswd",
    "GET /v1/checkpoints/no-such-checkpoint",
    "GET //etc/passwd",
    "DELETE /v1/checkpoints/..",
    "DELETE /v1/status",
    "PATCH /v1/workers",
    "PUT /v1/checkpoints/..%2fescaped",
];
const BODIES: &[&str] = &[
    "",
    "{}",
    "{\"workers\":-1}",
    "{\"workers\":1e9}",
    "[[[[[[[[",
    "null",
    "\u{0}",
    "{\"workers\":",
];

impl Attempt {
    fn drawn(dice: &mut Dice, token: &str) -> Self {
        let kind = match dice.between(0, 15) {
            0..=5 => Kind::Read,
            6 => Kind::Change,
            7 | 8 => Kind::Stranger,
            9..=11 => Kind::Wrong,
            12 | 13 => Kind::Noise,
            _ => Kind::Leave,
        };
        let bearer = format!("Authorization: Bearer {token}\r\n");
        let read = |dice: &mut Dice| format!("GET {}", dice.one_of(READS));
        let bytes = match kind {
            Kind::Read => request(&read(dice), &bearer, ""),
            Kind::Change if dice.between(0, 1) == 0 => request("POST /v1/checkpoints", &bearer, ""),
            Kind::Change => {
                let body = format!("{{\"workers\":{}}}", dice.between(1, 3));
                request("PUT /v1/workers", &bearer, &body)
            }
            Kind::Stranger => {
                let mut wrong = String::new();
                for _ in 0..dice.between(0, 8) {
                    let _ = write!(wrong, "{:08x}", dice.word());
                }
                let line =
                    dice.one_of(&["GET /v1/status", "PUT /v1/workers", "POST /v1/checkpoints"]);
                request(line, &format!("Authorization: Bearer {wrong}\r\n"), "{\"workers\":3}")
            }
            Kind::Wrong if dice.between(0, 1) == 0 => {
                request("PUT /v1/workers", &bearer, dice.one_of(BODIES))
            }
            Kind::Wrong => request(dice.one_of(WRONG), &bearer, "no checkpoint"),
            Kind::Noise => {
                let mut bytes = request(&read(dice), &bearer, "");
                // Never so that it still is what it was: the first byte is one of no method.
                for _ in 0..dice.between(1, 40) {
                    let at = dice.between(0, bytes.len() - 1);
                    bytes[at] = dice.word() as u8;
                }
                bytes[0] = b'\x16';
                bytes
            }
            Kind::Leave => {
                let mut bytes = request("PUT /v1/checkpoints/mine", &bearer, &"7".repeat(20_000));
                bytes.truncate(dice.between(0, bytes.len() - 1));
                bytes
            }
        };
        Self { kind, bytes }
    }

    /// Sends it and judges the answer.
    fn make(&self, address: SocketAddr) -> Result<()> {
        let mut stream = TcpStream::connect(address).context("nobody listens")?;
        stream.set_read_timeout(Some(PATIENCE))?;
        // Who is refused early may be hung up on while it is still sending.
        let _ = stream.write_all(&self.bytes);
        if self.kind == Kind::Leave {
            let _ = stream.shutdown(Shutdown::Both);
            return Ok(());
        }
        let mut answer = Vec::new();
        let read = stream.read_to_end(&mut answer);
        let head = String::from_utf8_lossy(&answer[..answer.len().min(400)]).into_owned();
        let status: u16 = head
            .strip_prefix("HTTP/1.1 ")
            .and_then(|rest| rest.get(..3)?.parse().ok())
            .unwrap_or_default();
        let fits = match self.kind {
            Kind::Read => status == 200 && read.is_ok(),
            // 409: not now; 429, 503: others come first.
            Kind::Change => matches!(status, 200 | 202 | 409 | 429 | 503),
            Kind::Stranger => status == 401,
            Kind::Wrong => (400..500).contains(&status) || status == 503,
            // What is no request may be hung up on.
            Kind::Noise => (400..500).contains(&status) || answer.is_empty(),
            Kind::Leave => true,
        };
        if !fits {
            let sent = String::from_utf8_lossy(&self.bytes);
            bail!("{:?}: `{}` was answered by `{head}` ({read:?})", self.kind, sent.escape_debug());
        }
        Ok(())
    }
}

fn request(line: &str, headers: &str, body: &str) -> Vec<u8> {
    format!(
        "{line} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\
         Content-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

/// What came of many requests.
#[derive(Debug, Default)]
pub struct Report {
    /// Requests that were made.
    pub requests: usize,
    /// Iterations of the run meanwhile.
    pub iterations: usize,
}

impl Report {
    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({ "requests": self.requests, "iterations": self.iterations })
    }
}

/// Makes `times` requests that `seed` says to one live run, several at a time; then stops the run and
/// compares it with one that nobody asked.
pub fn run(
    times: usize,
    seed: u64,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Report> {
    // A budget that is never used up.
    let flags = flags(1, 1_000_000);
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let mut run = Run::train(&flags);
    // A checkpoint comes after the fifth.
    wait_for(&mut run, stop, |run| newest_is_there(&run.path()) && iterations(run) > 5)?;
    let before = iterations(&run);
    let domain = domain_of(&run, run.pid()).context("a live run has a domain")?;
    let holder: Value = serde_json::from_slice(&std::fs::read(run.path().join("run.lock"))?)?;
    let address = holder["http"].as_str().context("a service")?.parse()?;
    let token = std::fs::read_to_string(run.path().join("http.token"))?;
    // A checkpoint is there a moment before the service knows of it.
    let bearer = format!("Authorization: Bearer {}\r\n", token.trim_end());
    let newest = request("GET /v1/checkpoints/latest", &bearer, "");
    let newest = Attempt { kind: Kind::Read, bytes: newest };
    wait_for(&mut run, stop, |_| newest.make(address).is_ok())?;

    let next = AtomicUsize::new(0);
    let failed = Mutex::new(None);
    let client = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= times || stop.count() > 0 {
                return;
            }
            let attempt = Attempt::drawn(&mut Dice::of(seed, number as u32), token.trim_end());
            if let Err(error) = attempt.make(address) {
                let error = error.context(format!("request {} of seed {seed}", number + 1));
                failed.lock().expect("no client panics").get_or_insert(error);
                next.store(times, Ordering::Relaxed);
            }
        }
    };
    std::thread::scope(|scope| -> Result<()> {
        let clients: Vec<_> = (0..CLIENTS).map(|_| scope.spawn(client)).collect();
        let mut said = 0;
        while clients.iter().any(|client| !client.is_finished()) {
            let ended = run.ended();
            if ended.is_some() {
                next.store(times, Ordering::Relaxed);
                bail!("the run ended with {ended:?}; its log:\n{}", run.log());
            }
            let done = next.load(Ordering::Relaxed).min(times);
            if done >= said + 500 {
                said = done;
                narrate(&format!("{done} of {times} requests"));
            }
            std::thread::sleep(super::TICK);
        }
        Ok(())
    })?;
    if let Some(error) = failed.into_inner().expect("no client panics") {
        return Err(error.context(run.log()));
    }
    ensure!(stop.count() == 0, "interrupted");
    // It goes on, and is there for others.
    let asked = iterations(&run);
    wait_for(&mut run, stop, |run| iterations(run) > asked + 1)?;
    let read = request("GET /v1/status", &bearer, "");
    Attempt { kind: Kind::Read, bytes: read }.make(address)?;
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);
    let escaped = run.path().join("escaped");
    ensure!(!escaped.exists(), "{} was made from outside", escaped.display());

    let digests = run.digests();
    narrate(&format!("comparing {} iterations with a calm run", digests.len()));
    let mut calm = Run::train(&flags);
    wait_for(&mut calm, stop, |calm| iterations(calm) >= digests.len())?;
    calm.signal(Signal::INT);
    calm.succeed();
    let part = calm.digests().iter().zip(&digests).position(|(calm, here)| calm != here);
    ensure!(part.is_none(), "the digests part at iteration {part:?}");
    Ok(Report { requests: times, iterations: digests.len() - before })
}

/// Whether a checkpoint has been committed.
fn newest_is_there(run: &Path) -> bool {
    let entries = std::fs::read_dir(run.join("checkpoints"));
    entries
        .into_iter()
        .flatten()
        .flatten()
        .any(|entry| entry.path().join("manifest.json").is_file())
}
