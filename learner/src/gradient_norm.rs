//! Squared norms of rows.

use std::ops::Range;

use tch::{Device, Kind, Tensor};

use crate::features::{Features, Loop, run_for};
use crate::memory::numbers;

/// Interleaved chains of a sum.
const CHAINS: usize = 16;

/// For each of `columns` the squared norm of these columns of the row of that number of `[A, P]`, summed in f64. Adam squares in f32, so what overflows
/// there is infinite here, too. On a CPU each row is read once and nothing is written.
#[expect(unsafe_code, reason = "only here is it known that nobody writes meanwhile")]
pub(crate) fn squared_norms(rows: &Tensor, columns: &[Range<i64>]) -> Vec<f32> {
    if rows.device() != Device::Cpu {
        return by_operations(rows, columns);
    }
    let len = rows.size()[1] as usize;
    // SAFETY: gradients are made of zeros, and filled where they are learned before their norm is asked for; who asks has them to itself.
    let rows: &[f32] = unsafe { numbers(rows) };
    let features = Features::detect();
    let norm = |(row, columns): (&[f32], &Range<i64>)| {
        let mut sum = 0.0;
        let row = &row[columns.start as usize..columns.end as usize];
        run_for(features, Squares { row, sum: &mut sum });
        sum as f32
    };
    rows.chunks_exact(len).zip(columns).map(norm).collect()
}

/// The same in libtorch's operations, as few as there are.
fn by_operations(rows: &Tensor, columns: &[Range<i64>]) -> Vec<f32> {
    let mut first = 0;
    let norms = columns.chunk_by(|one, next| one == next).map(|alike| {
        let (count, columns) = (alike.len() as i64, &alike[0]);
        let part = rows.narrow(0, first, count);
        let part = part.narrow(1, columns.start, columns.end - columns.start);
        first += count;
        part.square().sum_dim_intlist(&[1i64][..], false, Kind::Double)
    });
    let norms: Vec<Tensor> = norms.collect();
    Vec::try_from(Tensor::cat(&norms, 0).to_kind(Kind::Float)).expect("a number a row")
}

/// The arguments of a row of [`squared_norms`].
struct Squares<'a> {
    row: &'a [f32],
    sum: &'a mut f64,
}

impl Loop for Squares<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let mut sums = [0.0f64; CHAINS];
        let (chunks, rest) = self.row.as_chunks::<CHAINS>();
        for chunk in chunks {
            for i in 0..CHAINS {
                let x = f64::from(chunk[i]);
                // A product of two f32 is exact in f64, so whether it is fused with the sum does not matter.
                sums[i] += x * x;
            }
        }
        for (i, &x) in rest.iter().enumerate() {
            sums[i] += f64::from(x) * f64::from(x);
        }
        *self.sum = sums.iter().sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pass_is_the_operations() {
        tch::manual_seed(5);
        let rows = Tensor::randn([3, 1003], (Kind::Float, Device::Cpu));
        let columns = [0..1003, 7..907, 0..5];
        let (ours, theirs) = (squared_norms(&rows, &columns), by_operations(&rows, &columns));
        assert_eq!(ours.len(), 3);
        for (ours, theirs) in ours.into_iter().zip(theirs) {
            // Theirs are sums of squares that were rounded to f32; both are rounded at the end.
            let error = (ours / theirs - 1.0).abs();
            assert!(error < 3.0 * f32::EPSILON / 2.0, "{error}");
        }
    }

    #[test]
    fn what_is_not_finite_has_no_finite_norm() {
        // The square of the last one is infinite in f32.
        for x in [f32::NAN, f32::INFINITY, 1e30] {
            let rows = Tensor::from_slice(&[1.0, x, 2.0, 1.0, 1.0, 1.0]).view([2, 3]);
            let norms = squared_norms(&rows, &[0..3, 0..3]);
            assert!(!norms[0].is_finite() && norms[1] == 3.0, "{norms:?}");
        }
    }
}
