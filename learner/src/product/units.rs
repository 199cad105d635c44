//! Hidden units at the end of a product: what is summed goes through them at once, forward or back, and the product itself never lies in memory.
//!
//! Rows are sample by sample, of each the actors of a network.

use crate::number::Bf16;
use crate::unit::Unit;

/// Where the biases of a product's rows stand in an array `[A, H]` or `[N, H]`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Biases {
    /// Of the first row.
    pub(crate) first: usize,
    /// From an actor's to the next one's.
    pub(crate) step: usize,
    /// Rows after which they begin anew.
    pub(crate) actors: usize,
}

impl Biases {
    /// # Panics
    /// If they are not among so many numbers.
    pub(super) fn check(self, numbers: usize, columns: usize) {
        assert!(self.actors > 0, "rows of nobody");
        let end = self.first + (self.actors - 1) * self.step + columns;
        assert!(end <= numbers, "the layer has fewer biases");
    }

    /// Where those of a row begin.
    #[cfg(test)]
    pub(super) fn of(self, row: usize) -> usize {
        self.first + row % self.actors * self.step
    }
}

/// Activations `[R, H]` of a hidden layer: unit(product + bias), of the rounded product, rounded.
#[derive(Debug)]
pub(crate) struct Activations<'a> {
    #[cfg_attr(
        not(any(test, target_arch = "x86_64")),
        expect(dead_code, reason = "no products of our own")
    )]
    pub(crate) unit: Unit,
    pub(crate) bias: &'a [f32],
    pub(crate) biases: Biases,
    pub(crate) out: &'a mut [Bf16],
}

/// The gradient `[R, H]` by a layer's products, from that by its activations: the rounded product.
#[derive(Debug)]
pub(crate) struct Gradients<'a> {
    #[cfg_attr(
        not(any(test, target_arch = "x86_64")),
        expect(dead_code, reason = "no products of our own")
    )]
    pub(crate) unit: Unit,
    /// Activations.
    pub(crate) hidden: &'a [Bf16],
    /// Gains the gradient by the biases.
    pub(crate) bias_gradient: &'a mut [f32],
    pub(crate) biases: Biases,
    /// Rounded.
    pub(crate) out: &'a mut [Bf16],
}
