//! ReLU or ELU of hidden layers, LayerNorm if there is one, and the head, in one pass over each row, forward and backward, on a CPU.
//!
//! What stands between two matrix products would be a dozen of libtorch's operations, each a pass over activations that
//! do not fit into the first caches. Here a row's features are read once and written once, in f32 in between. `torch.rs` holds the
//! same passes in libtorch's operations, for other activations and devices and as the twin that tests this one.
//!
//! The arithmetic is plain Rust ([`crate::features`]). Sums run in sixteen interleaved chains and an order that only the shapes fix.
//!
//! Letters as in [`super`]: `N` networks, `K` actors of each, `A = K·N`, `B` samples, `R = B·K` rows, `H` features, `U` outputs of the head. All
//! arrays are row-major.

#[cfg(target_arch = "x86_64")]
use super::rounding::Natively;
use super::rounding::{Plain, Rounding};
use crate::features::{Features, Loop, mul_add, run_for};
use crate::layer_norm::LAYER_NORM_EPSILON;
use crate::number::{BLOCK, Number};
use crate::unit::{Elu, Nonlinearity, Relu, Unit};

/// Interleaved chains of a sum.
const CHAINS: usize = BLOCK;

/// What a hidden layer makes of its product, `[N, R, H]` each, and reciprocal deviations `[N, R]`.
#[derive(Debug)]
pub(crate) struct Forward<'a, T> {
    /// Products without bias; nothing if `hidden` holds the activations already.
    pub(crate) product: Option<&'a [T]>,
    /// `[A, H]`, or `[N, H]` if actors have none of their own.
    pub(crate) bias: &'a [f32],
    /// Activations, standardised if there is a LayerNorm.
    pub(crate) hidden: &'a mut [T],
    /// Reciprocal deviations, with LayerNorm.
    pub(crate) inverse_std: Option<&'a mut [f32]>,
    /// The head, after the last layer.
    pub(crate) head: Option<HeadForward<'a>>,
}

/// The head's outputs.
#[derive(Debug)]
pub(crate) struct HeadForward<'a> {
    /// `[N, U, H]`.
    pub(crate) weight: &'a [f32],
    /// `[N, U]`.
    pub(crate) bias: &'a [f32],
    /// `[A, U, B]`.
    pub(crate) output: &'a mut [f32],
}

/// The way back through a hidden layer.
#[derive(Debug)]
pub(crate) struct Backward<'a, T> {
    /// Products of the way forward, `[N, R, H]`. Only a LayerNorm needs them: without one the way back goes by what became of them, as rounded as that is.
    pub(crate) product: &'a [T],
    /// `[A, H]` or `[N, H]`.
    pub(crate) bias: &'a [f32],
    /// What the way forward made of them, `[N, R, H]`.
    pub(crate) hidden: &'a [T],
    /// Reciprocal deviations, `[N, R]`, with LayerNorm.
    pub(crate) inverse_std: Option<&'a [f32]>,
    /// In: gradient by `hidden`, unless `head` gives it; out: gradient by the products. `[N, R, H]`.
    pub(crate) gradient: &'a mut [T],
    /// Gains the gradient by the bias, `[A, H]` or `[N, H]`.
    pub(crate) bias_gradient: &'a mut [f32],
    /// The head, of the last layer.
    pub(crate) head: Option<HeadBackward<'a>>,
}

/// The way back through the head.
#[derive(Debug)]
pub(crate) struct HeadBackward<'a> {
    /// `[N, U, H]`.
    pub(crate) weight: &'a [f32],
    /// Gradient by the outputs, `[A, U, B]`.
    pub(crate) output_gradient: &'a [f32],
    /// Gains the gradient by the weights, `[N, U, H]`.
    pub(crate) weight_gradient: &'a mut [f32],
    /// Gains the gradient by the bias, `[N, U]`.
    pub(crate) bias_gradient: &'a mut [f32],
}

/// Sizes of the arrays.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) networks: usize,
    pub(crate) samples: usize,
    /// Of a network.
    pub(crate) actors: usize,
    /// Whether every actor has a bias of its own.
    pub(crate) own_bias: bool,
    pub(crate) features: usize,
    pub(crate) outputs: usize,
}

/// Where a row's numbers are.
struct Row {
    network: usize,
    /// Among the biases.
    bias: usize,
    /// Of its actor's first output.
    output: usize,
}

impl Sizes {
    fn rows(self) -> usize {
        self.networks * self.samples * self.actors
    }

    /// The `index`-th row of all in memory. No closure is called for each row, as it would be compiled without the features of its caller.
    #[inline(always)]
    fn row(self, index: usize) -> Row {
        let (before, k) = (index / self.actors, index % self.actors);
        let (network, sample) = (before / self.samples, before % self.samples);
        let actor = k * self.networks + network;
        let bias = if self.own_bias { actor } else { network };
        Row { network, bias, output: actor * self.outputs * self.samples + sample }
    }
}

/// Scratch memory of the passes: one row's features, twice.
#[derive(Debug)]
pub(crate) struct RowPasses {
    features: Features,
    unit: Unit,
    rows: [Vec<f32>; 2],
}

impl RowPasses {
    /// Scratch memory, and the features of this processor.
    pub(crate) fn new(unit: Unit) -> Self {
        Self { features: Features::detect(), unit, rows: [Vec::new(), Vec::new()] }
    }

    /// What hidden units make of their inputs.
    pub(crate) fn unit(&self) -> Unit {
        self.unit
    }

    /// ĥ = standardise(unit(product + bias)), or without standardising, and the head's outputs if there is a head.
    pub(crate) fn forward<T: Number>(&mut self, sizes: Sizes, arrays: Forward<'_, T>) {
        let rows = self.rows.each_mut().map(|row| {
            row.resize(sizes.features, 0.0);
            row.as_mut_slice()
        });
        match self.unit {
            Unit::Relu => {
                run_for(self.features, RowKernel { sizes, arrays, rows, unit: Relu::new(()) });
            }
            Unit::Elu => {
                run_for(self.features, RowKernel { sizes, arrays, rows, unit: Elu::new(()) });
            }
        }
    }

    /// The gradient by the products from that by ĥ (or by the head's outputs); adds the gradients by bias and head.
    pub(crate) fn backward<T: Number>(&mut self, sizes: Sizes, arrays: Backward<'_, T>) {
        let rows = self.rows.each_mut().map(|row| {
            row.resize(sizes.features, 0.0);
            row.as_mut_slice()
        });
        match self.unit {
            Unit::Relu => {
                run_for(self.features, RowKernel { sizes, arrays, rows, unit: Relu::new(()) });
            }
            Unit::Elu => {
                run_for(self.features, RowKernel { sizes, arrays, rows, unit: Elu::new(()) });
            }
        }
    }
}

/// The arguments of a pass.
struct RowKernel<'r, A, N> {
    sizes: Sizes,
    arrays: A,
    rows: [&'r mut [f32]; 2],
    unit: N,
}

/// A pass, with a way to round what it puts.
trait Pass {
    fn run<R: Rounding, const FMA: bool>(self, rounding: R);
}

impl<T: Number, N: Nonlinearity<f32>> Pass for RowKernel<'_, Forward<'_, T>, N> {
    #[inline(always)]
    fn run<R: Rounding, const FMA: bool>(self, rounding: R) {
        forward_rows::<T, N, R, FMA>(self.sizes, self.arrays, self.rows, self.unit, rounding);
    }
}

impl<T: Number, N: Nonlinearity<f32>> Pass for RowKernel<'_, Backward<'_, T>, N> {
    #[inline(always)]
    fn run<R: Rounding, const FMA: bool>(self, rounding: R) {
        backward_rows::<T, N, R, FMA>(self.sizes, self.arrays, self.rows, self.unit, rounding);
    }
}

impl<A, N> Loop for RowKernel<'_, A, N>
where
    Self: Pass,
{
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        Pass::run::<_, FMA>(self, Plain);
    }
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code, reason = "the processor's own rounding")]
    #[inline(always)]
    unsafe fn run_with_bf16(self) {
        // SAFETY: the caller's promise.
        Pass::run::<_, true>(self, unsafe { Natively::new() });
    }
}

/// The sum of chains, halved until one is left.
#[inline(always)]
fn total(mut chains: [f32; CHAINS]) -> f32 {
    let mut n = CHAINS;
    while n > 1 {
        n /= 2;
        for i in 0..n {
            chains[i] += chains[i + n];
        }
    }
    chains[0]
}

/// Σ f over a row, in interleaved chains.
macro_rules! sum {
    ($($x:ident in $row:expr),+ => $term:expr) => {{
        let mut sums = [0.0; CHAINS];
        sum!(@loop sums, $($x in $row),+ => $term);
        total(sums)
    }};
    (@loop $sums:ident, $x:ident in $row:expr => $term:expr) => {
        let (chunks, rest) = $row.as_chunks::<CHAINS>();
        for $x in chunks {
            for i in 0..CHAINS {
                let $x = $x[i];
                $sums[i] = $term($sums[i]);
            }
        }
        for (i, &$x) in rest.iter().enumerate() {
            $sums[i] = $term($sums[i]);
        }
    };
    (@loop $sums:ident, $x:ident in $row:expr, $y:ident in $other:expr => $term:expr) => {
        let ((chunks, rest), (others, other_rest)) =
            ($row.as_chunks::<CHAINS>(), $other.as_chunks::<CHAINS>());
        for ($x, $y) in chunks.iter().zip(others) {
            for i in 0..CHAINS {
                let ($x, $y) = ($x[i], $y[i]);
                $sums[i] = $term($sums[i]);
            }
        }
        for (i, (&$x, &$y)) in rest.iter().zip(other_rest).enumerate() {
            $sums[i] = $term($sums[i]);
        }
    };
}

#[inline(always)]
fn forward_rows<T: Number, N: Nonlinearity<f32>, R: Rounding, const FMA: bool>(
    sizes: Sizes,
    arrays: Forward<'_, T>,
    rows: [&mut [f32]; 2],
    unit: N,
    rounding: R,
) {
    let Sizes { samples, features: h, outputs, .. } = sizes;
    let Forward { product, bias, hidden, mut inverse_std, mut head } = arrays;
    let hidden = &mut hidden[..sizes.rows() * h];
    let [row, _] = rows;
    let row = &mut row[..h];
    let per_feature = 1.0 / h as f32;
    let blocks = h / CHAINS * CHAINS;
    for index in 0..sizes.rows() {
        let at = sizes.row(index);
        let bias = &bias[at.bias * h..][..h];
        let hidden = &mut hidden[index * h..][..h];
        let product = product.map(|product| &product[index * h..][..h]);
        if let (Some(product), Some(inverse_std)) = (product, &mut inverse_std) {
            for i in 0..h {
                row[i] = unit.of::<FMA>(product[i].widen() + bias[i]);
            }
            let mean = sum!(x in row => |sum| sum + x) * per_feature;
            for x in &mut *row {
                *x -= mean;
            }
            let variance = sum!(x in row => |sum| mul_add::<FMA>(x, x, sum)) * per_feature;
            let inverse = 1.0 / (variance + LAYER_NORM_EPSILON as f32).sqrt();
            inverse_std[index] = inverse;
            for start in (0..blocks).step_by(CHAINS) {
                let mut x = block(row, start);
                for x in &mut x {
                    *x *= inverse;
                }
                hidden[start..][..CHAINS].copy_from_slice(&rounding.each(x));
            }
            for i in blocks..h {
                hidden[i] = T::round(row[i] * inverse);
            }
        } else if let Some(product) = product {
            for start in (0..blocks).step_by(CHAINS) {
                let (product, bias) = (block(product, start), block(bias, start));
                let mut x = [0.0; CHAINS];
                for i in 0..CHAINS {
                    x[i] = unit.of::<FMA>(product[i].widen() + bias[i]);
                }
                hidden[start..][..CHAINS].copy_from_slice(&rounding.each(x));
            }
            for i in blocks..h {
                hidden[i] = T::round(unit.of::<FMA>(product[i].widen() + bias[i]));
            }
        }
        if let Some(head) = &mut head {
            for i in 0..h {
                row[i] = hidden[i].widen();
            }
            for u in 0..outputs {
                let of_network = at.network * outputs + u;
                let weight = &head.weight[of_network * h..][..h];
                head.output[at.output + u * samples] = sum!(x in row, w in weight => |sum| mul_add::<FMA>(x, w, sum))
                    + head.bias[of_network];
            }
        }
    }
}

/// With LayerNorm (d − mean(d) − ĥ · mean(d ⊙ ĥ)) / σ, else d, back through the units.
#[inline(always)]
fn backward_rows<T: Number, N: Nonlinearity<f32>, R: Rounding, const FMA: bool>(
    sizes: Sizes,
    arrays: Backward<'_, T>,
    rows: [&mut [f32]; 2],
    unit: N,
    rounding: R,
) {
    let Sizes { samples, features: h, outputs, .. } = sizes;
    let Backward { product, bias, hidden, inverse_std, gradient, bias_gradient, mut head } = arrays;
    let [row, wide] = rows;
    let (row, wide) = (&mut row[..h], &mut wide[..h]);
    let per_feature = 1.0 / h as f32;
    let blocks = h / CHAINS * CHAINS;
    for index in 0..sizes.rows() {
        let at = sizes.row(index);
        let hidden = &hidden[index * h..][..h];
        let gradient = &mut gradient[index * h..][..h];
        let bias_gradient = &mut bias_gradient[at.bias * h..][..h];
        if head.is_none() && inverse_std.is_none() {
            for start in (0..blocks).step_by(CHAINS) {
                let (x, d) = (block(hidden, start), block(gradient, start));
                let mut back = [0.0; CHAINS];
                for i in 0..CHAINS {
                    back[i] = unit.back_from_result(x[i].widen(), d[i].widen());
                }
                put_gradient(back, rounding, bias_gradient, gradient, start);
            }
            for i in blocks..h {
                let d = unit.back_from_result(hidden[i].widen(), gradient[i].widen());
                bias_gradient[i] += d;
                gradient[i] = T::round(d);
            }
            continue;
        }
        for i in 0..h {
            wide[i] = hidden[i].widen();
        }
        if let Some(head) = &mut head {
            for u in 0..outputs {
                head.bias_gradient[at.network * outputs + u] +=
                    head.output_gradient[at.output + u * samples];
            }
            // All outputs for some features, which stay in a register, and then the next ones.
            for start in (0..blocks).step_by(CHAINS) {
                back_through_head::<FMA, CHAINS>(sizes, &at, head, [wide, row], start);
            }
            for start in blocks..h {
                back_through_head::<FMA, 1>(sizes, &at, head, [wide, row], start);
            }
        } else {
            for i in 0..h {
                row[i] = gradient[i].widen();
            }
        }
        if let Some(inverse_std) = inverse_std {
            let mean = sum!(d in row => |sum| sum + d) * per_feature;
            let along = sum!(d in row, x in wide => |sum| mul_add::<FMA>(d, x, sum)) * per_feature;
            let inverse = inverse_std[index];
            let (product, bias) = (&product[index * h..][..h], &bias[at.bias * h..][..h]);
            for i in 0..h {
                let d = (row[i] - mul_add::<FMA>(wide[i], along, mean)) * inverse;
                row[i] = unit.back::<FMA>(product[i].widen() + bias[i], d);
            }
        } else {
            for i in 0..h {
                row[i] = unit.back_from_result(wide[i], row[i]);
            }
        }
        for start in (0..blocks).step_by(CHAINS) {
            put_gradient(block(row, start), rounding, bias_gradient, gradient, start);
        }
        for i in blocks..h {
            bias_gradient[i] += row[i];
            gradient[i] = T::round(row[i]);
        }
    }
}

/// Sixteen numbers of a row, by value: what is written through a reference might be what is read, for all that the compiler knows.
#[inline(always)]
fn block<T: Copy>(row: &[T], start: usize) -> [T; CHAINS] {
    *row[start..][..CHAINS].as_array().expect("so many")
}

/// Adds sixteen gradients by products to those by the bias, and rounds them.
#[inline(always)]
fn put_gradient<T: Number, R: Rounding>(
    d: [f32; CHAINS],
    rounding: R,
    bias_gradient: &mut [f32],
    gradient: &mut [T],
    start: usize,
) {
    let mut sums = block(bias_gradient, start);
    for (sum, d) in sums.iter_mut().zip(d) {
        *sum += d;
    }
    bias_gradient[start..][..CHAINS].copy_from_slice(&sums);
    gradient[start..][..CHAINS].copy_from_slice(&rounding.each(d));
}

/// The gradient by `W` features of the row `hidden` from those by the outputs, into `gradient`; adds the gradients by the weights.
#[inline(always)]
fn back_through_head<const FMA: bool, const W: usize>(
    Sizes { samples, features: h, outputs, .. }: Sizes,
    at: &Row,
    head: &mut HeadBackward<'_>,
    [hidden, gradient]: [&mut [f32]; 2],
    start: usize,
) {
    let of = |slice: &[f32]| *slice[..W].as_array::<W>().expect("so many");
    let hidden = of(&hidden[start..]);
    let mut sums = [0.0; W];
    for u in 0..outputs {
        let d = head.output_gradient[at.output + u * samples];
        let first = (at.network * outputs + u) * h + start;
        let weight = of(&head.weight[first..]);
        let weight_gradient = &mut head.weight_gradient[first..][..W];
        let mut made = of(weight_gradient);
        for i in 0..W {
            sums[i] = mul_add::<FMA>(d, weight[i], sums[i]);
        }
        for i in 0..W {
            made[i] = mul_add::<FMA>(d, hidden[i], made[i]);
        }
        weight_gradient.copy_from_slice(&made);
    }
    gradient[start..][..W].copy_from_slice(&sums);
}
