//! What `metrics.jsonl` says of the iterations that a run has done: the digest that each ended with.
//!
//! Only digests are taken from the file, and only to be compared: a checkpoint is a place to go on from
//! if it has the digest that its last iteration ended with. Other numbers are for people; a changed one
//! changes nothing that is learned, and nobody notices it.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use serde_json::Value;

use crate::stamp::Stamp;
use crate::{jsonl, regular_files};

/// The digests of a run's iterations, from the first on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Recorded {
    path: PathBuf,
    digests: Vec<Digest>,
}

impl Recorded {
    /// Reads the lines of a run, which count 0, 1, 2, …; none if it has no file. They end at the first
    /// that is no JSON, where a crash or a power cut spoiled the file.
    pub fn read(run_dir: &RunDir) -> Result<Self, ExitError> {
        let path = run_dir.metrics_jsonl();
        let bytes = match regular_files::read(&path, regular_files::RECORD) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(unreadable(&path, &error)),
        };
        let mut recorded = Self { path, digests: Vec::new() };
        recorded.take(&bytes)?;
        Ok(recorded)
    }

    /// What the lines say that were [read](jsonl::read) from `path`, the metrics of a run.
    pub fn of_lines(path: PathBuf, lines: &[(String, Value)]) -> Result<Self, ExitError> {
        let mut recorded = Self { path, digests: Vec::new() };
        lines.iter().try_for_each(|(_, line)| recorded.push(line))?;
        Ok(recorded)
    }

    /// Takes the lines in that `bytes` begin with; returns how many bytes these are.
    fn take(&mut self, bytes: &[u8]) -> Result<usize, ExitError> {
        let mut taken = 0;
        for (text, line) in jsonl::parse(bytes) {
            self.push(&line)?;
            taken += text.len() + 1;
        }
        Ok(taken)
    }

    /// Takes the next line in.
    fn push(&mut self, line: &Value) -> Result<(), ExitError> {
        let index = self.digests.len();
        let refuse = |what: String| {
            ExitError::new(
                ExitCode::RunDirectory,
                format!(
                    "{}: line {}: {what}: lines count 0, 1, 2, …, and each has its digest; put \
                     the file back from a copy, or remove this line and all after it, and \
                     `octopus resume` goes on from the last checkpoint that the others reach",
                    self.path.display(),
                    index + 1
                ),
            )
        };
        if line["iteration"] != index {
            let is = &line["iteration"];
            return Err(refuse(format!("is of iteration {is}, expected {index}")));
        }
        let digest = line["digest"].as_str().and_then(|digest| digest.parse().ok());
        let digest = digest.ok_or_else(|| match &line["digest"] {
            Value::Null => refuse("has no digest".to_owned()),
            is => refuse(format!("has the digest {is}, which is none")),
        })?;
        self.digests.push(digest);
        Ok(())
    }

    /// Where it was read.
    pub fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// How many iterations are recorded.
    pub fn iterations(&self) -> u64 {
        self.digests.len() as u64
    }

    /// The digest of the state after so many iterations, if that is recorded.
    pub fn digest_after(&self, iterations: u64) -> Option<Digest> {
        let last = usize::try_from(iterations.checked_sub(1)?).ok()?;
        self.digests.get(last).copied()
    }

    /// The iterations from `first` on, with their digests.
    pub fn from(&self, first: u64) -> impl Iterator<Item = (u64, Digest)> + '_ {
        let numbered = (0..).zip(&self.digests);
        numbered.filter(move |(k, _)| *k >= first).map(|(k, digest)| (k, *digest))
    }
}

/// What a run has recorded, for who asks again and again while it goes on: lines are read once.
///
/// Runs append to the file; whoever writes it anew puts another in its place, or changes its end. So of a file that has
/// only grown, and still has the line before the new ones, those are read alone.
#[derive(Debug, Default)]
pub struct Followed(Mutex<Option<Known>>);

/// What was read of a file.
#[derive(Debug)]
struct Known {
    stamp: Stamp,
    recorded: Arc<Recorded>,
    /// How far the lines go (bytes).
    read: u64,
    /// Hash of the last bytes of these.
    end: blake3::Hash,
}

/// How many bytes before the new ones are looked at again.
const SEAM: u64 = 512;

impl Followed {
    /// The same as [`Recorded::read`] says.
    pub fn read(&self, run_dir: &RunDir) -> Result<Arc<Recorded>, ExitError> {
        let path = run_dir.metrics_jsonl();
        // Who comes meanwhile waits, and has nothing to read then.
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let before = known.take().filter(|known| known.recorded.path == path);
        let now = match regular_files::open(&path) {
            Ok(file) => look(file, &path, before)?,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Ok(Arc::new(Recorded { path, digests: Vec::new() }));
            }
            Err(error) => return Err(unreadable(&path, &error)),
        };
        Ok(Arc::clone(&known.insert(now).recorded))
    }
}

/// Reads what of `file` is not known from `before`.
fn look(mut file: File, path: &Path, before: Option<Known>) -> Result<Known, ExitError> {
    let fail = |error: std::io::Error| unreadable(path, &error);
    let stamp = Stamp::of(&file.metadata().map_err(fail)?);
    let (mut recorded, read) = match before {
        Some(known) if known.stamp == stamp => return Ok(known),
        Some(known) if known.stamp.may_have_grown_to(&stamp) => {
            let end = end(&mut file, known.read).map_err(fail)?;
            if end == known.end { (known.recorded, known.read) } else { Default::default() }
        }
        _ => Default::default(),
    };
    file.seek(SeekFrom::Start(read)).map_err(fail)?;
    let limit = regular_files::RECORD.saturating_sub(read);
    let bytes = regular_files::drain(&file, limit).map_err(fail)?;
    let lines = Arc::make_mut(&mut recorded);
    path.clone_into(&mut lines.path);
    let read = read + lines.take(&bytes)? as u64;
    let end = end(&mut file, read).map_err(fail)?;
    Ok(Known { stamp, recorded, read, end })
}

/// The hash of the last bytes before `place`.
fn end(file: &mut File, place: u64) -> std::io::Result<blake3::Hash> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(place.saturating_sub(SEAM)))?;
    file.take(place.min(SEAM)).read_to_end(&mut bytes)?;
    Ok(blake3::hash(&bytes))
}

fn unreadable(path: &Path, error: &std::io::Error) -> ExitError {
    let message = format!("{}: cannot be read: {error}", path.display());
    ExitError::new(ExitCode::RunDirectory, message)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    fn line(iteration: u64) -> String {
        format!("{{\"iteration\":{iteration},\"digest\":\"{iteration:032x}\"}}\n")
    }

    fn lines(iterations: std::ops::Range<u64>) -> String {
        iterations.map(line).collect()
    }

    struct Metrics(tempfile::TempDir, Followed);

    impl Metrics {
        fn new(text: &str) -> Self {
            let metrics = Self(tempfile::tempdir().expect("tempdir"), Followed::default());
            metrics.write(text);
            metrics
        }

        fn run(&self) -> RunDir {
            RunDir::new(self.0.path())
        }

        /// Writes the file anew, where it is.
        fn write(&self, text: &str) {
            std::fs::write(self.run().metrics_jsonl(), text).expect("writable");
        }

        fn append(&self, text: &str) {
            let file = File::options().append(true).open(self.run().metrics_jsonl());
            file.and_then(|mut file| file.write_all(text.as_bytes())).expect("writable");
        }

        /// How many iterations are recorded, read either way.
        fn iterations(&self) -> u64 {
            let followed = self.1.read(&self.run()).expect("readable");
            assert_eq!(*followed, Recorded::read(&self.run()).expect("readable"));
            followed.iterations()
        }
    }

    #[test]
    fn what_is_appended_is_found() {
        let metrics = Metrics::new(&lines(0..20));
        assert_eq!([metrics.iterations(), metrics.iterations()], [20, 20]);
        let (begun, rest) = (line(20), lines(21..25));
        metrics.append(&begun[..10]);
        assert_eq!(metrics.iterations(), 20, "half a line is none");
        metrics.append(&format!("{}{rest}", &begun[10..]));
        assert_eq!(metrics.iterations(), 25);
        metrics.append(&format!("spoiled\n{}", line(25)));
        assert_eq!(metrics.iterations(), 25);
        std::fs::remove_file(metrics.run().metrics_jsonl()).expect("there");
        assert_eq!(metrics.iterations(), 0);
    }

    /// Another line stands in the place of one that was read: whoever reads that again sees it.
    #[test]
    fn lines_are_read_once() {
        let metrics = Metrics::new(&lines(0..100));
        assert_eq!(metrics.iterations(), 100);
        metrics.write(&format!("{}{}", line(7), lines(1..101)));
        assert!(Recorded::read(&metrics.run()).is_err(), "the first line counts wrong");
        let followed = metrics.1.read(&metrics.run()).expect("only the last line is read");
        assert_eq!(followed.iterations(), 101);
    }

    #[test]
    fn a_file_that_is_written_anew_is_read_anew() {
        let metrics = Metrics::new(&lines(0..100));
        assert_eq!(metrics.iterations(), 100);
        // As a run that is resumed does.
        crate::files::replace(&metrics.run().metrics_jsonl(), lines(0..90).as_bytes())
            .expect("writable");
        assert_eq!(metrics.iterations(), 90);
        metrics.write(&lines(0..30));
        assert_eq!(metrics.iterations(), 30);
        // Longer, and with other lines before the new ones.
        let others = lines(0..60).replace("000\"", "00a\"").replace("1d\"", "ff\"");
        metrics.write(&others);
        assert_eq!(metrics.iterations(), 60);
        metrics.write(&lines(1..200));
        assert!(metrics.1.read(&metrics.run()).is_err());
        metrics.write(&lines(0..40));
        assert_eq!(metrics.iterations(), 40);
    }
}
