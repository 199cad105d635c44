//! A matrix with its rows in pairs, as products read it.

use crate::features::{Features, Loop, run_for};
use crate::number::Bf16;

/// Columns of a panel.
pub(crate) const PANEL: usize = 32;

/// A row of a panel: numbers of two rows of the matrix side by side, the first in the lower half.
pub(crate) type PairRow = [u32; PANEL];

/// A matrix `[R, C]` in panels of [`PANEL`] columns one after the other, each with its rows in pairs. An odd row is paired with zeros, and the last panel
/// is filled up with them.
#[derive(Debug, Default)]
pub(crate) struct Packed {
    rows: usize,
    columns: usize,
    pairs: Vec<PairRow>,
}

impl Packed {
    /// R.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// C.
    pub(crate) fn columns(&self) -> usize {
        self.columns
    }

    /// All panels, each of `R / 2` rows, rounded up.
    pub(crate) fn panels(&self) -> std::slice::ChunksExact<'_, PairRow> {
        self.pairs.chunks_exact(self.rows.div_ceil(2).max(1))
    }

    /// Takes over `matrix` `[rows, columns]`, row-major.
    pub(crate) fn pack(&mut self, matrix: &[Bf16], rows: usize, columns: usize) {
        assert_eq!(matrix.len(), rows * columns, "another matrix");
        self.resize(rows, columns);
        run_for(Features::detect(), Pack { matrix, rows, columns, pairs: &mut self.pairs });
    }

    /// Takes over the transpose of `matrix` `[columns, rows]`, row-major.
    pub(crate) fn pack_transposed(&mut self, matrix: &[Bf16], rows: usize, columns: usize) {
        assert_eq!(matrix.len(), rows * columns, "another matrix");
        self.resize(rows, columns);
        let each = rows.div_ceil(2);
        for (panel, columns) in matrix.chunks(PANEL * rows).enumerate() {
            let panel = &mut self.pairs[panel * each..][..each];
            for (column, numbers) in columns.chunks_exact(rows).enumerate() {
                let (pairs, rest) = numbers.as_chunks::<2>();
                for (row, &[first, second]) in panel.iter_mut().zip(pairs) {
                    row[column] = pair(first, second);
                }
                if let (Some(row), &[odd]) = (panel.last_mut(), rest) {
                    row[column] = pair(odd, Bf16(0));
                }
            }
        }
    }

    /// Makes room for `[rows, columns]`. What is left over of a panel stays zero as long as the sizes do.
    fn resize(&mut self, rows: usize, columns: usize) {
        if (self.rows, self.columns) != (rows, columns) {
            (self.rows, self.columns) = (rows, columns);
            self.pairs.clear();
            self.pairs.resize(rows.div_ceil(2) * columns.div_ceil(PANEL), [0; PANEL]);
        }
    }
}

#[inline(always)]
fn pair(first: Bf16, second: Bf16) -> u32 {
    u32::from(first.0) | u32::from(second.0) << 16
}

/// The arguments of [`Packed::pack`].
struct Pack<'a> {
    matrix: &'a [Bf16],
    rows: usize,
    columns: usize,
    pairs: &'a mut [PairRow],
}

impl Loop for Pack<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { matrix, rows, columns, pairs } = self;
        let each = rows.div_ceil(2);
        for (panel, pairs) in pairs.chunks_exact_mut(each.max(1)).enumerate() {
            let first = panel * PANEL;
            let width = PANEL.min(columns - first);
            for (row, out) in pairs.iter_mut().enumerate() {
                let part = |row: usize| &matrix[row * columns + first..][..width];
                let upper = part(2 * row);
                let lower = if 2 * row + 1 < rows { part(2 * row + 1) } else { &[] };
                if let ([upper], [lower]) = (upper.as_chunks().0, lower.as_chunks().0) {
                    *out = whole_row(upper, lower);
                } else {
                    let lower = lower.iter().copied().chain(std::iter::repeat(Bf16(0)));
                    for ((out, &upper), lower) in out.iter_mut().zip(upper).zip(lower) {
                        *out = pair(upper, lower);
                    }
                }
            }
        }
    }
}

/// By value: what is written through a reference might be what is read, for all that the compiler knows, and no vector instructions.
#[inline(always)]
fn whole_row(upper: &[Bf16; PANEL], lower: &[Bf16; PANEL]) -> PairRow {
    let mut row = [0; PANEL];
    for i in 0..PANEL {
        row[i] = pair(upper[i], lower[i]);
    }
    row
}
