//! A short dose of chaos; `make chaos` gives the long one.

use run::signals::StopRequests;
use tests::chaos::plan::Plan;
use tests::chaos::standstills::Dose;
use tests::chaos::{Chaos, calm, environment, http, others, restarts, standstills};

/// Puts a run through a plan with every act that there is.
fn survives(seed: u64, overlap: usize) {
    let stop = StopRequests::new();
    let plan = Plan::new(seed, 5);
    let expected = calm(overlap, plan.iterations, &stop).expect("a calm run");
    let mut story = format!("{plan}");
    let mut narrate = |line: &str| story = format!("{story}\n{line}");
    let report = Chaos::run(&plan, overlap, &expected, &stop, &mut narrate);
    let report = report.unwrap_or_else(|error| panic!("{error:#}\n{story}"));
    let done: usize = report.acts.values().sum();
    assert_eq!(done + report.late, plan.events.len(), "{report:?}");
    // A fast run may be done before its last events; all but those must have been seen.
    assert!(done > plan.events.len() / 2, "{report:?}\n{story}");
}

#[test]
fn chaos_without_overlap_changes_no_bit_and_leaves_nothing() {
    survives(1, 0);
}

#[test]
fn chaos_with_overlap_changes_no_bit_and_leaves_nothing() {
    survives(2, 1);
}

#[test]
fn processes_that_are_killed_again_and_again_cost_the_coordinator_nothing() {
    let report = restarts::run(12, 9, &StopRequests::new(), &mut |_| ()).expect("survives");
    for (phase, restarts) in [(&report.workers, 12), (&report.learners, 9)] {
        assert_eq!(phase.times.len(), restarts);
        assert_eq!(phase.descriptors.growth(), Some(0), "{phase:?}");
        assert_eq!(phase.files.growth(), Some(0), "{phase:?}");
    }
}

#[test]
fn foreign_environments_change_no_bit_or_are_named() {
    let report = environment::run(3, 1, &StopRequests::new(), &mut |_| ()).expect("survives");
    assert_eq!(report.survived + report.refused, 3);
}

#[test]
fn clients_good_and_hostile_change_no_bit_of_a_live_run() {
    let report = http::run(150, 1, &StopRequests::new(), &mut |_| ()).expect("survives");
    assert_eq!(report.requests, 150);
}

#[test]
fn another_user_gets_nothing_from_a_live_run_and_changes_nothing() {
    let mut story = String::new();
    let mut narrate = |line: &str| story = format!("{story}\n{line}");
    let report = others::run(25, 1, &StopRequests::new(), &mut narrate).expect("survives");
    if report.refused == 0 {
        eprintln!("{story}");
    } else {
        assert_eq!(report.refused, 25);
    }
}

#[test]
fn a_disk_that_stands_still_costs_a_run_nothing() {
    let report = standstills::run(4, Dose::Short, &StopRequests::new(), &mut |_| ());
    let report = report.expect("survives");
    match report.not_tried {
        Some(reason) => eprintln!("not tried: {reason}"),
        None => assert_eq!(report.acts.values().sum::<usize>(), 4),
    }
}
