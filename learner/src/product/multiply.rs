//! The product itself.

use super::native::Native;
use super::operands::{Left, Out};
use super::packed::Packed;

/// The product of `left` with `right` `[K, N]`.
///
/// # Panics
/// If the sizes do not fit each other.
pub(crate) fn multiply(native: Native, left: Left<'_>, right: &Packed, out: Out<'_>) {
    let (inner, columns) = (right.rows(), right.columns());
    let rows = match left {
        Left::Rows(numbers) => {
            let rows = numbers.len() / inner.max(1);
            assert_eq!(numbers.len(), rows * inner, "the left factor has other rows");
            rows
        }
        Left::Transposed(packed) => {
            assert_eq!(packed.rows(), inner, "the factors do not fit each other");
            packed.columns()
        }
    };
    assert_eq!(out.len(), rows * columns, "the product has another size");
    assert!(inner > 0, "factors of nothing");
    out.check(columns);
    match native {
        #[cfg(target_arch = "x86_64")]
        Native::Pairs(pairs) => super::pairs::multiply(pairs, left, right, out, rows),
        #[cfg(target_arch = "x86_64")]
        Native::Tiles(tiles) => super::tiles::multiply(tiles, left, right, out, rows),
        #[cfg(test)]
        Native::Plain => super::plain::multiply(left, right, out, rows),
    }
}
