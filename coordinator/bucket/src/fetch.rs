//! A checkpoint is brought from the bucket.

use std::fs;
use std::path::{Path, PathBuf};

use store::checkpoint::{LABELS, Labels, MANIFEST, Manifest};
use store::files;

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::listing::Listed;
use crate::record::{folder, object};
use crate::recorded_files;

/// Prefix of a directory that is being filled.
const FETCHING: &str = ".fetching-";

impl Bucket {
    /// Brings a whole checkpoint into a store at `root`: every file is as the manifest says, or there is none.
    pub(crate) fn fetch(&self, listed: &Listed, root: &Path) -> Result<PathBuf, BucketError> {
        let target = root.join(listed.name.as_str());
        let scratch = root.join(format!("{FETCHING}{}-{}", listed.name, std::process::id()));
        let fetched = (|| {
            fs::create_dir_all(&scratch).map_err(|error| file_error(&scratch, &error))?;
            self.wait(async {
                for (file, entry) in &listed.manifest().files {
                    let below = format!("{}/{}", folder(&listed.name), object(file, entry));
                    self.download(&below, &scratch.join(file), entry).await?;
                }
                Ok::<_, BucketError>(())
            })?;
            write_summary(listed, &scratch)?;
            // Once more by whoever reads checkpoints: what it lists belongs to one.
            Manifest::read(&scratch)?;
            if target.exists() {
                fs::remove_dir_all(&target).map_err(|error| file_error(&target, &error))?;
            }
            fs::rename(&scratch, &target).map_err(|error| file_error(&target, &error))
        })();
        if fetched.is_err() {
            // The error above is the one to report.
            let _ = fs::remove_dir_all(&scratch);
        }
        fetched.map(|()| target)
    }

    /// Brings what the run had recorded up to the checkpoint into the directory `run`.
    pub(crate) fn fetch_recorded(&self, listed: &Listed, run: &Path) -> Result<(), BucketError> {
        for (file, entry) in &listed.record.run {
            let below = format!("{}/{}", folder(&listed.name), object(file, entry));
            let packed = run.join(format!(".{file}"));
            self.wait(self.download(&below, &packed, entry))?;
            let bytes = fs::read(&packed).map_err(|error| file_error(&packed, &error))?;
            let (name, content) = recorded_files::unpacked(file, &bytes)
                .map_err(|reason| BucketError::damaged(self.shown(&below), reason))?;
            write(&run.join(name), &content)?;
            fs::remove_file(&packed).map_err(|error| file_error(&packed, &error))?;
        }
        Ok(())
    }
}

/// Writes manifest and labels of a checkpoint into a store at `root`: enough to list it.
pub(crate) fn summarise(listed: &Listed, root: &Path) -> Result<(), BucketError> {
    let dir = root.join(listed.name.as_str());
    fs::create_dir_all(&dir).map_err(|error| file_error(&dir, &error))?;
    write_summary(listed, &dir)
}

fn write_summary(listed: &Listed, dir: &Path) -> Result<(), BucketError> {
    let json = serde_json::to_vec_pretty(listed.manifest()).expect("a manifest has a JSON form");
    write(&dir.join(MANIFEST), &json)?;
    let labels = dir.join(LABELS);
    if listed.labels != Labels::default() {
        let json = serde_json::to_vec_pretty(&listed.labels).expect("labels have a JSON form");
        return write(&labels, &json);
    }
    // What was said of it before, and is not any more.
    match fs::remove_file(&labels) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(file_error(&labels, &error))
        }
        _ => Ok(()),
    }
}

pub(crate) fn write(path: &Path, content: &[u8]) -> Result<(), BucketError> {
    files::replace(path, content).map_err(|error| BucketError::File(error.to_string()))
}

pub(crate) fn file_error(path: &Path, error: &std::io::Error) -> BucketError {
    BucketError::File(format!("{}: {error}", path.display()))
}
