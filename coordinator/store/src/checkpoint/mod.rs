//! Checkpoints: committed snapshots of a training state, one directory each.
//!
//! ```text
//! checkpoints/
//!   iteration-00000050/
//!     state.safetensors    everything that training needs to go on; only a run's own has it
//!     policy.safetensors   the actors alone, one row an agent, as workers run them
//!     config.toml          the resolved configuration
//!     robot.toml           the robot's description
//!     manifest.json        written last: counters, digest, length and BLAKE3 of every file above
//!     labels.json          pins, tags, score: the only file that ever changes
//!   catalogue.sqlite       an index of all this, for users' own tools
//!   .lock                  held by whoever changes the store
//! ```
//!
//! A checkpoint exists if and only if its directory has its final name. It gets that name by one
//! rename, after every byte of it has reached the disk, so a kill or a power cut at any moment
//! leaves either the whole checkpoint or none. See [`CheckpointStore::commit`].
//!
//! | file | concept |
//! |---|---|
//! | `store` | committing, listing, loading |
//! | `manifest`, `labels`, `name`, `entry` | what is said about a checkpoint, and by whom |
//! | `disk`, `guard` | how a store is changed: step by step, by one at a time |
//! | `opening` | how files of a store are opened: no link is followed |
//! | `labelling`, `retention` | pins, tags, scores; what stays and what goes |
//! | `catalogue` | the index |
//! | `hash_cache` | which files were found whole |
//! | `archive` | a checkpoint as one file |
//! | `state_layout` | what a training state must hold |
//! | `commit` | a snapshot becomes a checkpoint, whole or not at all |
//! | `verify`, `compare` | the thorough check; two checkpoints side by side |
//! | `parts`, `compose` | arms of several checkpoints; one policy set from them |
//! | `selector` | how users name a checkpoint |

mod archive;
mod assembly;
mod catalogue;
mod commit;
mod compare;
mod compose;
mod disk;
mod entry;
mod error;
mod file_names;
pub mod fixtures;
mod guard;
mod hash_cache;
mod labelling;
mod labels;
mod lock_timeout;
mod manifest;
mod name;
mod opening;
mod ownership;
mod parts;
mod read;
mod reserved;
mod retention;
mod selector;
mod state_layout;
mod store;
mod tensors;
mod verify;

pub use archive::MAX_CONTENT;
pub use assembly::{Assembly, Snapshot};
pub use catalogue::CATALOGUE;
pub use commit::Placement;
pub use compare::{
    Difference, KeyDifference, TensorDifference, compare, compare_policies, flatten,
};
pub use compose::Composition;
pub use entry::{DamagedEntry, Entry, Kind, Survey};
pub use error::{CheckpointError, newest};
pub use file_names::{CONFIG, FORMAT, LABELS, MANIFEST, POLICY, ROBOT, STATE};
pub use guard::UPLOAD;
pub use hash_cache::Checked;
pub use labels::{Labels, MAX_TAGS, Score};
pub use lock_timeout::LockTimeout;
pub use manifest::{FileEntry, Manifest, Origin};
pub use name::{ITERATION, Name, NameError};
pub use ownership::Ownership;
pub use parts::{Part, Parts};
pub use read::{Checkpoint, read_policy};
pub use reserved::{BEST, LATEST};
pub use retention::Retention;
pub use selector::{Selector, store_at, store_to_be};
pub use state_layout::{STATE_FORMAT, StateLayout, StateTensor};
pub use store::CheckpointStore;
pub use tensors::shapes;
pub use verify::Verification;

#[cfg(test)]
mod tests;
