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
