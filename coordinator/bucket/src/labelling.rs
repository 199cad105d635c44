//! Pins and tags: the only objects of a checkpoint that ever change, each by one writer at a time.

use store::checkpoint::{Labels, MAX_TAGS, Name};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::objects::{Small, Written};
use crate::record::{LABELS, folder};

/// How often labels are tried that others change at the same moment.
const TRIES: usize = 16;

/// Labels as a bucket holds them; none there are none.
pub(crate) struct StoredLabels {
    pub(crate) labels: Labels,
    /// What was read; none of what is too long.
    read: Option<Small>,
    /// Why they cannot be read, and count as pinned.
    pub(crate) problem: Option<String>,
}

/// Where the labels of a checkpoint lie.
fn labels_key(name: &Name) -> String {
    format!("{}/{LABELS}", folder(name))
}

/// What becomes of labels that cannot be read when they are changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unreadable {
    /// They stay: perhaps they can be mended.
    Keep,
    /// Whoever asks for the change has been told that they count as pinned.
    Replace,
}

impl Bucket {
    /// The labels of a checkpoint.
    pub(crate) async fn labels(&self, name: &Name) -> Result<StoredLabels, BucketError> {
        let unreadable = |read, reason| StoredLabels {
            labels: Labels::unreadable(),
            read,
            problem: Some(reason),
        };
        let small = match self.read(&labels_key(name)).await {
            Ok(Some(small)) => small,
            Ok(None) => {
                let labels = Labels::default();
                return Ok(StoredLabels { labels, read: None, problem: None });
            }
            Err(BucketError::Damaged { reason, .. }) => return Ok(unreadable(None, reason)),
            Err(error) => return Err(error),
        };
        Ok(match Labels::parse(&small.bytes) {
            Ok(labels) => StoredLabels { labels, read: Some(small), problem: None },
            Err(reason) => unreadable(Some(small), reason),
        })
    }

    /// The error of labels that cannot be read.
    pub(crate) fn unreadable_labels(&self, name: &Name, problem: &str) -> BucketError {
        let place = self.place(name);
        let reason = format!(
            "{problem}; the checkpoint counts as pinned; put this file back from a copy, or let `octopus checkpoints unpin \
             {}` write it anew",
            output::quoted(&place)
        );
        BucketError::damaged(self.shown(&labels_key(name)), reason)
    }

    /// Changes the labels of a checkpoint. Whoever changes them meanwhile is not overwritten: the change is made again
    /// to what is there then.
    async fn relabel(
        &self,
        name: &Name,
        unreadable: Unreadable,
        change: impl Fn(&mut Labels) -> Result<(), BucketError>,
    ) -> Result<(), BucketError> {
        let key = labels_key(name);
        for _ in 0..TRIES {
            let there = self.labels(name).await?;
            if let (Some(problem), Unreadable::Keep) = (&there.problem, unreadable) {
                return Err(self.unreadable_labels(name, problem));
            }
            let mut after = there.labels.clone();
            change(&mut after)?;
            if after == there.labels && there.problem.is_none() {
                return Ok(());
            }
            let text = serde_json::to_vec_pretty(&after).expect("labels have a JSON form");
            if there.problem.is_some() && there.read.is_none() {
                // Too long to be read, and so to be replaced.
                self.remove(&key).await?;
            }
            if self.write_after(&key, there.read.as_ref(), text).await? == Written::Done {
                return Ok(());
            }
        }
        let reason = "others change it at the same time, again and again".to_owned();
        Err(BucketError::Away { place: self.shown(&key), reason })
    }

    /// Pins a checkpoint, so that it is not removed by hand, or lets it go.
    pub fn pin(&self, name: &Name, pinned: bool) -> Result<(), BucketError> {
        self.wait(self.relabel(name, Unreadable::Replace, |labels| {
            labels.pinned = pinned;
            Ok(())
        }))
    }

    /// Gives a checkpoint a tag, and takes it from every other.
    pub fn tag(&self, name: &Name, tag: &Name) -> Result<(), BucketError> {
        self.wait(async {
            let listing = self.listing().await?;
            // On the new one first: cut off in between, both have it.
            self.relabel(name, Unreadable::Replace, |labels| {
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
                self.relabel(&other.name, Unreadable::Keep, |labels| {
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
                    self.relabel(&holder.name, Unreadable::Keep, |labels| {
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
        self.relabel(name, Unreadable::Keep, |there| {
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::SMALL;

    /// What somebody has said in them would be lost, and a pinned checkpoint with it.
    #[test]
    fn labels_that_cannot_be_read_count_as_pinned_and_only_their_user_replaces_them() {
        let dir = tempfile::tempdir().expect("tempdir");
        let bucket = Bucket::open(&format!("file://{}", dir.path().display())).expect("opens");
        let name = Name::of_iteration(5);
        let key = labels_key(&name);
        for damage in ["", "{", "[]", "{\"pinned\": 3}", "{\"surprise\": 1}"] {
            bucket.wait(bucket.write_named(&key, damage.into())).expect("written");
            let StoredLabels { labels, problem, .. } =
                bucket.wait(bucket.labels(&name)).expect("told");
            assert!(labels.pinned && problem.expect("why").contains("not labels"), "{damage}");
            bucket.delete(&name).expect_err("pinned");
            let (sent, local) =
                (Labels::default(), Labels { milestone: true, ..Labels::default() });
            let said = bucket.wait(bucket.send_labels(&name, &sent, &local)).expect_err("kept");
            assert!(matches!(said, BucketError::Damaged { .. }));
            assert!(said.to_string().contains("octopus checkpoints unpin file:///"), "{said}");
            let there = bucket.wait(bucket.read(&key)).expect("read").expect("there");
            assert_eq!(there.bytes, damage);
        }
        bucket.pin(&name, true).expect("written anew");
        let there = bucket.wait(bucket.labels(&name)).expect("read");
        assert_eq!((there.labels, there.problem), (Labels::unreadable(), None));
        // What is too long to be read is replaced as well.
        let long = " ".repeat(SMALL as usize + 1);
        bucket.wait(bucket.write_named(&key, long.into())).expect("written");
        bucket.delete(&name).expect_err("pinned");
        bucket.pin(&name, false).expect("written anew");
        let there = bucket.wait(bucket.labels(&name)).expect("read");
        assert_eq!((there.labels, there.problem), (Labels::default(), None));
    }
}
