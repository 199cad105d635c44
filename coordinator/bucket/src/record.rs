//! What the bucket holds of a checkpoint, and how its objects are called.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use store::checkpoint::{CONFIG, FileEntry, Manifest, Name, POLICY, ROBOT, STATE};

/// Version of the layout.
pub(crate) const FORMAT: u32 = 1;
/// Folder of the checkpoints.
pub(crate) const CHECKPOINTS: &str = "checkpoints";
/// The object that is written last.
pub(crate) const MANIFEST: &str = "manifest.json";
/// The object of labels.
pub(crate) const LABELS: &str = "labels.json";

/// A checkpoint in the bucket: what it says about itself, and what its run had recorded by then.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Record {
    format: u32,
    /// That of the local checkpoint.
    pub(crate) manifest: Manifest,
    /// Files of the run directory, compressed, by name.
    pub(crate) run: BTreeMap<String, FileEntry>,
}

impl Record {
    pub(crate) fn new(manifest: Manifest, run: BTreeMap<String, FileEntry>) -> Self {
        Self { format: FORMAT, manifest, run }
    }

    /// Reads one, and checks that it names nothing that does not belong to a checkpoint.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let record: Self =
            serde_json::from_slice(bytes).map_err(|error| format!("not a manifest: {error}"))?;
        if record.format != FORMAT {
            return Err(format!("format {}, this version reads {FORMAT}", record.format));
        }
        let known = [STATE, POLICY, CONFIG, ROBOT];
        let files = record.manifest.files.keys().filter(|name| !known.contains(&name.as_str()));
        let run = record.run.keys().filter(|name| !crate::recorded_files::is_one(name));
        if let Some(unknown) = files.chain(run).next() {
            return Err(format!("lists {unknown:?}, which is no file of a checkpoint"));
        }
        let entries = record.manifest.files.values().chain(record.run.values());
        let is_hash = |text: &str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
        if entries.into_iter().any(|entry| !is_hash(&entry.blake3)) {
            return Err("lists a BLAKE3 hash that is none".to_owned());
        }
        Ok(record)
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec_pretty(self).expect("a record has a JSON form")
    }

    /// Objects that it lists, below the checkpoint's folder.
    pub(crate) fn objects(&self) -> impl Iterator<Item = String> + '_ {
        let entries = self.manifest.files.iter().chain(&self.run);
        entries.map(|(file, entry)| object(file, entry))
    }
}

/// Name of the object that holds a file.
pub(crate) fn object(file: &str, entry: &FileEntry) -> String {
    format!("{file}.{}", entry.blake3.get(..16).unwrap_or(&entry.blake3))
}

/// The folder of a checkpoint.
pub(crate) fn folder(name: &Name) -> String {
    format!("{CHECKPOINTS}/{name}")
}
