//! How one object is read and written.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::Path as FilePath;

use bytes::Bytes;
use futures_util::StreamExt as _;
use object_store::{
    Error, MultipartUpload as _, ObjectStoreExt as _, PutMode, PutOptions, PutPayload,
    UpdateVersion,
};
use store::checkpoint::FileEntry;

use crate::bucket::Bucket;
use crate::error::BucketError;

/// Longest small object: manifests, labels (bytes).
pub(crate) const SMALL: u64 = 4 << 20;
/// Larger files are sent in parts of this size (bytes); S3 wants 5 MiB at least.
const PART: usize = 8 << 20;

/// A small object, and the version that it had.
#[derive(Debug)]
pub(crate) struct Small {
    pub(crate) bytes: Bytes,
    version: UpdateVersion,
}

/// What became of a write that depends on what is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Written {
    Done,
    /// Somebody else was first; nothing was changed.
    Lost,
}

impl Bucket {
    /// Reads a small object; none if there is none.
    pub(crate) async fn read(&self, below: &str) -> Result<Option<Small>, BucketError> {
        let fail = |error: &Error| BucketError::of(self.shown(below), error);
        let found = match self.objects.get(&self.path(below)).await {
            Ok(found) => found,
            Err(error @ Error::NotFound { .. }) => {
                // Without the bucket nothing is there either, which is another thing.
                let missing = error.to_string().contains("NoSuchBucket");
                return if missing { Err(fail(&error)) } else { Ok(None) };
            }
            Err(error) => return Err(fail(&error)),
        };
        if found.meta.size > SMALL {
            let reason = format!("{} bytes, expected {SMALL} at most", found.meta.size);
            return Err(BucketError::damaged(self.shown(below), reason));
        }
        let version =
            UpdateVersion { e_tag: found.meta.e_tag.clone(), version: found.meta.version.clone() };
        let bytes = found.bytes().await.map_err(|error| fail(&error))?;
        Ok(Some(Small { bytes, version }))
    }

    /// Writes a small object in the place of `before`, or where none was, and only then.
    pub(crate) async fn write_after(
        &self,
        below: &str,
        before: Option<&Small>,
        bytes: Vec<u8>,
    ) -> Result<Written, BucketError> {
        let path = self.path(below);
        let mode = before.map_or(PutMode::Create, |small| PutMode::Update(small.version.clone()));
        let payload = PutPayload::from(bytes);
        let options = PutOptions::from(mode);
        match self.objects.put_opts(&path, payload.clone(), options).await {
            Ok(_) => Ok(Written::Done),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(Written::Lost),
            // It is gone: what was read is not there any more.
            Err(Error::NotFound { .. }) if before.is_some() => Ok(Written::Lost),
            // A directory has no versions; it is looked at once more instead.
            Err(Error::NotImplemented { .. }) => {
                let now = self.read(below).await?;
                if now.as_ref().map(|small| &small.bytes) != before.map(|small| &small.bytes) {
                    return Ok(Written::Lost);
                }
                self.objects
                    .put(&path, payload)
                    .await
                    .map(|_| Written::Done)
                    .map_err(|error| BucketError::of(self.shown(below), &error))
            }
            Err(error) => Err(BucketError::of(self.shown(below), &error)),
        }
    }

    /// Writes an object whose name says what is in it, so that one that is there is the same.
    pub(crate) async fn write_named(&self, below: &str, bytes: Vec<u8>) -> Result<(), BucketError> {
        let sent = self.objects.put(&self.path(below), PutPayload::from(bytes)).await;
        sent.map(drop).map_err(|error| BucketError::of(self.shown(below), &error))
    }

    /// The same from a file, which must be as its entry says. What an attempt before this one has sent need not be sent
    /// again, if one may have `begun`.
    pub(crate) async fn upload(
        &self,
        below: &str,
        file: &FilePath,
        entry: &FileEntry,
        begun: bool,
    ) -> Result<(), BucketError> {
        let path = self.path(below);
        let fail = |error: &Error| BucketError::of(self.shown(below), error);
        if begun
            && entry.len > PART as u64
            && let Ok(there) = self.objects.head(&path).await
            && there.size == entry.len
        {
            return Ok(());
        }
        let unreadable =
            |error: std::io::Error| BucketError::File(format!("{}: {error}", file.display()));
        let changed =
            || BucketError::File(format!("{}: is not as it was committed", file.display()));
        let mut open = File::open(file).map_err(unreadable)?;
        let mut hasher = blake3::Hasher::new();
        let next = |open: &mut File, hasher: &mut blake3::Hasher| {
            let mut part = Vec::with_capacity(PART.min(entry.len as usize + 1));
            open.take(PART as u64).read_to_end(&mut part).map_err(unreadable)?;
            hasher.update(&part);
            Ok::<_, BucketError>(part)
        };
        if entry.len <= PART as u64 {
            let bytes = next(&mut open, &mut hasher)?;
            if hasher.finalize().to_hex().as_str() != entry.blake3 {
                return Err(changed());
            }
            return self.write_named(below, bytes).await;
        }
        let mut parts = self.objects.put_multipart(&path).await.map_err(|error| fail(&error))?;
        let sent = async {
            loop {
                let part = next(&mut open, &mut hasher)?;
                if part.is_empty() {
                    break;
                }
                parts.put_part(PutPayload::from(part)).await.map_err(|error| fail(&error))?;
            }
            if hasher.finalize().to_hex().as_str() != entry.blake3 {
                return Err(changed());
            }
            parts.complete().await.map(drop).map_err(|error| fail(&error))
        }
        .await;
        if sent.is_err() {
            // The error above is the one to report; what is left of the parts is the server's to remove.
            let _ = parts.abort().await;
        }
        sent
    }

    /// Writes an object into a new file, which then is as the entry says.
    pub(crate) async fn download(
        &self,
        below: &str,
        file: &FilePath,
        entry: &FileEntry,
    ) -> Result<(), BucketError> {
        let fail = |error: &Error| match error {
            Error::NotFound { .. } => {
                BucketError::damaged(self.shown(below), "is missing, and the manifest lists it")
            }
            error => BucketError::of(self.shown(below), error),
        };
        let unwritable =
            |error: std::io::Error| BucketError::File(format!("{}: {error}", file.display()));
        let found = self.objects.get(&self.path(below)).await.map_err(|error| fail(&error))?;
        if found.meta.size != entry.len {
            let reason = format!("{} bytes, the manifest says {}", found.meta.size, entry.len);
            return Err(BucketError::damaged(self.shown(below), reason));
        }
        let mut open = File::create(file).map_err(unwritable)?;
        let mut hasher = blake3::Hasher::new();
        let mut pieces = found.into_stream();
        while let Some(piece) = pieces.next().await {
            let piece = piece.map_err(|error| fail(&error))?;
            hasher.update(&piece);
            open.write_all(&piece).map_err(unwritable)?;
        }
        if hasher.finalize().to_hex().as_str() != entry.blake3 {
            let reason = "its content differs from its BLAKE3 hash in the manifest";
            return Err(BucketError::damaged(self.shown(below), reason));
        }
        open.sync_all().map_err(unwritable)
    }

    /// Removes an object; none there is none to remove.
    pub(crate) async fn remove(&self, below: &str) -> Result<(), BucketError> {
        match self.objects.delete(&self.path(below)).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(BucketError::of(self.shown(below), &error)),
        }
    }
}
