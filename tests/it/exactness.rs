//! The same bits whatever happens.

use rustix::process::Signal;
use tests::{Run, assert_nothing_left, kill};

/// Digests of a calm run with `workers` workers.
fn calm(workers: &str, overlap: &str, iterations: &str) -> Vec<String> {
    let mut run = Run::train(&[
        &format!("--workers={workers}"),
        &format!("--overlap={overlap}"),
        &format!("--iterations={iterations}"),
    ]);
    run.succeed();
    run.digests()
}

#[test]
fn the_number_of_workers_changes_no_bit() {
    for overlap in ["0", "1"] {
        let one = calm("1", overlap, "6");
        assert_eq!(one.len(), 6);
        assert_ne!(one[0], one[1], "training moves the parameters");
        assert_eq!(calm("3", overlap, "6"), one, "overlap {overlap}");
    }
}

#[test]
fn a_killed_worker_is_replaced_and_changes_no_bit() {
    let expected = calm("2", "1", "40");
    let mut run = Run::train(&["--workers=2", "--overlap=1", "--iterations=40"]);
    for at in [3, 9, 15] {
        run.wait_for_iterations(at);
        let workers = run.children("sim-worker");
        assert!(!workers.is_empty(), "no worker lives");
        kill(workers[0], Signal::KILL);
    }
    let domain = run.domain();
    run.succeed();
    assert_eq!(run.digests(), expected);
    assert!(run.log().contains("has been replaced"), "{}", run.log());
    for line in run.metrics() {
        let steps = |key: &str| line["accounting"][key].as_u64().expect("a count");
        assert_eq!(
            steps("produced"),
            steps("trained") + steps("duplicate") + steps("lost"),
            "{line}"
        );
        assert_eq!(steps("trained"), 128);
    }
    assert_nothing_left(&domain);
}

#[test]
fn a_stop_and_a_resume_change_no_bit() {
    for overlap in ["0", "1"] {
        let overlap_flag = format!("--overlap={overlap}");
        let expected = calm("2", overlap, "40");
        let mut run = Run::train(&["--workers=2", &overlap_flag, "--iterations=40"]);
        run.wait_for_iterations(4);
        let domain = run.domain();
        run.signal(Signal::INT);
        run.succeed();
        assert_nothing_left(&domain);
        let done = run.digests().len();
        assert!((4..40).contains(&done), "stopped after {done} iterations");
        run.resume(&["--workers=1"]);
        run.succeed();
        assert_eq!(run.digests(), expected, "overlap {overlap}, stopped after {done}");
    }
}

#[test]
fn a_killed_coordinator_leaves_nothing_and_its_run_resumes_to_the_same_bits() {
    let expected = calm("2", "1", "40");
    let mut run = Run::train(&["--workers=2", "--overlap=1", "--iterations=40"]);
    run.wait_for_iterations(12);
    let domain = run.domain();
    run.signal(Signal::KILL);
    assert_eq!(run.wait(), None);
    assert_nothing_left(&domain);
    run.resume(&[]);
    run.succeed();
    assert_eq!(run.digests(), expected);
}

#[test]
fn a_killed_learner_ends_the_run_with_a_message_and_it_resumes_to_the_same_bits() {
    let expected = calm("2", "0", "40");
    let mut run = Run::train(&["--workers=2", "--overlap=0", "--iterations=40"]);
    run.wait_for_iterations(12);
    let domain = run.domain();
    for learner in run.children("learner") {
        kill(learner, Signal::KILL);
    }
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert!(run.log().contains("octopus resume"), "{}", run.log());
    assert_nothing_left(&domain);
    run.resume(&[]);
    run.succeed();
    assert_eq!(run.digests(), expected);
}

#[test]
fn a_second_signal_stops_at_once() {
    let mut run = Run::train(&["--workers=2", "--iterations=100000"]);
    run.wait_for_iterations(6);
    let domain = run.domain();
    run.signal(Signal::INT);
    run.signal(Signal::TERM);
    let code = run.wait();
    // The first one may have been through before the second came.
    assert!(matches!(code, Some(0 | 130)), "{code:?}: {}", run.log());
    assert_nothing_left(&domain);
}
