//! Pins and tags: the only objects of a checkpoint that ever change, each by one writer at a time.

use store::checkpoint::{Labels, MAX_TAGS, Name};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::objects::{Small, Written};
use crate::record::{LABELS, folder};

/// How often labels are tried that others change at the same moment.
const TRIES: usize = 16;

impl Bucket {
    /// The labels of a checkpoint; none there are none.
    pub(crate) async fn labels(&self, name: &Name) -> Result<Labels, BucketError> {
        Ok(self.labels_and_version(name).await?.0)
    }

    async fn labels_and_version(
        &self,
        name: &Name,
    ) -> Result<(Labels, Option<Small>), BucketError> {
        let key = format!("{}/{LABELS}", folder(name));
        let Some(small) = self.read(&key).await? else { return Ok((Labels::default(), None)) };
        let labels = serde_json::from_slice(&small.bytes).map_err(|error| {
            BucketError::damaged(self.shown(&key), format!("not labels: {error}"))
        })?;
        Ok((labels, Some(small)))
    }

    /// Changes the labels of a checkpoint. Whoever changes them meanwhile is not overwritten: the change is made again
    /// to what is there then.
    pub(crate) async fn relabel(
        &self,
        name: &Name,
        change: impl Fn(&mut Labels) -> Result<(), BucketError>,
    ) -> Result<Labels, BucketError> {
        let key = format!("{}/{LABELS}", folder(name));
        for _ in 0..TRIES {
            let (before, version) = self.labels_and_version(name).await?;
            let mut after = before.clone();
            change(&mut after)?;
            if after == before {
                return Ok(after);
            }
            let text = serde_json::to_vec_pretty(&after).expect("labels have a JSON form");
            if self.write_after(&key, version.as_ref(), text).await? == Written::Done {
                return Ok(after);
            }
        }
        let reason = "others change it at the same time, again and again".to_owned();
        Err(BucketError::Away { place: self.shown(&key), reason })
    }

    /// Pins a checkpoint, so that it is not removed by hand, or lets it go.
    pub fn pin(&self, name: &Name, pinned: bool) -> Result<(), BucketError> {
        self.wait(self.relabel(name, |labels| {
            labels.pinned = pinned;
            Ok(())
        }))
        .map(drop)
    }

    /// Gives a checkpoint a tag, and takes it from every other.
    pub fn tag(&self, name: &Name, tag: &Name) -> Result<(), BucketError> {
        self.wait(async {
            let listing = self.listing().await?;
            // On the new one first: cut off in between, both have it.
            self.relabel(name, |labels| {
                if labels.has_tag(tag.as_str()) {
                    return Ok(());
                }
                if labels.tags.len() >= MAX_TAGS {
                    let reason = format!("`{name}` has {MAX_TAGS} tags already; untag it first");
                    return Err(BucketError::Refused(reason));
                }
                labels.tags.push(tag.clone());
                labels.tags.sort();
                Ok(())
            })
            .await?;
            let others = listing.checkpoints.iter().filter(|other| other.name != *name);
            for other in others.filter(|other| other.labels.has_tag(tag.as_str())) {
                self.relabel(&other.name, |labels| {
                    labels.tags.retain(|there| there != tag);
                    Ok(())
                })
                .await?;
            }
            Ok(())
        })
    }

    /// Takes a tag from whichever checkpoint has it; returns these.
    pub fn untag(&self, tag: &Name) -> Result<Vec<Name>, BucketError> {
        self.wait(async {
            let listing = self.listing().await?;
            let mut holders = Vec::new();
            for holder in listing.checkpoints {
                if holder.labels.has_tag(tag.as_str()) {
                    self.relabel(&holder.name, |labels| {
                        labels.tags.retain(|there| there != tag);
                        Ok(())
                    })
                    .await?;
                    holders.push(holder.name);
                }
            }
            Ok(holders)
        })
    }

    /// Brings the labels in the bucket to what they are locally. What somebody else has said there since they were last
    /// `sent` stays: only what has changed locally is changed.
    pub(crate) async fn send_labels(
        &self,
        name: &Name,
        sent: &Labels,
        local: &Labels,
    ) -> Result<(), BucketError> {
        self.relabel(name, |there| {
            if local.pinned != sent.pinned {
                there.pinned = local.pinned;
            }
            there.tags.retain(|tag| local.tags.contains(tag) || !sent.tags.contains(tag));
            for tag in local.tags.iter().filter(|tag| !sent.tags.contains(tag)) {
                if !there.tags.contains(tag) && there.tags.len() < MAX_TAGS {
                    there.tags.push(tag.clone());
                }
            }
            there.tags.sort();
            there.score.clone_from(&local.score);
            there.milestone = local.milestone;
            Ok(())
        })
        .await
        .map(drop)
    }
}
