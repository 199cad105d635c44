//! Checkpoints in a bucket: against a real server of S3, over wires that are cut, with servers that fail.

use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tests::bucket::{KEY_ID, S3Server, SECRET, Wire, credentials, octopus_at, tells_secrets};
use tests::{Run, octopus, program, stderr};

/// Where runs of these tests keep their checkpoints.
const ADDRESS: &str = "s3://bucket/runs/a";
const SENT: &str = "--set=run.checkpoints=s3://bucket/runs/a";

/// A run that does not begin before it is told to, with the credentials of the server at `port`.
fn run_at(port: u16) -> Run {
    let mut run = Run::new();
    let variables = credentials(port);
    let variables: Vec<_> = variables.iter().map(|(name, value)| (*name, value.as_str())).collect();
    run.set_variables(&variables);
    run
}

/// The digests of a run of so many iterations that nothing disturbs.
fn undisturbed(iterations: u32) -> Vec<String> {
    let mut run = Run::train(&["--workers=1", &format!("--iterations={iterations}")]);
    run.succeed();
    run.digests()
}

/// Sends a run's checkpoints into a bucket and stops it on its way.
fn paused(port: u16, at: u32, of: u32) -> Run {
    let mut run = run_at(port);
    let (of, at) = (format!("--iterations={of}"), format!("--pause-at={at}"));
    run.start_training(&["--workers=1", &of, &at, SENT]);
    run.succeed();
    run
}

/// Expects the exit code; returns what was printed.
fn at(port: u16, code: i32, args: &[&str]) -> String {
    let output = octopus_at(port, args);
    expect(&output, code, args);
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn expect(output: &Output, code: i32, args: &[&str]) -> String {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    assert!(!message.contains("panicked"), "{args:?}:\n{message}");
    assert!(!message.contains(SECRET) && !message.contains(KEY_ID), "{args:?}:\n{message}");
    message
}

/// Names of the checkpoints in a bucket.
fn names(port: u16, address: &str) -> Vec<String> {
    let list: Value =
        serde_json::from_str(&at(port, 0, &["checkpoints", "list", address, "--json"]))
            .expect("JSON");
    assert_eq!(list["damaged"], Value::Array(Vec::new()));
    let entries = list["entries"].as_array().expect("entries").iter();
    entries.map(|entry| entry["name"].as_str().expect("a name").to_owned()).collect()
}

/// What a run's directory says about its bucket.
fn status(run: &Run) -> Value {
    let output = octopus(&["status", &run.path().display().to_string(), "--json"]);
    let status: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    status["bucket"].clone()
}

/// Waits until `done`, of a run that goes on.
fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let watchdog = Instant::now() + Duration::from_mins(2);
    while !done() {
        assert!(Instant::now() < watchdog, "{what} has not come");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_machine_that_has_nothing_but_the_bucket_goes_on_to_the_same_bits() {
    let expected = undisturbed(14);
    let server = S3Server::start();
    let port = server.port();
    let first = paused(port, 7, 14);
    assert!(!first.log().contains("bucket"), "all is well: {}", first.log());
    assert_eq!(status(&first)["waiting"], Value::Array(Vec::new()));
    let shown = octopus(&["status", &first.path().display().to_string()]);
    let shown = String::from_utf8_lossy(&shown.stdout).into_owned();
    assert!(shown.contains("bucket        s3://bucket/runs/a: has all checkpoints"), "{shown}");
    assert_eq!(names(port, ADDRESS), ["iteration-00000005", "iteration-00000007"]);
    assert!(!tells_secrets(&first.path()));
    assert!(!first.log().contains(SECRET) && !first.log().contains(KEY_ID));
    drop(first);

    let place = tempfile::tempdir().expect("tempdir");
    let dir = place.path().join("again");
    let dir = dir.to_str().expect("UTF-8");
    let said = octopus_at(port, &["resume", ADDRESS, "--run-dir", dir, "--no-eval"]);
    let said = expect(&said, 0, &["resume"]);
    assert!(said.contains("iteration-00000007 of s3://bucket/runs/a is in"), "{said}");
    let metrics = std::fs::read_to_string(Path::new(dir).join("metrics.jsonl")).expect("metrics");
    let digests: Vec<String> = metrics
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON")["digest"].clone())
        .map(|digest| digest.as_str().expect("a digest").to_owned())
        .collect();
    assert_eq!(digests, expected);
    assert!(!tells_secrets(place.path()));
    assert_eq!(names(port, ADDRESS).last().expect("some"), "iteration-00000014");
    at(port, 0, &["checkpoints", "verify", ADDRESS]);

    // Where the run is now, no second copy lands.
    let again = octopus_at(port, &["resume", ADDRESS, "--run-dir", dir]);
    assert!(expect(&again, 5, &["resume"]).contains("holds a run already"));
    let here = octopus_at(port, &["resume", dir, "--run-dir", "elsewhere"]);
    expect(&here, 2, &["resume"]);
}

#[test]
fn checkpoints_of_a_bucket_are_shown_compared_labelled_exported_served_and_removed() {
    let server = S3Server::start();
    let port = server.port();
    let run = paused(port, 7, 14);
    let five = format!("{ADDRESS}:5");
    let shown = at(port, 0, &["checkpoints", "show", &five]);
    assert!(
        shown.contains("whole") && shown.contains("s3://bucket/runs/a:iteration-00000005"),
        "{shown}"
    );
    at(port, 1, &["checkpoints", "diff", &five, ADDRESS]);
    let local = format!("{}:latest", run.path().display());
    at(port, 0, &["checkpoints", "diff", ADDRESS, &local]);

    at(port, 0, &["checkpoints", "pin", &five]);
    at(port, 5, &["checkpoints", "show", &format!("{ADDRESS}:none")]);
    at(port, 2, &["checkpoints", "tag", &five, "best"]);
    // Eight at the same time: each sees what the others have said.
    let tags: Vec<String> = (0..8).map(|n| format!("tag-{n}")).collect();
    std::thread::scope(|scope| {
        for tag in &tags {
            scope.spawn(|| at(port, 0, &["checkpoints", "tag", &five, tag]));
        }
    });
    let list = at(port, 0, &["checkpoints", "list", ADDRESS, "--json"]);
    let list: Value = serde_json::from_str(&list).expect("JSON");
    assert_eq!(list["entries"][0]["labels"]["pinned"], true);
    assert_eq!(list["entries"][0]["labels"]["tags"], serde_json::json!(tags));
    // A tag moves.
    at(port, 0, &["checkpoints", "tag", ADDRESS, "tag-0"]);
    let seven = at(port, 0, &["checkpoints", "show", &format!("{ADDRESS}:tag-0"), "--json"]);
    assert!(seven.contains("iteration-00000007"), "{seven}");
    at(port, 0, &["checkpoints", "untag", ADDRESS, "tag-0"]);
    at(port, 5, &["checkpoints", "untag", ADDRESS, "tag-0"]);

    let place = tempfile::tempdir().expect("tempdir");
    let archive = place.path().join("five.tar");
    let archive = archive.to_str().expect("UTF-8");
    at(port, 0, &["checkpoints", "export", &five, "--out", archive]);
    let store = place.path().join("store");
    let store = store.to_str().expect("UTF-8");
    at(port, 0, &["checkpoints", "import", archive, "--store", store]);
    at(port, 2, &["checkpoints", "import", archive, "--store", ADDRESS]);

    let prune = ["checkpoints", "prune", ADDRESS, "--keep-latest=1", "--json"];
    let pruned = |more: &[&str]| -> Value {
        serde_json::from_str(&at(port, 0, &[&prune[..], more].concat())).expect("JSON")
    };
    assert_eq!(pruned(&[])["removed"], serde_json::json!([]), "pinned and tagged ones stay");
    at(port, 0, &["checkpoints", "tag", ADDRESS, "passing"]);
    serves(port);

    at(port, 5, &["checkpoints", "delete", &five]);
    at(port, 0, &["checkpoints", "unpin", &five]);
    for tag in &tags[1..] {
        at(port, 0, &["checkpoints", "untag", ADDRESS, tag]);
    }
    let doomed = serde_json::json!(["iteration-00000005"]);
    assert_eq!(pruned(&["--dry-run"])["removed"], doomed);
    assert_eq!(names(port, ADDRESS).len(), 2, "a dry run removes nothing");
    assert_eq!(pruned(&[])["removed"], doomed);
    assert_eq!(names(port, ADDRESS), ["iteration-00000007"]);
    let left = server.ask("GET", "/bucket?prefix=runs/a/checkpoints/iteration-00000005", "");
    assert!(!left.contains("<Key>"), "nothing of it is left: {left}");
}

/// A service shows what is in the bucket, and changes nothing.
fn serves(port: u16) {
    use std::io::{BufRead as _, BufReader};
    let mut command = Command::new(program("octopus"));
    command.args(["serve", "--store", ADDRESS, "--listen=127.0.0.1:0", "--json"]);
    command.envs(credentials(port)).stdout(std::process::Stdio::piped());
    let mut child = command.spawn().expect("it starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("a pipe")).read_line(&mut line).expect("a line");
    let service = tests::Owned::from(child);
    let line: Value = serde_json::from_str(&line).expect("JSON");
    assert_eq!((&line["store"], &line["checkpoints"]), (&ADDRESS.into(), &2.into()));
    let token =
        std::fs::read_to_string(line["token_file"].as_str().expect("a path")).expect("a token");
    let address = line["address"].as_str().expect("an address");
    let ask = |method: &str, path: &str| {
        use std::io::{Read as _, Write as _};
        let mut stream = std::net::TcpStream::connect(address).expect("it listens");
        let request = format!(
            "{method} {path} HTTP/1.0\r\nHost: {address}\r\nAuthorization: Bearer {}\r\n\r\n",
            token.trim()
        );
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    };
    let listed = ask("GET", "/v1/checkpoints");
    assert!(
        listed.contains("iteration-00000005") && listed.contains("iteration-00000007"),
        "{listed}"
    );
    // It follows the bucket, also where the last that was said of a checkpoint is taken back.
    assert!(listed.contains("passing"), "{listed}");
    at(port, 0, &["checkpoints", "untag", ADDRESS, "passing"]);
    let watchdog = Instant::now() + Duration::from_mins(2);
    while ask("GET", "/v1/checkpoints").contains("passing") {
        assert!(Instant::now() < watchdog, "the service still has the tag");
        std::thread::sleep(Duration::from_millis(200));
    }
    let refused = ask("DELETE", "/v1/checkpoints/iteration-00000005");
    assert!(refused.starts_with("HTTP/1.0 403"), "{refused}");
    tests::kill(service.id(), Signal::TERM);
    let mut service = service;
    assert!(service.succeeded());
}

#[test]
fn what_could_not_be_sent_is_sent_later() {
    let server = S3Server::start();
    let wire = Wire::to(server.port());
    wire.set_down(true);
    let mut run = run_at(wire.port());
    run.start_training(&["--workers=1", "--iterations=7", SENT]);
    run.succeed();
    let log = run.log();
    assert!(log.contains("checkpoints are not sent to the bucket: s3://bucket/runs/a"), "{log}");
    assert!(log.contains("2 checkpoints are not in s3://bucket/runs/a"), "{log}");
    let waiting = ["iteration-00000007", "iteration-00000005"];
    assert_eq!(status(&run)["waiting"], serde_json::json!(waiting));
    assert!(status(&run)["trouble"].as_str().expect("a reason").contains("cannot be reached"));

    // It has nothing more to train, and something to send.
    wire.set_down(false);
    run.resume(&[]);
    run.succeed();
    assert_eq!(status(&run)["waiting"], serde_json::json!([]));
    assert_eq!(names(server.port(), ADDRESS), ["iteration-00000005", "iteration-00000007"]);
    at(server.port(), 0, &["checkpoints", "verify", ADDRESS]);
}

/// What its HTTP service says, which the page of the run shows, too.
#[test]
fn a_live_run_says_how_far_its_bucket_is() {
    let server = S3Server::start();
    let wire = Wire::to(server.port());
    wire.set_down(true);
    let mut run = run_at(wire.port());
    run.start_training(&["--workers=1", "--iterations=1000000", SENT]);
    run.wait_for_iterations(7);
    let wait_until = |run: &Run, what: &str, is_so: &dyn Fn(&Value) -> bool| {
        let watchdog = Instant::now() + Duration::from_mins(2);
        loop {
            let directory = run.path().display().to_string();
            let output = octopus(&["status", &directory, "--json"]);
            let status: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            let bucket = &status["live"]["bucket"];
            if is_so(bucket) {
                return;
            }
            assert!(Instant::now() < watchdog, "not {what}: {bucket}; log:\n{}", run.log());
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    wait_until(&run, "in trouble", &|bucket| {
        bucket["address"] == ADDRESS
            && bucket["trouble"].as_str().is_some_and(|why| why.contains("cannot be reached"))
            && bucket["waiting"].as_array().is_some_and(|waiting| !waiting.is_empty())
    });
    wire.set_down(false);
    wait_until(&run, "out of it", &|bucket| bucket["trouble"].is_null());
    run.signal(Signal::INT);
    run.succeed();
    assert_eq!(status(&run)["waiting"], serde_json::json!([]));
}

#[test]
fn cut_wires_and_failing_servers_cost_time_and_nothing_else() {
    let server = S3Server::start();
    let wire = Wire::to(server.port());
    let mut run = run_at(wire.port());
    server.fail(r#"{"unavailable": 5, "slow_s": 0.05}"#);
    run.start_training(&["--workers=1", "--iterations=40", "--set=run.checkpoints_kept=100", SENT]);
    for n in 1..6 {
        run.wait_for_iterations(5 * n);
        // In the middle of whatever is being sent.
        wire.cut_after(10_000 + 3_000 * n as i64);
        server.fail(r#"{"unavailable": 3}"#);
    }
    run.succeed();
    run.resume(&[]);
    run.succeed();
    assert_eq!(status(&run)["waiting"], serde_json::json!([]), "{}", run.log());
    let expected: Vec<String> = (1..9).map(|n| format!("iteration-{:08}", 5 * n)).collect();
    assert_eq!(names(server.port(), ADDRESS), expected);
    at(server.port(), 0, &["checkpoints", "verify", ADDRESS]);
    assert_eq!(run.digests().len(), 40);
}

/// What is sent in parts is cut between and within them.
#[test]
fn large_files_are_sent_in_parts_and_come_back_whole() {
    let server = S3Server::start();
    let wire = Wire::to(server.port());
    let mut run = run_at(wire.port());
    wire.cut_after(10_000_000);
    run.start_training(&[
        "--workers=1",
        "--iterations=5",
        "--set=network.critic_hidden=[1024,1024]",
        SENT,
    ]);
    run.succeed();
    run.resume(&[]);
    run.succeed();
    let state = run.path().join("checkpoints/iteration-00000005/state.safetensors");
    let bytes = std::fs::metadata(state).expect("there").len();
    assert!(bytes > 10_000_000, "{bytes} bytes are one part, or two");
    assert_eq!(status(&run)["waiting"], serde_json::json!([]), "{}", run.log());
    at(server.port(), 0, &["checkpoints", "verify", ADDRESS]);
    let place = format!("{}:latest", run.path().display());
    at(wire.port(), 0, &["checkpoints", "diff", ADDRESS, &place]);
}

/// What the run says of a checkpoint goes to the bucket, and what others say of it there stays.
#[test]
fn scores_and_labels_of_both_sides_come_together() {
    let server = S3Server::start();
    let port = server.port();
    let mut run = run_at(port);
    let evaluated = [
        "--workers=1",
        "--iterations=12",
        "--pause-at=6",
        "--set=run.evaluate_every=3",
        "--set=run.evaluation_episodes=2",
        "--set=run.evaluation_steps=4",
        "--set=run.best_after=0",
        SENT,
    ];
    run.start_training(&evaluated);
    run.succeed();
    let list = || -> Value {
        let list = at(port, 0, &["checkpoints", "list", ADDRESS, "--json"]);
        serde_json::from_str::<Value>(&list).expect("JSON")["entries"].clone()
    };
    let best = |entries: &Value| {
        let entries = entries.as_array().expect("entries").clone();
        let tagged = entries.iter().filter(|entry| {
            entry["labels"]["tags"].as_array().expect("tags").contains(&"best".into())
        });
        tagged.map(|entry| entry["name"].as_str().expect("a name").to_owned()).collect::<Vec<_>>()
    };
    let local = octopus(&["checkpoints", "list", &run.path().display().to_string(), "--json"]);
    let local: Value = serde_json::from_slice(&local.stdout).expect("JSON");
    let first = best(&local["entries"]);
    assert_eq!((first.len(), best(&list())), (1, first.clone()));

    let newest = format!("{}:latest", run.path().display());
    at(port, 0, &["checkpoints", "tag", ADDRESS, "theirs"]);
    at(port, 0, &["checkpoints", "tag", &newest, "ours"]);
    // Nothing but the label is to be sent.
    run.resume(&["--pause-at=6"]);
    run.succeed();
    let entries = list();
    let entry = entries.as_array().expect("entries").iter();
    let entry = entry.max_by_key(|entry| entry["iteration"].as_u64()).expect("some");
    let tags = entry["labels"]["tags"].as_array().expect("tags");
    assert!(tags.contains(&"theirs".into()) && tags.contains(&"ours".into()), "{tags:?}");

    let place = tempfile::tempdir().expect("tempdir");
    let dir = place.path().join("again");
    let dir = dir.to_str().expect("UTF-8");
    at(port, 0, &["resume", ADDRESS, "--run-dir", dir, "--no-eval", "--pause-at=6"]);
    let restored = octopus(&["checkpoints", "list", dir, "--json"]);
    let restored: Value = serde_json::from_slice(&restored.stdout).expect("JSON");
    assert_eq!(best(&restored["entries"]), first, "what is best is known there, too");
}

#[test]
fn of_two_runs_with_one_prefix_the_second_sends_nothing() {
    let server = S3Server::start();
    let port = server.port();
    let _first = paused(port, 5, 10);
    let mut second = run_at(port);
    second.start_training(&["--workers=1", "--iterations=5", "--set=run.seed=8", SENT]);
    second.succeed();
    let log = second.log();
    assert!(log.contains("s3://bucket/runs/a: belongs to another run"), "{log}");
    assert!(log.contains("none is sent any more"), "{log}");
    assert_eq!(names(port, ADDRESS), ["iteration-00000005"]);
    at(port, 0, &["checkpoints", "verify", ADDRESS]);
    assert!(status(&second)["trouble"].as_str().expect("why").contains("another run"));
}

#[test]
fn a_run_that_goes_on_elsewhere_is_sent_from_there() {
    let expected = undisturbed(12);
    let server = S3Server::start();
    let port = server.port();
    let mut old = paused(port, 6, 12);
    let place = tempfile::tempdir().expect("tempdir");
    let dir = place.path().join("new");
    let dir = dir.to_str().expect("UTF-8");
    // The old one comes back in the middle of the new one's work, which then sends no more.
    let mut command = Command::new(program("octopus"));
    command.args(["resume", ADDRESS, "--run-dir", dir, "--no-eval", "--pause-at=8"]);
    let output = command.envs(credentials(port)).output().expect("it starts");
    expect(&output, 0, &["resume"]);
    old.resume(&["--workers=2"]);
    old.succeed();
    assert_eq!(old.digests(), expected);
    let again = octopus_at(port, &["resume", dir, "--no-eval"]);
    expect(&again, 0, &["resume"]);
    let names = names(port, ADDRESS);
    assert_eq!(names.last().expect("some"), "iteration-00000012");
    assert!(names.contains(&"iteration-00000008".to_owned()), "{names:?}");
    at(port, 0, &["checkpoints", "verify", ADDRESS]);
}

#[test]
fn a_session_that_was_taken_over_stops_sending() {
    let server = S3Server::start();
    let port = server.port();
    let mut old = run_at(port);
    old.start_training(&["--workers=1", "--iterations=100000", SENT]);
    wait_until("a checkpoint", || !names(port, ADDRESS).is_empty());
    let place = tempfile::tempdir().expect("tempdir");
    let dir = place.path().join("new");
    let dir = dir.to_str().expect("UTF-8");
    let output =
        octopus_at(port, &["resume", ADDRESS, "--run-dir", dir, "--no-eval", "--time-limit=1s"]);
    expect(&output, 0, &["resume"]);
    wait_until("the old session's word", || old.log().contains("has taken it over"));
    old.signal(rustix::process::Signal::INT);
    old.succeed();
    at(port, 0, &["checkpoints", "verify", ADDRESS]);
}

#[test]
fn a_bucket_that_does_not_exist_or_cannot_be_written_is_said_and_the_run_goes_on() {
    let server = S3Server::start();
    let port = server.port();
    let mut run = run_at(port);
    run.start_training(&[
        "--workers=1",
        "--iterations=5",
        "--set=run.checkpoints=s3://none/runs/a",
    ]);
    run.succeed();
    assert!(run.log().contains("there is no such bucket"), "{}", run.log());
    let list = octopus_at(port, &["checkpoints", "list", "s3://none/runs/a"]);
    assert!(expect(&list, 4, &["list"]).contains("there is no such bucket"));

    server.fail(r#"{"read_only": true}"#);
    let mut run = run_at(port);
    run.start_training(&["--workers=1", "--iterations=5", SENT]);
    run.succeed();
    assert!(run.log().contains("the credentials do not allow it"), "{}", run.log());
    assert!(!run.log().contains(SECRET) && !run.log().contains(KEY_ID));
    server.fail(r#"{"read_only": false}"#);

    let nothing = octopus_at(port, &["resume", ADDRESS, "--run-dir", "/nonexistent/run"]);
    let said = expect(&nothing, 5, &["resume"]);
    assert!(said.contains("/nonexistent") || said.contains("holds no checkpoint"), "{said}");
    let place = tempfile::tempdir().expect("tempdir");
    let dir = place.path().join("run");
    let nothing = octopus_at(port, &["resume", ADDRESS, "--run-dir", &dir.display().to_string()]);
    assert!(expect(&nothing, 5, &["resume"]).contains("holds no checkpoint"));
    assert!(std::fs::read_dir(place.path()).expect("there").next().is_none(), "nothing is left");
}

#[test]
fn addresses_that_are_none_are_refused_and_no_secret_in_them_is_repeated() {
    for wrong in
        ["s3://", "s3://bucket", "http://bucket/a", "s3://KEY:hidden@bucket/a", "file://a/b"]
    {
        let set = format!("--set=run.checkpoints=\"{wrong}\"");
        let output = octopus(&["train", "--dry-run", &set]);
        let said = expect(&output, 3, &[&set]);
        assert!(said.contains("run.checkpoints") && !said.contains("hidden"), "{said}");
        let output = octopus(&["checkpoints", "list", wrong]);
        let said = expect(&output, 2, &["list", wrong]);
        assert!(said.contains("is no address of a bucket") && !said.contains("hidden"), "{said}");
    }
    let output = octopus(&["eval", "s3://bucket/a:best"]);
    assert!(
        expect(&output, 5, &["eval"]).contains("is a bucket, which this command does not read")
    );
}

/// A directory that others see, too, is the simplest bucket; what is changed in it under us is found.
#[test]
fn what_was_changed_in_a_bucket_is_found_and_passed_over() {
    let expected = undisturbed(12);
    let place = tempfile::tempdir().expect("tempdir");
    let address = format!("file://{}/shared/a", place.path().display());
    let mut run = Run::new();
    let set = format!("--set=run.checkpoints={address}");
    run.start_training(&["--workers=1", "--iterations=12", "--pause-at=10", &set]);
    run.succeed();
    assert_eq!(names(1, &address), ["iteration-00000005", "iteration-00000010"]);
    let newest = place.path().join("shared/a/checkpoints/iteration-00000010");
    let state = std::fs::read_dir(&newest).expect("there").flatten();
    let state =
        state.map(|entry| entry.path()).find(|path| path.display().to_string().contains("/state."));
    let state = state.expect("a state");
    let mut bytes = std::fs::read(&state).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&state, bytes).expect("written");

    let verified = octopus(&["checkpoints", "verify", &address]);
    expect(&verified, 5, &["verify"]);
    let verified = String::from_utf8_lossy(&verified.stdout).into_owned();
    assert!(verified.contains("differs from its BLAKE3 hash"), "{verified}");
    let dir = place.path().join("again");
    let shown = dir.display().to_string();
    let output = octopus(&["resume", &address, "--run-dir", &shown, "--no-eval"]);
    let said = expect(&output, 0, &["resume"]);
    assert!(said.contains("going on from iteration-00000005 instead"), "{said}");
    let metrics = std::fs::read_to_string(dir.join("metrics.jsonl")).expect("metrics");
    for (line, digest) in metrics.lines().zip(&expected) {
        assert!(line.contains(digest.as_str()), "{line}");
    }
    assert_eq!(metrics.lines().count(), 12);
    assert_eq!(names(1, &address).len(), 3);
    // The run has made it again, and replaced it.
    at(1, 0, &["checkpoints", "verify", &address]);
}

/// A copied checkpoint was sent as the run's own, and a damaged one kept all older ones and all labels back.
#[test]
fn neither_a_copied_nor_a_damaged_checkpoint_is_in_the_way_of_the_others() {
    let place = tempfile::tempdir().expect("tempdir");
    let address = format!("file://{}/bucket/a", place.path().display());
    let in_the_way = place.path().join("bucket");
    std::fs::write(&in_the_way, "no directory").expect("written");
    let mut run = Run::new();
    let set = format!("--set=run.checkpoints={address}");
    run.start_training(&["--workers=1", "--iterations=12", &set]);
    run.succeed();
    assert!(run.log().contains("3 checkpoints are not in"), "{}", run.log());

    let own = |iteration: u64| run.path().join(format!("checkpoints/iteration-{iteration:08}"));
    copy(&own(12), &own(13), "iteration", &serde_json::json!(13));
    let state = own(10).join("state.safetensors");
    let mut bytes = std::fs::read(&state).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&state, bytes).expect("written");
    let pinned = format!("{}:12", run.path().display());
    expect(&octopus(&["checkpoints", "pin", &pinned]), 0, &["pin"]);
    std::fs::remove_file(&in_the_way).expect("removed");
    run.resume(&[]);
    run.succeed();
    let log = run.log();
    assert!(log.contains("not all checkpoints are sent to the bucket"), "{log}");
    assert!(log.contains("one checkpoint is not in"), "{log}");
    assert_eq!(status(&run)["waiting"], serde_json::json!(["iteration-00000010"]));
    assert_eq!(names(1, &address), ["iteration-00000005", "iteration-00000012"]);
    let list = at(1, 0, &["checkpoints", "list", &address]);
    assert!(list.contains("pinned"), "{list}");

    // As buckets hold it that were written before copies were told from others.
    let sent = |iteration: u64| in_the_way.join(format!("a/checkpoints/iteration-{iteration:08}"));
    copy(&sent(12), &sent(13), "manifest", &{
        let record = std::fs::read_to_string(sent(12).join("manifest.json")).expect("a record");
        let mut record: Value = serde_json::from_str(&record).expect("JSON");
        record["manifest"]["iteration"] = serde_json::json!(13);
        record["manifest"].take()
    });
    // What a resume passes over is the newest of nothing, and pushes out no checkpoint of the run's own.
    let shown = at(1, 0, &["checkpoints", "show", &address]);
    assert!(
        shown.contains("iteration-00000012") && !shown.contains("iteration-00000013"),
        "{shown}"
    );
    at(1, 0, &["checkpoints", "unpin", &format!("{address}:12")]);
    let prune = ["checkpoints", "prune", &address, "--keep-latest=1", "--dry-run", "--json"];
    let pruned: Value = serde_json::from_str(&at(1, 0, &prune)).expect("JSON");
    assert_eq!(pruned["removed"], serde_json::json!(["iteration-00000005"]));
    let dir = place.path().join("again").display().to_string();
    let output = octopus(&["resume", &address, "--run-dir", &dir]);
    let said = expect(&output, 0, &["resume"]);
    assert!(said.contains("is no checkpoint that its run has made"), "{said}");
    assert!(said.contains("iteration-00000012"), "{said}");
}

/// They kept all other labels back, the message said that no checkpoint is sent, and a resume passed the checkpoint over.
#[test]
fn unreadable_labels_in_a_bucket_are_in_the_way_of_nothing_else() {
    let place = tempfile::tempdir().expect("tempdir");
    let address = format!("file://{}/a", place.path().display());
    let mut run = Run::new();
    let set = format!("--set=run.checkpoints={address}");
    run.start_training(&["--workers=1", "--iterations=15", "--pause-at=10", &set]);
    run.succeed();
    let sent = |iteration: u64| {
        place.path().join(format!("a/checkpoints/iteration-{iteration:08}/labels.json"))
    };
    std::fs::write(sent(5), "rotten").expect("written");
    let here = run.path().display().to_string();
    for (iteration, tag) in [(5, "early"), (10, "late")] {
        let tag = ["checkpoints", "tag", &format!("{here}:{iteration}"), tag];
        expect(&octopus(&tag), 0, &tag);
    }
    run.resume(&[]);
    run.succeed();
    let log = run.log();
    assert_eq!(log.matches("not all labels are sent to the bucket").count(), 1, "{log}");
    assert!(log.contains("labels.json: not labels") && log.contains("checkpoints unpin"), "{log}");
    assert!(!log.contains("checkpoints are not sent"), "{log}");
    assert_eq!(status(&run)["waiting"], serde_json::json!([]));
    assert_eq!(
        std::fs::read_to_string(sent(5)).expect("there"),
        "rotten",
        "it is not written over"
    );
    assert!(std::fs::read_to_string(sent(10)).expect("there").contains("late"));

    let list = octopus(&["checkpoints", "list", &address]);
    let said = expect(&list, 0, &["list"]);
    assert!(said.contains("labels.json: not labels"), "{said}");
    let list = String::from_utf8_lossy(&list.stdout).into_owned();
    assert!(list.contains("iteration-00000015") && list.contains("pinned"), "{list}");
    // A run goes on from it.
    std::fs::write(sent(15), "[]").expect("written");
    let dir = place.path().join("again").display().to_string();
    let output = octopus(&["resume", &address, "--run-dir", &dir, "--no-eval"]);
    assert!(expect(&output, 0, &["resume"]).contains("iteration-00000015 of file:///"));

    at(1, 0, &["checkpoints", "unpin", &format!("{address}:5")]);
    at(1, 0, &["checkpoints", "verify", &address]);
    run.resume(&[]);
    run.succeed();
    assert!(std::fs::read_to_string(sent(5)).expect("there").contains("early"), "{}", run.log());
    assert_eq!(status(&run)["trouble"], Value::Null);
}

/// It lay there for ever, with all checkpoints of the bucket in it. (That it is also removed is tried where it cannot remove
/// what other tests have killed.)
#[test]
fn the_copy_of_a_bucket_that_a_killed_service_leaves_is_found_by_clean() {
    use std::io::{BufRead as _, BufReader};
    let place = tempfile::tempdir().expect("tempdir");
    let address = format!("file://{}/a", place.path().display());
    let mut run = Run::new();
    let set = format!("--set=run.checkpoints={address}");
    run.start_training(&["--workers=1", "--iterations=5", &set]);
    run.succeed();
    let temporary = place.path().join("temporary");
    std::fs::create_dir(&temporary).expect("made");
    let with = |args: &[&str]| {
        let mut command = Command::new(program("octopus"));
        command.args(args).env("TMPDIR", &temporary).stdin(std::process::Stdio::null());
        command
    };
    let found = || {
        let output = with(&["clean", "--dry-run", "--json"]).output().expect("it starts");
        expect(&output, 0, &["clean"]);
        let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let entries = found.as_array().expect("a list").iter();
        let paths = entries.filter_map(|entry| entry["directory"].as_str());
        paths.map(std::path::PathBuf::from).collect::<Vec<_>>()
    };
    let mut serve = with(&["serve", "--store", &address, "--listen=127.0.0.1:0", "--json"]);
    let mut child = serve.stdout(std::process::Stdio::piped()).spawn().expect("it starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("a pipe")).read_line(&mut line).expect("a line");
    let service = tests::Owned::from(child);
    assert!(line.contains("\"checkpoints\":1"), "{line}");
    assert!(found().is_empty(), "it is used");
    tests::kill(service.id(), Signal::KILL);
    drop(service);
    let [left] = <[_; 1]>::try_from(found()).expect("what it left");
    assert!(left.starts_with(&temporary) && left.join("checkpoints").is_dir(), "{left:?}");
}

/// Copies a checkpoint, and changes a key of its manifest.
fn copy(from: &Path, to: &Path, key: &str, value: &Value) {
    std::fs::create_dir(to).expect("made");
    for file in std::fs::read_dir(from).expect("there").flatten() {
        std::fs::copy(file.path(), to.join(file.file_name())).expect("copied");
    }
    let manifest = to.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).expect("a manifest");
    let mut json: Value = serde_json::from_str(&text).expect("JSON");
    json[key] = value.clone();
    std::fs::write(&manifest, json.to_string()).expect("written");
}
