//! Beside a live run: status, workers, a checkpoint now; and beside none.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::http::StatusCode;
use serde_json::json;

use super::Bench;
use crate::http::limits::Limits;
use crate::live::{Best, Command, HostStatus, LiveRun, LiveStatus, ProcessStatus, Role, Totals};

/// A run's loop that does what it is asked at once.
struct FakeRun {
    live: LiveRun,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl FakeRun {
    fn start() -> Self {
        let live = LiveRun::new();
        live.publish(status());
        let stop = Arc::new(AtomicBool::new(false));
        let (board, stopped) = (live.clone(), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let mut workers = 2;
            while !stopped.load(Ordering::Relaxed) {
                match board.next_command() {
                    // As a run that is about to end does.
                    Some(Command::Scale { workers: 7, reply }) => {
                        let _ = reply.send(Err("the run is ending".to_owned()));
                    }
                    Some(Command::Scale { workers: 6, .. }) => {}
                    Some(Command::Scale { workers: wanted, reply }) => {
                        let _ = reply.send(Ok(std::mem::replace(&mut workers, wanted)));
                    }
                    Some(Command::ScaleHost { host, workers: wanted, reply }) => {
                        assert_eq!((host, wanted), (3, 4));
                        let _ = reply.send(Ok(2));
                    }
                    Some(Command::Checkpoint { reply }) => {
                        let _ = reply.send(Ok("iteration-00000042".to_owned()));
                    }
                    None => std::thread::sleep(Duration::from_millis(1)),
                }
            }
        });
        Self { live, stop, thread: Some(thread) }
    }

    fn bench(&self) -> Bench {
        Bench::with(&[1], Some(self.live.clone()), Limits::default())
    }
}

impl Drop for FakeRun {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn status() -> LiveStatus {
    let process = |role, worker, pid| ProcessStatus {
        role,
        worker,
        pid,
        state: "ready".to_owned(),
        restarts: 1,
        resident_bytes: 1 << 20,
        cpu_s: 2.5,
        shards: vec!["3/1".to_owned()],
        env_steps: 77,
        rollout_s: 0.25,
    };
    LiveStatus {
        run_dir: "/runs/a \"strange\"\\name".into(),
        state: "training".to_owned(),
        task: "trajectory \"x\"\\\n".to_owned(),
        iterations: 42,
        planned_iterations: 100,
        env_steps: 12345,
        env_steps_per_s: 1e6,
        workers: 2,
        min_workers: 1,
        max_workers: 8,
        processes: vec![
            process(Role::Learner, None, Some(10)),
            process(Role::Worker, Some(0), Some(11)),
            process(Role::Worker, Some(1), None),
        ],
        hosts: [(3, "lab"), (5, "twin"), (6, "twin")]
            .map(|(host, name)| HostStatus {
                host,
                name: name.to_owned(),
                max_workers: 16,
                ..HostStatus::default()
            })
            .to_vec(),
        accounting: Totals { produced: 10, received: 9, trained: 8, duplicate: 1, lost: 1 },
        best: Some(Best { name: "iteration-00000001".to_owned(), score: 0.5 }),
        eta_s: Some(3.0),
        ..LiveStatus::default()
    }
}

#[tokio::test]
async fn beside_no_run_there_is_nothing_to_ask() {
    let bench = Bench::new(&[1]);
    for line in ["GET /v1/status", "PUT /v1/workers", "POST /v1/checkpoints"] {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{line}");
        assert!(answer.error().contains("no live run"), "{line}");
    }
}

#[tokio::test]
async fn the_status_is_the_boards() {
    let run = FakeRun::start();
    let answer = run.bench().ask("GET /v1/status").await;
    assert_eq!(answer.status, StatusCode::OK);
    let read: LiveStatus = serde_json::from_slice(&answer.body).expect("a status");
    assert_eq!(read, status());
}

#[tokio::test]
async fn workers_are_scaled_within_the_limit() {
    let run = FakeRun::start();
    let bench = run.bench();
    let answer = bench.put_json("/v1/workers", r#"{"workers": 5}"#).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.json(), json!({ "workers": 5, "before": 2 }));
    let answer = bench.put_json("/v1/workers", r#"{"workers": 1}"#).await;
    assert_eq!(answer.json(), json!({ "workers": 1, "before": 5 }));
    for (body, status, word) in [
        (r#"{"workers": 0}"#, 422, "1 to 8"),
        (r#"{"workers": 9}"#, 422, "1 to 8"),
        (r#"{"workers": -1}"#, 422, "`-1`, expected a whole number"),
        (r#"{"workers": 1.5}"#, 422, "floating point"),
        (r#"{"workers": 99999999999999999999999}"#, 422, "JSON"),
        (r#"{"worker": 1}"#, 422, "worker"),
        (r#"{"workers": 1, "force": true}"#, 422, "force"),
        (r#"{"workers": 1"#, 422, "EOF"),
        ("[]", 422, "JSON"),
        ("[1]", 422, "a list, expected an object in braces"),
        (" \n[1, null]", 422, "a list, expected an object in braces"),
        ("", 422, "EOF"),
        (r#"{"workers": 7}"#, 409, "ending"),
        (r#"{"workers": 6}"#, 409, "no more requests"),
        (r#"{"workers": 4, "host": "attic"}"#, 422, "there are 3 (lab), 5 (twin), 6 (twin)"),
        (r#"{"workers": 4, "host": "twin"}"#, 422, "its number, 5 or 6"),
        (r#"{"workers": 17, "host": "lab"}"#, 422, "1 to 16"),
    ] {
        let answer = bench.put_json("/v1/workers", body).await;
        assert_eq!(answer.status.as_u16(), status, "{body}: {answer:?}");
        assert!(answer.error().contains(word), "{body}: {}", answer.error());
    }
    for body in [r#"{"workers": 4, "host": "lab"}"#, r#"{"workers": 4, "host": "3"}"#] {
        let answer = bench.put_json("/v1/workers", body).await;
        assert_eq!(answer.json(), json!({ "workers": 4, "before": 2 }), "{body}");
    }
    let long = format!("{{\"workers\": {}1}}", " ".repeat(70_000));
    let answer = bench.put_json("/v1/workers", &long).await;
    assert_eq!(answer.status, StatusCode::PAYLOAD_TOO_LARGE);
    let headers = [("content-type", "application/x-www-form-urlencoded")];
    let answer = bench.send("PUT /v1/workers", &headers, r#"{"workers": 1}"#).await;
    assert_eq!(answer.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
}

#[tokio::test]
async fn a_checkpoint_is_committed_when_asked_for() {
    let run = FakeRun::start();
    let answer = run.bench().ask("POST /v1/checkpoints").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.json(), json!({ "checkpoint": "iteration-00000042" }));
}

#[tokio::test]
async fn a_run_that_does_not_answer_is_not_waited_for_for_ever() {
    let live = LiveRun::new();
    let limits = Limits { command_time: Duration::from_millis(10), ..Limits::default() };
    let bench = Bench::with(&[], Some(live.clone()), limits);
    let answer = bench.ask("POST /v1/checkpoints").await;
    assert_eq!(answer.status, StatusCode::ACCEPTED);
    assert_eq!(answer.json(), json!({ "checkpoint": null }));
    let answer = bench.put_json("/v1/workers", r#"{"workers": 5}"#).await;
    assert_eq!(answer.status, StatusCode::GATEWAY_TIMEOUT);
    live.close();
    let answer = bench.ask("POST /v1/checkpoints").await;
    assert_eq!(answer.status, StatusCode::CONFLICT);
    assert!(answer.error().contains("ending"));
}

/// A sample: name, labels, value.
type Sample = (String, Vec<(String, String)>, f64);

/// Reads the text format strictly, as its specification has it; returns the samples.
fn parse(page: &str) -> Vec<Sample> {
    let mut family: Option<(String, String)> = None;
    let mut finished = Vec::new();
    let mut samples = Vec::new();
    assert!(page.ends_with('\n'), "the last line ends too");
    let mut helped = String::new();
    for line in page.lines() {
        if let Some(rest) = line.strip_prefix("# HELP ") {
            helped = rest.split_once(' ').expect("name and text").0.to_owned();
        } else if let Some(rest) = line.strip_prefix("# TYPE ") {
            let (name, kind) = rest.split_once(' ').expect("name and type");
            assert_eq!(name, helped, "help comes before the type");
            assert!(["gauge", "counter", "histogram"].contains(&kind), "{line}");
            assert_eq!(kind == "counter", name.ends_with("_total"), "{line}");
            assert!(!finished.contains(&name.to_owned()), "{name} comes in one piece");
            finished.push(name.to_owned());
            family = Some((name.to_owned(), kind.to_owned()));
        } else {
            let (name, labels, value) = parse_sample(line);
            let (family, kind) = family.as_ref().expect("a type before the first sample");
            let suffixes: &[&str] =
                if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
            let fits = suffixes.iter().any(|suffix| name == format!("{family}{suffix}"));
            assert!(fits, "{line} stands in the family {family}");
            samples.push((name, labels, value));
        }
    }
    samples
}

fn parse_sample(line: &str) -> Sample {
    let end = line.find(['{', ' ']).expect("a value");
    let (name, mut rest) = line.split_at(end);
    let word = |text: &str| {
        !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
    };
    assert!(word(name), "{line}");
    let mut labels = Vec::new();
    if let Some(inside) = rest.strip_prefix('{') {
        rest = inside;
        loop {
            let (label, after) = rest.split_once("=\"").expect("a label");
            assert!(word(label), "{line}");
            let mut text = String::new();
            let mut chars = after.char_indices();
            let close = loop {
                match chars.next().expect("a closing quote") {
                    (at, '"') => break at,
                    (_, '\\') => text.push(match chars.next().expect("escaped").1 {
                        'n' => '\n',
                        other @ ('\\' | '"') => other,
                        other => panic!("\\{other} in {line}"),
                    }),
                    (_, other) => text.push(other),
                }
            };
            labels.push((label.to_owned(), text));
            rest = &after[close + 1..];
            match rest.split_at(1) {
                (",", more) => rest = more,
                ("}", more) => break rest = more,
                _ => panic!("{line}"),
            }
        }
    }
    let value = rest.strip_prefix(' ').expect("a space before the value");
    (name.to_owned(), labels, value.parse().unwrap_or_else(|_| panic!("{line}")))
}

#[tokio::test]
async fn the_metrics_are_what_prometheus_reads_and_what_the_run_says() {
    let run = FakeRun::start();
    let bench = run.bench();
    for _ in 0..3 {
        bench.ask("GET /v1/checkpoints/latest").await;
    }
    bench.ask("GET /v1/checkpoints/nothing").await;
    bench.ask("BREW /coffee/1").await;
    let answer = bench.ask("GET /metrics").await;
    assert!(answer.header("content-type").starts_with("text/plain; version=0.0.4"));
    let samples = parse(std::str::from_utf8(&answer.body).expect("UTF-8"));
    let value = |name: &str, wanted: &[(&str, &str)]| {
        let found: Vec<f64> = samples
            .iter()
            .filter(|(there, labels, _)| {
                there == name
                    && wanted
                        .iter()
                        .all(|(label, text)| labels.iter().any(|(l, t)| l == label && t == text))
            })
            .map(|(.., value)| *value)
            .collect();
        assert_eq!(found.len(), 1, "{name} {wanted:?}");
        found[0]
    };
    assert_eq!(value("octopus_checkpoints", &[]), 1.0);
    let bytes = bench.store.entries().expect("entries")[0].bytes as f64;
    assert_eq!(value("octopus_checkpoint_bytes", &[]), bytes);
    assert_eq!(value("octopus_env_steps_total", &[("task", "trajectory \"x\"\\\n")]), 12345.0);
    assert_eq!(value("octopus_run_state", &[("state", "training")]), 1.0);
    assert_eq!(value("octopus_accounted_env_steps_total", &[("fate", "lost")]), 1.0);
    assert_eq!(value("octopus_process_up", &[("role", "worker"), ("worker", "0")]), 1.0);
    assert_eq!(value("octopus_process_up", &[("role", "worker"), ("worker", "1")]), 0.0);
    assert_eq!(value("octopus_process_cpu_seconds_total", &[("role", "learner")]), 2.5);
    assert_eq!(value("octopus_best_score", &[]), 0.5);
    let route = ("route", "/v1/checkpoints/{name}");
    let requests = "octopus_http_requests_total";
    assert_eq!(value(requests, &[("method", "GET"), route, ("status", "200")]), 3.0);
    assert_eq!(value(requests, &[("method", "GET"), route, ("status", "404")]), 1.0);
    assert_eq!(value(requests, &[("method", "other"), ("route", "none")]), 1.0);
    let duration = "octopus_http_request_duration_seconds";
    assert_eq!(value(&format!("{duration}_count"), &[route]), 4.0);
    assert_eq!(value(&format!("{duration}_bucket"), &[route, ("le", "+Inf")]), 4.0);
    let buckets: Vec<f64> = samples
        .iter()
        .filter(|(name, labels, _)| *name == format!("{duration}_bucket") && labels[0].1 == route.1)
        .map(|(.., value)| *value)
        .collect();
    assert!(buckets.is_sorted(), "buckets are cumulative: {buckets:?}");
}
