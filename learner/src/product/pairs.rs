//! The loops of a product, in instructions that multiply bfloat16 in pairs.
#![expect(
    unsafe_code,
    reason = "instructions of detected processor features, and reads without a check of bounds in the innermost loop"
)]

use std::arch::x86_64::{
    __m512, __m512bh, __m512i, _mm512_dpbf16_ps, _mm512_load_si512, _mm512_set1_epi32,
    _mm512_setzero_ps,
};

use super::native::Pairs;
use super::operands::{Left, Out};
use super::packed::Packed;
use super::panel::{PANEL, PairRow};
use super::registers::LANES;
use super::sums::{Put, Rows, for_each_out};

/// Rows of a tile.
const TILE: usize = 8;

/// Rows that meet all panels before others do, so that they are fetched into the second cache once.
const BLOCK: usize = 64;

/// The sums of a tile.
type TileSums<const M: usize> = [[__m512; 2]; M];

/// The product of `left` `[rows, K]` with `right` `[K, N]`. The sizes fit each other, and K is not zero.
pub(super) fn multiply(_: Pairs, left: Left<'_>, right: &Packed, out: Out<'_>, rows: usize) {
    // SAFETY: there is no `Pairs` without these features.
    unsafe { for_each_out!(out, put => multiply_compiled(left, right, &mut put, rows)) };
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16")]
fn multiply_compiled<P: Put>(left: Left<'_>, right: &Packed, out: &mut P, rows: usize) {
    let (panels, inner) = (right.panels(), right.rows());
    for index in 0..panels * rows.div_ceil(BLOCK) {
        let (block, panel) = (index / panels, index % panels);
        let pairs = right.panel(panel);
        let mut row = block * BLOCK;
        let end = rows.min(row + BLOCK);
        while row < end {
            let at = [row, panel * PANEL, right.columns()];
            // SAFETY: this function is compiled for the features that all below it use.
            unsafe {
                match rows - row {
                    1 => tile::<1, P>(left, inner, pairs, out, at),
                    2 => tile::<2, P>(left, inner, pairs, out, at),
                    3 => tile::<3, P>(left, inner, pairs, out, at),
                    4 => tile::<4, P>(left, inner, pairs, out, at),
                    5 => tile::<5, P>(left, inner, pairs, out, at),
                    6 => tile::<6, P>(left, inner, pairs, out, at),
                    7 => tile::<7, P>(left, inner, pairs, out, at),
                    _ => tile::<TILE, P>(left, inner, pairs, out, at),
                }
            }
            row += TILE;
        }
    }
}

/// Rows `row` to `row + M` of the product with a panel, whose first column is `column` of `columns`.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16. M is at most [`TILE`].
#[inline(always)]
unsafe fn tile<const M: usize, P: Put>(
    left: Left<'_>,
    inner: usize,
    panel: &[PairRow],
    out: &mut P,
    [row, column, columns]: [usize; 3],
) {
    // SAFETY: the caller's promise is that of all below. The slices hold every address that is read: of M rows of K numbers those of K / 2 pairs, and of a panel its
    // K / 2 rows (rounded up), M pairs each; tiles do not reach over the end of a panel, as that is a multiple of theirs.
    unsafe {
        let sums = match left {
            Left::Rows(numbers) => {
                let numbers = &numbers[row * inner..][..M * inner];
                let (pairs, odd) = panel.split_at(inner / 2);
                let mut sums = sums::<M>(numbers.as_ptr().cast(), [inner * 2, 4], pairs);
                if let [last] = odd {
                    for (m, sums) in sums.iter_mut().enumerate() {
                        let x = u32::from(numbers[(m + 1) * inner - 1].0);
                        add_products(sums, x, halves(last));
                    }
                }
                sums
            }
            Left::Transposed(packed) => {
                let each = panel.len();
                let of_rows = packed.panel(row / PANEL);
                debug_assert_eq!(of_rows.len(), each);
                let first = of_rows.as_ptr().cast::<u32>().add(row % PANEL);
                sums::<M>(first.cast(), [4, size_of::<PairRow>()], panel)
            }
        };
        let mut next = out.begin(Rows { count: M, first: row, column, columns });
        for sums in sums {
            P::put(&mut next, sums);
        }
    }
}

/// The sums over all rows of `panel`, times the pair at `first`, `step` bytes further with each row of the panel, and `row` bytes with each of the tile.
///
/// # Safety
/// As for [`tile`]; all these pairs can be read.
#[inline(always)]
unsafe fn sums<const M: usize>(
    first: *const u8,
    [row, step]: [usize; 2],
    panel: &[PairRow],
) -> TileSums<M> {
    // SAFETY: the caller's promise.
    unsafe {
        let mut sums = [[_mm512_setzero_ps(); 2]; M];
        let mut at = first;
        for pairs in panel {
            let pairs = halves(pairs);
            for (m, sums) in sums.iter_mut().enumerate() {
                let x = at.wrapping_add(m * row).cast::<u32>().read_unaligned();
                add_products(sums, x, pairs);
            }
            at = at.wrapping_add(step);
        }
        sums
    }
}

/// A row of a panel in two registers.
///
/// # Safety
/// As for [`tile`].
#[inline(always)]
unsafe fn halves(row: &PairRow) -> [__m512bh; 2] {
    // SAFETY: a row has twice sixteen pairs, and begins where a cache line does. The transmuted types are of one size, and every bit pattern is a
    // value of both.
    unsafe {
        let (first, second) = (row.0.as_ptr(), row.0.as_ptr().add(LANES));
        [
            std::mem::transmute::<__m512i, __m512bh>(_mm512_load_si512(first.cast())),
            std::mem::transmute::<__m512i, __m512bh>(_mm512_load_si512(second.cast())),
        ]
    }
}

/// Adds the products of the pair `x` with sixteen pairs, twice.
///
/// # Safety
/// As for [`tile`].
#[inline(always)]
unsafe fn add_products(sums: &mut [__m512; 2], x: u32, pairs: [__m512bh; 2]) {
    // SAFETY: the caller's promise; transmuted as above.
    unsafe {
        let x = std::mem::transmute::<__m512i, __m512bh>(_mm512_set1_epi32(x as i32));
        sums[0] = _mm512_dpbf16_ps(sums[0], x, pairs[0]);
        sums[1] = _mm512_dpbf16_ps(sums[1], x, pairs[1]);
    }
}
