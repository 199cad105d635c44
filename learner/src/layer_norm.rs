//! LayerNorm without its affine map, which is folded into the next layer (see [`crate::mlp`]).

use tch::Tensor;

/// ε of LayerNorm.
pub(crate) const LAYER_NORM_EPSILON: f64 = 1e-5;

/// Standardises each input over its features, without gain: what a LayerNorm input becomes before
/// its folded affine map. `x` is `[…, in]` in f32.
pub(crate) fn standardise_input(x: &Tensor) -> Tensor {
    let width = x.size()[x.dim() - 1];
    x.layer_norm([width], None::<Tensor>, None::<Tensor>, LAYER_NORM_EPSILON, false)
}
