//! A group of actors: what it holds, reads, and comes to.
//!
//! Letters as in [`super`].

use std::sync::atomic::AtomicU64;

use proto::layout::{BlockLayout, Dimensions};
use tch::{Device, Kind, Tensor};

use super::options::Options;
use super::room::Room;
use crate::actors::Actors;
use crate::optimizer_step::NetworkPasses;
use crate::report::UpdateReport;

/// Actors that are computed together.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) actors: Actors,
    /// The rows of their critics: as many as actors, or fewer that have an output for each.
    pub(super) critics: Actors,
    pub(super) actor: NetworkPasses,
    pub(super) critic: NetworkPasses,
    /// `[A, U]`: one where an action moves a joint, zero elsewhere; nothing where all do.
    pub(super) own: Option<Tensor>,
    /// Room for what is computed in plain Rust; nothing where libtorch computes everything.
    pub(super) plain: Option<Room>,
    pub(super) chunk_samples: i64,
    pub(super) device: Device,
    pub(super) kind: Kind,
}

/// What all groups read.
pub(super) struct IterationInputs<'a> {
    pub(super) shards: &'a [&'a [f32]],
    pub(super) layout: &'a BlockLayout,
    pub(super) dimensions: &'a Dimensions,
    pub(super) options: &'a Options,
    /// Counts the shards and chunks begun.
    pub(super) work: &'a AtomicU64,
    pub(super) iteration: u64,
    /// One an actor.
    pub(super) actor_lr: Vec<f64>,
    pub(super) critic_lr: f64,
    pub(super) observation_norm: Option<(Vec<f32>, Vec<f32>)>,
    pub(super) state_norm: Option<(Vec<f32>, Vec<f32>)>,
}

/// What a group's update came to.
pub(super) struct GroupUpdate {
    pub(super) actor_steps: Vec<i64>,
    pub(super) critic_steps: Vec<i64>,
    /// Mean KL divergence over the last epoch's mini-batches, one an actor.
    pub(super) last_kl: Vec<f64>,
    pub(super) report: UpdateReport,
}
