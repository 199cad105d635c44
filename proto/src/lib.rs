//! What the processes of a SpaceOctopus run share, and nothing else: no simulator, no libtorch, no
//! asynchronous runtime.
//!
//! A run has one coordinator, one learner and several workers. They agree on
//!
//! * [`config`]: the typed configuration, its presets and how layers of it are merged;
//! * [`layout`]: sizes, and the place of every number in the arrays that cross a process border;
//! * [`message`]: the control messages and the course of an iteration;
//! * [`channel`]: the iceoryx2 services that carry both, with their sizes and deadlines;
//! * [`run_dir`]: the files of a run directory;
//! * [`rng`]: random numbers that are pure functions of their address;
//! * [`Digest`]: the fingerprint of a training state;
//! * [`child`] and [`logging`]: what learner and workers do first;
//! * [`clock`]: clocks, and percentiles of what they measured;
//! * [`ExitCode`]: how programs end.
//!
//! Read [`message`] next: it tells the story of an iteration.

pub mod channel;
pub mod child;
pub mod clock;
pub mod config;
mod digest;
mod error;
pub mod layout;
pub mod logging;
pub mod message;
pub mod rng;
pub mod run_dir;

pub use digest::{Digest, DigestBuilder};
pub use error::{ChannelError, ConfigError, ExitCode, ExitError, mib};
