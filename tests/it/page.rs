//! The page, in a real browser. Skipped, with a word, where there is no Chromium or the page is not built; a failure if all is to be tried.

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tests::guide::repository;
use tests::{Owned, Run, kill, octopus, program, python, stderr};

/// The browser, if both it and the page are there.
#[expect(clippy::print_stderr, reason = "a test says what it does not try")]
fn chromium() -> Option<PathBuf> {
    let found = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let chosen = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let chromium = chosen.or_else(|| found.iter().map(PathBuf::from).find(|path| path.is_file()));
    let missing = match &chromium {
        None => "no Chromium here; install it, or name one in CHROMIUM",
        Some(_) if !service::page::is_built() => service::page::MISSING,
        Some(_) => return chromium,
    };
    assert!(!in_full(), "{missing}");
    eprintln!("skipped: {missing}");
    None
}

/// Whether all is tried, and not only what takes less than a minute.
fn in_full() -> bool {
    std::env::var_os("SPACEOCTOPUS_WEB_TEST").is_some()
}

fn policy() -> PathBuf {
    policy_of("trajectory")
}

fn policy_of(task: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/policies").join(task)
}

/// What the script found.
fn browse(chromium: &Path, arguments: &[&str]) -> Value {
    browse_by("page.py", chromium, arguments)
}

fn browse_by(script: &str, chromium: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(python())
        .arg(tests::crosscheck(script))
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

/// It may be built while the program is there already, and is none before it is whole.
#[test]
fn the_page_is_found_beside_the_program() {
    // On the program's own file system, for a second name of it.
    let programs = program("octopus").with_file_name("");
    let dir = tempfile::tempdir_in(programs).expect("a directory");
    let place = dir.path().join("target/debug");
    std::fs::create_dir_all(&place).expect("a directory");
    let octopus = place.join("octopus");
    std::fs::hard_link(program("octopus"), &octopus).expect("can be linked");
    let out = dir.path().join("robot.html");
    let view = || {
        let mut command = Command::new(&octopus);
        command.arg("view").arg(policy()).arg("--out").arg(&out).output().expect("starts")
    };
    let without = view();
    assert_eq!(without.status.code(), Some(4), "{}", stderr(&without));
    assert!(stderr(&without).contains("`make page` builds it"), "{}", stderr(&without));

    let page = dir.path().join("target/octopus-page");
    std::fs::create_dir(&page).expect("a directory");
    for name in ["index.html", "page.css", "page.js", "worker.js", "simulator.wasm"] {
        std::fs::write(page.join(format!("{name}.gz")), name).expect("writes");
    }
    let half = view();
    assert_eq!(half.status.code(), Some(4), "{}", stderr(&half));
    assert!(!out.exists());
    std::fs::write(page.join("single.html"), "<!doctype html>\n<!-- data -->").expect("writes");
    let with = view();
    assert!(with.status.success(), "{}", stderr(&with));
    let written = std::fs::read_to_string(&out).expect("a file");
    for asset in ["page.css", "page.js", "worker.js", "simulator.wasm"] {
        assert!(written.contains(&format!("data-asset=\"{asset}\"")), "{asset}");
    }
}

/// Goals that are turned, arms that are held and limp; in full also other masses, late commands, and a robot of two policies
/// whose base's goal is turned. The native program then does all that again, with the same bits.
#[test]
fn what_is_done_to_the_robot_is_done_again_natively_to_the_bit() {
    let Some(chromium) = chromium() else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let at = |name: &str| dir.path().join(name).display().to_string();
    let [trajectory, reorientation] =
        ["trajectory", "reorientation"].map(|task| policy_of(task).display().to_string());
    let file = at("robot.html");
    let written = octopus(&["view", &trajectory, "--with", &reorientation, "--out", &file]);
    assert!(written.status.success(), "{}", stderr(&written));
    let form = if in_full() { "full" } else { "short" };
    let found = browse_by("page_hold.py", &chromium, &[form, &file]);
    let mut hash = blake3::Hasher::new();
    for state in found["states"].as_array().expect("states") {
        for bits in state.as_array().expect("numbers") {
            let bits = bits.as_u64().and_then(|bits| u32::try_from(bits).ok()).expect("a number");
            hash.update(&bits.to_le_bytes());
        }
    }
    let recording = at("episode.json");
    std::fs::write(&recording, found["recording"].to_string()).expect("writes");
    let again = ["experiment", "episode", "--json", "--script", &recording];
    let again =
        octopus(&[&again[..], &["--policy", &trajectory, "--policy", &reorientation]].concat());
    assert!(again.status.success(), "{}", stderr(&again));
    let again: Value = serde_json::from_slice(&again.stdout).expect("JSON");
    assert_eq!(again["states_blake3"], hash.finalize().to_hex().to_string());
    let states = found["states"].as_array().map_or(0, Vec::len);
    assert_eq!(again["steps"], states - 1);

    // The file of the episode opens in the page, and plays to the same end.
    let shown = at("episode.html");
    let policies = ["--policy", &trajectory, "--policy", &reorientation];
    let written = octopus(&[&["view", &recording, "--out", &shown][..], &policies].concat());
    assert!(written.status.success(), "{}", stderr(&written));
    let replayed = browse(&chromium, &["replayed", &shown]);
    assert_eq!(replayed["last"], found["states"][states - 1]);
    let (viewed, address) = Viewed::of(&[&[&*recording][..], &policies].concat());
    assert!(address.contains("/#play="), "{address}");
    let replayed = browse(&chromium, &["replayed", &address]);
    assert_eq!(replayed["last"], found["states"][states - 1]);
    drop(viewed);
}

/// A recording for robot viewers is played by the policy that it names.
#[test]
fn a_recorded_episode_is_shown() {
    let Some(chromium) = chromium() else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let at = |name: &str| dir.path().join(name).display().to_string();
    let what = policy().display().to_string();
    let (mcap, csv, html) = (at("reach.mcap"), at("reach.csv"), at("reach.html"));
    let made = ["record", &what, "--out", &mcap, "--csv", &csv, "--steps=20", "--episode=3"];
    let made = octopus(&made);
    assert!(made.status.success(), "{}", stderr(&made));
    let written = octopus(&["view", &mcap, "--out", &html]);
    assert!(written.status.success(), "{}", stderr(&written));
    let replayed = browse(&chromium, &["replayed", &html]);
    let table = std::fs::read_to_string(&csv).expect("columns");
    let last = table.lines().last().expect("a row").split(',').skip(1).take(3);
    let last: Vec<f32> = last.map(|number| number.parse().expect("a number")).collect();
    let shown = replayed["last"].as_array().expect("numbers").iter().take(3);
    let shown: Vec<f32> =
        shown.map(|bits| f32::from_bits(bits.as_u64().expect("bits") as u32)).collect();
    assert_eq!(shown, last, "the base is where the recording has it");

    // What is no episode, or has other policies, is refused in words.
    let text = at("text.json");
    std::fs::write(&text, "{\"steps\": \"five\"}").expect("writes");
    let other = policy_of("reorientation").display().to_string();
    std::fs::write(at("cut.mcap"), &std::fs::read(&mcap).expect("there")[..1000]).expect("writes");
    let script = at("script.json");
    std::fs::write(&script, "{\"steps\": 5, \"events\": []}").expect("writes");
    for (args, code, word) in [
        (vec!["view", &text], 3, "is no recording"),
        (vec!["view", &mcap, "--policy", &other], 3, "has the digest"),
        (vec!["view", &at("cut.mcap")], 3, "Foxglove and Rerun open it"),
        (vec!["view", &script], 3, "--policy CHECKPOINT"),
        (vec!["view", &what, "--policy", &other], 2, "is no file of an episode"),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(word), "{args:?}: {}", stderr(&refused));
    }
}

/// Every claim of the report, every box and every course leads to the episode behind it.
#[test]
fn what_the_report_says_can_be_watched() {
    let Some(chromium) = chromium() else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let out = dir.path().join("paper").display().to_string();
    let policies = policy().join("..").display().to_string();
    let args = ["--quick", "--episodes=2", "--steps=90", "--policies", &policies, "--out", &out];
    let made = octopus(&[&["reproduce"], &args[..]].concat());
    assert!(made.status.success(), "{}", stderr(&made));
    let form = if in_full() { "full" } else { "short" };
    let found = browse_by("page_report.py", &chromium, &[form, &out]);
    assert_eq!(found["claims"], 11, "{found}");
    assert!(found["clicked"].as_u64() > Some(5), "{found}");
}

/// `octopus view`, killed when dropped.
struct Viewed(Child);

impl Drop for Viewed {
    fn drop(&mut self) {
        kill(self.0.id(), Signal::INT);
        let _ = self.0.wait();
    }
}

impl Viewed {
    /// What it serves, and its address.
    fn of(arguments: &[&str]) -> (Self, String) {
        let mut process = Command::new(program("octopus"))
            .args(["view", "--json"])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("octopus can be started");
        let stdout = process.stdout.take().expect("piped");
        let viewed = Self(process);
        let mut line = String::new();
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let said: Value = serde_json::from_str(&line).expect("JSON");
        (viewed, said["address"].as_str().expect("an address").to_owned())
    }
}

/// The address holds the token and the page takes it out; without it, or with a wrong one, the page asks for it.
#[test]
fn a_policy_is_served_to_whoever_has_the_address() {
    let Some(chromium) = chromium() else { return };
    let (viewed, address) = Viewed::of(&[policy().to_str().expect("UTF-8")]);
    assert!(address.contains("/#policy=trajectory&token="), "{address}");
    browse(&chromium, &["served", &address]);
    drop(viewed);
}

/// The page and `octopus plot` have one band for one learning.
#[test]
fn runs_belong_together_as_the_configuration_says() {
    let path = repository().join("coordinator/web/src/runs/alike.ts");
    let text = std::fs::read_to_string(path).expect("the page's source");
    let (_, list) = text.split_once("HOUSEKEEPING = [").expect("a list");
    let (list, _) = list.split_once(']').expect("its end");
    let mut found: Vec<&str> = list.split('"').filter(|name| name.starts_with("run.")).collect();
    found.sort_unstable();
    let mut expected: Vec<String> = proto::config::Run::HARMLESS
        .iter()
        .chain(&["seed"])
        .map(|key| format!("run.{key}"))
        .collect();
    expected.sort_unstable();
    assert_eq!(found, expected);
}

/// A run that is over: a block of a kept policy is made again in the page, and is what the learner recorded; checkpoints are compared. Then
/// its service goes, for a minute in full, and comes again.
#[test]
fn a_finished_run_is_looked_at_and_its_service_goes_and_comes() {
    let Some(chromium) = chromium() else { return };
    let mut run = Run::train(&["--iterations=11", "--workers=1", "--overlap=1"]);
    run.succeed();
    let dir = tempfile::tempdir().expect("a directory");
    let token = "correct-horse-battery-staple";
    let file = dir.path().join("token");
    std::fs::write(&file, token).expect("writes");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("own file");
    let port = {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        listener.local_addr().expect("bound").port()
    };
    let path = run.path().display().to_string();
    let listen = format!("--listen=127.0.0.1:{port}");
    let file = format!("--token-file={}", file.display());
    let view = || Viewed::of(&[path.as_str(), &listen, &file]).0;
    let address = format!("http://127.0.0.1:{port}/#token={token}");

    let mut viewed = Some(view());
    browse_by("page_run.py", &chromium, &["rest", &address]);
    let seconds = if in_full() { "60" } else { "2" };
    let mut script = Command::new(python())
        .arg(tests::crosscheck("page_run.py"))
        .arg(&chromium)
        .args(["gone", &address, seconds])
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python can be started");
    let said = BufReader::new(script.stdout.take().expect("piped"));
    let mut script = Owned::from(script);
    for line in said.lines() {
        match line.expect("UTF-8").as_str() {
            "stop" => viewed = None,
            "start" => viewed = Some(view()),
            _ => {}
        }
    }
    assert!(script.succeeded(), "see above");
    drop(viewed);
}

/// A run that trains until it is stopped, and keeps what it is told to.
fn long_run() -> Run {
    Run::train(&["--iterations=1000000", "--workers=2", "--set=run.checkpoint_every=1000000"])
}

/// The address of the page of a run, as soon as it has one.
fn page_of(run: &Run) -> String {
    let path = run.path().display().to_string();
    let watchdog = Instant::now() + Duration::from_mins(2);
    loop {
        let said = octopus(&["view", &path, "--json"]);
        if said.status.success() {
            let said: Value = serde_json::from_slice(&said.stdout).expect("JSON");
            return said["address"].as_str().expect("an address").to_owned();
        }
        assert!(Instant::now() < watchdog, "{}; log:\n{}", stderr(&said), run.log());
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The page is open from the first iteration on, while a worker is killed, others come and go, checkpoints are
/// committed, pinned and tagged, and the run is stopped and resumed. Then it is looked at at rest, and among others.
///
/// It takes minutes where a browser draws without a GPU, so only `make web-test` does it.
#[test]
fn a_run_is_followed_from_its_first_iteration() {
    if !in_full() {
        return eprintln!("skipped: `make web-test` does it");
    }
    let Some(chromium) = chromium() else { return };
    let mut run = long_run();
    run.domain_when_there();
    let address = page_of(&run);
    let mut script = Command::new(python())
        .arg(tests::crosscheck("page_run.py"))
        .arg(&chromium)
        .args(["live", &address])
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python can be started");
    let said = BufReader::new(script.stdout.take().expect("piped"));
    let mut script = Owned::from(script);
    let mut found = String::new();
    for line in said.lines() {
        let line = line.expect("UTF-8");
        if line == "resume" {
            run.succeed();
            run.resume(&["--iterations=1000000"]);
        } else {
            found = line;
        }
    }
    assert!(script.succeeded(), "{}", run.log());
    run.succeed();
    let found: Value = serde_json::from_str(&found).expect("JSON");
    let pinned = found["pinned"].as_str().expect("a name");
    let labels =
        std::fs::read_to_string(run.path().join("checkpoints").join(pinned).join("labels.json"));
    let labels: Value = serde_json::from_str(&labels.expect("labels")).expect("JSON");
    assert_eq!(
        (&labels["pinned"], &labels["tags"]),
        (&true.into(), &serde_json::json!(["mine", "promoted"]))
    );
    // Whoever watched may have seen fewer; none of them was another one.
    assert!(run.digests().len() as u64 >= found["iterations"].as_u64().expect("a number"));

    let path = run.path();
    let (viewed, address) = Viewed::of(&[path.to_str().expect("UTF-8")]);
    browse_by("page_run.py", &chromium, &["rest", &address]);
    drop(viewed);
    among_others(&chromium, &path);
}

/// The run, one of another seed, and one of another discount, with a name as trials of a sweep have it, side by side.
fn among_others(chromium: &Path, run: &Path) {
    let dir = tempfile::tempdir().expect("a directory");
    for (name, key, from, to) in
        [("a", "seed", "7", "7"), ("b", "seed", "7", "8"), ("gamma=0.5,seed=7", "gamma", "", "0.5")]
    {
        let copy = dir.path().join(name);
        let copied = Command::new("cp").arg("-r").arg(run).arg(&copy).status();
        assert!(copied.expect("cp is there").success());
        let file = copy.join("config.toml");
        let text = std::fs::read_to_string(&file).expect("a configuration");
        let changed: String = text
            .lines()
            .map(|line| match line.strip_prefix(&format!("{key} = ")) {
                Some(value) if value == from || from.is_empty() => format!("{key} = {to}\n"),
                _ => format!("{line}\n"),
            })
            .collect();
        std::fs::write(&file, changed).expect("writes");
    }
    let (viewed, address) = Viewed::of(&[dir.path().to_str().expect("UTF-8")]);
    browse_by("page_run.py", chromium, &["runs", &address]);
    drop(viewed);
}
