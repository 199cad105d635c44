use proto::config::{Layers, Preset};
use proto::message::TaskErrors;
use serde_json::json;
use simulator::robot::Robot;
use store::checkpoint::fixtures::snapshot_of;
use tempfile::TempDir;

use super::*;

/// Snapshots of a run that commits every `checkpoint_every` iterations, keeps one, and evaluates
/// every tenth with eight episodes: one chunk.
struct Fixture {
    config: Config,
    snapshots: Snapshots,
    store: CheckpointStore,
    _dir: TempDir,
}

impl Fixture {
    fn new(settings: &[&str]) -> Self {
        let common = [
            "network.hidden=[4]",
            "network.critic_hidden=[4]",
            "run.checkpoints_kept=1",
            "run.evaluate_every=10",
            "run.evaluation_episodes=8",
            "run.best_after=0",
        ];
        let mut layers = Layers::new(Preset::Tuned, None);
        for setting in common.iter().chain(settings) {
            layers = layers.set(setting).expect("a key");
        }
        let config = layers.resolve().expect("valid");
        let dir = tempfile::tempdir().expect("a directory");
        let store = CheckpointStore::new(dir.path().join("checkpoints"));
        let robot = Robot::builtin("paper").expect("built in").to_toml();
        let snapshots = Snapshots::new(&config, robot, json!({}), store.clone(), || Ok(()));
        Self { config, snapshots, store, _dir: dir }
    }

    fn arrives(&mut self, iteration: u64) -> Evaluation {
        let snapshot = snapshot_of(&self.config, iteration, 0.0);
        self.snapshots.arrived(snapshot, Phase::Training)
    }

    fn settle(&mut self) -> Vec<Committed> {
        self.snapshots.committer.settle();
        self.snapshots.results()
    }

    /// Iterations of the checkpoints that there are.
    fn kept(&self) -> Vec<u64> {
        self.store.entries().expect("readable").iter().map(|entry| entry.iteration).collect()
    }
}

fn errors(chunk: &EvaluationChunk, position: f32) -> Vec<EpisodeErrors> {
    vec![
        EpisodeErrors {
            tail: TaskErrors { position, orientation: 0.1, base: 0.1 },
            ..Default::default()
        };
        usize::try_from(chunk.episodes).expect("few")
    ]
}

#[test]
fn a_wish_of_a_time_without_a_learner_is_kept_until_there_is_one() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0"]);
    let (asker, mut answer) = oneshot::channel();
    fixture.snapshots.ask_for(0, asker);
    assert!(fixture.snapshots.must_tell_learner());
    assert!(!fixture.snapshots.must_tell_learner(), "once");
    // It dies before it has sent anything; the one after it is asked again.
    fixture.snapshots.learner_gone();
    fixture.snapshots.go_on_from(0);
    assert!(fixture.snapshots.must_tell_learner());
    fixture.arrives(3);
    fixture.settle();
    assert_eq!(answer.try_recv().expect("answered"), Ok("iteration-00000003".to_owned()));
    assert_eq!(fixture.snapshots.wish, RequestedCheckpoint::None);
}

#[test]
fn the_clock_asks_again_only_when_the_last_commit_is_done() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0", "run.checkpoint_every_s=0.000001"]);
    fixture.snapshots.iteration_done(1);
    assert!(fixture.snapshots.must_tell_learner());
    fixture.arrives(1);
    // The commit is under way, or at least nobody has looked whether it is done.
    fixture.snapshots.iteration_done(2);
    assert!(!fixture.snapshots.must_tell_learner());
    fixture.settle();
    fixture.snapshots.iteration_done(3);
    assert!(fixture.snapshots.must_tell_learner());
}

#[test]
fn the_best_is_kept_although_a_newer_one_was_committed_meanwhile() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=7"]);
    let evaluation = fixture.arrives(20);
    assert_eq!(evaluation.drop, []);
    fixture.arrives(21);
    fixture.settle();
    assert_eq!(fixture.kept(), [21]);
    for chunk in &evaluation.play {
        fixture.snapshots.played(*chunk, errors(chunk, 0.1));
    }
    fixture.settle();
    assert_eq!(fixture.kept(), [20, 21]);
    let best = fixture.store.best().expect("readable").expect("there is one");
    assert_eq!(best.iteration, 20);

    // Committed by plan and tidied up before its episodes were played: committed again.
    let evaluation = fixture.arrives(70);
    fixture.arrives(77);
    fixture.settle();
    assert_eq!(fixture.kept(), [20, 77]);
    for chunk in &evaluation.play {
        fixture.snapshots.played(*chunk, errors(chunk, 0.01));
    }
    fixture.settle();
    assert_eq!(fixture.kept(), [70, 77]);
}

#[test]
fn a_slow_disk_costs_checkpoints_but_no_memory() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=1", "run.evaluate_every=0"]);
    fixture.snapshots.committer.room = 0;
    // Nobody looks what is done, so the first counts as being written.
    for iteration in 1..=5 {
        fixture.arrives(iteration);
    }
    let mut given_up = Vec::new();
    let mut committed = Vec::new();
    for result in fixture.settle() {
        match result {
            Committed::GivenUp { iteration } => given_up.push(iteration),
            Committed::Checkpoint { iteration, .. } => committed.push(iteration),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((given_up, committed), (vec![2, 3, 4], vec![1, 5]));
}

#[test]
fn small_snapshots_wait_for_a_slow_disk() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=1", "run.evaluate_every=0"]);
    for iteration in 1..=5 {
        fixture.arrives(iteration);
    }
    let of = |result| match result {
        Committed::Checkpoint { iteration, .. } => iteration,
        other => panic!("{other:?}"),
    };
    assert_eq!(fixture.settle().into_iter().map(of).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
}

#[test]
fn planned_checkpoints_that_never_came_are_told() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=2", "run.evaluate_every=0"]);
    fixture.snapshots.begin_from(Some((2, fixture.store.dir(&Name::of_iteration(2)))));
    for iteration in [4, 9, 10] {
        fixture.arrives(iteration);
    }
    let given_up = |results: Vec<Committed>| -> Vec<u64> {
        let of = |result| match result {
            Committed::GivenUp { iteration } => Some(iteration),
            _ => None,
        };
        results.into_iter().filter_map(of).collect()
    };
    assert_eq!(given_up(fixture.settle()), [6, 8]);
    assert_eq!(given_up(fixture.settle()), [0; 0]);
}

#[test]
fn a_commit_that_fails_is_told_to_whoever_asked_and_leaves_the_best_as_it_is() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0"]);
    // A file where the store's directory would be.
    std::fs::write(fixture.store.root(), "in the way").expect("writable");
    let (asker, mut answer) = oneshot::channel();
    fixture.snapshots.ask_for(0, asker);
    let evaluation = fixture.arrives(10);
    let results = fixture.settle();
    assert!(matches!(results[..], [Committed::Failed { iteration: 10, .. }]), "{results:?}");
    assert!(answer.try_recv().expect("answered").is_err());
    std::fs::remove_file(fixture.store.root()).expect("removable");
    for chunk in &evaluation.play {
        fixture.snapshots.played(*chunk, errors(chunk, 0.1));
    }
    fixture.settle();
    assert_eq!(fixture.store.best().expect("readable").map(|best| best.iteration), Some(10));
}

#[test]
fn many_who_ask_for_the_same_share_one_snapshot() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0"]);
    let ask = |fixture: &mut Fixture, iterations| {
        let (asker, answer) = oneshot::channel();
        fixture.snapshots.ask_for(iterations, asker);
        answer
    };
    let mut answers: Vec<_> = (0..5).map(|_| ask(&mut fixture, 3)).collect();
    assert!(fixture.snapshots.must_tell_learner());
    // Asked while the learner is at it, and while the disk is.
    answers.push(ask(&mut fixture, 3));
    assert!(!fixture.snapshots.must_tell_learner(), "it has been told");
    fixture.arrives(3);
    answers.push(ask(&mut fixture, 3));
    assert!(!fixture.snapshots.must_tell_learner(), "it is being committed");
    let results = fixture.settle();
    assert!(matches!(results[..], [Committed::Checkpoint { iteration: 3, .. }]), "{results:?}");
    for mut answer in answers {
        assert_eq!(answer.try_recv().expect("answered"), Ok("iteration-00000003".to_owned()));
    }
}

#[test]
fn who_asks_for_more_than_is_on_its_way_gets_the_next_snapshot() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0"]);
    let [(first, mut early), (second, mut late)] = [(); 2].map(|()| oneshot::channel());
    fixture.snapshots.ask_for(3, first);
    assert!(fixture.snapshots.must_tell_learner());
    fixture.snapshots.ask_for(4, second);
    assert!(!fixture.snapshots.must_tell_learner(), "one at a time");
    fixture.arrives(3);
    assert!(fixture.snapshots.must_tell_learner());
    fixture.arrives(4);
    fixture.settle();
    assert_eq!(early.try_recv().expect("answered"), Ok("iteration-00000003".to_owned()));
    assert_eq!(late.try_recv().expect("answered"), Ok("iteration-00000004".to_owned()));
}

#[test]
fn who_asks_after_a_rewind_gets_a_snapshot_although_an_earlier_one_is_being_written() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=10"]);
    let evaluation = fixture.arrives(10);
    fixture.snapshots.learner_gone();
    fixture.settle();
    fixture.snapshots.go_on_from(0);
    let again = fixture.arrives(10);
    assert_eq!(evaluation.play, again.play, "the one before was given up");
    fixture.settle();
    fixture.snapshots.go_on_from(5);
    // The best so far is being written.
    for chunk in &again.play {
        fixture.snapshots.played(*chunk, errors(chunk, 0.1));
    }
    let (asker, _answer) = oneshot::channel();
    fixture.snapshots.ask_for(7, asker);
    assert!(fixture.snapshots.must_tell_learner());
}

#[test]
fn a_checkpoint_that_is_committed_can_do_without_its_evaluation() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=10"]);
    let evaluation = fixture.arrives(10);
    assert!(!evaluation.play.is_empty());
    fixture.settle();
    assert_eq!(fixture.snapshots.settled_at(10), None, "it is still evaluated");
    assert_eq!(fixture.snapshots.settled_unevaluated_at(9), None, "another one is committed");
    assert!(fixture.snapshots.settled_unevaluated_at(10).is_some());
}

#[test]
fn nothing_is_committed_whose_metrics_are_not_durable() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=1", "run.evaluate_every=0"]);
    let robot = Robot::builtin("paper").expect("built in").to_toml();
    let record = || Err(anyhow::anyhow!("the disk is gone"));
    let store = fixture.store.clone();
    fixture.snapshots = Snapshots::new(&fixture.config, robot, json!({}), store, record);
    fixture.arrives(1);
    let results = fixture.settle();
    assert!(matches!(results[..], [Committed::Unrecorded { iteration: 1, .. }]), "{results:?}");
    assert_eq!(fixture.kept(), [0; 0]);
}

#[test]
fn who_asked_and_has_gone_is_not_kept() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=0"]);
    for _ in 0..1000 {
        let (asker, answer) = oneshot::channel();
        fixture.snapshots.ask_for(3, asker);
        drop(answer);
    }
    let (asker, mut answer) = oneshot::channel();
    fixture.snapshots.ask_for(3, asker);
    assert_eq!(fixture.snapshots.askers.len(), 1);
    fixture.arrives(3);
    fixture.settle();
    assert_eq!(answer.try_recv().expect("answered"), Ok("iteration-00000003".to_owned()));
}

#[test]
fn metrics_that_wait_for_their_disk_hold_up_commits_and_nothing_else() {
    let mut fixture = Fixture::new(&["run.checkpoint_every=1", "run.evaluate_every=0"]);
    let robot = Robot::builtin("paper").expect("built in").to_toml();
    let store = fixture.store.clone();
    let (end, wait) = std::sync::mpsc::channel::<()>();
    let record = move || {
        // That nothing is ever sent is how it ends.
        let _ = wait.recv();
        Ok(())
    };
    fixture.snapshots = Snapshots::new(&fixture.config, robot, json!({}), store, record);
    for iteration in 1..=4 {
        fixture.arrives(iteration);
        fixture.snapshots.iteration_done(iteration);
        fixture.snapshots.results();
    }
    assert_eq!(fixture.kept(), [0; 0]);
    assert_eq!(fixture.snapshots.settled_at(4), None);
    drop(end);
    fixture.settle();
    assert_eq!(fixture.kept(), [4]);
    assert!(fixture.snapshots.settled_at(4).is_some());
}
