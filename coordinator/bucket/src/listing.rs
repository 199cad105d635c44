//! What checkpoints a bucket holds.

use futures_util::StreamExt as _;
use futures_util::stream::iter;
use store::checkpoint::{Labels, Manifest, Name};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::labelling::StoredLabels;
use crate::record::{CHECKPOINTS, MANIFEST, Record, folder};

/// Small objects that are read at the same time.
const AT_ONCE: usize = 8;

/// A checkpoint of a bucket.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Its name.
    pub name: Name,
    pub(crate) record: Record,
    /// What users and runs say about it.
    pub labels: Labels,
    /// Why that cannot be read, and counts as pinned.
    pub(crate) labels_problem: Option<String>,
}

impl Listed {
    /// What it says about itself.
    pub fn manifest(&self) -> &Manifest {
        &self.record.manifest
    }
}

/// Everything that a bucket holds below a prefix.
#[derive(Debug, Default)]
pub struct Listing {
    /// Checkpoints, in the order of their names, which is that of their iterations.
    pub checkpoints: Vec<Listed>,
    /// Those whose manifest cannot be understood, and why.
    pub damaged: Vec<(Name, String)>,
}

impl Bucket {
    /// Looks at every checkpoint: manifests and labels alone.
    pub fn list(&self) -> Result<Listing, BucketError> {
        self.wait(self.listing())
    }

    pub(crate) async fn listing(&self) -> Result<Listing, BucketError> {
        let path = self.path(CHECKPOINTS);
        let found = self.objects.list_with_delimiter(Some(&path)).await;
        let found = found.map_err(|error| BucketError::of(self.shown(CHECKPOINTS), &error))?;
        let folders = found.common_prefixes.iter();
        let names = folders.filter_map(|folder| folder.filename()?.parse::<Name>().ok());
        let mut names: Vec<Name> = names.collect();
        names.sort();
        let mut looks = iter(names)
            .map(|name| async move {
                let found = self.look(&name).await;
                (name, found)
            })
            .buffered(AT_ONCE);
        let mut listing = Listing::default();
        while let Some((name, found)) = looks.next().await {
            match found {
                Ok(Some(listed)) => listing.checkpoints.push(listed),
                // Its manifest is still to come, or it is being removed.
                Ok(None) => {}
                Err(BucketError::Damaged { reason, .. }) => listing.damaged.push((name, reason)),
                Err(error) => return Err(error),
            }
        }
        Ok(listing)
    }

    /// Says of labels that cannot be read what to do.
    pub(crate) fn warn_of_labels(&self, listed: &Listed) {
        if let Some(problem) = &listed.labels_problem {
            tracing::warn!("{}", self.unreadable_labels(&listed.name, problem));
        }
    }

    async fn look(&self, name: &Name) -> Result<Option<Listed>, BucketError> {
        let key = format!("{}/{MANIFEST}", folder(name));
        let Some(small) = self.read(&key).await? else { return Ok(None) };
        let record = Record::parse(&small.bytes)
            .map_err(|reason| BucketError::damaged(self.shown(&key), reason))?;
        if name.iteration().is_some_and(|iteration| iteration != record.manifest.iteration) {
            let reason = format!("is of iteration {}, not of that name", record.manifest.iteration);
            return Err(BucketError::damaged(self.shown(&key), reason));
        }
        let StoredLabels { labels, problem, .. } = self.labels(name).await?;
        Ok(Some(Listed { name: name.clone(), record, labels, labels_problem: problem }))
    }
}
