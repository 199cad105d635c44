//! What a core could do at best: its rate of fused multiply-adds, and how many operations a control
//! step takes, counted by running the very code of the simulator on a number that counts.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use std::cell::Cell;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use proto::clock::thread_cpu;
use sim_worker::collision::count_contacts;
use sim_worker::dynamics::{StepOptions, Workspace, step};
use sim_worker::robot::{Model, Robot};
use sim_worker::scalar::{
    LaneFn, PairKernel, PairProducts, Real, WeightPair, dispatch, elementary,
};
use sim_worker::state::State;

use super::physics::{EPISODE, commands};

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

/// Floating-point operations of a control step under random commands. Counted are additions,
/// multiplications, divisions and square roots; comparisons, rounding and selecting are not.
pub(super) fn physics(robot: &Robot, options: &StepOptions) -> f64 {
    let model = Model::<Counted>::new(robot);
    let mut ws = Workspace::new(&model);
    let n = robot.n_joints();
    let commands = commands::<Counted>(n, 1);
    let mut state = State::<Counted>::home(robot);
    OPERATIONS.set(0);
    for command in commands.chunks_exact(n) {
        step(&model, &mut ws, &mut state, command, options);
        if options.contacts {
            count_contacts(&model, &mut ws, &state);
        }
    }
    OPERATIONS.get() as f64 / EPISODE as f64
}

thread_local! {
    static OPERATIONS: Cell<u64> = const { Cell::new(0) };
}

/// A single-precision number that counts operations.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Counted(f32);

fn counted(operations: u64, value: f32) -> Counted {
    OPERATIONS.set(OPERATIONS.get() + operations);
    Counted(value)
}

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for Counted {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                counted(1, self.0.$method(other.0))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl Neg for Counted {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}
impl AddAssign for Counted {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}
impl SubAssign for Counted {
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}
impl MulAssign for Counted {
    fn mul_assign(&mut self, other: Self) {
        *self = *self * other;
    }
}

impl Real for Counted {
    const LANES: usize = 1;
    type Mask = bool;
    type Pair = [Self; 2];

    fn pair(first: Self, second: Self) -> [Self; 2] {
        [first, second]
    }
    fn add_pair_product<P: PairProducts>(self, x: [Self; 2], w: WeightPair, _: P) -> Self {
        let [first, second] = w.widened().map(Self);
        x[0].mul_add(first, x[1].mul_add(second, self))
    }

    fn splat(x: f64) -> Self {
        Self(x as f32)
    }
    fn lane(self, _: usize) -> f64 {
        f64::from(self.0)
    }
    fn set_lane(&mut self, _: usize, x: f64) {
        self.0 = x as f32;
    }
    fn mul_add(self, a: Self, b: Self) -> Self {
        counted(2, f32::mul_add(self.0, a.0, b.0))
    }
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        counted(2, f32::mul_add(-self.0, a.0, b.0))
    }
    fn sqrt(self) -> Self {
        counted(1, self.0.sqrt())
    }
    fn abs(self) -> Self {
        Self(self.0.abs())
    }
    fn min(self, other: Self) -> Self {
        if self.0 < other.0 { self } else { other }
    }
    fn max(self, other: Self) -> Self {
        if self.0 > other.0 { self } else { other }
    }
    fn round(self) -> Self {
        Self(self.0.round_ties_even())
    }
    fn floor(self) -> Self {
        Self(self.0.floor())
    }
    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }
    fn le(self, other: Self) -> bool {
        self.0 <= other.0
    }
    fn select(m: bool, a: Self, b: Self) -> Self {
        if m { a } else { b }
    }
    fn copy_sign_to(self, magnitude: Self) -> Self {
        Self(magnitude.0.copysign(self.0))
    }
    fn pow2i(self) -> Self {
        Self(self.0.exp2())
    }
    fn frexp(self) -> (Self, Self) {
        let (mantissa, exponent) = self.lane(0).frexp();
        (Self(mantissa as f32), Self(exponent as f32))
    }
    fn sin_cos(self) -> (Self, Self) {
        elementary::sin_cos(self)
    }
    fn atan2(self, x: Self) -> Self {
        elementary::atan2(self, x)
    }
    fn exp(self) -> Self {
        elementary::exp(self)
    }
    fn ln(self) -> Self {
        elementary::ln(self)
    }
    fn log10(self) -> Self {
        elementary::log10(self)
    }
    fn tanh(self) -> Self {
        elementary::tanh(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_counted_as_the_source_has_them() {
        OPERATIONS.set(0);
        let (a, b) = (Counted(3.0), Counted(4.0));
        // Two products, one of them fused with the sum; a root; comparisons are free.
        let c = a.mul_add(a, b * b).sqrt();
        assert_eq!((c.max(a), OPERATIONS.get()), (Counted(5.0), 4));
    }

    #[test]
    fn contacts_cost_operations() {
        let robot = Robot::builtin("paper").expect("built in");
        let count = |contacts| physics(&robot, &StepOptions { contacts, ..StepOptions::default() });
        let (without, with) = (count(false), count(true));
        // 27 substeps of three evaluations on 26 bodies: some hundred operations a body each time.
        assert!((27.0 * 3.0 * 26.0 * 100.0..1e8).contains(&without), "{without}");
        assert!(with > without, "{with}");
    }
}
