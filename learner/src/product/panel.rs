//! Some columns of a matrix, as products read them.

/// Columns of a panel.
pub(crate) const PANEL: usize = 32;

/// A row of a panel: numbers of two rows of the matrix side by side, the first in the lower half. Two cache lines.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct PairRow(pub(super) [u32; PANEL]);

/// Panels have a multiple of so many rows of pairs, as many as a tile has.
pub(super) const TILE: usize = 16;
