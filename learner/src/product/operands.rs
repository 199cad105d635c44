//! What products read and write.

use super::packed::Packed;
use super::units::{Activations, Gradients};
use crate::number::Bf16;

/// The left factor `[M, K]`.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Left<'a> {
    /// Row-major, as it lies in memory.
    Rows(&'a [Bf16]),
    /// By its transpose `[K, M]`.
    Transposed(&'a Packed),
}

/// Where the product `[M, N]` goes, row-major.
#[derive(Debug)]
pub(crate) enum Out<'a> {
    /// Rounded.
    Rounded(&'a mut [Bf16]),
    /// Rounded and widened, in the place of what is there.
    Widened(&'a mut [f32]),
    /// Rounded and widened, added to what is there.
    Added(&'a mut [f32]),
    /// Through a layer's units.
    Activations(Activations<'a>),
    /// Back through a layer's units.
    Gradients(Gradients<'a>),
}

impl Out<'_> {
    /// M · N.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Rounded(out) => out.len(),
            Self::Widened(out) | Self::Added(out) => out.len(),
            Self::Activations(units) => units.out.len(),
            Self::Gradients(units) => units.out.len(),
        }
    }

    /// # Panics
    /// If what units need does not fit a product of so many columns.
    pub(super) fn check(&self, columns: usize) {
        match self {
            Self::Rounded(_) | Self::Widened(_) | Self::Added(_) => {}
            Self::Activations(Activations { bias, biases, .. }) => {
                biases.check(bias.len(), columns);
            }
            Self::Gradients(Gradients { hidden, bias_gradient, biases, out, .. }) => {
                assert_eq!(hidden.len(), out.len(), "the activations have another size");
                biases.check(bias_gradient.len(), columns);
            }
        }
    }
}
