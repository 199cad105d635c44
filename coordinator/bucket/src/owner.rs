//! Who may write below a prefix: one run, and of its sessions the newest.
//!
//! A run that another machine has resumed may still go on where it was. Both come to the same bits, so nothing is lost
//! if the older one stops sending; it looks before every checkpoint.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::objects::Written;
use crate::record::FORMAT;

/// The object.
const OWNER: &str = "owner.json";
/// How often a session tries to take over from one that does so at the same moment.
const TRIES: usize = 5;

/// The content of `owner.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Owner {
    format: u32,
    /// The run, 32 hexadecimal digits.
    pub(crate) run: String,
    /// The session of it that may write.
    session: String,
    /// Its machine.
    host: String,
    since_unix_s: u64,
}

/// The right to write below a prefix.
#[derive(Debug, Clone)]
pub(crate) struct Lease {
    run: String,
    session: String,
}

impl Lease {
    /// Of a new session of `run`.
    pub(crate) fn new(run: &str) -> Self {
        Self { run: run.to_owned(), session: identifier() }
    }
}

/// 32 hexadecimal digits that nobody else has.
pub(crate) fn identifier() -> String {
    use std::hash::{BuildHasher as _, RandomState};
    // The standard library's own keys are random, from the system.
    let half = || RandomState::new().hash_one((std::process::id(), SystemTime::now()));
    format!("{:016x}{:016x}", half(), half())
}

impl Bucket {
    /// Who owns the prefix; nobody if nothing is there.
    pub(crate) async fn owner(&self) -> Result<Option<Owner>, BucketError> {
        let Some(small) = self.read(OWNER).await? else { return Ok(None) };
        serde_json::from_slice(&small.bytes).map(Some).map_err(|error| {
            BucketError::damaged(self.shown(OWNER), format!("not an owner: {error}"))
        })
    }

    /// Takes the prefix for a session, from nobody or from an older session of the same run.
    pub(crate) async fn claim(&self, lease: &Lease) -> Result<(), BucketError> {
        for _ in 0..TRIES {
            let before = self.read(OWNER).await?;
            if let Some(before) = &before {
                let owner: Owner = serde_json::from_slice(&before.bytes).map_err(|error| {
                    BucketError::damaged(self.shown(OWNER), format!("not an owner: {error}"))
                })?;
                if owner.run != lease.run {
                    let place = self.address().to_owned();
                    return Err(BucketError::Foreign { place, run: owner.run });
                }
            }
            let now = Owner {
                format: FORMAT,
                run: lease.run.clone(),
                session: lease.session.clone(),
                host: host(),
                since_unix_s: now(),
            };
            let text = serde_json::to_vec_pretty(&now).expect("an owner has a JSON form");
            if self.write_after(OWNER, before.as_ref(), text).await? == Written::Done {
                return Ok(());
            }
        }
        let reason = "others take it at the same time, again and again".to_owned();
        Err(BucketError::Away { place: self.shown(OWNER), reason })
    }

    /// Refuses a session that does not own the prefix any more.
    pub(crate) async fn check(&self, lease: &Lease) -> Result<(), BucketError> {
        let place = self.address().to_owned();
        match self.owner().await? {
            Some(owner) if owner.run != lease.run => {
                Err(BucketError::Foreign { place, run: owner.run })
            }
            Some(owner) if owner.session != lease.session => {
                Err(BucketError::TakenOver { place, host: owner.host })
            }
            Some(_) => Ok(()),
            // Somebody has emptied the bucket.
            None => self.claim(lease).await,
        }
    }
}

fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => "another machine".to_owned(),
        name => name.to_owned(),
    }
}

pub(crate) fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs())
}
