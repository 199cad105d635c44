//! Links that are encrypted and whose ends know each other: the same bits over them, and nobody else gets in.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

use certificates::issue::{Wanted, issue};
use proto::certificates::CertificateDir;
use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;
use tests::{Run, assert_nothing_left, kill, octopus, program, stderr};

use crate::machines::{Machine, alone, assert_adds_up, free_quic_endpoint, hold, open, wait_for};

const DAY: Duration = Duration::from_hours(24);

/// A directory of certificates for these hosts, and what a machine of its own holds of it.
struct Certificates {
    dir: TempDir,
}

impl Certificates {
    fn made(hosts: &[&str]) -> Self {
        let dir = tempfile::tempdir().expect("a directory");
        let certificates = Self { dir };
        certificates.add(hosts, SystemTime::now());
        certificates
    }

    fn path(&self) -> PathBuf {
        self.dir.path().join("certificates")
    }

    /// Makes certificates as of another time.
    fn add(&self, hosts: &[&str], now: SystemTime) {
        let hosts = hosts.iter().map(|host| (*host).to_owned()).collect();
        let wanted = Wanted { hosts, days: 30, ..Wanted::default() };
        issue(&CertificateDir::new(self.path()), &wanted, now).expect("made");
    }

    /// What the machine `host` is given.
    fn for_host(&self, host: &str) -> TempDir {
        let given = tempfile::tempdir().expect("a directory");
        for name in ["authority.pem", &format!("{host}.pem"), &format!("{host}.key")] {
            fs::copy(self.path().join(name), given.path().join(name)).expect("made");
        }
        given
    }

    /// The flag that names them.
    fn flag(&self) -> String {
        flag(&self.path())
    }
}

fn flag(dir: &Path) -> String {
    format!("--certificates={}", dir.display())
}

fn said(args: &[&str]) -> (Option<i32>, String) {
    let output = octopus(args);
    (output.status.code(), stderr(&output))
}

/// The end of a host alone, as if `octopus join` had nothing against its certificates.
fn gateway(endpoint: &str, name: &str, certificates: Option<&Path>) -> (Option<i32>, String) {
    let dir = tempfile::tempdir().expect("a directory");
    let mut command = Command::new(program("gateway"));
    command.args(["host", "--connect", endpoint, "--workers=1", "--wait=3"]);
    command.arg(format!("--name={name}")).arg("--processor=another");
    command.arg("--sim-worker").arg(program("sim-worker")).arg("--run-dir").arg(dir.path());
    if let Some(path) = certificates {
        command.arg(flag(path));
    }
    let output = command.stdin(Stdio::null()).output().expect("starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout) + &text(&output.stderr))
}

/// All that a run has written, and its log.
fn written(run: &Run) -> String {
    fn below(dir: &Path, text: &mut String) {
        for entry in fs::read_dir(dir).expect("readable").flatten() {
            let path = entry.path();
            if path.is_dir() {
                below(&path, text);
            } else {
                text.push_str(&String::from_utf8_lossy(&fs::read(&path).unwrap_or_default()));
            }
        }
    }
    let mut text = run.log();
    below(&run.path(), &mut text);
    text
}

/// The lines of a key that are its secret.
fn secret(key: &Path) -> String {
    let text = fs::read_to_string(key).expect("a key");
    text.lines().nth(1).expect("base64").to_owned()
}

#[test]
fn machines_that_show_certificates_change_no_bit_and_no_key_is_written_down() {
    let expected = alone(30);
    let certificates = Certificates::made(&["lab-2", "lab-3"]);
    let endpoint = free_quic_endpoint();
    let more = ["--workers=1", "--iterations=30", &certificates.flag()];
    let mut run = open(&endpoint, &more);
    let learner = hold(&mut run);
    let domain = run.domain_when_there();
    let given = ["lab-2", "lab-3"].map(|host| certificates.for_host(host));
    let mut helpers =
        given.each_ref().map(|dir| Machine::join(&endpoint, &["--workers=1", &flag(dir.path())]));
    let domains = helpers.each_ref().map(Machine::domain);
    wait_for(&mut run, "(lab-2) helps with 1 worker", 1);
    wait_for(&mut run, "(lab-3) helps with 1 worker", 1);
    kill(learner, Signal::CONT);
    run.succeed();
    helpers.iter_mut().for_each(Machine::succeed);
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
    let all = written(&run) + &helpers.iter().map(Machine::log).collect::<String>();
    assert!(!all.contains("PRIVATE KEY"));
    for name in ["authority", "learner", "lab-2"] {
        let key = secret(&certificates.path().join(format!("{name}.key")));
        assert!(!all.contains(&key), "the key of {name}");
    }
    domains.iter().chain([&domain]).for_each(|domain| assert_nothing_left(domain));
}

#[test]
fn who_has_no_certificate_that_fits_is_refused_and_the_run_goes_on() {
    let certificates = Certificates::made(&["lab-2", "lab-3"]);
    let now = SystemTime::now();
    certificates.add(&["late"], now - 60 * DAY);
    certificates.add(&["early"], now + 60 * DAY);
    let endpoint = free_quic_endpoint();
    let port = endpoint.rsplit_once(':').expect("a port").1;
    let everywhere = format!("quic/0.0.0.0:{port}");
    let mut run = open(&everywhere, &["--workers=1", "--iterations=1000000", &certificates.flag()]);
    run.wait_for_iterations(1);
    let join = |dir: &Path, more: &[&str]| {
        let dir = flag(dir);
        let args = ["--workers=1", "--wait=20s", &dir];
        let args: Vec<_> = args.into_iter().chain(more.iter().copied()).collect();
        Machine::join(&endpoint, &args).ended()
    };
    // Of another authority, although its name is known.
    let others = Certificates::made(&["lab-2"]);
    let (code, text) = join(&others.path(), &[]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("of another authority than"), "{text}");
    // The run's own authority, but a certificate that another one has signed.
    let mixed = others.for_host("lab-2");
    let authority = mixed.path().join("authority.pem");
    fs::copy(certificates.path().join("authority.pem"), authority).expect("writable");
    let (code, text) = join(mixed.path(), &[]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("lab-2.pem: is of another authority"), "{text}");
    let (code, text) = gateway(&endpoint, "lab-2", Some(mixed.path()));
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("it is of another authority than the run's own"), "{text}");
    // Not valid any more, or not yet, by this machine's clock and by the run's.
    for (name, here) in [("late", "has expired, on"), ("early", "is not valid before")] {
        let (code, text) = join(&certificates.path(), &[&format!("--name={name}")]);
        assert_eq!(code, Some(4), "{text}");
        assert!(text.contains(here), "{text}");
        let (code, text) = gateway(&endpoint, name, Some(&certificates.path()));
        assert_eq!(code, Some(4), "{text}");
        assert!(text.contains("by the run's clock it has expired, or is not valid yet"), "{text}");
    }
    // The name of another: here, and where nobody looks before the run does.
    let given = certificates.for_host("lab-2");
    for end in ["pem", "key"] {
        let of = |name: &str| given.path().join(format!("{name}.{end}"));
        fs::copy(of("lab-2"), of("lab-3")).expect("writable");
    }
    let (code, text) = join(given.path(), &["--name=lab-3"]);
    assert_eq!(code, Some(3), "{text}");
    assert!(text.contains("is the certificate of \"lab-2\", not of lab-3"), "{text}");
    let (code, text) = gateway(&endpoint, "lab-3", Some(given.path()));
    assert_eq!(code, Some(1), "{text}");
    assert!(!text.contains("joined"), "{text}");
    // None at all.
    let (code, text) = gateway(&endpoint, "lab-2", None);
    assert_eq!(code, Some(1), "{text}");
    // A host cannot be the learner, and is reached by no name that its certificate has not.
    let elsewhere = endpoint.replace("127.0.0.1", "127.0.0.2");
    let mut lost = Machine::join(&elsewhere, &["--workers=1", &flag(given.path()), "--name=lab-2"]);
    let (code, text) = lost.ended();
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("is for other addresses"), "{text}");
    // The run has heard nothing of all that, and those who may join still do.
    assert!(!run.log().contains("helps with"), "{}", run.log());
    let given = certificates.for_host("lab-3");
    let mut helper = Machine::join(&endpoint, &["--workers=1", &flag(given.path())]);
    wait_for(&mut run, "(lab-3) helps with 1 worker", 1);
    let done = run.metrics().len();
    run.wait_for_iterations(done + 5);
    helper.leave();
    run.signal(Signal::INT);
    run.succeed();
}

#[test]
fn who_may_join_changes_while_the_run_goes_on() {
    let certificates = Certificates::made(&["lab-2"]);
    let endpoint = free_quic_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=1000000", &certificates.flag()]);
    let second = certificates.for_host("lab-2");
    let mut helper = Machine::join(&endpoint, &["--workers=1", "--wait=10s", &flag(second.path())]);
    wait_for(&mut run, "(lab-2) helps with 1 worker", 1);
    // Signed by the same authority, but the run has not been told.
    let elsewhere = tempfile::tempdir().expect("a directory");
    for name in ["authority.pem", "authority.key", "learner.pem", "learner.key"] {
        let to = elsewhere.path().join(name);
        fs::copy(certificates.path().join(name), to).expect("made");
    }
    let hosts = vec!["lab-3".to_owned()];
    let wanted = Wanted { hosts, days: 30, ..Wanted::default() };
    issue(&CertificateDir::new(elsewhere.path()), &wanted, SystemTime::now()).expect("made");
    let third = flag(elsewhere.path());
    let (code, text) = Machine::join(&endpoint, &["--workers=1", &third]).ended();
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("none of those in the directory"), "{text}");
    // Now it is, and the other one goes on.
    fs::copy(elsewhere.path().join("lab-3.pem"), certificates.path().join("lab-3.pem"))
        .expect("writable");
    // The run looks into the directory every half second; until then the answer is the one of before.
    wait_for(&mut run, "(lab-2) helps with 1 worker", 2);
    let mut another = Machine::join(&endpoint, &["--workers=1", &third]);
    wait_for(&mut run, "(lab-3) helps with 1 worker", 1);
    // And the first is none any more.
    fs::remove_file(certificates.path().join("lab-2.pem")).expect("there");
    // It hears no more of the run, and is told why.
    let (code, text) = helper.ended();
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("none of those in the directory"), "{text}");
    let done = run.metrics().len();
    run.wait_for_iterations(done + 5);
    another.leave();
    run.signal(Signal::INT);
    run.succeed();
}

#[test]
fn a_run_that_cannot_show_its_certificate_does_not_begin() {
    let train = |certificates: Option<&Path>, more: &[&str]| {
        let place = tempfile::tempdir().expect("a directory");
        let dir = format!("--run-dir={}", place.path().join("run").display());
        let listen = format!("--listen-workers={}", free_quic_endpoint());
        let mut args = vec!["train", "--iterations=1", "--workers=1", &dir, &listen];
        let certificates = certificates.map(flag);
        args.extend(certificates.as_deref());
        args.extend(more);
        let told = said(&args);
        assert!(!place.path().join("run").exists(), "{told:?}");
        told
    };
    let (code, text) = train(None, &[]);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("--certificates DIR"), "{text}");
    let certificates = Certificates::made(&["lab-2"]);
    let (code, text) = train(Some(&certificates.path()), &["--insecure"]);
    assert_eq!(code, Some(2), "{text}");
    // What a host has is not enough.
    let given = certificates.for_host("lab-2");
    let (code, text) = train(Some(given.path()), &[]);
    assert_eq!(code, Some(3), "{text}");
    assert!(text.contains("learner.pem: cannot be read"), "{text}");
    let key = certificates.path().join("learner.key");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).expect("own");
    let (code, text) = train(Some(&certificates.path()), &[]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("chmod 600"), "{text}");
    let old = Certificates { dir: tempfile::tempdir().expect("a directory") };
    old.add(&["lab-2"], SystemTime::now() - 60 * DAY);
    let (code, text) = train(Some(&old.path()), &[]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("learner.pem: has expired"), "{text}");
    // A run that listens there already.
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").expect("a free port");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).expect("own");
    let listen = format!("--listen-workers=quic/{}", taken.local_addr().expect("bound"));
    let (code, text) = said(&["train", "--iterations=1", &listen, &certificates.flag()]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("cannot be listened at"), "{text}");
}

#[test]
fn certificates_are_made_once_and_shown() {
    let place = tempfile::tempdir().expect("a directory");
    let dir = place.path().join("certs");
    let path = dir.to_str().expect("UTF-8");
    let shown = |args: &[&str]| -> Vec<Value> {
        let args: Vec<_> = ["certificates", path, "--json"].iter().chain(args).copied().collect();
        let output = octopus(&args);
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice(&output.stdout).expect("JSON")
    };
    let names = |shown: &[Value]| -> Vec<(String, bool)> {
        let name = |one: &Value| one["certificate"].as_str().expect("a name").to_owned();
        shown.iter().map(|one| (name(one), one["new"] == true)).collect()
    };
    let own = |name: &str, new| (name.to_owned(), new);
    let first = shown(&["--host=lab-2", "--learner=10.0.0.7", "--days=7"]);
    assert_eq!(names(&first), [own("authority", true), own("learner", true), own("lab-2", true)]);
    let addresses = first[1]["addresses"].to_string();
    assert!(addresses.contains("10.0.0.7") && addresses.contains("localhost"), "{addresses}");
    let valid = |one: &Value, key: &str| one[key].as_i64().expect("seconds");
    assert_eq!(valid(&first[2], "not_after") - valid(&first[2], "not_before"), 8 * 86_400);
    for name in ["authority", "learner", "lab-2"] {
        let mode = fs::metadata(dir.join(format!("{name}.key"))).expect("made").permissions();
        assert_eq!(mode.mode() & 0o777, 0o600, "{name}");
    }
    let second = shown(&["--host=lab-3"]);
    let there = |name| own(name, false);
    let expected = [there("authority"), there("learner"), there("lab-2"), own("lab-3", true)];
    assert_eq!(names(&second), expected);
    assert_eq!(
        second[..2].iter().map(|one| &one["not_after"]).collect::<Vec<_>>(),
        [&first[0]["not_after"], &first[1]["not_after"]]
    );
    let table = octopus(&["certificates", path]);
    let table = String::from_utf8_lossy(&table.stdout).into_owned();
    assert!(table.contains("lab-3") && table.contains("UTC") && !table.contains("new"), "{table}");
    let (code, text) = said(&["certificates", path, "--host=lab-2"]);
    assert_eq!(code, Some(5), "{text}");
    assert!(text.contains("nothing is overwritten"), "{text}");
    for wrong in ["--host=learner", "--host=a/b", "--learner=10.0.0.7:7447", "--days=0"] {
        let (code, text) = said(&["certificates", path, wrong]);
        assert_eq!(code, Some(2), "{wrong}: {text}");
    }
    let file = place.path().join("file");
    fs::write(&file, "").expect("writable");
    let (code, text) = said(&["certificates", file.join("below").to_str().expect("UTF-8")]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("cannot be written"), "{text}");
}

/// What a machine of another kind would do that reaches the port: speak no TLS, or begin and fall silent.
#[test]
fn noise_at_the_port_disturbs_nobody() {
    let certificates = Certificates::made(&["lab-2"]);
    let endpoint = free_quic_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=1000000", &certificates.flag()]);
    run.wait_for_iterations(1);
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let to = endpoint.trim_start_matches("quic/");
    for len in [0, 1, 20, 1200, 1500] {
        let noise: Vec<u8> = (0..len).map(|byte: u32| (byte * 37 % 251) as u8).collect();
        socket.send_to(&noise, to).expect("sent");
    }
    let given = certificates.for_host("lab-2");
    let mut helper = Machine::join(&endpoint, &["--workers=1", &flag(given.path())]);
    wait_for(&mut run, "(lab-2) helps with 1 worker", 1);
    assert!(run.children("gateway").len() == 1, "{}", run.log());
    helper.leave();
    run.signal(Signal::INT);
    run.succeed();
}
