//! What a run has recorded up to a checkpoint: without it the checkpoint is nobody's, and no run goes on from it.

use std::io::{Read as _, Write as _};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use proto::run_dir::RunDir;
use store::regular_files;

use crate::error::BucketError;

/// Files of a run directory that go with every checkpoint: the digests that tie it to its run, the budgets that the
/// iterations were made under, the evaluations, and which sessions there were.
const FILES: [&str; 4] = ["metrics.jsonl", "budgets.json", "evaluations.jsonl", "provenance.json"];
/// They are compressed.
const SUFFIX: &str = ".gz";
/// Most bytes that one may have.
const LONGEST: u64 = 4 << 30;

/// Whether a file of this name, compressed, goes with a checkpoint.
pub(crate) fn is_one(name: &str) -> bool {
    name.strip_suffix(SUFFIX).is_some_and(|name| FILES.contains(&name))
}

/// The files of a run as they belong to its checkpoint after `iterations`: names and compressed bytes. The metrics end
/// with the checkpoint's own iteration, and so must reach it.
pub(crate) fn of(run_dir: &RunDir, iterations: u64) -> Result<Vec<(String, Vec<u8>)>, BucketError> {
    let mut files = Vec::new();
    for name in FILES {
        let path = run_dir.path().join(name);
        let mut bytes = match regular_files::read(&path, LONGEST) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(BucketError::File(format!("{}: {error}", path.display()))),
        };
        if name == "metrics.jsonl" {
            let wanted = iterations as usize;
            let ends = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n');
            let end = match wanted {
                0 => Some(0),
                _ => ends.map(|(at, _)| at + 1).nth(wanted - 1),
            };
            let Some(end) = end else {
                let reason = format!("{}: ends before iteration {iterations}", path.display());
                return Err(BucketError::File(reason));
            };
            bytes.truncate(end);
        }
        files.push((format!("{name}{SUFFIX}"), compressed(&bytes)));
    }
    Ok(files)
}

/// Removes those of a run directory, where they belong to a checkpoint that is not taken.
pub(crate) fn remove(run: &Path) {
    for name in FILES {
        // What is not there need not go.
        let _ = std::fs::remove_file(run.join(name));
    }
}

/// Without a time in it: the same bytes give the same.
fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("a vector takes all");
    encoder.finish().expect("a vector takes all")
}

/// Name and content of the file that was compressed.
pub(crate) fn unpacked(name: &str, bytes: &[u8]) -> Result<(String, Vec<u8>), String> {
    let plain = name.strip_suffix(SUFFIX).unwrap_or(name).to_owned();
    let mut content = Vec::new();
    GzDecoder::new(bytes)
        .take(LONGEST)
        .read_to_end(&mut content)
        .map_err(|error| format!("cannot be unpacked: {error}"))?;
    Ok((plain, content))
}
