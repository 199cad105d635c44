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

use super::native::Tiles;
use super::operands::{Left, Out};
use super::packed::Packed;
use super::panel::{PANEL, PairRow, TILE};
use super::registers::LANES;
use super::sums::{Put, Rows, for_each_out};
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
pub(super) fn multiply(_: Tiles, left: Left<'_>, right: &Packed, out: Out<'_>, rows: usize) {
    // SAFETY: there is no `Tiles` without these features, nor without the kernel's leave to use tiles.
    unsafe { for_each_out!(out, put => multiply_compiled(left, right, &mut put, rows)) };
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16")]
fn multiply_compiled<P: Put>(left: Left<'_>, right: &Packed, out: &mut P, rows: usize) {
    let (inner, columns) = (right.rows(), right.columns());
    let steps = inner.div_ceil(STEP);
    let mut copy = Vec::new();
    let mut sums = [const { Sums([[0.0; PANEL]; BLOCK]) }; 2];
    // SAFETY: `multiply` stands for the features. Tiles are configured as long as they are used, and blocks and panels have `steps` steps.
    unsafe {
        let _configured = Configured::new();
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
                let (column, count) = match panel.checked_sub(1) {
                    Some(before) => (before * PANEL, count),
                    None => (0, 0),
                };
                let next = out.begin(Rows { count, first: row, column, columns });
                let mut waiting = Waiting::<P> { sums: &before.0[..count], next };
                if panel < right.panels() {
                    let pairs = right.filled_panel(panel);
                    debug_assert_eq!(pairs.len(), steps * TILE);
                    multiply_block(block, pairs, made, &mut waiting);
                }
                waiting.put(BLOCK);
            }
        }
    }
}

/// Sums of rows with a panel, which wait to be put.
struct Waiting<'s, P: Put> {
    sums: &'s [[f32; PANEL]],
    next: P::Next,
}

impl<P: Put> Waiting<'_, P> {
    /// Puts so many rows, if there are as many.
    ///
    /// # Safety
    /// As for [`Put::put`], which is told of all these rows. Rows of sums begin cache lines.
    #[inline(always)]
    unsafe fn put(&mut self, count: usize) {
        for _ in 0..count {
            let Some((row, others)) = self.sums.split_first() else { return };
            // SAFETY: the caller's promise.
            unsafe {
                let first = _mm512_load_ps(row.as_ptr());
                let second = _mm512_load_ps(row.as_ptr().add(LANES));
                P::put(&mut self.next, [first, second]);
            }
            self.sums = others;
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

/// Tiles as they are configured for products, until it is dropped.
struct Configured {
    found: Configuration,
}

impl Configured {
    /// Takes eight whole tiles. What was configured before comes back at the end: a library that is in between two products of its own may not look again.
    ///
    /// # Safety
    /// The processor has tiles, and the process may use them. Nobody's numbers are in them.
    unsafe fn new() -> Self {
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
        Self { found }
    }
}

impl Drop for Configured {
    /// Configures tiles as they were found. What was in them is gone.
    fn drop(&mut self) {
        // SAFETY: who made it promised that there are tiles.
        unsafe {
            asm!(
                "ldtilecfg [{found}]",
                found = in(reg) &raw const self.found,
                options(nostack, preserves_flags, readonly),
            );
        }
    }
}

/// Products of tiles in a step, between which other sums are put.
const PRODUCTS: usize = 4;

/// The sums of a block with a panel. Meanwhile `waiting` is put: tiles multiply by themselves, and leave the vector instructions to others.
///
/// The compiler has no use for tiles of its own, so that what is in one stays there from one instruction to the next.
///
/// # Safety
/// Tiles are configured. The block has as many steps as the panel, at least one. Called from code that is compiled for AVX-512 with bfloat16.
#[inline(always)]
unsafe fn multiply_block<P: Put>(
    block: Block,
    panel: &[PairRow],
    sums: &mut Sums,
    waiting: &mut Waiting<'_, P>,
) {
    let steps = panel.len() / TILE;
    let rows = BLOCK.div_ceil(PRODUCTS * steps);
    let [mut first, mut second] = block.tiles;
    let width = size_of::<PairRow>();
    // SAFETY: the caller's promise; `sums` are four tiles, side by side and one above the other.
    unsafe {
        asm!(
            "tilezero tmm0",
            "tilezero tmm1",
            "tilezero tmm2",
            "tilezero tmm3",
            out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
            options(nostack, nomem, preserves_flags),
        );
        for panel in panel.chunks_exact(TILE) {
            let panel = panel.as_ptr();
            asm!(
                "tileloadd tmm4, [{first} + {row}*1]",
                "tileloadd tmm6, [{panel} + {width}*1]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                first = in(reg) first, row = in(reg) block.row, panel = in(reg) panel, width = in(reg) width,
                out("tmm0") _, out("tmm4") _, out("tmm6") _,
                options(nostack, preserves_flags, readonly),
            );
            waiting.put(rows);
            asm!(
                "tileloadd tmm7, [{panel} + {width}*1 + 64]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                panel = in(reg) panel, width = in(reg) width,
                out("tmm1") _, out("tmm7") _,
                options(nostack, preserves_flags, readonly),
            );
            waiting.put(rows);
            asm!(
                "tileloadd tmm5, [{second} + {row}*1]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                second = in(reg) second, row = in(reg) block.row,
                out("tmm2") _, out("tmm5") _,
                options(nostack, preserves_flags, readonly),
            );
            waiting.put(rows);
            asm!(
                "tdpbf16ps tmm3, tmm5, tmm7",
                out("tmm3") _,
                options(nostack, nomem, preserves_flags),
            );
            waiting.put(rows);
            first = first.wrapping_add(block.step);
            second = second.wrapping_add(block.step);
        }
        asm!(
            "tilestored [{sums} + {width}*1], tmm0",
            "tilestored [{sums} + {width}*1 + 64], tmm1",
            "tilestored [{sums} + {width}*1 + 2048], tmm2",
            "tilestored [{sums} + {width}*1 + 2112], tmm3",
            sums = in(reg) sums.0.as_mut_ptr(), width = in(reg) width,
            options(nostack, preserves_flags),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A library of its own tiles finds them as they were, also after a panic.
    #[test]
    fn tiles_are_left_as_they_were_found() {
        if !crate::product::Native::all()
            .iter()
            .any(|native| matches!(native, crate::product::Native::Tiles(_)))
        {
            return;
        }
        // SAFETY: there are tiles, and nobody's numbers are in them.
        let palette = || unsafe { Configured::new() }.found.palette;
        assert_eq!(palette(), 0);
        let panic = std::panic::catch_unwind(|| {
            // SAFETY: as above.
            let _configured = unsafe { Configured::new() };
            assert_eq!(palette(), 1);
            panic!("in between");
        });
        assert!(panic.is_err());
        assert_eq!(palette(), 0);
    }
}
