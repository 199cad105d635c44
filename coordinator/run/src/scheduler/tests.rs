use super::*;

const SECOND: Duration = Duration::from_secs(1);

fn addresses(orders: &[Order]) -> Vec<(WorkerId, u64, u32)> {
    orders
        .iter()
        .map(|order| match order {
            Order::Rollout { worker, iteration, shards, .. } => (*worker, *iteration, shards[0]),
            other => panic!("{other:?} is no rollout"),
        })
        .collect()
}

/// Delivers everything that is ordered, until the scheduler has nothing more to order.
fn deliver_all(scheduler: &mut Scheduler, now: Instant) -> Vec<(WorkerId, u64, u32)> {
    let mut all = Vec::new();
    loop {
        let orders = addresses(&scheduler.assign(now));
        if orders.is_empty() {
            return all;
        }
        for (_, iteration, shard) in &orders {
            scheduler.block_received((*iteration, *shard), now);
        }
        all.extend(orders);
    }
}

#[test]
fn shards_spread_evenly_and_no_worker_gets_more_than_two() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(5, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.worker_ready(1, 0, now);
    let orders = addresses(&scheduler.assign(now));
    assert_eq!(orders, [(0, 0, 0), (1, 0, 1), (0, 0, 2), (1, 0, 3)]);
    assert!(scheduler.assign(now).is_empty(), "both are full");
    scheduler.block_received((0, 1), now);
    assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 4)]);
}

#[test]
fn without_overlap_the_next_iteration_waits_for_the_training() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(3, 0, 0, 2);
    scheduler.worker_ready(0, 0, now);
    assert_eq!(deliver_all(&mut scheduler, now).len(), 3);
    scheduler.iteration_done(0);
    assert!(deliver_all(&mut scheduler, now).iter().all(|(_, iteration, _)| *iteration == 1));
    scheduler.iteration_done(1);
    assert!(scheduler.is_finished());
}

#[test]
fn with_overlap_one_iteration_runs_ahead_with_the_policy_before() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(2, 1, 0, 9);
    scheduler.worker_ready(0, 0, now);
    let all = deliver_all(&mut scheduler, now);
    let iterations: Vec<u64> = all.iter().map(|(_, iteration, _)| *iteration).collect();
    assert_eq!(iterations, [0, 0, 1, 1], "1 is rolled out while 0 is trained on, 2 is not");
    scheduler.iteration_done(0);
    let orders = scheduler.assign(now);
    assert!(
        orders
            .iter()
            .all(|order| matches!(order, Order::Rollout { iteration: 2, policy_version: 1, .. }))
    );
}

#[test]
fn what_a_dead_worker_had_is_ordered_again_unless_the_learner_has_it() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(2, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.assign(now);
    scheduler.block_received((0, 0), now);
    let unfinished = UnfinishedWork { at_hand: Some((0, 1)), undelivered: vec![(0, 1)] };
    assert_eq!(scheduler.worker_gone(0), unfinished);
    scheduler.worker_ready(0, 1, now);
    let orders = scheduler.assign(now);
    assert_eq!(addresses(&orders), [(0, 0, 1)]);
    assert!(matches!(orders[0], Order::Rollout { incarnation: 1, .. }));
    assert_eq!(scheduler.in_flight(), 1);
}

#[test]
fn a_silent_worker_is_reminded_once_a_deadline() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(1, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    let first = scheduler.assign(now);
    assert!(scheduler.repeat_overdue(now + SECOND, 2 * SECOND).is_empty());
    assert_eq!(scheduler.repeat_overdue(now + 2 * SECOND, 2 * SECOND), first);
    assert!(scheduler.repeat_overdue(now + 3 * SECOND, 2 * SECOND).is_empty());
}

#[test]
fn time_in_which_nobody_was_heard_makes_no_order_overdue() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(1, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.assign(now);
    let stopped = Duration::from_secs(110);
    scheduler.postpone_deadlines(stopped);
    assert_eq!(scheduler.repeat_overdue(now + stopped + SECOND, 2 * SECOND), []);
    assert_eq!(scheduler.repeat_overdue(now + stopped + 2 * SECOND, 2 * SECOND).len(), 1);
}

#[test]
fn an_order_is_awaited_until_its_worker_has_delivered_or_is_another_one() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(2, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    let orders = scheduler.assign(now);
    assert!(orders.iter().all(|order| scheduler.awaits(order)));
    scheduler.block_received((0, 0), now);
    assert!(!scheduler.awaits(&orders[0]) && scheduler.awaits(&orders[1]));
    scheduler.worker_ready(0, 1, now);
    scheduler.assign(now);
    assert!(!scheduler.awaits(&orders[1]), "for the one before");
}

#[test]
fn a_stop_finishes_what_is_begun_and_begins_nothing() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(2, 0, 0, 100);
    scheduler.worker_ready(0, 0, now);
    scheduler.assign(now);
    scheduler.stop_after_current();
    assert!(!scheduler.is_finished());
    deliver_all(&mut scheduler, now);
    scheduler.block_received((0, 0), now);
    scheduler.block_received((0, 1), now);
    scheduler.iteration_done(0);
    assert!(scheduler.is_finished());
    assert!(scheduler.assign(now).is_empty());
}

#[test]
fn a_leaving_worker_finishes_what_is_at_hand_and_gets_no_more() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(3, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.worker_ready(1, 0, now);
    scheduler.assign(now);
    scheduler.retire(0);
    let tasks: Vec<_> = scheduler.tasks(0).copied().collect();
    assert_eq!(tasks, [Task::Rollout((0, 0))], "its second order is open again");
    scheduler.block_received((0, 1), now);
    assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 2)]);
    assert_eq!(scheduler.worker_gone(0).undelivered, [(0, 0)]);
    scheduler.block_received((0, 2), now);
    assert_eq!(addresses(&scheduler.assign(now)), [(1, 0, 0)]);
}

#[test]
fn evaluations_go_first_and_outlive_their_worker() {
    let now = Instant::now();
    let chunk = EvaluationChunk { policy_version: 0, first: 0, episodes: 16 };
    let mut scheduler = Scheduler::new(1, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.evaluate([chunk]);
    let orders = scheduler.assign(now);
    assert_eq!(orders[0], Order::Evaluate { worker: 0, incarnation: 0, episodes: chunk });
    assert_eq!(scheduler.worker_gone(0).at_hand, None);
    scheduler.worker_ready(1, 0, now);
    assert!(matches!(scheduler.assign(now)[0], Order::Evaluate { worker: 1, .. }));
    scheduler.evaluation_done(chunk, now);
    assert_eq!(scheduler.tasks(1).count(), 1, "the shard is left");
}

#[test]
fn a_block_that_cannot_be_made_is_open_again() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(1, 0, 0, 1);
    scheduler.worker_ready(0, 0, now);
    scheduler.assign(now);
    scheduler.give_back(0, (0, 0), now);
    assert_eq!((scheduler.open(), scheduler.in_flight()), (1, 0));
    assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 0)]);
}

#[test]
fn a_host_makes_one_block_for_comparison_before_it_is_given_work() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(3, 0, 0, 1).with_audits(1, 0.0);
    let chunk = EvaluationChunk { policy_version: 0, first: 0, episodes: 16 };
    scheduler.evaluate([chunk]);
    for worker in [2000, 2001] {
        scheduler.worker_ready(worker, 9, now);
    }
    let audit =
        |worker| Order::Audit { worker, incarnation: 9, iteration: 0, policy_version: 0, shard: 0 };
    assert_eq!(scheduler.assign(now), [audit(2000)]);
    assert!(scheduler.awaits(&audit(2000)) && !scheduler.trusts(2001));
    // Its worker is lost: another one makes it.
    assert_eq!(scheduler.worker_gone(2000).undelivered, []);
    assert_eq!(scheduler.assign(now), [audit(2001)]);
    scheduler.audit_made(2001, (0, 0), now);
    assert!(scheduler.assign(now).is_empty(), "it is being compared");
    // This machine cannot tell: once more.
    scheduler.try_again(2);
    assert_eq!(scheduler.assign(now), [audit(2001)]);
    scheduler.audit_made(2001, (0, 0), now);
    assert!(scheduler.trust(2) && scheduler.trusts(2000));
    let orders = scheduler.assign(now);
    assert!(matches!(orders[0], Order::Evaluate { worker: 2001, .. }));
    assert_eq!(addresses(&orders[1..]), [(2001, 0, 0)], "the block that was compared is open");
}

#[test]
fn what_is_compared_stays_open_and_is_not_given_to_the_same_worker_meanwhile() {
    let now = Instant::now();
    let mut scheduler = Scheduler::new(2, 0, 0, 1).with_audits(1, 1.0);
    scheduler.worker_ready(1000, 1, now);
    scheduler.trust(1);
    let audits = scheduler.assign(now);
    assert!(audits.iter().all(|order| matches!(order, Order::Audit { worker: 1000, .. })));
    assert_eq!((audits.len(), scheduler.open()), (2, 2));
    scheduler.worker_ready(0, 0, now);
    assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 0), (0, 0, 1)]);
    scheduler.block_received((0, 0), now);
    scheduler.block_received((0, 1), now);
    assert_eq!(scheduler.tasks(1000).count(), 2, "it is compared all the same");
    // One of them turns out to have come from a machine that makes other bits.
    scheduler.block_discarded((0, 1));
    assert_eq!(addresses(&scheduler.assign(now)), [(0, 0, 1)]);
}
