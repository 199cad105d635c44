//! The ends of the logs of a run's processes, followed while they grow.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use serde::Serialize;
use store::regular_files;

/// How much of a log that is there already is shown (bytes).
const END: u64 = 16 * 1024;
/// Most that is read of a log at once (bytes).
const PIECE: u64 = 256 * 1024;
/// Most logs that are followed.
const LOGS: usize = 300;

/// A line of a log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct LogLine {
    /// Who wrote it: `learner`, `worker-1`.
    pub(super) who: String,
    /// The line.
    pub(super) text: String,
}

/// How far each log has been read.
#[derive(Debug, Default)]
pub(super) struct LogTails(BTreeMap<String, u64>);

impl LogTails {
    /// Whole lines that are new in the logs of a directory; of those that are met for the first time the last ones.
    pub(super) fn read(&mut self, dir: &Path) -> Vec<LogLine> {
        let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .filter_map(|entry| {
                entry.file_name().into_string().ok()?.strip_suffix(".log").map(str::to_owned)
            })
            .collect();
        names.sort();
        names.truncate(LOGS);
        let mut lines = Vec::new();
        for who in names {
            let path = dir.join(format!("{who}.log"));
            let place = self.0.get(&who).copied();
            // A log that cannot be read now may be later.
            let Ok((next, text)) = grown(&path, place) else { continue };
            lines.extend(
                text.lines()
                    .filter(|text| !text.trim().is_empty())
                    .map(|text| LogLine { who: who.clone(), text: text.to_owned() }),
            );
            self.0.insert(who, next);
        }
        lines
    }
}

/// Whole lines from a place on, and where the next begin; of a log without a place its end.
fn grown(path: &Path, place: Option<u64>) -> std::io::Result<(u64, String)> {
    let mut file = regular_files::open(path)?;
    let len = file.metadata()?.len();
    let from = match place {
        Some(place) if place <= len => place,
        Some(_) => 0,
        None => len.saturating_sub(END),
    };
    if from == len {
        return Ok((from, String::new()));
    }
    file.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::new();
    file.take(PIECE).read_to_end(&mut bytes)?;
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    // The end of a log begins in the middle of a line.
    let begun = if place.is_none() && from > 0 {
        bytes[..whole].iter().position(|byte| *byte == b'\n').map_or(whole, |end| end + 1)
    } else {
        0
    };
    // A line longer than a piece would never be whole.
    let end = if whole == 0 && bytes.len() as u64 == PIECE { bytes.len() } else { whole };
    let text = String::from_utf8_lossy(&bytes[begun.min(end)..end]);
    let text = text.chars().filter(|c| *c == '\n' || *c == '\t' || !c.is_control()).collect();
    Ok((from + end as u64, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_lines_of_logs_each_once() {
        let dir = tempfile::tempdir().expect("tempdir");
        let mut tails = LogTails::default();
        assert!(tails.read(&dir.path().join("none")).is_empty());
        let (learner, worker) = (dir.path().join("learner.log"), dir.path().join("worker-0.log"));
        std::fs::write(&learner, "one\n\u{1b}[31mtwo\nthr").expect("writes");
        std::fs::write(dir.path().join("else"), "no log\n").expect("writes");
        let texts = |lines: &[LogLine]| {
            lines.iter().map(|line| format!("{}: {}", line.who, line.text)).collect::<Vec<_>>()
        };
        assert_eq!(texts(&tails.read(dir.path())), ["learner: one", "learner: [31mtwo"]);
        std::fs::write(&learner, "one\n\u{1b}[31mtwo\nthree\n").expect("writes");
        std::fs::write(&worker, "x".repeat(20_000) + "\nlast\n").expect("writes");
        assert_eq!(texts(&tails.read(dir.path())), ["learner: three", "worker-0: last"]);
        assert!(tails.read(dir.path()).is_empty());
        std::fs::write(&learner, "anew\n").expect("writes");
        assert_eq!(texts(&tails.read(dir.path())), ["learner: anew"]);
    }
}
