//! temporary
pub mod config;
pub mod digest;
pub mod layout;
mod error;
pub mod rng;
pub use digest::{Digest, DigestBuilder};
pub use error::{ChannelError, ConfigError, ExitCode, ExitError};
