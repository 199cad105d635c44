//! Arrays of `f32` that begin where vector registers want them.
//!
//! iceoryx2 can be asked to align a payload, but then it makes every *element* as long as the border: an
//! array of `f32` takes sixteen times its memory. Elements that are as long as the border have it by
//! themselves.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// Numbers of one line.
const WIDTH: usize = 16;

/// Sixteen numbers on a 64-byte border.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
#[repr(align(64))]
pub(crate) struct Line([f32; WIDTH]);

impl Line {
    /// How many lines hold `len` numbers.
    pub(crate) const fn count(len: usize) -> usize {
        len.div_ceil(WIDTH)
    }

    /// The first `len` numbers of `lines`.
    pub(crate) fn numbers(lines: &[Self], len: usize) -> &[f32] {
        &bytemuck::cast_slice(lines)[..len]
    }

    /// The same, to be written.
    pub(crate) fn numbers_mut(lines: &mut [Self], len: usize) -> &mut [f32] {
        &mut bytemuck::cast_slice_mut(lines)[..len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_lie_in_their_lines_one_after_the_other() {
        let mut lines = vec![Line::default(); Line::count(33)];
        assert_eq!((lines.len(), Line::count(0), Line::count(32)), (3, 0, 2));
        for (i, x) in Line::numbers_mut(&mut lines, 33).iter_mut().enumerate() {
            *x = i as f32;
        }
        assert_eq!(lines[1].0[15], 31.0);
        assert_eq!(lines[2].0[..2], [32.0, 0.0]);
        let numbers = Line::numbers(&lines, 33);
        assert_eq!((numbers.len(), numbers[32]), (33, 32.0));
        assert_eq!(numbers.as_ptr() as usize % 64, 0);
    }
}
