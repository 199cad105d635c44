//! What is known of a trial beside its run directory: a small file, written whole by whoever trains it.

use std::io::ErrorKind;
use std::path::Path;

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use store::recorded::Recorded;
use store::{files, regular_files};

use super::score::Scored;

/// See the module.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// At the rungs, and at the end.
    pub scores: Vec<Scored>,
    /// Why it went no further when it was last tried.
    pub failure: Option<String>,
    /// Processor time of its processes (s), of the sessions whose end was seen.
    pub cpu_s: f64,
    /// Whether nothing can be told, for a file of it or of its run is damaged. It counts as failed, is left as it is, and no
    /// rung is decided without it.
    #[serde(skip)]
    pub damaged: bool,
}

impl Record {
    /// What counts for the trial whose run is in `run`: scores of a run that was removed or trained anew are left out.
    pub fn of(path: &Path, run: &Path) -> Self {
        Self::try_of(path, run).unwrap_or_else(|error| Self {
            failure: Some(error.message),
            damaged: true,
            ..Self::default()
        })
    }

    fn try_of(path: &Path, run: &Path) -> Result<Self, ExitError> {
        let mut record = Self::read(path)?;
        // Also of a trial that has no score yet: it could not go on, and would be taken for one that failed.
        let recorded = Recorded::read(&RunDir::new(run))?;
        record
            .scores
            .retain(|scored| recorded.digest_after(scored.iteration) == Some(scored.digest));
        Ok(record)
    }

    /// Reads a record; a trial that has none is new.
    pub fn read(path: &Path) -> Result<Self, ExitError> {
        let refuse = |what: String| {
            let message = format!(
                "{}: {what}; put it back from a copy, or remove it, and the trial is scored again",
                path.display()
            );
            ExitError::new(ExitCode::RunDirectory, message)
        };
        match regular_files::read(path, regular_files::RECORD) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(refuse(format!("cannot be read: {error}"))),
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map_err(|error| refuse(format!("is no record of a trial: {error}"))),
        }
    }

    /// Writes it.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        Ok(files::replace(path, &output::json_bytes(self)?)?)
    }

    /// What it was scored after so many iterations.
    pub fn at(&self, iteration: u64) -> Option<&Scored> {
        self.scores.iter().find(|scored| scored.iteration == iteration)
    }
}

#[cfg(test)]
mod tests {
    use proto::Digest;

    use super::*;

    fn scored(iteration: u64, digest: Digest) -> Scored {
        Scored {
            iteration,
            digest,
            score: 0.1 + 0.2,
            episodes: 4,
            position_m: None,
            angle_rad: 0.3,
            contact_rate: 0.0,
            reachable: None,
        }
    }

    /// Else a trial that is trained anew, perhaps with another configuration, would have the scores of the one before.
    #[test]
    fn scores_of_another_run_do_not_count() {
        let dir = tempfile::tempdir().expect("tempdir");
        let (path, run) = (dir.path().join("a.json"), dir.path().join("a"));
        let [one, two, other] = [1, 2, 3].map(|byte| Digest([byte; 16]));
        let scores = vec![scored(1, one), scored(2, two)];
        Record { scores, cpu_s: 1.5, ..Record::default() }.write(&path).expect("written");
        let count = |digests: &[Digest]| {
            let line = |(k, digest): (usize, &Digest)| {
                format!("{{\"iteration\":{k},\"digest\":\"{digest}\"}}\n")
            };
            let lines: String = digests.iter().enumerate().map(line).collect();
            std::fs::write(RunDir::new(&run).metrics_jsonl(), lines).expect("written");
            let record = Record::of(&path, &run);
            assert_eq!(record.cpu_s, 1.5, "it was spent all the same");
            record.scores.len()
        };
        assert_eq!(Record::of(&path, &run).scores, [], "the run is gone");
        std::fs::create_dir(&run).expect("made");
        assert_eq!(count(&[]), 0);
        assert_eq!(count(&[one]), 1);
        assert_eq!(count(&[one, two, other]), 2);
        assert_eq!(count(&[one, other]), 1);
        assert_eq!(count(&[other, other]), 0);
    }

    #[test]
    fn damage_is_the_reason_why_a_trial_failed() {
        let dir = tempfile::tempdir().expect("tempdir");
        let (path, run) = (dir.path().join("a.json"), dir.path().join("a"));
        let damaged = |words: &str| {
            let record = Record::of(&path, &run);
            let failure = record.failure.expect("a reason");
            assert!(record.damaged && failure.contains(words), "{failure}");
        };
        std::fs::write(&path, "{").expect("written");
        damaged("a.json: is no record of a trial");
        let scores = vec![scored(1, Digest([7; 16]))];
        Record { scores, ..Record::default() }.write(&path).expect("written");
        assert!(!Record::of(&path, &run).damaged);
        std::fs::create_dir(&run).expect("made");
        std::fs::write(RunDir::new(&run).metrics_jsonl(), "{}\n").expect("written");
        damaged("metrics.jsonl: line 1");
        // Before it has a score, too.
        std::fs::remove_file(&path).expect("removed");
        damaged("metrics.jsonl: line 1");
    }

    #[test]
    fn a_record_is_read_as_it_was_written_and_nothing_else_is_one() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("a.json");
        assert_eq!(Record::read(&path).expect("new"), Record::default());
        let scored = scored(3, Digest([7; 16]));
        let failure = Some("no room".to_owned());
        let record = Record { scores: vec![scored.clone()], failure, cpu_s: 1.5, damaged: false };
        record.write(&path).expect("written");
        let read = Record::read(&path).expect("read");
        assert_eq!(read, record);
        assert_eq!((read.at(3), read.at(4)), (Some(&scored), None));
        // JSON has no word for what is no number.
        let bad = Record { scores: vec![Scored { score: f64::NAN, ..scored }], ..record };
        bad.write(&path).expect("written");
        assert!(Record::read(&path).expect("read").scores[0].score.is_nan());
        for text in ["", "{", "[]", "{\"scores\":[]}", "{\"scores\":[],\"cpu_s\":0,\"x\":1}"] {
            std::fs::write(&path, text).expect("written");
            let error = Record::read(&path).expect_err(text);
            assert_eq!(error.code, ExitCode::RunDirectory);
            assert!(error.message.contains("a.json: is no record of a trial"), "{error}");
        }
    }
}
