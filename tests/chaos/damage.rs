//! Damage: a file of a run directory is lost, cut, doubled or changed, and `octopus resume` ends with the
//! bits of a run that was left alone, or says which file is wrong.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use proto::rng::philox4x32_10;
use run::signals::StopRequests;
use serde_json::Value;
use tempfile::TempDir;

use super::PATIENCE;
use super::verdict::{Report, Verdict};
use crate::{Owned, Run, program};

/// Iterations of the run that is damaged.
const ITERATIONS: usize = 20;
/// The iteration after which its newest checkpoint was committed.
const NEWEST: usize = 10;

/// What is done to a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damage {
    /// It is gone.
    Lose,
    /// Nothing is left in it.
    Empty,
    /// Its second half is gone.
    Halve,
    /// Its content is there twice.
    Double,
    /// A bit is another, chosen by this number.
    Flip(u32),
    /// A decimal digit is another, chosen by this number.
    Digit(u32),
    /// A directory is in its place.
    Directory,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lose => write!(f, "lost"),
            Self::Empty => write!(f, "emptied"),
            Self::Halve => write!(f, "halved"),
            Self::Double => write!(f, "doubled"),
            Self::Flip(n) => write!(f, "with bit {n} flipped"),
            Self::Digit(n) => write!(f, "with digit {n} changed"),
            Self::Directory => write!(f, "replaced by a directory"),
        }
    }
}

impl Damage {
    /// Does it to the file at `path`.
    pub fn inflict(self, path: &Path) -> Result<()> {
        let mut bytes = std::fs::read(path)?;
        match self {
            Self::Lose | Self::Directory => {
                std::fs::remove_file(path)?;
                if self == Self::Directory {
                    std::fs::create_dir(path)?;
                }
                return Ok(());
            }
            Self::Empty => bytes.clear(),
            Self::Halve => bytes.truncate(bytes.len() / 2),
            Self::Double => bytes.extend_from_within(..),
            Self::Flip(n) => {
                let bits = 8 * bytes.len().max(1);
                let bit = n as usize % bits;
                if let Some(byte) = bytes.get_mut(bit / 8) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Self::Digit(n) => {
                let digits: Vec<usize> =
                    (0..bytes.len()).filter(|&at| bytes[at].is_ascii_digit()).collect();
                if !digits.is_empty() {
                    let digit = &mut bytes[digits[n as usize % digits.len()]];
                    *digit = b'0' + (*digit - b'0' + 1 + (n % 9) as u8) % 10;
                }
            }
        }
        Ok(std::fs::write(path, bytes)?)
    }

    fn drawn(kind: u32, place: u32) -> Self {
        match kind % 10 {
            0 => Self::Lose,
            1 => Self::Empty,
            2 => Self::Halve,
            3 => Self::Double,
            4 => Self::Directory,
            5 | 6 => Self::Flip(place),
            _ => Self::Digit(place),
        }
    }
}

/// A run that was killed twice on its way, and what it would have come to.
#[derive(Debug)]
pub struct Patient {
    run: Run,
    calm: Vec<String>,
}

impl Patient {
    /// Trains it: 12 of 20 iterations are recorded and 14 were, the newest checkpoint is after ten.
    pub fn new() -> Result<Self> {
        let flags = ["--workers=2", "--overlap=0", "--iterations=20"];
        let mut calm = Run::train(&flags);
        calm.succeed();
        let mut run = Run::with_variables(&[("SPACEOCTOPUS_TEST_FAULT", "crash@14/2")]);
        run.start_training(&flags);
        ensure!(run.wait() == Some(6), "{}", run.log());
        run.set_variables(&[("SPACEOCTOPUS_TEST_FAULT", "crash@12/1")]);
        run.resume(&[]);
        ensure!(run.wait() == Some(6), "{}", run.log());
        ensure!(run.path().join("promised.jsonl").is_file(), "{}", run.log());
        Ok(Self { run, calm: calm.digests() })
    }

    /// All its files, relative to its directory.
    pub fn files(&self) -> Result<Vec<PathBuf>> {
        let mut found = Vec::new();
        walk(&self.run.path(), Path::new(""), &mut |file, is_dir| {
            if !is_dir {
                found.push(file.to_owned());
            }
            Ok(())
        })?;
        found.sort();
        Ok(found)
    }

    /// Resumes a copy whose `file` has taken `damage`.
    pub fn try_with(&self, file: &Path, damage: Damage) -> Result<Verdict> {
        let copy = self.copy()?;
        let dir = copy.path().join("run");
        damage.inflict(&dir.join(file))?;
        let output = resume(&dir)?;
        self.judge(&dir, file, &output).with_context(|| {
            let said = String::from_utf8_lossy(&output.stderr);
            format!("{} {damage}, {}:\n{said}", file.display(), output.status)
        })
    }

    /// A copy of its directory, `run` in one that goes away.
    pub fn copy(&self) -> Result<TempDir> {
        let copy = tempfile::tempdir()?;
        copy_dir(&self.run.path(), &copy.path().join("run"))?;
        Ok(copy)
    }

    /// The digests that it would have come to.
    pub fn calm(&self) -> &[String] {
        &self.calm
    }

    fn judge(&self, dir: &Path, file: &Path, output: &Output) -> Result<Verdict> {
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(!said.contains("panicked"), "it panicked");
        let code = output.status.code().context("a signal ended it")?;
        // A checkpoint is named by its directory or by the file.
        let named = file.iter().any(|part| {
            let part = part.to_string_lossy();
            part.contains(['.', '-']) && said.contains(&*part)
        });
        match code {
            0 => {
                let text = std::fs::read_to_string(dir.join("metrics.jsonl"))?;
                let lines: Vec<Value> =
                    text.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
                for (index, line) in lines.iter().enumerate() {
                    ensure!(line["iteration"] == index, "line {} is {line}", index + 1);
                }
                // Another budget is another course, if it is said.
                if named && said.contains("run.env_steps is") {
                    return Ok(Verdict::Survived);
                }
                ensure!(lines.len() == ITERATIONS, "it ended after {} iterations", lines.len());
                for (index, line) in lines.iter().enumerate().skip(NEWEST) {
                    let digest = &line["digest"];
                    ensure!(*digest == *self.calm[index], "iteration {index} has {digest}");
                }
                Ok(Verdict::Survived)
            }
            1 | 5 => {
                ensure!(named, "the file is not named");
                Ok(Verdict::Refused)
            }
            code => bail!("exit code {code}"),
        }
    }
}

/// Damages a run `times` times, each time a fresh copy, as `seed` says.
pub fn run(
    times: usize,
    seed: u64,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Report> {
    let patient = Patient::new()?;
    let files = patient.files()?;
    let mut report = Report::default();
    for time in 0..times {
        ensure!(stop.count() == 0, "stopped");
        let [file, kind, place, _] =
            philox4x32_10([time as u32, 0, 0, 0], [seed as u32, (seed >> 32) as u32]);
        let file = &files[file as usize % files.len()];
        let damage = Damage::drawn(kind, place);
        let verdict = patient.try_with(file, damage)?;
        narrate(&format!("{} {damage}: {verdict:?}", file.display()));
        report.count(verdict);
    }
    Ok(report)
}

/// `octopus resume` on a directory, to its end.
pub fn resume(dir: &Path) -> Result<Output> {
    let log = dir.with_extension("log");
    let mut command = Command::new(program("octopus"));
    command.arg("resume").arg(dir).args(["--no-eval", "--listen=off"]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(std::fs::File::create(&log)?);
    let mut process = Owned::spawn(&mut command);
    // What hangs is seen by what no longer changes: a busy machine may take its time.
    let (mut recorded, mut since) = (0, Instant::now());
    let status = loop {
        if let Some(status) = process.ended() {
            break status;
        }
        let metrics = std::fs::metadata(dir.join("metrics.jsonl")).map_or(0, |file| file.len());
        if metrics != recorded {
            (recorded, since) = (metrics, Instant::now());
        }
        ensure!(since.elapsed() < PATIENCE, "it hangs:\n{}", std::fs::read_to_string(&log)?);
        std::thread::sleep(super::TICK);
    };
    Ok(Output { status, stdout: Vec::new(), stderr: std::fs::read(&log)? })
}

/// Copies a directory with everything in it.
pub fn copy_dir(from: &Path, to: &Path) -> Result<()> {
    std::fs::create_dir(to)?;
    walk(from, Path::new(""), &mut |file, is_dir| {
        if is_dir {
            std::fs::create_dir(to.join(file))?;
        } else {
            std::fs::copy(from.join(file), to.join(file))?;
        }
        Ok(())
    })
}

/// Shows every file and directory below `root`, directories before what is in them.
fn walk(root: &Path, below: &Path, show: &mut dyn FnMut(&Path, bool) -> Result<()>) -> Result<()> {
    for entry in std::fs::read_dir(root.join(below))? {
        let entry = entry?;
        let path = below.join(entry.file_name());
        let is_dir = entry.file_type()?.is_dir();
        show(&path, is_dir)?;
        if is_dir {
            walk(root, &path, show)?;
        }
    }
    Ok(())
}
