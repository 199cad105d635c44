//! What a core could do at best: its rate of fused multiply-adds.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use process::clock::thread_cpu;
use simulator::scalar::{LaneFn, PairKernel, PairProducts, Real, WeightPair, dispatch};

/// Floating-point operations per second of one core, a fused multiply-add being two.
pub(super) fn peak(seconds: f64) -> f64 {
    dispatch(Peak(seconds))
}

/// As [`peak`], of products of bfloat16 pairs, each two multiplications and two additions.
pub(super) fn pair_peak(seconds: f64) -> f64 {
    dispatch(PairPeak(seconds))
}

/// How long to measure (s).
struct Peak(f64);

/// How long to measure (s).
struct PairPeak(f64);

/// Operations of a chain between two looks at the clock.
const ROW: usize = 20_000;

impl LaneFn for Peak {
    type Output = f64;

    #[inline(always)]
    fn call<S: Real>(self) -> f64 {
        // As many chains as hide the latency; more than there are registers would spill.
        chains::<S, 5>(self.0).max(chains::<S, 8>(self.0)).max(chains::<S, 10>(self.0))
    }
}

#[inline(always)]
fn chains<S: Real, const N: usize>(time: f64) -> f64 {
    let (a, b) = (std::hint::black_box(S::splat(0.5)), std::hint::black_box(S::splat(0.25)));
    2.0 * rate::<S, _, _, _, N>(time, FusedMultiplyAdd, a, b)
}

impl LaneFn for PairPeak {
    type Output = f64;

    #[inline(always)]
    fn call<S: Real>(self) -> f64 {
        S::compiled_for_pairs(self)
    }
}

impl<S: Real> PairKernel<S> for PairPeak {
    type Output = f64;

    #[inline(always)]
    fn run<P: PairProducts>(self, products: P) -> f64 {
        let x = std::hint::black_box(S::pair(S::splat(0.5), S::splat(0.25)));
        let w = std::hint::black_box(WeightPair::new(0.5, -0.25));
        4.0 * rate::<S, _, _, _, 10>(self.0, PairProduct(products), x, w)
    }
}

/// One operation on a chain's number.
trait Operation<S, A, B>: Copy {
    fn apply(self, x: S, a: A, b: B) -> S;
}

#[derive(Clone, Copy)]
struct FusedMultiplyAdd;

impl<S: Real> Operation<S, S, S> for FusedMultiplyAdd {
    #[inline(always)]
    fn apply(self, x: S, a: S, b: S) -> S {
        x.mul_add(a, b)
    }
}

#[derive(Clone, Copy)]
struct PairProduct<P>(P);

impl<S: Real, P: PairProducts> Operation<S, S::Pair, WeightPair> for PairProduct<P> {
    #[inline(always)]
    fn apply(self, x: S, a: S::Pair, b: WeightPair) -> S {
        x.add_pair_product(a, b, self.0)
    }
}

/// Operations per second on all lanes of `N` chains.
#[inline(always)]
fn rate<S: Real, O: Operation<S, A, B>, A: Copy, B: Copy, const N: usize>(
    time: f64,
    operation: O,
    a: A,
    b: B,
) -> f64 {
    let mut x = [S::one(); N];
    let mut rows = 0_u32;
    let start = thread_cpu();
    let elapsed = loop {
        let mut i = 0;
        while i < ROW {
            let mut chain = 0;
            while chain < N {
                x[chain] = operation.apply(x[chain], a, b);
                chain += 1;
            }
            i += 1;
        }
        rows += 1;
        let elapsed = thread_cpu() - start;
        if elapsed >= time / 3.0 {
            break elapsed;
        }
    };
    std::hint::black_box(x);
    f64::from(rows) * (ROW * N * S::LANES) as f64 / elapsed
}
