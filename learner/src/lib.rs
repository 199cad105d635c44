//! The learner process: multi-agent PPO in libtorch over shared memory.
pub mod adam;
mod error;
pub mod gae;
pub mod input_norm;
pub mod loss;
pub mod mappo;
mod memory;
pub mod mlp;
pub mod network;
pub mod precision;
pub mod state;
pub mod synthetic;
pub mod value_norm;

pub use error::LearnerError;
