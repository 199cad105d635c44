//! The training state: everything that an interrupted run needs to go on as if nothing had happened.
//!
//! It is a set of named arrays, written as one [safetensors](https://github.com/huggingface/safetensors)
//! file that Python reads without our code:
//!
//! | name | type, shape |
//! |---|---|
//! | `actor.<parameter>`, `critic.<parameter>` | f32 `[P, …]`, the names of [`NetworkSpec`](crate::network::NetworkSpec) |
//! | `actor.adam.m.<parameter>`, `….v.<parameter>`, likewise `critic` | f32 `[P, …]` |
//! | `actor.adam.steps`, `critic.adam.steps` | i64 `[P]` |
//! | `actor.rate` | f64 `[P]`: share of the scheduled learning rate; only with `optimizer.target_kl` |
//! | `value_norm.mean`, `.mean_square`, `.debias` | f64 `[P]` |
//! | `observation_norm.mean`, `.m2`, `.count` | f64 `[A, O]`, `[A, O]`, `[1]`; running normalisation only |
//! | `state_norm.mean`, `.m2`, `.count` | f64 `[1, S]`, `[1, S]`, `[1]`; likewise, unless critics see observations |
//! | `target_actor.<parameter>`, `target_critic.<parameter>` | f32 `[P, …]`; MADDPG only, like the next |
//! | `replay.observation`, `.state`, `.action`, `.reward`, `.future` | f32, see [`Replay`](replay::Replay) |
//! | `replay.episodes` | u64 `[1]`: episodes that were ever put in |
//! | `previous_policy` | f32, flat: the policy published before, which overlapping workers still use |
//! | `counters.iteration`, `counters.env_steps` | u64 `[1]`; the iteration is also the policy version |
//! | `counters.precision` | u64 `[1]`: bits of the products' operands, 16 or 32 |
//!
//! `P` are the actors: one for each of the `A` agents, or one for all.
//!
//! For readers who want the policies alone, the file repeats them as `policy.<name>`, exactly as
//! workers got them (`proto::layout::ActorLayout`); a restore does not need these.
//!
//! The [`Digest`](proto::Digest) is that of all other names in alphabetical order, each with its array's little-endian
//! bytes, so anyone can recompute it from the file.

mod arrays;
mod file;
pub mod image;
mod network_state;
mod off_policy;
pub mod replay;
mod training_state;

pub use file::FORMAT;
pub use network_state::NetworkState;
pub use off_policy::OffPolicy;
pub use training_state::TrainingState;

#[cfg(test)]
mod tests;
