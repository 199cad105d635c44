//! Checkpoints in a bucket: S3, Google, Azure, or a directory that others see, too.
//!
//! ```text
//! s3://bucket/prefix/
//!   owner.json                        which run this is, and which of its sessions may write
//!   checkpoints/
//!     iteration-00000050/
//!       state.safetensors.0123456789abcdef     each file, named by what is in it
//!       policy.safetensors.…, config.toml.…, robot.toml.…
//!       metrics.jsonl.gz.…, budgets.json.gz.…  what the run had recorded up to this checkpoint
//!       manifest.json                 written last, only if there is none: the checkpoint's own manifest, and
//!                                     length and BLAKE3 of what the run had recorded
//!       labels.json                   pins, tags, score; replaced only if it is still as it was read
//! ```
//!
//! A checkpoint exists if and only if it has its `manifest.json`. Objects that it names never change, so two writers
//! cannot mix their files: whichever manifest comes first stands, and all of its files are whole.
//!
//! Every checkpoint has all that a run needs to go on from it, so that a machine that has nothing but the bucket comes
//! to the same bits. The local store stays what it is; nothing here is on the way of a training:
//!
//! | module | concept |
//! |---|---|
//! | [`mirror`] | the thread that sends what a run commits, when it can |
//! | [`sent`] | what it has sent, in the run directory |
//! | [`replica`] | a local copy of what a bucket holds, for commands that read |
//! | [`restore`] | a run directory made from nothing but the bucket |
//! | `bucket`, `objects` | a bucket, and how one object is read and written |
//! | `owner` | who may write below a prefix |
//! | `ownership` | which checkpoints are the run's own |
//! | `commit`, `record`, `listing`, `labelling` | what is done with its checkpoints |

mod bucket;
mod commit;
mod error;
mod fetch;
mod labelling;
mod listing;
pub mod mirror;
mod objects;
mod owner;
mod ownership;
mod record;
mod recorded_files;
pub mod replica;
pub mod restore;
mod secrets;
pub mod sent;

pub use bucket::Bucket;
pub use error::BucketError;
pub use listing::{Listed, Listing};
