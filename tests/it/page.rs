//! The page, in a real browser. Skipped, with a word, where there is no Chromium or the program has no page.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use rustix::process::Signal;
use serde_json::Value;
use tests::{kill, octopus, program, python, stderr};

/// The browser, if both it and the page are there.
#[expect(clippy::print_stderr, reason = "a test says what it does not try")]
fn chromium() -> Option<PathBuf> {
    let found = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let chosen = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let chromium = chosen.or_else(|| found.iter().map(PathBuf::from).find(|path| path.is_file()));
    if chromium.is_none() {
        eprintln!("skipped: no Chromium here; install it, or name one in CHROMIUM");
    } else if !service::page::is_built() {
        eprintln!("skipped: {}", service::page::MISSING);
        return None;
    }
    chromium
}

fn policy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/policies/trajectory")
}

/// What the script found.
fn browse(chromium: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(python())
        .arg(tests::crosscheck("page.py"))
        .arg(chromium)
        .args(arguments)
        .output()
        .expect("Python can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("the script prints JSON")
}

/// The robot is drawn; a goal that is dragged is reached; pause, step, back and a link give the same bits; no request
/// leaves the file.
#[test]
fn one_file_shows_the_robot_without_a_network() {
    let Some(chromium) = chromium() else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("robot.html");
    let (what, out) = (policy(), file.display().to_string());
    let written = octopus(&["view", what.to_str().expect("UTF-8"), "--out", &out]);
    assert!(written.status.success(), "{}", stderr(&written));
    let found = browse(&chromium, &["file", &out]);
    assert!(found["goal_error_m"].as_f64().expect("a number") < 0.01, "{found}");
    // It writes over its own, and over nothing else.
    let again = octopus(&["view", what.to_str().expect("UTF-8"), "--out", &out]);
    assert!(again.status.success(), "{}", stderr(&again));
    std::fs::write(&file, "somebody's").expect("writes");
    let refused = octopus(&["view", what.to_str().expect("UTF-8"), "--out", &out]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
}

/// `octopus view`, killed when dropped.
struct Viewed(Child);

impl Drop for Viewed {
    fn drop(&mut self) {
        kill(self.0.id(), Signal::INT);
        let _ = self.0.wait();
    }
}

/// The address holds the token and the page takes it out; without it, or with a wrong one, the page asks for it.
#[test]
fn a_policy_is_served_to_whoever_has_the_address() {
    let Some(chromium) = chromium() else { return };
    let mut process = Command::new(program("octopus"))
        .args(["view", "--json"])
        .arg(policy())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect("octopus can be started");
    let stdout = process.stdout.take().expect("piped");
    let viewed = Viewed(process);
    let mut line = String::new();
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    let said: Value = serde_json::from_str(&line).expect("JSON");
    let address = said["address"].as_str().expect("an address");
    assert!(address.contains("/#policy=trajectory&token="), "{address}");
    browse(&chromium, &["served", address]);
    drop(viewed);
}
