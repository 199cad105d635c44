//! Blocks of numbers with rows and columns exchanged, in registers.
#![expect(unsafe_code, reason = "instructions of detected processor features")]

use std::arch::x86_64::{
    __m512i, _mm512_loadu_si512, _mm512_setzero_si512, _mm512_shuffle_i32x4, _mm512_store_si512,
    _mm512_unpackhi_epi32, _mm512_unpackhi_epi64, _mm512_unpacklo_epi32, _mm512_unpacklo_epi64,
};

use super::panel::{PairRow, TILE};
use crate::features::Features;
use crate::number::Bf16;

/// Pairs sixteen columns of as many rows as there are, from the `half` of the panel on: `columns` lie one after the other. Says how many rows of pairs are
/// filled: whole blocks of sixteen, none without AVX-512.
pub(super) fn pair_columns(
    features: Features,
    columns: &[Bf16],
    rows: usize,
    panel: &mut [PairRow],
    half: usize,
) -> usize {
    if columns.len() < TILE * rows {
        return 0;
    }
    // The last row of pairs may be half a one.
    let panel = &mut panel[..rows / 2];
    match features {
        // SAFETY: `Features::detect` found it, or nobody could have made this value.
        Features::Avx512(_) | Features::Avx512Bf16(_) => unsafe {
            pair_columns_compiled(columns, rows, panel, half)
        },
        Features::Avx2(_) | Features::Any => 0,
    }
}

#[target_feature(enable = "avx512f")]
fn pair_columns_compiled(
    columns: &[Bf16],
    rows: usize,
    panel: &mut [PairRow],
    half: usize,
) -> usize {
    let columns: [&[Bf16]; TILE] = std::array::from_fn(|c| &columns[c * rows..][..rows]);
    let blocks = panel.as_chunks_mut::<TILE>().0;
    for (block, pairs) in blocks.iter_mut().enumerate() {
        let mut lanes = [_mm512_setzero_si512(); TILE];
        for (lanes, column) in lanes.iter_mut().zip(columns) {
            let numbers: &[Bf16] = &column[2 * TILE * block..][..2 * TILE];
            // SAFETY: the slice has as many numbers as a register.
            *lanes = unsafe { _mm512_loadu_si512(numbers.as_ptr().cast()) };
        }
        // SAFETY: compiled for AVX-512.
        let lanes = unsafe { transposed(lanes) };
        for (pairs, lanes) in pairs.iter_mut().zip(lanes) {
            let to: &mut [u32] = &mut pairs.0[half * TILE..][..TILE];
            // SAFETY: the slice has room, and halves of rows begin cache lines.
            unsafe { _mm512_store_si512(to.as_mut_ptr().cast(), lanes) };
        }
    }
    blocks.len() * TILE
}

/// Sixteen rows of sixteen numbers as their columns: numbers of two rows side by side, then those of four, then blocks of four by four to their
/// places.
///
/// # Safety
/// Called from code that is compiled for AVX-512.
#[inline(always)]
pub(super) unsafe fn transposed(rows: [__m512i; TILE]) -> [__m512i; TILE] {
    // SAFETY: the caller's promise.
    unsafe {
        let (mut twos, mut fours) = (rows, rows);
        for i in 0..8 {
            twos[2 * i] = _mm512_unpacklo_epi32(rows[2 * i], rows[2 * i + 1]);
            twos[2 * i + 1] = _mm512_unpackhi_epi32(rows[2 * i], rows[2 * i + 1]);
        }
        // Of rows 4 i to 4 i + 3: `fours[4 i + j]` has columns j, 4 + j, 8 + j and 12 + j.
        for i in 0..4 {
            let [a, b, c, d] = [twos[4 * i], twos[4 * i + 1], twos[4 * i + 2], twos[4 * i + 3]];
            fours[4 * i] = _mm512_unpacklo_epi64(a, c);
            fours[4 * i + 1] = _mm512_unpackhi_epi64(a, c);
            fours[4 * i + 2] = _mm512_unpacklo_epi64(b, d);
            fours[4 * i + 3] = _mm512_unpackhi_epi64(b, d);
        }
        let mut columns = rows;
        for j in 0..4 {
            let [a, b, c, d] = [fours[j], fours[4 + j], fours[8 + j], fours[12 + j]];
            // The even quarters of two registers, and the odd ones.
            let even = [_mm512_shuffle_i32x4::<0x88>(a, b), _mm512_shuffle_i32x4::<0x88>(c, d)];
            let odd = [_mm512_shuffle_i32x4::<0xdd>(a, b), _mm512_shuffle_i32x4::<0xdd>(c, d)];
            columns[j] = _mm512_shuffle_i32x4::<0x88>(even[0], even[1]);
            columns[4 + j] = _mm512_shuffle_i32x4::<0x88>(odd[0], odd[1]);
            columns[8 + j] = _mm512_shuffle_i32x4::<0xdd>(even[0], even[1]);
            columns[12 + j] = _mm512_shuffle_i32x4::<0xdd>(odd[0], odd[1]);
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_blocks_go_through_registers_where_there_is_avx_512() {
        let rows = 75;
        let columns: Vec<Bf16> = (0..TILE * rows).map(|i| Bf16(i as u16)).collect();
        let mut panel = vec![PairRow([0; 2 * TILE]); rows.div_ceil(2)];
        let done = pair_columns(Features::detect(), &columns, rows, &mut panel, 1);
        let expected = if std::arch::is_x86_feature_detected!("avx512bw") { 32 } else { 0 };
        assert_eq!(done, expected);
        for (row, pairs) in panel[..done].iter().enumerate() {
            for (column, &pair) in pairs.0[TILE..].iter().enumerate() {
                let number = |row: usize| (column * rows + row) as u32;
                assert_eq!(pair, number(2 * row) | number(2 * row + 1) << 16);
            }
        }
    }
}
