//! What the processes of a SpaceOctopus run agree on: values and their layouts. Pure: no process, thread,
//! clock, file or channel, and so the same in a browser as in a worker.
//!
//! A run has one coordinator, one learner and several workers. They agree on
//!
//! * [`config`]: the typed configuration, its presets and how layers of it are merged;
//! * [`tasks`]: what arms are for, a file a task;
//! * [`layout`]: sizes, and the place of every number in the arrays that cross a process border;
//! * [`message`]: the control messages and the course of an iteration;
//! * [`gateway`]: what gateways say to each other and to who started them; [`certificates`]: by what they are known;
//! * [`run_dir`]: the files of a run directory; [`bucket_address`]: where its checkpoints go, too;
//! * [`rng`]: random numbers that are pure functions of their address;
//! * [`Digest`]: the fingerprint of a training state;
//! * [`statistics`]: percentiles, means and intervals;
//! * [`ExitCode`]: how programs end.
//!
//! The crate `channels` carries these things between processes, the crate `process` holds what each process
//! does first. Read [`message`] next: it tells the story of an iteration.

pub mod agents;
pub mod bucket_address;
pub mod certificates;
pub mod config;
mod digest;
mod error;
pub mod finite;
pub mod gateway;
pub mod layout;
pub mod message;
pub mod rng;
pub mod run_dir;
pub mod statistics;
pub mod tasks;

pub use digest::{Digest, DigestBuilder};
pub use error::{ConfigError, ExitCode, ExitError, mib};
