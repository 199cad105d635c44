//! Memory in which gradients are computed on a CPU. Letters as in [`super`].

use tch::Tensor;

use crate::loss::{ActorRoom, CriticRoom};

/// Room for what is computed of a chunk.
#[derive(Debug, Default)]
pub(super) struct Room {
    /// What actors see, and what critics do, gathered.
    pub(super) seen: [Option<Tensor>; 2],
    /// `[A, U + 2, B]` or `[A, 2, B]`: what losses need of the samples.
    pub(super) columns: Vec<f32>,
    pub(super) actor: ActorRoom,
    pub(super) critic: CriticRoom,
}
