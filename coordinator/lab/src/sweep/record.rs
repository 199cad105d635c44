//! What is known of a trial beside its run directory: a small file, written whole by whoever trains it.

use std::io::ErrorKind;
use std::path::Path;

use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
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
}

impl Record {
    /// Reads a record; a trial that has none is new.
    pub fn read(path: &Path) -> Result<Self, ExitError> {
        let refuse = |what: String| {
            let message = format!(
                "{}: {what}; put it back from a copy, or name another --out",
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
    use super::*;

    #[test]
    fn a_record_is_read_as_it_was_written_and_nothing_else_is_one() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("a.json");
        assert_eq!(Record::read(&path).expect("new"), Record::default());
        let scored = Scored {
            iteration: 3,
            score: 0.1 + 0.2,
            episodes: 4,
            position_m: None,
            angle_rad: 0.3,
            contact_rate: 0.0,
            reachable: None,
        };
        let failure = Some("no room".to_owned());
        let record = Record { scores: vec![scored.clone()], failure, cpu_s: 1.5 };
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
