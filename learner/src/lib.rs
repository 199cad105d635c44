//! The learner: multi-agent PPO and its relatives in libtorch over shared memory.
//!
//! One process trains the policies of all agents. Workers put blocks of samples into shared memory;
//! [`learner`] receives them, has [`mappo`] or [`maddpg`] make an update of each complete iteration, publishes the
//! next policy and reports to the coordinator. It knows no storage: a snapshot of its
//! [`state`] goes to the coordinator, who keeps it.
//!
//! How it is built:
//!
//! * The agents' networks are stacked ([`network`]) and go through each operation together.
//! * Forward and backward passes ([`mlp`]), losses ([`loss`]) and Adam ([`adam`]) are written by
//!   hand, into buffers that live across updates; nothing is recorded for differentiation. Tests
//!   compare them with libtorch's own differentiation and with an implementation in JAX and Optax.
//! * Blocks are viewed where workers wrote them ([`inbox`]); the first operation on them is already a
//!   computation.
//! * What `octopus bench` measures of the learner is measured here ([`mod@bench`]).
//! * Nothing depends on arrival order, on the clock, or on a generator with a state. The same
//!   samples give the same bits, and a restored state goes on as if it had never stopped.
//!
//! ```
//! use learner::{Update as _, mappo::Mappo, precision::Arithmetic, state::TrainingState, synthetic};
//! use proto::{agents::Joints, config::{Layers, Preset}, layout::Dimensions};
//!
//! let config = Layers::new(Preset::Tuned, None)
//!     .set("env.n_envs=8")?
//!     .set("network.hidden=[16]")?
//!     .resolve()?;
//! let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
//! let mut state =
//!     TrainingState::initial(&config, &dimensions, Arithmetic::F32, tch::Device::Cpu);
//! let mut mappo = Mappo::new(&config, &dimensions, &state);
//! let blocks = synthetic::blocks(&dimensions, 1);
//! let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
//! let report = mappo.update(&mut state, &shards)?;
//! assert_eq!((state.iteration, report.kl.len()), (1, 8));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Read [`mappo`] next.

#![expect(
    clippy::inline_always,
    reason = "only what is inlined into a function is compiled for its processor features, see `features`"
)]

mod actors;
pub mod adam;
mod algorithm;
pub mod bench;
mod error;
mod features;
pub mod gae;
mod gradient_norm;
pub mod inbox;
pub mod input_norm;
mod lanes;
mod layer_norm;
pub mod learner;
mod limits;
pub mod loss;
pub mod maddpg;
pub mod mappo;
mod memory;
pub mod mlp;
pub mod network;
mod number;
mod optimizer_step;
pub mod panics;
pub mod precision;
mod product;
pub mod report;
pub mod state;
pub mod synthetic;
mod threads;
mod unit;
mod update;
pub mod value_norm;

pub use algorithm::Algorithm;
pub use error::LearnerError;
pub use update::Update;

/// Held by tests that compare bits: an update sets the number of libtorch's threads, which belongs to the whole
/// process, and sums of one network depend on it.
#[cfg(test)]
fn alone() -> std::sync::MutexGuard<'static, ()> {
    static ALONE: std::sync::Mutex<()> = std::sync::Mutex::new(());
    ALONE.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// The first GPU, where there is one and libtorch was built for it: tests run on it, too.
#[cfg(test)]
fn gpu() -> Option<tch::Device> {
    learner::device("cuda:0").ok()
}
