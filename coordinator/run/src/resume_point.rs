//! What a run goes on from: the newest checkpoint that is its own.
//!
//! A checkpoint is the run's own if it has the digest that the run recorded for its last iteration.
//! One of the same seed and configuration may still be another's: with another budget the learning
//! rate falls otherwise, and whoever copies or imports a checkpoint can be mistaken. So the name, the
//! manifest and `metrics.jsonl` must agree here, and the learner that starts from it must find the
//! manifest's digest (see [`session`](crate::session)). What was imported comes last.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use store::checkpoint::{Checkpoint, CheckpointStore, Labels, Manifest, Name};
use store::recorded::Recorded;

/// What was found.
#[derive(Debug, Default)]
pub struct Search {
    /// What the run goes on from; without one it starts anew, and comes to the same bits.
    pub base: Option<Checkpoint>,
    /// What was looked at before, and why the run cannot go on from it.
    pub passed_over: Vec<PassedOver>,
}

/// A checkpoint from which a run cannot go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PassedOver {
    /// Its directory.
    pub dir: PathBuf,
    /// Whether it came from outside.
    pub imported: bool,
    /// Whether the metrics end before it.
    pub unreached: bool,
    /// Why, with the files.
    pub reason: String,
}

/// Looks for the base of the run in `run_dir`, whose checkpoints are in `store`. Those in `refused`, by
/// directory, the learner could not start from.
pub fn find(
    store: &CheckpointStore,
    run_dir: &RunDir,
    refused: &BTreeMap<PathBuf, String>,
) -> Result<Search, ExitError> {
    let damaged =
        |error: &dyn std::fmt::Display| ExitError::new(ExitCode::RunDirectory, error.to_string());
    let mut candidates = store.list().map_err(|error| damaged(&error))?;
    candidates.reverse();
    // A stable sort: the newest first among equals.
    candidates.sort_by_key(|dir| Labels::read(dir).imported);

    let mut search = Search::default();
    let mut recorded = None;
    for dir in candidates {
        let manifest = match Manifest::read(&dir) {
            // The state before the first iteration is that of a start.
            Ok(manifest) if !manifest.has_state() || manifest.iteration == 0 => continue,
            other => other,
        };
        // Only where there is something to compare: a repetition of some iterations has lines that
        // do not begin with the first.
        let recorded = match &mut recorded {
            Some(recorded) => recorded,
            none => none.insert(Recorded::read(run_dir)?),
        };
        let (iteration, judged) = match manifest {
            Ok(manifest) => {
                let judged = judge(&dir, &manifest, recorded, refused)
                    .and_then(|()| store.load(&dir).map_err(|error| error.to_string()));
                (manifest.iteration, judged)
            }
            Err(error) => (0, Err(error.to_string())),
        };
        match judged {
            Ok(checkpoint) => {
                search.base = Some(checkpoint);
                break;
            }
            // Removed since it was listed.
            Err(_) if !dir.exists() => {}
            Err(reason) => search.passed_over.push(PassedOver {
                unreached: iteration > recorded.iterations(),
                imported: Labels::read(&dir).imported,
                dir,
                reason,
            }),
        }
    }
    Ok(search)
}

impl Search {
    /// What was found, with a sentence about each checkpoint that was passed over for it. Without any
    /// base that is an error, never a silent start from nothing, unless all of them came from
    /// outside and are none of the run's.
    pub fn settle(self, run_dir: &RunDir) -> Result<(Option<Checkpoint>, Vec<String>), ExitError> {
        let Self { base, passed_over } = self;
        let reasons = passed_over.iter().map(|passed| &passed.reason);
        let instead = match &base {
            Some(base) => format!("going on from checkpoint {} instead", base.manifest.iteration),
            None if passed_over.iter().all(|passed| passed.imported) => {
                "it is not the run's, which starts anew".to_owned()
            }
            None => {
                let reasons: Vec<&str> = reasons.map(String::as_str).collect();
                let config = run_dir.config();
                let message = format!(
                    "{}; there is no other checkpoint to go on from: put the files back from a copy, \
                     or make the same run again: `octopus train --config {}`; `octopus checkpoints \
                     verify {}` says what is whole",
                    reasons.join("; "),
                    output::quoted(&config),
                    output::quoted(run_dir.path()),
                );
                return Err(ExitError::new(ExitCode::RunDirectory, message));
            }
        };
        let sentences = reasons.map(|reason| format!("{reason}; {instead}")).collect();
        Ok((base, sentences))
    }
}

/// Why the run cannot go on from the checkpoint in `dir`, as far as names and digests tell.
fn judge(
    dir: &Path,
    manifest: &Manifest,
    recorded: &Recorded,
    refused: &BTreeMap<PathBuf, String>,
) -> Result<(), String> {
    let (shown, metrics) = (dir.display(), recorded.path().display());
    let iteration = manifest.iteration;
    if dir.file_name() != Some(Name::of_iteration(iteration).as_str().as_ref()) {
        return Err(format!("{shown}: its manifest is of iteration {iteration}, not of that name"));
    }
    if let Some(reason) = refused.get(dir) {
        return Err(format!("{shown}: {reason}"));
    }
    let Some(digest) = recorded.digest_after(iteration) else {
        let end = recorded.iterations();
        return Err(format!(
            "{metrics}: the iterations from {end} on are missing, but {shown} is of {iteration}"
        ));
    };
    if digest != manifest.digest {
        let how = if Labels::read(dir).imported {
            "it was imported, and is of another course"
        } else {
            "it was copied here, or one of the two was changed"
        };
        return Err(format!(
            "{shown}: has digest {}, but {metrics} says that iteration {} ended with {digest}: {how}",
            manifest.digest,
            iteration - 1
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proto::Digest;
    use proto::config::{Config, Layers, Preset};
    use simulator::robot::Robot;
    use store::checkpoint::fixtures::snapshot_of;
    use store::checkpoint::{LABELS, MANIFEST, STATE};

    use super::*;

    /// A run of five iterations with checkpoints after some of them.
    struct Fixture {
        dir: tempfile::TempDir,
        run_dir: RunDir,
        store: CheckpointStore,
    }

    fn config() -> Config {
        let small = ["network.hidden=[4]", "network.critic_hidden=[4]"];
        let layers = small.iter().try_fold(Layers::new(Preset::Tuned, None), |l, set| l.set(set));
        layers.expect("keys").resolve().expect("valid")
    }

    /// The digest that iteration `k` ended with.
    fn digest(k: u64) -> Digest {
        snapshot_of(&config(), k + 1, 0.0).digest
    }

    impl Fixture {
        fn new(iterations: &[u64]) -> Self {
            let dir = tempfile::tempdir().expect("tempdir");
            let run_dir = RunDir::new(dir.path());
            let store = CheckpointStore::new(run_dir.checkpoints());
            let fixture = Self { dir, run_dir, store };
            fixture.record(5);
            for &iteration in iterations {
                fixture.commit(iteration, 0.0);
            }
            fixture
        }

        fn record(&self, lines: u64) {
            let line = |k| format!("{{\"iteration\":{k},\"digest\":\"{}\"}}\n", digest(k));
            let text: String = (0..lines).map(line).collect();
            std::fs::write(self.run_dir.metrics_jsonl(), text).expect("writable");
        }

        /// Commits a checkpoint; the run's own if its actors count up from zero.
        fn commit(&self, iteration: u64, first: f32) -> PathBuf {
            let snapshot = snapshot_of(&config(), iteration, first);
            let robot = Robot::builtin("paper").expect("built in").to_toml();
            let provenance = serde_json::json!({});
            self.store.commit(&snapshot, &config(), &robot, &provenance).expect("commits")
        }

        fn find(&self) -> Search {
            find(&self.store, &self.run_dir, &BTreeMap::new()).expect("readable")
        }

        fn found(&self) -> Option<u64> {
            self.find().base.map(|base| base.manifest.iteration)
        }
    }

    fn import(dir: &Path) {
        std::fs::write(dir.join(LABELS), r#"{"imported":true}"#).expect("writable");
    }

    #[test]
    fn the_newest_with_the_recorded_digest_is_taken() {
        let run = Fixture::new(&[2, 4]);
        assert_eq!((run.found(), run.find().passed_over), (Some(4), Vec::new()));
        // Of the same seed and robot, but not what this run came to.
        let foreign = run.commit(5, 100.0);
        for imported in [false, true] {
            if imported {
                import(&foreign);
            }
            let (base, said) = run.find().settle(&run.run_dir).expect("one is left");
            assert_eq!(base.expect("one is left").manifest.iteration, 4);
            let expected = usize::from(!imported);
            assert_eq!(said.len(), expected, "own ones are looked at first: {said:?}");
            for word in ["iteration-00000005: has digest", "iteration 4 ended with", "was copied"] {
                assert!(said.iter().all(|said| said.contains(word)), "{word}: {said:?}");
            }
        }
        // What has come from outside and is the run's all the same is better than nothing.
        std::fs::remove_dir_all(run.store.dir(&Name::of_iteration(2))).expect("removable");
        import(&run.store.dir(&Name::of_iteration(4)));
        assert_eq!(run.found(), Some(4));
    }

    #[test]
    fn what_was_imported_and_is_not_the_runs_stops_nobody() {
        let run = Fixture::new(&[]);
        import(&run.commit(3, 100.0));
        let (base, said) = run.find().settle(&run.run_dir).expect("starts anew");
        assert!(base.is_none());
        assert!(said[0].contains("it was imported") && said[0].contains("starts anew"), "{said:?}");
    }

    #[test]
    fn what_is_damaged_or_misnamed_is_passed_over_and_never_for_nothing() {
        let run = Fixture::new(&[1, 2, 3, 4]);
        let dir = |iteration| run.store.dir(&Name::of_iteration(iteration));
        std::fs::write(dir(4).join(MANIFEST), "{}").expect("writable");
        std::fs::write(dir(3).join(STATE), "short").expect("writable");
        std::fs::remove_dir_all(dir(1)).expect("removable");
        std::fs::rename(dir(2), dir(1)).expect("renames");
        let search = run.find();
        assert!(search.base.is_none());
        let reasons: Vec<&str> = search.passed_over.iter().map(|p| p.reason.as_str()).collect();
        for (reason, word) in
            reasons.iter().zip(["manifest.json", "state.safetensors", "of iteration 2"])
        {
            assert!(reason.contains(word), "{word}: {reason}");
        }
        let error = search.settle(&run.run_dir).expect_err("all are damaged");
        assert_eq!(error.code, ExitCode::RunDirectory);
        assert!(error.message.contains("no other checkpoint"), "{error}");
    }

    #[test]
    fn a_checkpoint_that_the_metrics_do_not_reach_or_the_learner_refused_is_none() {
        let run = Fixture::new(&[2, 4, 5]);
        run.record(4);
        let search = run.find();
        assert_eq!(search.base.expect("one").manifest.iteration, 4);
        assert!(search.passed_over[0].unreached);
        assert!(search.passed_over[0].reason.contains("from 4 on are missing"));
        let refused = BTreeMap::from([(
            run.store.dir(&Name::of_iteration(4)),
            "the learner refuses it".to_owned(),
        )]);
        let search = find(&run.store, &run.run_dir, &refused).expect("readable");
        assert_eq!(search.base.expect("the one before").manifest.iteration, 2);
        assert!(
            search.passed_over[1].reason.ends_with("iteration-00000004: the learner refuses it")
        );
        assert!(!search.passed_over[1].unreached);
        drop(run.dir);
    }

    #[test]
    fn the_state_before_the_first_iteration_is_a_start() {
        let run = Fixture::new(&[0]);
        let (base, said) = run.find().settle(&run.run_dir).expect("starts anew");
        assert!(base.is_none() && said.is_empty());
    }
}
