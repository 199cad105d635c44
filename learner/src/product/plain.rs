//! The product in plain Rust: the twin of the others, which reads what they read.

use super::operands::{Left, Out};
use super::packed::Packed;
use super::panel::PANEL;
use crate::number::{Bf16, Number};

/// The product of `left` `[rows, K]` with `right` `[K, N]`: an element is one chain of sums.
pub(super) fn multiply(left: Left<'_>, right: &Packed, mut out: Out<'_>, rows: usize) {
    let (inner, columns) = (right.rows(), right.columns());
    for row in 0..rows {
        for column in 0..columns {
            let mut sum = 0.0;
            for k in 0..inner {
                let x = match left {
                    Left::Rows(numbers) => numbers[row * inner + k],
                    Left::Transposed(packed) => number(packed, k, row),
                };
                sum += x.widen() * number(right, k, column).widen();
            }
            let (at, rounded) = (row * columns + column, Bf16::round(sum));
            match &mut out {
                Out::Rounded(out) => out[at] = rounded,
                Out::Widened(out) => out[at] = rounded.widen(),
                Out::Added(out) => out[at] += rounded.widen(),
                Out::Activations(units) => {
                    let x = rounded.widen() + units.bias[units.biases.of(row) + column];
                    units.out[at] = Bf16::round(units.unit.of(x));
                }
                Out::Gradients(units) => {
                    let (hidden, d) = (units.hidden[at].widen(), rounded.widen());
                    let d = units.unit.back_from_result(hidden, d);
                    units.bias_gradient[units.biases.of(row) + column] += d;
                    units.out[at] = Bf16::round(d);
                }
            }
        }
    }
}

fn number(packed: &Packed, row: usize, column: usize) -> Bf16 {
    let pair = packed.panel(column / PANEL)[row / 2].0[column % PANEL];
    Bf16((pair >> (row % 2 * 16)) as u16)
}
