//! Squared norms of rows.

use tch::{Device, Kind, Tensor};

use crate::features::{Features, Loop, run_for};
use crate::memory::numbers;

/// Interleaved chains of a sum.
const CHAINS: usize = 16;

/// Σ x² of each row of `[A, P]`: `[A]` in f32, summed in f64. Adam squares in f32, so what overflows there is infinite here, too. On a CPU each row is read
/// once and nothing is written.
pub(crate) fn squared_norms(rows: &Tensor) -> Tensor {
    if rows.device() != Device::Cpu {
        return by_operations(rows);
    }
    let features = Features::detect();
    let norms: Vec<f32> = (0..rows.size()[0])
        .map(|row| in_one_pass(features, &rows.get(row).contiguous()) as f32)
        .collect();
    Tensor::from_slice(&norms)
}

/// The same in libtorch's operations.
fn by_operations(rows: &Tensor) -> Tensor {
    rows.square().sum_dim_intlist(&[1i64][..], false, Kind::Double).to_kind(Kind::Float)
}

#[expect(unsafe_code, reason = "only here is it known that nobody writes meanwhile")]
fn in_one_pass(features: Features, row: &Tensor) -> f64 {
    let mut sum = 0.0;
    // SAFETY: gradients are filled before their norm is asked for, and who asks has them to itself.
    run_for(features, Squares { row: unsafe { numbers(row) }, sum: &mut sum });
    sum
}

/// The arguments of [`in_one_pass`].
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
        let all = Tensor::randn([3, 1003], (Kind::Float, Device::Cpu));
        // Rows with gaps between them, too.
        for rows in [all.shallow_clone(), all.narrow(1, 7, 900), all.narrow(1, 0, 5)] {
            let ours = squared_norms(&rows);
            let theirs = by_operations(&rows);
            let error = ((ours - &theirs) / theirs).abs().max().double_value(&[]);
            // Theirs are sums of squares that were rounded to f32; both are rounded at the end.
            assert!(error < 3.0 * 2f64.powi(-24), "{error}");
        }
    }

    #[test]
    fn what_is_not_finite_has_no_finite_norm() {
        // The square of the last one is infinite in f32.
        for x in [f32::NAN, f32::INFINITY, 1e30] {
            let row = Tensor::from_slice(&[1.0, x, 2.0]).view([1, 3]);
            assert!(!squared_norms(&row).double_value(&[0]).is_finite());
        }
    }
}
