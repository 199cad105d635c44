//! One fully connected layer on lanes: packed weights and the register-tiled product.

use crate::scalar::{Fused, Mask, PairKernel, PairProducts, Real, WeightPair, bf16_bias};

/// Units of a panel: what one pass over the inputs accumulates in registers.
///
/// Sixteen accumulators (8 units × 2 lane groups, or 2 panels × 1 group) cover the latency of the
/// multiply-add on current processors and leave room for operands among 32 vector registers; where
/// there are 16 ([`Real::PRODUCT_SUMS`]), eight (4 units × 2 groups, or 8 × 1) do so just about.
pub(super) const PANEL: usize = 8;

/// Weights of one layer, cut into panels: `W` is `f32`, or a [`WeightPair`] of two inputs' weights in bfloat16.
#[derive(Debug, Clone)]
pub(super) struct Dense<W> {
    /// Rows of weights: inputs of the layer, or pairs of them (an odd last one stands beside zero; so it does where pairs are widened).
    rows: usize,
    /// Units of the layer.
    pub(super) outputs: usize,
    /// `[panel][row][unit of the panel]`; units beyond `outputs` are zero.
    weights: Vec<[W; PANEL]>,
    /// `[panel][unit of the panel]`.
    bias: Vec<[f32; PANEL]>,
}

/// What one weight adds to a unit's sum.
trait Accumulate<S, X, W>: Copy {
    fn add(self, sum: S, x: X, w: W) -> S;
}

/// `x · w + sum`, one fused multiply-add.
#[derive(Clone, Copy)]
struct Single;

impl<S: Real> Accumulate<S, S, f32> for Single {
    #[inline(always)]
    fn add(self, sum: S, x: S, w: f32) -> S {
        S::splat(f64::from(w)).mul_add_inlined(x, sum)
    }
}

/// A pair's two products.
#[derive(Clone, Copy)]
struct Pairs<P>(P);

impl<S: Real, P: PairProducts> Accumulate<S, S::Pair, WeightPair> for Pairs<P> {
    #[inline(always)]
    fn add(self, sum: S, x: S::Pair, w: WeightPair) -> S {
        sum.add_pair_product(x, w, self.0)
    }
}

impl Dense<f32> {
    /// Packs `weight` (`[inputs, outputs]` row-major) and `bias` (`[outputs]`).
    pub(super) fn pack(weight: &[f32], bias: &[f32]) -> Self {
        let outputs = bias.len();
        let rows = weight.len() / outputs;
        assert_eq!(weight.len(), rows * outputs, "a weight matrix has whole rows");
        let panels = outputs.div_ceil(PANEL);
        let mut packed = vec![[0.0; PANEL]; panels * rows];
        let mut packed_bias = vec![[0.0; PANEL]; panels];
        for panel in 0..panels {
            let first = panel * PANEL;
            let width = PANEL.min(outputs - first);
            packed_bias[panel][..width].copy_from_slice(&bias[first..first + width]);
            for (input, row) in weight.chunks_exact(outputs).enumerate() {
                packed[panel * rows + input][..width].copy_from_slice(&row[first..first + width]);
            }
        }
        Self { rows, outputs, weights: packed, bias: packed_bias }
    }

    /// Packs numbers of bfloat16 that [`Dense::pack_pairs`] packs in pairs, as they are: of each two rows the second first, which is the order in which
    /// their products are added.
    pub(super) fn pack_widened(weight: &[f32], bias: &[f32]) -> Self {
        let Dense { rows, outputs, weights, bias } = Dense::pack_pairs(weight, bias);
        let widened = weights.iter().flat_map(|pairs| {
            let widened = pairs.map(WeightPair::widened);
            [widened.map(|[_, second]| second), widened.map(|[first, _]| first)]
        });
        Self { rows: 2 * rows, outputs, weights: widened.collect(), bias }
    }

    /// `out = x · weights + bias` for `groups` lane groups, tile after tile (see [`tile_groups`]).
    ///
    /// `x` and `out` hold tile `t` from `first group · stride` on, as `[feature][group of the tile]`.
    #[inline(always)]
    pub(super) fn apply<S: Real>(&self, x: &[S], out: &mut [S], groups: usize, stride: usize) {
        self.tiles(x, out, groups, stride, Single, Start::Bias);
    }

    /// As [`Self::apply`], but sums start from what is in `out`, not from the bias.
    #[inline(always)]
    pub(super) fn add_to<S: Real>(&self, x: &[S], out: &mut [S], groups: usize, stride: usize) {
        self.tiles(x, out, groups, stride, Single, Start::Out);
    }
}

/// Where sums start.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Start {
    /// From the layer's bias.
    Bias,
    /// From what is in the output's place.
    Out,
}

impl Dense<WeightPair> {
    /// Packs as [`Dense::pack`] does, and rounds to bfloat16.
    pub(super) fn pack_pairs(weight: &[f32], bias: &[f32]) -> Self {
        let Dense { rows, outputs, weights, bias } = Dense::pack(weight, bias);
        let paired = weights.chunks_exact(rows).flat_map(|panel| {
            panel.chunks(2).map(|rows| {
                std::array::from_fn(|unit| {
                    WeightPair::new(rows[0][unit], rows.get(1).map_or(0.0, |row| row[unit]))
                })
            })
        });
        let bias = bias.iter().map(|panel| panel.map(bf16_bias)).collect();
        Self { rows: rows.div_ceil(2), outputs, weights: paired.collect(), bias }
    }

    /// As [`Dense::apply`] of single numbers; `x` is `[pair][group of the tile]`.
    #[inline(always)]
    pub(super) fn apply<S: Real>(
        &self,
        x: &[S::Pair],
        out: &mut [S],
        groups: usize,
        stride: usize,
    ) {
        S::compiled_for_pairs(PairProduct { dense: self, x, out, groups, stride });
    }
}

/// The arguments of [`Dense::apply`] of pairs.
struct PairProduct<'a, S: Real> {
    dense: &'a Dense<WeightPair>,
    x: &'a [S::Pair],
    out: &'a mut [S],
    groups: usize,
    stride: usize,
}

impl<S: Real> PairKernel<S> for PairProduct<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run<P: PairProducts>(self, products: P) {
        let Self { dense, x, out, groups, stride } = self;
        dense.tiles(x, out, groups, stride, Pairs(products), Start::Bias);
        if products.rounded_apart() && !all_finite(out) {
            // A product may have overflowed that fused would not have. A sum that did stays so.
            dense.tiles(x, out, groups, stride, Pairs(Fused), Start::Bias);
        }
    }
}

#[inline(always)]
fn all_finite<S: Real>(x: &[S]) -> bool {
    let mut finite = S::Mask::splat(true);
    for value in x {
        finite = finite & value.abs().le(S::splat(f64::from(f32::MAX)));
    }
    finite.all()
}

impl<W: Copy> Dense<W> {
    /// Units, rounded up to whole panels: what `apply` writes.
    pub(super) fn padded_outputs(&self) -> usize {
        self.bias.len() * PANEL
    }

    #[inline(always)]
    fn tiles<S: Real, X: Copy, A: Accumulate<S, X, W>>(
        &self,
        x: &[X],
        out: &mut [S],
        groups: usize,
        stride: usize,
        accumulate: A,
        start: Start,
    ) {
        let panels = self.bias.len();
        let mut panel = 0;
        while panel < panels {
            // Panels outside, tiles inside: a pair of panels stays in the first-level cache.
            let pair = panel + 1 < panels;
            let (mut group, mut left) = (0, groups);
            while left > 0 {
                let at = group * stride;
                let (x, out) = (&x[at..], &mut out[at..]);
                let width = if left >= 2 { 2 } else { 1 };
                match (width, pair) {
                    (1, true) if S::PRODUCT_SUMS >= 2 * PANEL => {
                        self.multiply::<S, X, A, 2, 1, PANEL>(panel, x, out, accumulate, start);
                    }
                    (1, _) => {
                        for panel in panel..=panel + usize::from(pair) {
                            self.multiply::<S, X, A, 1, 1, PANEL>(panel, x, out, accumulate, start);
                        }
                    }
                    _ => {
                        for panel in panel..=panel + usize::from(pair) {
                            if S::PRODUCT_SUMS >= 2 * PANEL {
                                self.multiply::<S, X, A, 1, 2, PANEL>(
                                    panel, x, out, accumulate, start,
                                );
                            } else {
                                const HALF: usize = PANEL / 2;
                                self.multiply::<S, X, A, 1, 2, HALF>(
                                    panel, x, out, accumulate, start,
                                );
                            }
                        }
                    }
                }
                (group, left) = (group + width, left - width);
            }
            panel += 2;
        }
    }

    /// `Q` panels from `panel` on for one tile of `G` groups, `U` units of each at a time, all their sums in registers.
    #[inline(always)]
    fn multiply<
        S: Real,
        X: Copy,
        A: Accumulate<S, X, W>,
        const Q: usize,
        const G: usize,
        const U: usize,
    >(
        &self,
        panel: usize,
        x: &[X],
        out: &mut [S],
        accumulate: A,
        start: Start,
    ) {
        let n = self.rows;
        let x = &x.as_chunks::<G>().0[..n];
        let weights: [&[[W; PANEL]]; Q] =
            std::array::from_fn(|q| &self.weights[(panel + q) * n..(panel + q + 1) * n]);
        let out = &mut out.as_chunks_mut::<G>().0[panel * PANEL..(panel + Q) * PANEL];
        let mut first = 0;
        while first < PANEL {
            let mut sums = [[[S::zero(); G]; U]; Q];
            for q in 0..Q {
                for unit in 0..U {
                    sums[q][unit] = match start {
                        Start::Bias => {
                            let bias = self.bias[panel + q][first + unit];
                            [S::splat(f64::from(bias)); G]
                        }
                        Start::Out => out[q * PANEL + first + unit],
                    };
                }
            }
            for k in 0..n {
                let x = x[k];
                for q in 0..Q {
                    let row = &weights[q][k][first..first + U];
                    for unit in 0..U {
                        for g in 0..G {
                            sums[q][unit][g] = accumulate.add(sums[q][unit][g], x[g], row[unit]);
                        }
                    }
                }
            }
            for q in 0..Q {
                for unit in 0..U {
                    out[q * PANEL + first + unit] = sums[q][unit];
                }
            }
            first += U;
        }
    }
}

/// Groups of the tile that starts at `group`: two, or one at the end of an odd number.
#[inline(always)]
pub(super) fn tile_groups(group: usize, groups: usize) -> usize {
    if groups - group >= 2 { 2 } else { 1 }
}
