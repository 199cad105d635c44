//! A matrix with its rows in pairs, as products read it.

use super::panel::{PANEL, PairRow, TILE};
use crate::features::{Features, Loop, run_for};
use crate::number::Bf16;

/// A matrix `[R, C]` in panels of [`PANEL`] columns one after the other, each with its rows in pairs. An odd row is paired with zeros, and panels and the last
/// of them are filled up with zeros.
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

    /// How many panels there are.
    #[cfg(any(test, target_arch = "x86_64"))]
    pub(super) fn panels(&self) -> usize {
        self.columns.div_ceil(PANEL)
    }

    /// A panel's `R / 2` rows, rounded up.
    #[cfg(any(test, target_arch = "x86_64"))]
    pub(super) fn panel(&self, index: usize) -> &[PairRow] {
        &self.filled_panel(index)[..self.rows.div_ceil(2)]
    }

    /// A panel with the rows of zeros that fill it up.
    #[cfg(any(test, target_arch = "x86_64"))]
    pub(super) fn filled_panel(&self, index: usize) -> &[PairRow] {
        let each = filled(self.rows);
        &self.pairs[index * each..][..each]
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
        let each = filled(rows);
        #[cfg(target_arch = "x86_64")]
        let features = Features::detect();
        for (panel, columns) in matrix.chunks(PANEL * rows).enumerate() {
            let panel = &mut self.pairs[panel * each..][..rows.div_ceil(2)];
            for (half, columns) in columns.chunks(TILE * rows).enumerate() {
                #[cfg(target_arch = "x86_64")]
                let done = super::transposition::pair_columns(features, columns, rows, panel, half);
                #[cfg(not(target_arch = "x86_64"))]
                let done = 0;
                let panel = &mut panel[done..];
                for (column, numbers) in columns.chunks_exact(rows).enumerate() {
                    let (column, numbers) = (half * TILE + column, &numbers[2 * done..]);
                    let (pairs, rest) = numbers.as_chunks::<2>();
                    for (row, &[first, second]) in panel.iter_mut().zip(pairs) {
                        row.0[column] = pair(first, second);
                    }
                    if let (Some(row), &[odd]) = (panel.last_mut(), rest) {
                        row.0[column] = pair(odd, Bf16(0));
                    }
                }
            }
        }
    }

    /// Makes room for `[rows, columns]`. What is left over of a panel stays zero as long as the sizes do.
    fn resize(&mut self, rows: usize, columns: usize) {
        if (self.rows, self.columns) != (rows, columns) {
            (self.rows, self.columns) = (rows, columns);
            self.pairs.clear();
            self.pairs.resize(filled(rows) * columns.div_ceil(PANEL), PairRow([0; PANEL]));
        }
    }
}

/// Rows of a panel of a matrix with so many rows.
fn filled(rows: usize) -> usize {
    rows.div_ceil(2).next_multiple_of(TILE)
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
        let (each, used) = (filled(rows), rows.div_ceil(2));
        for row in 0..used {
            let upper = &matrix[2 * row * columns..][..columns];
            let lower = if 2 * row + 1 < rows {
                &matrix[(2 * row + 1) * columns..][..columns]
            } else {
                &[]
            };
            let ((uppers, upper), (lowers, lower)) = (upper.as_chunks(), lower.as_chunks());
            for (panel, (upper, lower)) in uppers.iter().zip(lowers).enumerate() {
                pairs[panel * each + row].0 = whole_row(upper, lower);
            }
            for panel in lowers.len()..uppers.len() {
                pairs[panel * each + row].0 = whole_row(&uppers[panel], &[Bf16(0); PANEL]);
            }
            if !upper.is_empty() {
                let lower = lower.iter().copied().chain(std::iter::repeat(Bf16(0)));
                let PairRow(out) = &mut pairs[uppers.len() * each + row];
                for ((out, &upper), lower) in out.iter_mut().zip(upper).zip(lower) {
                    *out = pair(upper, lower);
                }
            }
        }
    }
}

/// By value: what is written through a reference might be what is read, for all that the compiler knows, and no vector instructions.
#[inline(always)]
fn whole_row(upper: &[Bf16; PANEL], lower: &[Bf16; PANEL]) -> [u32; PANEL] {
    let mut row = [0; PANEL];
    for i in 0..PANEL {
        row[i] = pair(upper[i], lower[i]);
    }
    row
}
