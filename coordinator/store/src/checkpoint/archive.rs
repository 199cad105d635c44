//! A checkpoint as one file: an uncompressed tar archive.
//!
//! ```text
//! iteration-00000050/manifest.json
//! iteration-00000050/config.toml
//! iteration-00000050/policy.safetensors
//! iteration-00000050/robot.toml
//! iteration-00000050/state.safetensors
//! ```
//!
//! The manifest comes first, the others in alphabetical order; owner 0, mode 0644, time 0. So the
//! same checkpoint always gives the same bytes. Labels do not travel: what is pinned or best in one
//! store says nothing in another.
//!
//! An archive may come from anywhere. The manifest, which must come first, is read into memory up to
//! a limit; after it, nothing is written that it does not announce.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::Path;

use proto::config::{Config, Precision, Run};
use proto::run_dir::RunDir;
use tar::{Archive, Builder, EntryType, Header};

use super::commit::{Arrival, Clash};
use super::disk::{CHUNK, Disk};
use super::entry::Entry;
use super::file_names::{CONFIG, MANIFEST, ROBOT};
use super::guard::Scratch;
use super::manifest::{FileEntry, MAX_MANIFEST, Manifest};
use super::name::Name;
use super::read::{self, MAX_TEXT, small_files};
use super::store::CheckpointStore;
use super::{CheckpointError, opening, verify};
use crate::budgets;
use crate::recorded::Recorded;

/// Longest content of an archive (bytes).
pub const MAX_CONTENT: u64 = 4 << 30;

impl CheckpointStore {
    /// Writes a checkpoint as an archive, after checking that it is whole.
    pub fn export(&self, name: &Name, writer: impl Write) -> Result<(), CheckpointError> {
        let dir = self.existing(name)?;
        let manifest = read::load(&dir)?.manifest;
        let manifest_path = dir.join(MANIFEST);
        let text = opening::bytes(&manifest_path, MAX_MANIFEST)?;
        // Opened before the first byte is written: a checkpoint that is removed meanwhile stays
        // readable through these.
        let mut files = Vec::new();
        for (file, entry) in &manifest.files {
            let path = dir.join(file);
            files.push((file, entry.len, opening::file(&path)?));
        }
        let sink = |source| CheckpointError::Io { path: dir.clone(), action: "export", source };
        let mut builder = Builder::new(writer);
        builder.append(&header(name, MANIFEST, text.len() as u64)?, &text[..]).map_err(sink)?;
        for (file, len, open) in files {
            builder.append(&header(name, file, len)?, open.take(len)).map_err(sink)?;
        }
        builder.into_inner().and_then(|mut writer| writer.flush()).map_err(sink)
    }

    /// Unpacks an archive into the store, under the name `name` or the one that it has there.
    ///
    /// The same checkpoint twice is no error; another one of that name is, unless it is damaged:
    /// then the archive replaces it. A name `iteration-N` makes it one of the run's own checkpoints,
    /// so it must be of iteration N and of the same run. If the run has recorded another digest for
    /// its last iteration, or would have learned otherwise under its budget, it is refused. One
    /// whose digest is recorded is the run's own, the others stay marked as imported.
    pub fn import(&self, reader: impl Read, name: Option<Name>) -> Result<Entry, CheckpointError> {
        name.iter().try_for_each(|name| self.check_free(name))?;
        let scratch = Scratch::new(&self.disk, &self.root, "import")?;
        let (inner, manifest) = unpack(&self.disk, reader, &scratch)?;
        let found = verify::examine(scratch.path());
        if let Some(problem) = found.problems.first() {
            // The directory's name says nothing to anybody.
            let inside = format!("{}/", scratch.path().display());
            return Err(CheckpointError::archive(problem.replace(&inside, "")));
        }
        let name = name.unwrap_or(inner);
        let mut imported = name.iteration().is_some();
        if imported {
            imported = !self.check_own(&name, &manifest, scratch.path())?;
        }
        let (manifest, clash) = (&manifest, Clash::Refuse);
        self.publish(scratch, Arrival { name: &name, manifest, clash, score: None, imported })?;
        self.entry(&name)
    }

    /// Refuses, as one of the run's own checkpoints, what is of another run: than the one whose
    /// directory holds this store, and than the newest of its checkpoints that can say so. Returns
    /// whether the run has recorded that it came to this state itself.
    fn check_own(
        &self,
        name: &Name,
        manifest: &Manifest,
        dir: &Path,
    ) -> Result<bool, CheckpointError> {
        let refuse = |reason: String| {
            let cure = "import it under another name, which no `octopus resume` takes up";
            Err(CheckpointError::refused(format!("{reason}; {cure}")))
        };
        if *name != Name::of_iteration(manifest.iteration) {
            let is = manifest.iteration;
            return refuse(format!("`{name}` cannot name a checkpoint of iteration {is}"));
        }
        let (config, robot) = small_files(dir)?;
        let mut others = self.list()?;
        // A damaged one cannot say what run it is of.
        others.retain(|other| small_files(other).is_ok());
        let run = self.run();
        let newest = others.last().map(|dir| (dir.as_path(), "its newest checkpoint"));
        for (other, what) in
            run.iter().map(|run| (run.path(), "the one of this store")).chain(newest)
        {
            // Of the run itself that must not be unknown.
            let (its_config, its_robot) = small_files(other)?;
            if !(same_run(&config, &its_config) && robot == its_robot) {
                return refuse(format!(
                    "`{name}` is of another run than {what}: robot, configuration or seed differ"
                ));
            }
        }
        let Some(run) = run else { return Ok(false) };
        let recorded =
            Recorded::read(&run).map_err(|error| CheckpointError::refused(error.to_string()))?;
        if let Some(ours) = recorded.digest_after(manifest.iteration) {
            let theirs = manifest.digest;
            return if ours == theirs {
                Ok(true)
            } else {
                refuse(format!(
                    "`{name}` is of another course than this run: its digest is {theirs}, the run \
                     recorded {ours}"
                ))
            };
        }
        let (ours, _) = small_files(run.path())?;
        let budgets = (config.run.env_steps, ours.run.env_steps);
        if budgets::matters(&ours) && budgets.0 != budgets.1 {
            return refuse(format!(
                "`{name}` is of another course than this run: its learning rate falls over \
                 run.env_steps = {}, here over {}",
                budgets.0, budgets.1
            ));
        }
        Ok(false)
    }

    /// The run that this store belongs to, if it belongs to one.
    pub(super) fn run(&self) -> Option<RunDir> {
        // A store may be named by a relative path, or through a link.
        let root = self.root.canonicalize().ok()?;
        let run = RunDir::new(root.parent()?);
        (run.checkpoints() == root && run.config().exists()).then_some(run)
    }
}

/// `run`, with a precision that an earlier version left undecided taken to be that of `other`.
fn decided(run: &Run, other: &Run) -> Run {
    let mut run = run.clone();
    if run.precision == Precision::Auto {
        run.precision = other.precision;
    }
    run
}

/// Whether two configurations can be of one run. Budgets, processes and what is kept may change
/// when a run is resumed; the rest, and the seed, may not.
fn same_run(a: &Config, b: &Config) -> bool {
    (&a.task, &a.robot, &a.env) == (&b.task, &b.robot, &b.env)
        && (&a.network, &a.algorithm, &a.optimizer) == (&b.network, &b.algorithm, &b.optimizer)
        && decided(&a.run, &b.run).continues(&decided(&b.run, &a.run))
}

/// The header of a file of a checkpoint.
fn header(name: &Name, file: &str, len: u64) -> Result<Header, CheckpointError> {
    let mut header = Header::new_ustar();
    header
        .set_path(format!("{name}/{file}"))
        .map_err(|error| CheckpointError::archive(format!("{name}/{file}: {error}")))?;
    header.set_entry_type(EntryType::Regular);
    header.set_size(len);
    header.set_mode(0o644);
    header.set_mtime(0);
    header.set_uid(0);
    header.set_gid(0);
    header.set_cksum();
    Ok(header)
}

/// Writes the files of an archive into the scratch directory; returns the name of its folder and its
/// manifest. Lengths and hashes are as the manifest says.
fn unpack(
    disk: &Disk,
    reader: impl Read,
    scratch: &Scratch<'_>,
) -> Result<(Name, Manifest), CheckpointError> {
    let refuse = |reason: String| CheckpointError::Archive { reason };
    let unreadable = |error: std::io::Error| refuse(format!("it cannot be read: {error}"));
    let mut archive = Archive::new(reader);
    // Raw: the extensions for long names are not followed, they would be read without a limit.
    let mut entries = archive.entries().map_err(unreadable)?.raw(true);

    let mut first =
        entries.next().ok_or_else(|| refuse("it is empty".to_owned()))?.map_err(unreadable)?;
    let (name, file) = place(first.header())?;
    if file != MANIFEST {
        return Err(refuse(format!("it begins with {file}, not with {MANIFEST}")));
    }
    let len = first.header().entry_size().map_err(unreadable)?;
    if len > MAX_MANIFEST {
        return Err(refuse(format!("{MANIFEST} has {len} bytes, more than {MAX_MANIFEST}")));
    }
    let mut text = Vec::new();
    first.read_to_end(&mut text).map_err(unreadable)?;
    if text.len() as u64 != len {
        return Err(refuse(format!("it ends within {MANIFEST}")));
    }
    let manifest =
        Manifest::parse(&text).map_err(|reason| refuse(format!("{MANIFEST}: {reason}")))?;
    if manifest.bytes() > MAX_CONTENT {
        let bytes = manifest.bytes();
        return Err(refuse(format!("it announces {bytes} bytes, more than {MAX_CONTENT}")));
    }

    for file in [CONFIG, ROBOT] {
        let len = manifest.files[file].len;
        if len > MAX_TEXT {
            return Err(refuse(format!("{file} has {len} bytes, more than {MAX_TEXT}")));
        }
    }

    let mut missing: BTreeMap<&str, &FileEntry> =
        manifest.files.iter().map(|(file, entry)| (file.as_str(), entry)).collect();
    for entry in entries {
        let mut entry = entry.map_err(unreadable)?;
        let (folder, file) = place(entry.header())?;
        if folder != name {
            return Err(refuse(format!("it holds two folders, {name} and {folder}")));
        }
        let Some(expected) = missing.remove(file.as_str()) else {
            return Err(refuse(format!("{file} is not in {MANIFEST}, or there twice")));
        };
        let len = entry.header().entry_size().map_err(unreadable)?;
        if len != expected.len {
            let expected = expected.len;
            return Err(refuse(format!("{file} has {len} bytes, {MANIFEST} says {expected}")));
        }
        let path = scratch.path().join(&file);
        let mut out = disk.create(&path)?;
        let mut hasher = blake3::Hasher::new();
        let mut left = len;
        let mut chunk = vec![0; CHUNK];
        while left > 0 {
            let want = left.min(CHUNK as u64) as usize;
            let read = entry.read(&mut chunk[..want]).map_err(unreadable)?;
            if read == 0 {
                return Err(refuse(format!("it ends within {file}")));
            }
            hasher.update(&chunk[..read]);
            disk.write(&mut out, &path, &chunk[..read])?;
            left -= read as u64;
        }
        if hasher.finalize().to_hex().as_str() != expected.blake3 {
            return Err(refuse(format!("{file} differs from its BLAKE3 hash")));
        }
        disk.sync(&out, &path)?;
    }
    if let Some(file) = missing.keys().next() {
        return Err(refuse(format!("{file} is missing")));
    }
    // Last, as in a commit.
    disk.write_file(&scratch.path().join(MANIFEST), &text)?;
    Ok((name, manifest))
}

/// Folder and file of an archive's entry, which must be a regular file one level deep.
fn place(header: &Header) -> Result<(Name, String), CheckpointError> {
    let bytes = header.path_bytes();
    let path = String::from_utf8_lossy(&bytes);
    let shown = path.escape_debug();
    if header.entry_type() != EntryType::Regular {
        let kind = header.entry_type();
        return Err(CheckpointError::archive(format!("`{shown}` is no regular file: {kind:?}")));
    }
    let wrong = || {
        let expected = "expected NAME/FILE, as `octopus checkpoints export` writes it";
        CheckpointError::archive(format!("`{shown}`: {expected}"))
    };
    let (folder, file) = path.split_once('/').ok_or_else(wrong)?;
    let folder: Name = folder.parse().map_err(|_| wrong())?;
    let known = super::manifest::KNOWN.contains(&file) || file == MANIFEST;
    if known { Ok((folder, file.to_owned())) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn what_an_earlier_version_left_undecided_does_not_make_another_run() {
        let config = |precision: &str| {
            let layers = Layers::new(Preset::Tuned, None);
            let layers = layers.set(&format!("run.precision={precision}")).expect("valid");
            layers.resolve().expect("valid")
        };
        for (a, b, same) in [
            ("auto", "bf16", true),
            ("f32", "auto", true),
            ("auto", "auto", true),
            ("f32", "f32", true),
            ("f32", "bf16", false),
        ] {
            assert_eq!(same_run(&config(a), &config(b)), same, "{a} and {b}");
        }
    }
}
