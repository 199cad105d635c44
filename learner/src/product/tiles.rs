//! The loops of a product, in tiles of bfloat16 (AMX).
//!
//! Two by two tiles of sums stay in the registers: 32 rows of the left factor meet a panel. A step multiplies 32 numbers of each of these rows with as
//! many of each of the panel's columns. A panel lies as the instructions read it; so do whole blocks of rows whose inner index fills its steps,
//! and others are copied.
#![expect(
    unsafe_code,
    reason = "instructions of detected processor features, which no safe function stands for"
)]

use std::arch::asm;
use std::arch::x86_64::{
    _mm512_load_ps, _mm512_load_si512, _mm512_maskz_loadu_epi16, _mm512_setzero_si512,
    _mm512_store_si512,
};
use std::ops::Range;

use super::native::Tiles;
use super::operands::{Left, Out};
use super::packed::Packed;
use super::panel::{PANEL, PairRow, TILE};
use super::sums::{self, LANES};
use super::transposition::transposed;
use crate::number::Bf16;

/// Rows of the left factor that go together: two tiles.
const BLOCK: usize = 2 * TILE;

/// Numbers of the inner index in a step.
const STEP: usize = 2 * TILE;

/// A row of a tile: sixteen pairs, or sixteen sums.
const ROW_BYTES: usize = 64;

/// A tile of the left factor: sixteen pairs of sixteen rows. Cache lines.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Tile([[u32; TILE]; TILE]);

impl Tile {
    const ZEROS: Self = Self([[0; TILE]; TILE]);
}

/// The sums of a block's rows with a panel.
#[repr(align(64))]
struct Sums([[f32; PANEL]; BLOCK]);

/// Where a block of the left factor lies: its first two tiles, the bytes from a row to the next, and those from a step to the next.
#[derive(Clone, Copy)]
struct Block {
    tiles: [*const u8; 2],
    row: usize,
    step: usize,
}

/// The product of `left` `[rows, K]` with `right` `[K, N]`. The sizes fit each other, and K is not zero.
pub(super) fn multiply(_: Tiles, left: Left<'_>, right: &Packed, mut out: Out<'_>, rows: usize) {
    // SAFETY: there is no `Tiles` without these features, nor without the kernel's leave to use tiles.
    unsafe { multiply_compiled(left, right, &mut out, rows) };
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16")]
fn multiply_compiled(left: Left<'_>, right: &Packed, out: &mut Out<'_>, rows: usize) {
    let (inner, columns) = (right.rows(), right.columns());
    let steps = inner.div_ceil(STEP);
    let mut copy = Vec::new();
    let mut sums = [const { Sums([[0.0; PANEL]; BLOCK]) }; 2];
    // SAFETY: `multiply` stands for the features. Tiles are configured as long as they are used, and blocks and panels have `steps` steps.
    unsafe {
        let found = configure();
        for row in (0..rows).step_by(BLOCK) {
            let count = BLOCK.min(rows - row);
            let block = match left {
                Left::Rows(numbers) => {
                    let numbers = &numbers[row * inner..][..count * inner];
                    if count == BLOCK && inner.is_multiple_of(STEP) {
                        in_place(numbers, inner)
                    } else {
                        copy.resize(2 * steps, Tile::ZEROS);
                        copy_rows(numbers, inner, &mut copy);
                        copied(&copy)
                    }
                }
                Left::Transposed(packed) => {
                    copy.resize(2 * steps, Tile::ZEROS);
                    transpose(packed.filled_panel(row / PANEL), &mut copy);
                    copied(&copy)
                }
            };
            for panel in 0..=right.panels() {
                let [even, odd] = &mut sums;
                let (made, before) = if panel % 2 == 0 { (even, &*odd) } else { (odd, &*even) };
                let waiting = panel.checked_sub(1).map(|before| [row, before * PANEL, columns]);
                let mut done = 0;
                if panel < right.panels() {
                    let pairs = right.filled_panel(panel);
                    debug_assert_eq!(pairs.len(), steps * TILE);
                    done = match (waiting, &mut *out) {
                        (Some([row, column, _]), Out::Rounded(out)) if count == BLOCK => {
                            // A panel before another one is a whole one.
                            let last = (BLOCK - 1) * columns + PANEL;
                            let out = &mut out[row * columns + column..][..last];
                            multiply_and_put(block, pairs, made, before, out, columns)
                        }
                        _ => {
                            multiply_block(block, pairs, made);
                            0
                        }
                    };
                }
                if let Some(corner) = waiting {
                    put_rows(before, out, corner, done..count);
                }
            }
        }
        restore(&found);
    }
}

/// Rounds the sums of some rows of a block, and puts them where the corner `[row, column]` of a product with so many columns is.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16.
#[inline(always)]
unsafe fn put_rows(
    sums: &Sums,
    out: &mut Out<'_>,
    [row, column, columns]: [usize; 3],
    rows: Range<usize>,
) {
    let left = columns - column;
    for m in rows {
        let at = (row + m) * columns + column;
        let [first, second] = sums.0[m].as_chunks::<LANES>().0 else { unreachable!("two halves") };
        // SAFETY: the caller's promise; both halves begin cache lines.
        unsafe {
            let (first, second) = (_mm512_load_ps(first.as_ptr()), _mm512_load_ps(second.as_ptr()));
            if left >= PANEL {
                sums::put_both([first, second], out, at);
            } else {
                sums::put(first, out, at, left);
                if left > LANES {
                    sums::put(second, out, at + LANES, left - LANES);
                }
            }
        }
    }
}

/// 32 rows of the left factor, `[32, inner]`, as they lie in memory.
fn in_place(rows: &[Bf16], inner: usize) -> Block {
    let second = &rows[TILE * inner..];
    Block {
        tiles: [rows.as_ptr().cast(), second.as_ptr().cast()],
        row: inner * size_of::<Bf16>(),
        step: ROW_BYTES,
    }
}

/// A block that was copied: two tiles a step.
fn copied(copy: &[Tile]) -> Block {
    let second = &copy[1..];
    Block {
        tiles: [copy.as_ptr().cast(), second.as_ptr().cast()],
        row: ROW_BYTES,
        step: 2 * size_of::<Tile>(),
    }
}

/// Copies up to 32 rows of `inner` numbers, and fills up the last step with zeros. Tiles' other rows stay as they are: nobody reads their sums.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with 16-bit numbers.
#[inline(always)]
unsafe fn copy_rows(rows: &[Bf16], inner: usize, copy: &mut [Tile]) {
    for (row, numbers) in rows.chunks_exact(inner).enumerate() {
        let (half, row) = (row / TILE, row % TILE);
        for (numbers, tiles) in numbers.chunks(STEP).zip(copy.as_chunks_mut::<2>().0) {
            let mask = u32::MAX >> (STEP - numbers.len());
            let to = &mut tiles[half].0[row];
            // SAFETY: the caller's promise. The mask leaves the numbers that there are; a tile's row begins a cache line.
            unsafe {
                let numbers = _mm512_maskz_loadu_epi16(mask, numbers.as_ptr().cast());
                _mm512_store_si512(to.as_mut_ptr().cast(), numbers);
            }
        }
    }
}

/// Takes a panel of the transposed factor over: columns become rows.
///
/// # Safety
/// Called from code that is compiled for AVX-512.
#[inline(always)]
unsafe fn transpose(panel: &[PairRow], copy: &mut [Tile]) {
    let steps = panel.as_chunks::<TILE>().0;
    for (rows, tiles) in steps.iter().zip(copy.as_chunks_mut::<2>().0) {
        for (half, tile) in tiles.iter_mut().enumerate() {
            // SAFETY: the caller's promise; rows of panels and tiles begin cache lines.
            unsafe {
                let mut lanes = [_mm512_setzero_si512(); TILE];
                for (lanes, row) in lanes.iter_mut().zip(rows) {
                    *lanes = _mm512_load_si512(row.0[half * TILE..].as_ptr().cast());
                }
                for (row, lanes) in tile.0.iter_mut().zip(transposed(lanes)) {
                    _mm512_store_si512(row.as_mut_ptr().cast(), lanes);
                }
            }
        }
    }
}

/// How tiles are cut, as `ldtilecfg` reads it and `sttilecfg` writes it.
#[derive(Default)]
#[repr(C, align(64))]
struct Configuration {
    /// 0: tiles are not in use, 1: eight of at most sixteen rows of 64 bytes.
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    row_bytes: [u16; 16],
    rows: [u8; 16],
}

/// Takes eight whole tiles, and gives back what was configured before: a library that is in between two products of its own may not look again.
///
/// # Safety
/// The processor has tiles, and the process may use them. Nobody's numbers are in them.
unsafe fn configure() -> Configuration {
    let whole = Configuration {
        palette: 1,
        row_bytes: std::array::from_fn(|tile| if tile < 8 { ROW_BYTES as u16 } else { 0 }),
        rows: std::array::from_fn(|tile| if tile < 8 { TILE as u8 } else { 0 }),
        ..Configuration::default()
    };
    let mut found = Configuration::default();
    // SAFETY: both are 64 bytes; the rest is the caller's promise.
    unsafe {
        asm!(
            "sttilecfg [{found}]",
            "ldtilecfg [{whole}]",
            found = in(reg) &raw mut found,
            whole = in(reg) &raw const whole,
            options(nostack, preserves_flags),
        );
    }
    found
}

/// Configures tiles as they were found. What was in them is gone.
///
/// # Safety
/// As for [`configure`], which gave `found`.
unsafe fn restore(found: &Configuration) {
    // SAFETY: the caller's promise.
    unsafe {
        asm!("ldtilecfg [{found}]", found = in(reg) found, options(nostack, preserves_flags, readonly));
    }
}

/// Clears the tiles of sums.
macro_rules! clear {
    () => {
        concat!("tilezero tmm0\n", "tilezero tmm1\n", "tilezero tmm2\n", "tilezero tmm3")
    };
}

/// Multiplies a step of the block with one of the panel.
macro_rules! multiply {
    () => {
        concat!(
            "tileloadd tmm4, [{first} + {row}*1]\n",
            "tileloadd tmm6, [{panel} + {width}*1]\n",
            "tileloadd tmm7, [{panel} + {width}*1 + 64]\n",
            "tdpbf16ps tmm0, tmm4, tmm6\n",
            "tileloadd tmm5, [{second} + {row}*1]\n",
            "tdpbf16ps tmm1, tmm4, tmm7\n",
            "tdpbf16ps tmm2, tmm5, tmm6\n",
            "tdpbf16ps tmm3, tmm5, tmm7"
        )
    };
}

/// Goes on to the next step.
macro_rules! go_on {
    () => {
        concat!("add {first}, {step}\n", "add {second}, {step}\n", "add {panel}, 2048")
    };
}

/// Rounds a row of sums, whose halves lie so many bytes behind `before`, and puts it into `out`.
macro_rules! put {
    ($second:literal, $first:literal) => {
        concat!(
            "vmovaps {x}, [{before} + ",
            $second,
            "]\n",
            "vcvtne2ps2bf16 {x}, {x}, [{before} + ",
            $first,
            "]\n",
            "vmovdqu64 [{out}], {x}\n",
            "add {out}, {columns}"
        )
    };
}

/// Stores the tiles of sums: two side by side, and two below them.
macro_rules! store {
    () => {
        concat!(
            "tilestored [{sums} + {width}*1], tmm0\n",
            "tilestored [{sums} + {width}*1 + 64], tmm1\n",
            "tilestored [{sums} + {width}*1 + 2048], tmm2\n",
            "tilestored [{sums} + {width}*1 + 2112], tmm3"
        )
    };
}

/// The sums of a block with a panel.
///
/// # Safety
/// Tiles are configured. The block has as many steps as the panel, at least one.
unsafe fn multiply_block(block: Block, panel: &[PairRow], sums: &mut Sums) {
    let steps = panel.len() / TILE;
    let (panel, sums) = (panel.as_ptr(), sums.0.as_mut_ptr());
    // SAFETY: the caller's promise; `sums` are four tiles, side by side and one above the other.
    unsafe {
        asm!(
            clear!(),
            "2:",
            multiply!(),
            go_on!(),
            "dec {steps}",
            "jnz 2b",
            store!(),
            first = inout(reg) block.tiles[0] => _,
            second = inout(reg) block.tiles[1] => _,
            panel = inout(reg) panel => _,
            steps = inout(reg) steps => _,
            row = in(reg) block.row,
            step = in(reg) block.step,
            width = in(reg) size_of::<PairRow>(),
            sums = in(reg) sums,
            out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
            out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
            options(nostack),
        );
    }
}

/// Steps in which a whole block is put, four rows in each.
const PUTS: usize = BLOCK / 4;

/// The same, and meanwhile rounds the sums `before` of a whole block and panel, and puts them into `out`, where rows are `columns` apart: that is done while
/// tiles multiply. Says how many rows are put: few steps leave no time for all.
///
/// # Safety
/// As for [`multiply_block`]; `out` has room for the block.
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn multiply_and_put(
    block: Block,
    panel: &[PairRow],
    sums: &mut Sums,
    before: &Sums,
    out: &mut [Bf16],
    columns: usize,
) -> usize {
    let steps = panel.len() / TILE;
    let puts = steps.min(PUTS);
    let (panel, sums) = (panel.as_ptr(), sums.0.as_mut_ptr());
    // SAFETY: the caller's promise; `sums` are four tiles, side by side and one above the other. `puts` steps read and write four rows each.
    unsafe {
        asm!(
            clear!(),
            "2:",
            "tileloadd tmm4, [{first} + {row}*1]",
            "tileloadd tmm6, [{panel} + {width}*1]",
            "tdpbf16ps tmm0, tmm4, tmm6",
            put!(64, 0),
            "tileloadd tmm7, [{panel} + {width}*1 + 64]",
            "tdpbf16ps tmm1, tmm4, tmm7",
            put!(192, 128),
            "tileloadd tmm5, [{second} + {row}*1]",
            "tdpbf16ps tmm2, tmm5, tmm6",
            put!(320, 256),
            "tdpbf16ps tmm3, tmm5, tmm7",
            put!(448, 384),
            "add {before}, 512",
            go_on!(),
            "dec {puts}",
            "jnz 2b",
            "test {steps}, {steps}",
            "jz 4f",
            "3:",
            multiply!(),
            go_on!(),
            "dec {steps}",
            "jnz 3b",
            "4:",
            store!(),
            first = inout(reg) block.tiles[0] => _,
            second = inout(reg) block.tiles[1] => _,
            panel = inout(reg) panel => _,
            puts = inout(reg) puts => _,
            steps = inout(reg) steps - puts => _,
            row = in(reg) block.row,
            step = in(reg) block.step,
            width = in(reg) size_of::<PairRow>(),
            sums = in(reg) sums,
            before = inout(reg) before.0.as_ptr() => _,
            out = inout(reg) out.as_mut_ptr() => _,
            columns = in(reg) columns * size_of::<Bf16>(),
            x = out(zmm_reg) _,
            out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
            out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
            options(nostack),
        );
    }
    4 * puts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes `rows` and `panel` over.
    #[target_feature(enable = "avx512f,avx512bw")]
    fn copy_both(
        rows: &[Bf16],
        inner: usize,
        panel: &[PairRow],
        by_row: &mut [Tile],
        by_column: &mut [Tile],
    ) {
        // SAFETY: compiled for both features.
        unsafe {
            copy_rows(rows, inner, by_row);
            transpose(panel, by_column);
        }
    }

    /// What needs no tiles itself.
    #[test]
    fn blocks_are_copied_row_by_row_and_column_by_column() {
        use std::arch::is_x86_feature_detected as has;
        if !has!("avx512f") || !has!("avx512bw") {
            return;
        }
        let inner = 37;
        let number = |row: usize, k: usize| Bf16((row * inner + k + 1) as u16);
        let rows: Vec<_> = (0..BLOCK * inner).map(|i| number(i / inner, i % inner)).collect();
        let columns: Vec<_> = (0..BLOCK * inner).map(|i| number(i % BLOCK, i / BLOCK)).collect();
        let mut packed = Packed::default();
        packed.pack(&columns, inner, BLOCK);
        let [mut by_row, mut by_column] = [(); 2].map(|()| vec![Tile::ZEROS; 4]);
        // SAFETY: the processor has both features.
        unsafe { copy_both(&rows, inner, packed.filled_panel(0), &mut by_row, &mut by_column) };
        for row in 0..BLOCK {
            for pair in 0..2 * TILE {
                let expected = [0, 1].map(|i| {
                    let k = 2 * pair + i;
                    if k < inner { u32::from(number(row, k).0) } else { 0 }
                });
                let expected = expected[0] | expected[1] << 16;
                let at = (2 * (pair / TILE) + row / TILE, row % TILE, pair % TILE);
                assert_eq!(by_row[at.0].0[at.1][at.2], expected, "row {row}, pair {pair}");
                assert_eq!(by_column[at.0].0[at.1][at.2], expected, "row {row}, pair {pair}");
            }
        }
    }
}
