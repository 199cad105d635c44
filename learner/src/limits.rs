//! Comparisons as libtorch makes them: what is no number stays so.

/// `x` between two limits; NaN stays.
#[inline(always)]
pub(crate) fn clamp(x: f32, [low, high]: [f32; 2]) -> f32 {
    let x = if x < low { low } else { x };
    if x > high { high } else { x }
}

/// The smaller of two numbers; NaN if one is.
#[inline(always)]
pub(crate) fn minimum(a: f32, b: f32) -> f32 {
    let least = if a < b { a } else { b };
    if a.is_nan() { a } else { least }
}

/// The larger of two numbers; NaN if one is.
#[inline(always)]
pub(crate) fn maximum(a: f32, b: f32) -> f32 {
    let most = if a > b { a } else { b };
    if a.is_nan() { a } else { most }
}
