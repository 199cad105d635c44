use std::fs;

use proto::Digest;
use proto::config::{Layers, Preset, TaskName};
use proto::message::{Errors, Losses};
use serde_json::Value;

use super::curve::Point;
use super::*;
use crate::selection::{MeanErrors, Means};

fn report(iteration: u64) -> IterationReport {
    IterationReport {
        iteration,
        env_steps: (iteration + 1) * 12800,
        digest: Digest([iteration as u8; 16]),
        policy_version: iteration,
        returns: vec![-3.5, 0.1],
        losses: Losses { kl: 0.01, explained_variance: f32::NAN, ..Losses::default() },
        errors: Errors { position: 0.2, orientation: 0.3, base: 0.04, contact_rate: 0.0 },
        ..IterationReport::default()
    }
}

fn live(wall_s: f64) -> Live {
    Live { wall_s, env_steps_per_s: 9000.4, workers: 2, restarts: 0 }
}

fn config() -> Config {
    Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).resolve().expect("valid")
}

/// A session that reports `iterations`, each a second after the one before.
fn session(run_dir: &RunDir, resume_from: Option<u64>, iterations: std::ops::Range<u64>) {
    let mut reporter = Reporter::create(run_dir, &config(), resume_from, true).expect("creates");
    for (i, iteration) in iterations.enumerate() {
        reporter.iteration(&report(iteration), &live(1.0 + i as f64)).expect("writes");
    }
    reporter.finish().expect("finishes");
}

fn iterations(run_dir: &RunDir) -> Vec<u64> {
    let lines = jsonl::read(&run_dir.metrics_jsonl()).expect("readable");
    lines.iter().map(|(_, line)| line["iteration"].as_u64().expect("a number")).collect()
}

/// The dotted names of an object's leaves.
fn leaves(prefix: &str, value: &Value, names: &mut Vec<String>) {
    let dotted = |name: &str| {
        if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") }
    };
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, value)| leaves(&dotted(name), value, names));
        }
        Value::Array(items) => {
            let items = items.iter().enumerate();
            items.for_each(|(i, value)| leaves(&dotted(&i.to_string()), value, names));
        }
        _ => names.push(prefix.to_owned()),
    }
}

#[test]
fn table_and_json_have_the_same_names_and_all_are_documented() {
    let line = Line::new(&report(0), &live(1.0));
    let mut from_json = Vec::new();
    leaves("", &serde_json::to_value(&line).expect("JSON"), &mut from_json);
    let mut from_cells: Vec<_> =
        line.cells().into_iter().map(|(name, _)| name.into_owned()).collect();
    from_json.sort();
    from_cells.sort();
    assert_eq!(from_json, from_cells);
    let essay = include_str!("mod.rs");
    for name in from_cells {
        let documented = match name.split_once('.') {
            Some(("returns", _)) => "`returns`".to_owned(),
            Some(("timing", name)) => format!(".{name}`"),
            _ => format!("`{name}`"),
        };
        assert!(essay.contains(&documented), "{documented} is not in the table of keys");
    }
}

#[test]
fn a_resumed_run_drops_what_its_checkpoint_does_not_hold() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    session(&run_dir, None, 0..5);
    // A crash in the middle of a line.
    let mut text = fs::read_to_string(run_dir.metrics_jsonl()).expect("readable");
    text.push_str("{\"iteration\":5,\"env_st");
    fs::write(run_dir.metrics_jsonl(), text).expect("writable");

    session(&run_dir, Some(3), 3..6);
    assert_eq!(iterations(&run_dir), [0, 1, 2, 3, 4, 5]);
    let csv = fs::read_to_string(run_dir.metrics_csv()).expect("readable");
    let first_cells: Vec<_> = csv.lines().filter_map(|row| row.split(',').next()).collect();
    assert_eq!(first_cells, ["iteration", "0", "1", "2", "3", "4", "5"]);
    // Iteration 2 ended 3 s after the start, so 3 ended a second later.
    let lines = jsonl::read(&run_dir.metrics_jsonl()).expect("readable");
    assert_eq!(lines[3].1["wall_s"], 4.0);
    assert!(lines[0].1["explained_variance"].is_null(), "NaN has no other form in JSON");
    assert_eq!(fs::read_dir(run_dir.events()).expect("readable").count(), 2);
    assert!(run_dir.curve().is_file());
}

fn evaluated(iteration: u64) -> Evaluated {
    let tail = MeanErrors { position: 0.01, orientation: 0.02, base: 0.03 };
    let errors = Means { tail, min: tail };
    let env_steps = iteration * 12800;
    Evaluated { iteration, env_steps, score: 0.5, episodes: 32, steps: 200, errors }
}

#[test]
fn evaluations_of_policies_that_are_trained_again_are_dropped() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    let mut reporter = Reporter::create(&run_dir, &config(), None, true).expect("creates");
    for iteration in 0..6 {
        reporter.iteration(&report(iteration), &live(1.0 + iteration as f64)).expect("writes");
        if iteration % 2 == 1 {
            reporter.evaluation(&evaluated(iteration + 1), 1.5).expect("writes");
        }
    }
    drop(reporter);
    // Four iterations are kept, and with them the policy after the fourth.
    let mut reporter = Reporter::create(&run_dir, &config(), Some(4), true).expect("creates");
    reporter.evaluation(&evaluated(5), 0.25).expect("writes");
    reporter.rewind(4).expect("rewinds");
    // By plan, and once more at the end.
    reporter.evaluation(&evaluated(6), 0.5).expect("writes");
    reporter.evaluation(&evaluated(6), 0.75).expect("writes nothing");
    reporter.durability().wait().expect("writes");
    let lines = jsonl::read(&run_dir.evaluations()).expect("readable");
    let of = |key: &str| lines.iter().map(|(_, line)| line[key].clone()).collect::<Vec<_>>();
    assert_eq!(of("iteration"), [2, 4, 6]);
    assert_eq!(of("wall_s"), [1.5, 1.5, 4.5]);
    assert_eq!(lines[0].1["errors"]["tail"]["orientation"], 0.02);
}

/// A reporter as a kill leaves it: nothing is finished.
fn killed(run_dir: &RunDir, resume_from: Option<u64>, iterations: std::ops::Range<u64>) {
    let mut reporter = Reporter::create(run_dir, &config(), resume_from, true).expect("creates");
    for iteration in iterations {
        reporter.check_promised(iteration, report(iteration).digest).expect("the same");
        reporter.iteration(&report(iteration), &live(1.0)).expect("writes");
    }
}

/// Digests once lived in memory between the cut of the lines and the comparison, and were gone with
/// the second process.
#[test]
fn what_was_cut_off_is_compared_even_after_a_second_kill() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..9);
    killed(&run_dir, Some(4), 4..6);
    assert_eq!(iterations(&run_dir), [0, 1, 2, 3, 4, 5]);

    let mut reporter =
        Reporter::create(&run_dir, &config(), Some(5), true).expect("creates, a third time");
    let error = reporter.check_promised(8, Digest([9; 16])).expect_err("another digest");
    assert!(error.to_string().contains("promised.jsonl"), "{error}");
    // Also when the learner dies in between.
    reporter.iteration(&report(5), &live(1.0)).expect("writes");
    reporter.rewind(5).expect("rewinds");
    for iteration in 5..9 {
        let other = reporter.check_promised(iteration, Digest([77; 16]));
        assert!(other.is_err(), "iteration {iteration}");
        assert!(run_dir.promised().is_file(), "iteration {iteration}");
        reporter.check_promised(iteration, report(iteration).digest).expect("the same");
        reporter.iteration(&report(iteration), &live(1.0)).expect("writes");
    }
    reporter.durability().wait().expect("writes");
    assert!(!run_dir.promised().exists(), "all is passed");
    reporter.check_promised(9, Digest([77; 16])).expect("nothing is known of it");
    assert_eq!(iterations(&run_dir), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
}

#[test]
fn promises_that_cannot_be_read_are_an_error_and_forgotten_ones_are_gone() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..4);
    let mut reporter = Reporter::create(&run_dir, &config(), Some(2), true).expect("creates");
    reporter.forget_promised().expect("forgets");
    reporter.check_promised(3, Digest([77; 16])).expect("another budget, another course");
    assert!(!run_dir.promised().exists());

    fs::write(run_dir.promised(), "{\"iteration\":3,\"digest\":\"12\"}\n").expect("writable");
    let error = Reporter::create(&run_dir, &config(), Some(2), true).expect_err("damaged");
    let error = format!("{error:#}");
    assert!(error.contains("promised.jsonl: line 1: ") && error.contains("without the file"));
}

#[test]
fn iterations_count_as_recorded_up_to_a_gap() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    assert_eq!(recorded(&run_dir).expect("readable"), 0);
    session(&run_dir, None, 0..5);
    assert_eq!(recorded(&run_dir).expect("readable"), 5);
    let text = fs::read_to_string(run_dir.metrics_jsonl()).expect("readable");
    let lines: Vec<_> = text.split_inclusive('\n').collect();
    let write = |parts: &[&str]| fs::write(run_dir.metrics_jsonl(), parts.concat());
    write(&[lines[0], lines[1], lines[3], lines[4]]).expect("writable");
    assert_eq!(recorded(&run_dir).expect("readable"), 2, "a line is missing");
    write(&[lines[0], "\0\0\0\0\n", lines[1]]).expect("writable");
    assert_eq!(recorded(&run_dir).expect("readable"), 1, "a block of zeros");
    let spoiled = [lines[0].as_bytes(), b"\"\xff\xfe\"\n", lines[1].as_bytes()].concat();
    fs::write(run_dir.metrics_jsonl(), spoiled).expect("writable");
    assert_eq!(recorded(&run_dir).expect("readable"), 1, "no text");
}

#[test]
fn checksums_are_those_of_the_reference() {
    // RFC 3720, B.4: 32 bytes of zeros.
    assert_eq!(crc32c::crc32c(&[0; 32]), 0x8a91_36aa);
    let rotated = 0x8a91_36aa_u32.rotate_right(15);
    assert_eq!(tensorboard::masked_crc(&[0; 32]), rotated.wrapping_add(0xa282_ead8));
}

/// The bytes were worked out by hand from event.proto and read back by TensorBoard itself in
/// `tests/crosscheck/read_events.py`.
#[test]
fn an_event_is_the_protocol_buffer_that_tensorboard_reads() {
    let event = tensorboard::summary(1.0, 300, &[("a/b".to_owned(), 0.5)]);
    let expected = [
        &[0x09][..], // wall_time, fixed64
        &1.0_f64.to_le_bytes(),
        &[0x10, 0xac, 0x02],             // step = 300, varint
        &[0x2a, 0x0c],                   // summary, 12 bytes
        &[0x0a, 0x0a],                   // its first value, 10 bytes
        &[0x0a, 0x03, b'a', b'/', b'b'], // tag
        &[0x15, 0x00, 0x00, 0x00, 0x3f], // simple_value = 0.5
    ]
    .concat();
    assert_eq!(event, expected);
    let version = tensorboard::file_version(0.0);
    assert_eq!(version[9..], *b"\x1a\x0dbrain.Event:2");
    let start = tensorboard::session_start(0.0, 1);
    assert_eq!(start[9..], [0x10, 1, 0x3a, 2, 0x08, 1]);
    let record = tensorboard::record(&event);
    assert_eq!(record.len(), event.len() + 16);
    assert_eq!(record[..8], (event.len() as u64).to_le_bytes());
}

#[test]
fn the_curve_of_a_long_run_stays_small() {
    let dir = tempfile::tempdir().expect("tempdir");
    let point = |i: usize| {
        let progress = i as f64 / 5000.0;
        let error = 0.3 * (-4.0 * progress).exp();
        let mean = -20.0 * (-3.0 * progress).exp();
        Point {
            env_steps: 400.0 * i as f64,
            wall_s: i as f64,
            mean,
            low: mean - 2.0,
            high: mean + 1.0,
            position: error,
            orientation: 2.0 * error,
            base: error,
        }
    };
    let points: Vec<_> = (1..5000).map(point).collect();
    for task in [TaskName::Trajectory, TaskName::Reorientation] {
        let path = dir.path().join(format!("{}.svg", task.as_str()));
        curve::draw(&path, &points, task).expect("draws");
        let svg = fs::read_to_string(path).expect("readable");
        assert!(svg.contains("env-steps") && svg.contains("mrad") && svg.len() < 200_000);
    }
}

#[test]
fn thousands_are_set_apart() {
    assert_eq!([7, 1000, 1_664_000].map(progress::grouped), ["7", "1,000", "1,664,000"]);
}

#[test]
fn lines_are_durable_when_a_checkpoint_may_be_committed_and_in_order() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    let mut reporter = Reporter::create(&run_dir, &config(), None, true).expect("creates");
    let durability = reporter.durability();
    for iteration in 0..200 {
        reporter.iteration(&report(iteration), &live(1.0)).expect("hands over");
        if iteration % 50 == 49 {
            // On another thread, as a committer is.
            let durability = durability.clone();
            std::thread::spawn(move || durability.wait().expect("writes")).join().expect("waits");
            assert_eq!(iterations(&run_dir), (0..=iteration).collect::<Vec<_>>());
        }
    }
    reporter.finish().expect("finishes");
}

#[test]
fn a_line_that_cannot_be_written_is_told_and_nothing_is_written_after_it() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    let reporter = Reporter::create(&run_dir, &config(), None, true).expect("creates");
    let failing = reporter.recorder.wait_for(|_| Err(anyhow::anyhow!("no space left")));
    assert!(failing.expect_err("fails").to_string().contains("no space left"));
    let mut reporter = reporter;
    let refused = reporter.iteration(&report(0), &live(1.0)).expect_err("nothing more is taken");
    assert!(refused.to_string().contains("no space left"), "{refused}");
    let refused = reporter.durability().wait().expect_err("nothing is durable");
    assert!(refused.to_string().contains("no space left"), "{refused}");
    drop(reporter);
    assert_eq!(iterations(&run_dir), [0; 0]);
}
