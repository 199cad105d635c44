use std::fs;

use proto::config::{Layers, Preset, Schedule, TaskName};
use proto::message::{Errors, Losses};
use proto::{Digest, ExitCode};
use serde_json::Value;
use store::recorded::Recorded;

use super::points::Point;
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
    let blocks = vec![Digest([1; 16]), Digest([2; 16])];
    Live { wall_s, env_steps_per_s: 9000.4, workers: 2, blocks, ..Live::default() }
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
    let lines = store::jsonl::read(&run_dir.metrics_jsonl()).expect("readable");
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
            Some((array @ ("returns" | "blocks"), _)) => format!("`{array}`"),
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
    let lines = store::jsonl::read(&run_dir.metrics_jsonl()).expect("readable");
    assert_eq!(lines[3].1["wall_s"], 4.0);
    assert!(lines[0].1["explained_variance"].is_null(), "NaN has no other form in JSON");
    assert_eq!(fs::read_dir(run_dir.events()).expect("readable").count(), 2);
    assert!(run_dir.curve().is_file());
}

#[test]
fn a_table_with_other_columns_gets_those_of_this_program() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    session(&run_dir, None, 0..3);
    let table = || fs::read_to_string(run_dir.metrics_csv()).expect("readable");
    let rows = |text: &str| -> Vec<Vec<String>> {
        text.lines().map(|row| row.split(',').map(str::to_owned).collect()).collect()
    };
    let before = rows(&table());
    // Of a program that had no second column.
    let older: Vec<String> =
        before.iter().map(|row| [&row[..1], &row[2..]].concat().join(",") + "\n").collect();
    fs::write(run_dir.metrics_csv(), older.concat()).expect("writable");
    session(&run_dir, Some(2), 2..4);
    let after = rows(&table());
    assert_eq!(after.len(), 5);
    assert_eq!(after[0], before[0]);
    // JSON writes some numbers in another form.
    let same = |a: &String, b: &String| {
        a == b || a.parse::<f64>().is_ok_and(|a| b.parse::<f64>() == Ok(a))
    };
    for (before, after) in before.iter().zip(&after).skip(1).take(2) {
        let differs = before.iter().zip(after).position(|(a, b)| !same(a, b));
        assert_eq!((differs, before.len()), (None, after.len()), "{before:?} {after:?}");
    }
}

#[test]
fn a_disk_that_stands_still_holds_no_iteration_up_and_loses_none() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    let mut reporter = Reporter::create(&run_dir, &config(), None, true).expect("creates");
    let still = reporter.durability().stand_still();
    for iteration in 0..200 {
        reporter.iteration(&report(iteration), &live(1.0)).expect("hands over");
        if iteration % 10 == 9 {
            reporter.evaluation(&evaluated(iteration + 1), 1.5).expect("hands over");
        }
    }
    assert_eq!(iterations(&run_dir), [0; 0], "all of them wait");
    drop(still);
    reporter.durability().wait().expect("writes");
    assert_eq!(iterations(&run_dir), (0..200).collect::<Vec<_>>());
    let evaluations = store::jsonl::read(&run_dir.evaluations()).expect("readable");
    assert_eq!(evaluations.len(), 20);
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
    let lines = store::jsonl::read(&run_dir.evaluations()).expect("readable");
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
fn promises_that_cannot_be_read_are_an_error() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..4);
    let line = "{\"iteration\":3,\"digest\":\"12\"}\n";
    fs::write(run_dir.promised(), line).expect("writable");
    let error = Reporter::create(&run_dir, &config(), Some(2), true).expect_err("damaged");
    let error = format!("{error:#}");
    assert!(error.contains("promised.jsonl: line 1: ") && error.contains("without the file"));

    // Of an earlier version, without a seal.
    let line = format!("{{\"iteration\":3,\"digest\":\"{}\"}}\n", Digest([5; 16]));
    fs::write(run_dir.promised(), line).expect("writable");
    let reporter = Reporter::create(&run_dir, &config(), Some(2), true).expect("readable");
    assert!(reporter.check_promised(3, Digest([6; 16])).is_err());
    reporter.check_promised(3, Digest([5; 16])).expect("the promised one");
}

/// A changed digit once passed for other bits, of which the machine was blamed.
#[test]
fn a_promise_that_was_changed_is_no_promise() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..6);
    drop(Reporter::create(&run_dir, &config(), Some(2), true).expect("creates"));
    let whole = fs::read(run_dir.promised()).expect("promises");
    let text = String::from_utf8(whole.clone()).expect("text");
    assert_eq!(text.lines().count(), 1 + 4);
    Promised::read(&run_dir).expect("as it was written");
    let refused = |bytes: &[u8]| {
        fs::write(run_dir.promised(), bytes).expect("writable");
        Promised::read(&run_dir).expect_err("changed").to_string()
    };
    let digits = text.bytes().enumerate().filter(|(_, byte)| byte.is_ascii_digit());
    for (place, byte) in digits {
        let mut bytes = whole.clone();
        bytes[place] = if byte == b'0' { b'1' } else { b'0' };
        let error = refused(&bytes);
        assert!(error.contains("promised.jsonl: ") && error.contains("the run goes on"), "{error}");
    }
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    for parts in [&lines[..4], &[lines[0], lines[2], lines[3], lines[4]], &[lines[0]]] {
        assert!(refused(parts.concat().as_bytes()).contains("was changed"), "{parts:?}");
    }
}

#[test]
fn lines_that_say_something_else_than_was_promised_are_named() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..6);
    killed(&run_dir, Some(2), 2..4);
    let agree = || {
        let recorded = Recorded::read(&run_dir).expect("readable");
        Promised::read(&run_dir).expect("readable").agree(&recorded)
    };
    agree().expect("what was written");
    let text = fs::read_to_string(run_dir.metrics_jsonl()).expect("readable");
    let other = Digest([99; 16]).to_string();
    let edited = text.replace(&report(3).digest.to_string(), &other);
    fs::write(run_dir.metrics_jsonl(), edited).expect("writable");
    let error = agree().expect_err("changed");
    assert_eq!(error.code, ExitCode::RunDirectory);
    for word in ["metrics.jsonl: line 4 has digest", &other, "promised.jsonl", "was changed"] {
        assert!(error.message.contains(word), "{word}: {error}");
    }
}

/// The configuration of a run whose budget was changed.
fn longer() -> Config {
    let mut config = config();
    config.run.env_steps *= 2;
    config
}

/// A kill between the change of the budget and the end of its promises once made the next resume report
/// a difference that was none.
#[test]
fn a_change_of_the_budget_may_be_cut_short_anywhere() {
    let budget = |config: &Config| config.run.env_steps;
    let resumed = |run_dir: &RunDir| {
        let reporter = Reporter::create(run_dir, &longer(), Some(2), true).expect("creates");
        for iteration in 2..8 {
            reporter.check_promised(iteration, Digest([77; 16])).expect("another course");
        }
        assert!(!run_dir.promised().exists());
        assert_eq!(iterations(run_dir), [0, 1]);
        let last = Budgets::read(run_dir).expect("readable").last().expect("written");
        assert_eq!((last.from, last.env_steps), (2, budget(&longer())));
    };
    // What is there before: lines of six iterations, and promises of three of these and two more.
    let before = || {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        killed(&run_dir, None, 0..8);
        killed(&run_dir, Some(3), 3..6);
        assert_eq!(Budgets::read(&run_dir).expect("readable").last().map(|b| b.from), Some(0));
        assert!(run_dir.promised().is_file());
        (dir, run_dir)
    };
    let (_dir, run_dir) = before();
    resumed(&run_dir);
    // The lines are cut, the promises are there.
    let (_dir, run_dir) = before();
    JsonLines::open(&run_dir.metrics_jsonl(), 2).expect("cuts");
    resumed(&run_dir);
    // Nothing is left but to write the budget down.
    let (_dir, run_dir) = before();
    JsonLines::open(&run_dir.metrics_jsonl(), 2).expect("cuts");
    fs::remove_file(run_dir.promised()).expect("removable");
    resumed(&run_dir);
    // All was done, and then the machine was lost.
    resumed(&run_dir);
    // Whoever takes the change back before it has begun has lost no promise.
    let (_dir, run_dir) = before();
    let reporter = Reporter::create(&run_dir, &config(), Some(2), true).expect("creates");
    for iteration in 2..8 {
        assert!(reporter.check_promised(iteration, Digest([77; 16])).is_err(), "{iteration}");
    }
}

#[test]
fn iterations_of_a_budget_before_promise_nothing_of_this_one() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..6);
    let mut reporter = Reporter::create(&run_dir, &longer(), Some(4), true).expect("creates");
    for iteration in 4..6 {
        reporter.iteration(&report(iteration), &live(1.0)).expect("writes");
    }
    // The learner dies, and its checkpoint is there: the same again.
    reporter.rewind(4).expect("rewinds");
    assert!(reporter.check_promised(5, Digest([77; 16])).is_err());
    // It is lost: what came after the older one came from another budget.
    reporter.rewind(3).expect("rewinds");
    for iteration in 3..6 {
        reporter.check_promised(iteration, Digest([77; 16])).expect("another course");
    }
    let last = Budgets::read(&run_dir).expect("readable").last().expect("written");
    assert_eq!((last.from, last.env_steps), (3, longer().run.env_steps));

    // Where nothing falls over the budget, nothing changes with it.
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    killed(&run_dir, None, 0..6);
    let mut constant = longer();
    constant.optimizer.schedule = Schedule::Constant;
    let reporter = Reporter::create(&run_dir, &constant, Some(4), true).expect("creates");
    assert!(reporter.check_promised(5, Digest([77; 16])).is_err());

    fs::write(dir.path().join("budgets.json"), "{}").expect("writable");
    let error = Reporter::create(&run_dir, &constant, Some(4), true).expect_err("damaged");
    assert!(format!("{error:#}").contains("budgets.json: cannot be understood"), "{error:#}");
}

#[test]
fn lines_count_and_end_where_the_file_is_spoiled() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = RunDir::new(dir.path());
    let recorded = || Recorded::read(&run_dir).map(|recorded| recorded.iterations());
    assert_eq!(recorded().expect("none"), 0);
    session(&run_dir, None, 0..5);
    let whole = Recorded::read(&run_dir).expect("readable");
    assert_eq!((whole.iterations(), whole.digest_after(0)), (5, None));
    assert_eq!(whole.digest_after(5), Some(report(4).digest));
    assert_eq!(whole.digest_after(6), None);

    let text = fs::read_to_string(run_dir.metrics_jsonl()).expect("readable");
    let lines: Vec<_> = text.split_inclusive('\n').collect();
    let write = |parts: &[&str]| fs::write(run_dir.metrics_jsonl(), parts.concat());
    write(&[lines[0], "\0\0\0\0\n", lines[1]]).expect("writable");
    assert_eq!(recorded().expect("readable"), 1, "a block of zeros");
    let spoiled = [lines[0].as_bytes(), b"\"\xff\xfe\"\n", lines[1].as_bytes()].concat();
    fs::write(run_dir.metrics_jsonl(), spoiled).expect("writable");
    assert_eq!(recorded().expect("readable"), 1, "no text");

    // Twice the same lines once made a run of twice the lines.
    let digest = report(1).digest.to_string();
    let none = lines[1].replace(&digest, "x");
    let nameless = lines[1].replace("\"digest\"", "\"digits\"");
    for (parts, expected) in [
        (&[&text[..], &text][..], "line 6: is of iteration 0, expected 5"),
        (&[lines[0], lines[1], lines[3]], "line 3: is of iteration 3, expected 2"),
        (&[lines[0], lines[0]], "line 2: is of iteration 0, expected 1"),
        (&[lines[0], "{}\n"], "line 2: is of iteration null, expected 1"),
        (&[lines[0], &none], "line 2: has the digest \"x\", which is none"),
        (&[lines[0], &nameless], "line 2: has no digest"),
    ] {
        write(parts).expect("writable");
        let error = recorded().expect_err(expected);
        assert_eq!(error.code, ExitCode::RunDirectory);
        for word in ["metrics.jsonl", expected, "put the file back", "octopus resume"] {
            assert!(error.message.contains(word), "{word}: {error}");
        }
    }
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
    assert_eq!([7, 1000, 1_664_000].map(output::grouped), ["7", "1,000", "1,664,000"]);
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
