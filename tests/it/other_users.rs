//! Other users of the machine: what they can read and ask, and what they can make others believe.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;
use serde_json::{Value, json};
use tests::{Run, assert_nothing_left, octopus, stderr};

/// A user who owns nothing.
const NOBODY: u32 = 65534;

fn mode(path: &Path) -> u32 {
    path.metadata().unwrap_or_else(|error| panic!("{}: {error}", path.display())).mode() & 0o777
}

/// Waits until the run has made a file.
fn wait_for(path: &Path) {
    let watchdog = Instant::now() + Duration::from_mins(1);
    while !path.exists() {
        assert!(Instant::now() < watchdog, "no {}", path.display());
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Whether another user can read a file. Only root can find that out.
fn others_can_read(path: &Path) -> bool {
    let status = Command::new("cat")
        .arg(path)
        .uid(NOBODY)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    status.expect("cat starts").success()
}

fn ask(address: SocketAddr, line: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("connects");
    let request =
        format!("{line} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\r\n");
    let _ = stream.write_all(request.as_bytes());
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

/// Every user of a machine reaches its loopback; so whoever asks there shows a token, and only the
/// user of the run can read it.
#[test]
fn a_run_answers_nobody_but_its_user() {
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(6);
    let domain = run.domain();
    let path = run.path();
    wait_for(&path.join("checkpoints/.lock"));
    for file in ["http.token", "run.lock", "checkpoints/.lock"] {
        assert_eq!(mode(&path.join(file)), 0o600, "{file}");
    }
    if rustix::process::geteuid().is_root() {
        for place in [path.parent().expect("a directory"), &path] {
            std::fs::set_permissions(place, std::fs::Permissions::from_mode(0o755)).expect("own");
        }
        assert!(others_can_read(&path.join("metrics.jsonl")), "the way there is open");
        for file in ["http.token", "run.lock", "checkpoints/.lock"] {
            assert!(!others_can_read(&path.join(file)), "{file}");
        }
    }

    let status = octopus(&["status", path.to_str().expect("UTF-8"), "--json"]);
    let said: Value = serde_json::from_slice(&status.stdout).expect("JSON");
    assert!(said["live"]["workers"] == 1, "{}: {said}", stderr(&status));
    let holder = std::fs::read(path.join("run.lock")).expect("readable");
    let holder: Value = serde_json::from_slice(&holder).expect("JSON");
    let address = holder["http"].as_str().expect("a service").parse().expect("an address");
    for line in [
        "GET /v1/status",
        "GET /metrics",
        "GET /v1/checkpoints",
        "PUT /v1/workers",
        "POST /v1/checkpoints",
        "PUT /v1/checkpoints/mine",
        "DELETE /v1/checkpoints/iteration-00000005",
    ] {
        for wrong in ["", "Authorization: Bearer 0123456789abcdef0123456789abcdef\r\n"] {
            let answer = ask(address, line, wrong);
            assert!(answer.starts_with("HTTP/1.1 401"), "{line}: {answer}");
        }
    }
    assert!(ask(address, "GET /health", "").starts_with("HTTP/1.1 200"));
    let token = std::fs::read_to_string(path.join("http.token")).expect("own");
    let right = format!("Authorization: Bearer {}\r\n", token.trim_end());
    assert!(ask(address, "GET /v1/status", &right).starts_with("HTTP/1.1 200"));

    run.signal(Signal::INT);
    run.succeed();
    assert!(!run.log().contains(token.trim_end()), "it stays secret");
    let done = run.metrics().len();
    run.resume(&["--iterations=100001"]);
    // Before it has gone on, nothing of it listens to a signal.
    run.wait_for_iterations(done + 1);
    let again = std::fs::read_to_string(path.join("http.token")).expect("own");
    assert_eq!(again, token, "who has read it goes on when the run does");
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);
}

/// A token is worth as much as the run; whoever writes a lock file shall not get it.
#[test]
fn a_token_goes_only_to_a_process_of_this_user() {
    let mut run = Run::train(&["--workers=1", "--iterations=1"]);
    run.succeed();
    let path = run.path();
    let there = path.to_str().expect("UTF-8");
    let lock = path.join("run.lock");
    let trap = TcpListener::bind("127.0.0.1:0").expect("a port");
    trap.set_nonblocking(true).expect("a socket");
    let here = trap.local_addr().expect("an address").to_string();
    let own = std::process::id();
    let mut dead = Command::new("true").spawn().expect("starts");
    dead.wait().expect("own child");

    // Held as a run would hold it.
    let file = std::fs::File::options().write(true).open(&lock).expect("own");
    flock(&file, FlockOperation::LockExclusive).expect("free");
    let set = |mode| std::fs::set_permissions(&lock, std::fs::Permissions::from_mode(mode));
    let mut cases = vec![
        (own, here.as_str(), 0o602, NOBODY + 1, "other users may write"),
        (dead.id(), &here, 0o600, NOBODY + 1, "no process"),
        (own, "192.0.2.1:80", 0o600, NOBODY + 1, "nobody listens at 192.0.2.1:80"),
        (own, "127.0.0.1:1", 0o600, NOBODY + 1, "nobody listens at 127.0.0.1:1"),
        (own, "evil.example:80", 0o600, NOBODY + 1, "no address"),
        (own, "\u{1b}[31m", 0o600, NOBODY + 1, "no address"),
    ];
    if rustix::process::geteuid().is_root() {
        cases.push((own, &here, 0o600, NOBODY, "belongs to user 65534"));
    }
    for (pid, address, mode, owner, words) in cases {
        let text = json!({ "pid": pid, "domain": "spaceoctopus-x", "http": address }).to_string();
        std::fs::write(&lock, &text).expect("own");
        set(mode).expect("own");
        if owner == NOBODY {
            std::os::unix::fs::chown(&lock, Some(NOBODY), None).expect("root may");
        }
        let scale = octopus(&["scale", there, "2"]);
        assert_eq!(scale.status.code(), Some(5), "{text}: {}", stderr(&scale));
        let status = octopus(&["status", there]);
        for said in [stderr(&scale), stderr(&status)] {
            assert!(said.contains("run.lock") && said.contains(words), "{text}: {said}");
            assert!(!said.contains('\u{1b}'), "{said:?}");
        }
        let asked = trap.accept();
        assert!(
            asked.as_ref().is_err_and(|error| error.kind() == ErrorKind::WouldBlock),
            "{text}: {asked:?}"
        );
    }
}

/// The token's own file is believed only if nobody else can have written or read it.
#[test]
fn a_token_that_others_know_is_not_shown() {
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(1);
    let domain = run.domain();
    let path = run.path();
    let there = path.to_str().expect("UTF-8");
    let token = path.join("http.token");
    std::fs::set_permissions(&token, std::fs::Permissions::from_mode(0o644)).expect("own");
    let scale = octopus(&["scale", there, "2"]);
    let said = stderr(&scale);
    assert_eq!(scale.status.code(), Some(5), "{said}");
    assert!(said.contains("http.token") && said.contains("chmod 600"), "{said}");
    std::fs::set_permissions(&token, std::fs::Permissions::from_mode(0o600)).expect("own");
    assert!(octopus(&["scale", there, "2"]).status.success());
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);
}

/// The variable may hold the token of another service; the run's own is at hand.
#[test]
fn the_variable_for_a_token_does_not_keep_commands_from_the_runs_own() {
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(1);
    let domain = run.domain();
    let path = run.path();
    let there = path.to_str().expect("UTF-8");
    for args in [
        &["status", there, "--json"][..],
        &["scale", there, "2"],
        &["checkpoints", "commit", there],
    ] {
        let output = Command::new(tests::program("octopus"))
            .args(args)
            .env("SPACEOCTOPUS_TOKEN", "of-another-service-0123456789")
            .stdin(Stdio::null())
            .output()
            .expect("octopus can be started");
        assert!(output.status.success(), "{args:?}: {}", stderr(&output));
        assert_eq!(stderr(&output), "", "{args:?}");
    }
    run.signal(Signal::INT);
    run.succeed();
    assert_nothing_left(&domain);
}

/// Whoever holds the lock of the checkpoints keeps nobody from stopping a run.
#[test]
fn a_run_ends_although_somebody_holds_the_lock_of_its_checkpoints() {
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(6);
    let domain = run.domain();
    let lock = run.path().join("checkpoints/.lock");
    wait_for(&lock);
    let lock = std::fs::File::open(lock).expect("own");
    flock(&lock, FlockOperation::LockExclusive).expect("free");
    let client = service::client::Client::of_run(&run.path(), None).expect("a service");
    run.signal(Signal::INT);
    // Two signals at once are one.
    let watchdog = Instant::now() + Duration::from_mins(1);
    while client.status().expect("answers").state != "finishing" {
        assert!(Instant::now() < watchdog, "it does not end; log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(5));
    }
    run.signal(Signal::INT);
    assert_eq!(run.wait(), Some(130), "{}", run.log());
    assert_nothing_left(&domain);
}
