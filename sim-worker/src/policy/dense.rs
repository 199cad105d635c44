//! One fully connected layer on lanes: packed weights and the register-tiled product.

use crate::scalar::Real;

/// Units of a panel: what one pass over the inputs accumulates in registers.
///
/// Sixteen accumulators (8 units × 2 lane groups, or 2 panels × 1 group) cover the latency of the
/// multiply-add on current processors and leave room for operands among 32 vector registers.
pub(super) const PANEL: usize = 8;

/// Weights of one layer, cut into panels.
#[derive(Debug, Clone)]
pub(super) struct Dense {
    /// Inputs of the layer.
    pub(super) inputs: usize,
    /// Units of the layer.
    pub(super) outputs: usize,
    /// `[panel][input][unit of the panel]`; units beyond `outputs` are zero.
    weights: Vec<[f32; PANEL]>,
    /// `[panel][unit of the panel]`.
    bias: Vec<[f32; PANEL]>,
}

impl Dense {
    /// Packs `weight` (`[inputs, outputs]` row-major) and `bias` (`[outputs]`).
    pub(super) fn pack(weight: &[f32], bias: &[f32]) -> Self {
        let outputs = bias.len();
        let inputs = weight.len() / outputs;
        assert_eq!(weight.len(), inputs * outputs, "a weight matrix has whole rows");
        let panels = outputs.div_ceil(PANEL);
        let mut packed = vec![[0.0; PANEL]; panels * inputs];
        let mut packed_bias = vec![[0.0; PANEL]; panels];
        for panel in 0..panels {
            let first = panel * PANEL;
            let width = PANEL.min(outputs - first);
            packed_bias[panel][..width].copy_from_slice(&bias[first..first + width]);
            for (input, row) in weight.chunks_exact(outputs).enumerate() {
                packed[panel * inputs + input][..width].copy_from_slice(&row[first..first + width]);
            }
        }
        Self { inputs, outputs, weights: packed, bias: packed_bias }
    }

    /// Units, rounded up to whole panels: what [`Dense::apply`] writes.
    pub(super) fn padded_outputs(&self) -> usize {
        self.bias.len() * PANEL
    }

    /// `out = x · weights + bias` for `groups` lane groups, tile after tile (see [`tiles`]).
    ///
    /// `x` and `out` hold tile `t` from `first group · stride` on, as `[feature][group of the tile]`.
    #[inline(always)]
    pub(super) fn apply<S: Real>(&self, x: &[S], out: &mut [S], groups: usize, stride: usize) {
        let panels = self.bias.len();
        let mut panel = 0;
        while panel < panels {
            // Panels outside, tiles inside: a pair of panels stays in the first-level cache.
            let pair = panel + 1 < panels;
            let (mut group, mut left) = (0, groups);
            while left > 0 {
                let at = group * stride;
                if left >= 2 {
                    self.multiply::<S, 1, 2>(panel, &x[at..], &mut out[at..]);
                    if pair {
                        self.multiply::<S, 1, 2>(panel + 1, &x[at..], &mut out[at..]);
                    }
                    (group, left) = (group + 2, left - 2);
                } else {
                    if pair {
                        self.multiply::<S, 2, 1>(panel, &x[at..], &mut out[at..]);
                    } else {
                        self.multiply::<S, 1, 1>(panel, &x[at..], &mut out[at..]);
                    }
                    (group, left) = (group + 1, left - 1);
                }
            }
            panel += 2;
        }
    }

    /// `Q` panels from `panel` on for one tile of `G` groups, all sums in registers.
    #[inline(always)]
    fn multiply<S: Real, const Q: usize, const G: usize>(
        &self,
        panel: usize,
        x: &[S],
        out: &mut [S],
    ) {
        let n = self.inputs;
        let x = &x.as_chunks::<G>().0[..n];
        let weights: [&[[f32; PANEL]]; Q] =
            std::array::from_fn(|q| &self.weights[(panel + q) * n..(panel + q + 1) * n]);
        let mut sums = [[[S::zero(); G]; PANEL]; Q];
        for q in 0..Q {
            for unit in 0..PANEL {
                sums[q][unit] = [S::splat(f64::from(self.bias[panel + q][unit])); G];
            }
        }
        for k in 0..n {
            let x = x[k];
            for q in 0..Q {
                let row = &weights[q][k];
                for unit in 0..PANEL {
                    let w = S::splat(f64::from(row[unit]));
                    for g in 0..G {
                        sums[q][unit][g] = w.mul_add(x[g], sums[q][unit][g]);
                    }
                }
            }
        }
        let out = &mut out.as_chunks_mut::<G>().0[panel * PANEL..(panel + Q) * PANEL];
        for q in 0..Q {
            for unit in 0..PANEL {
                out[q * PANEL + unit] = sums[q][unit];
            }
        }
    }
}

/// Groups of the tile that starts at `group`: two, or one at the end of an odd number.
#[inline(always)]
pub(super) fn tile_groups(group: usize, groups: usize) -> usize {
    if groups - group >= 2 { 2 } else { 1 }
}
