//! A short dose of chaos; `make chaos` gives the long one.

use run::signals::StopRequests;
use tests::chaos::plan::Plan;
use tests::chaos::{Chaos, calm, restarts};

/// Puts a run through a plan with every act that there is.
fn survives(seed: u64, overlap: usize) {
    let stop = StopRequests::new();
    let plan = Plan::new(seed, 5);
    let expected = calm(overlap, plan.iterations, &stop).expect("a calm run");
    let mut story = format!("{plan}");
    let mut narrate = |line: &str| story = format!("{story}\n{line}");
    let report = Chaos::run(&plan, overlap, &expected, &stop, &mut narrate);
    let report = report.unwrap_or_else(|error| panic!("{error:#}\n{story}"));
    assert_eq!(report.acts.values().sum::<usize>(), plan.events.len());
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
