//! Numbers of a panel's row in two registers, and in memory.
#![expect(unsafe_code, reason = "instructions of detected processor features")]

use std::arch::x86_64::{
    __m512, __m512bh, __m512i, _mm512_add_ps, _mm512_castsi512_ps, _mm512_castsi512_si256,
    _mm512_cvtepu16_epi32, _mm512_cvtne2ps_pbh, _mm512_extracti64x4_epi64, _mm512_loadu_ps,
    _mm512_loadu_si512, _mm512_mask_storeu_epi16, _mm512_mask_storeu_ps, _mm512_maskz_loadu_epi16,
    _mm512_maskz_loadu_ps, _mm512_slli_epi32, _mm512_storeu_ps, _mm512_storeu_si512,
};

use crate::number::Bf16;

/// Numbers in a register; a panel's row takes two.
pub(super) const LANES: usize = 16;

/// Both registers of a panel's row.
pub(super) const BOTH: usize = 2 * LANES;

/// Masks of the first `len` of twice sixteen.
#[inline(always)]
fn masks(len: usize) -> [u16; 2] {
    let mask = u32::MAX >> (BOTH - len);
    [mask as u16, (mask >> LANES) as u16]
}

/// So many numbers, and zeros.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16; they can be read.
#[inline(always)]
pub(super) unsafe fn load(first: *const f32, len: usize) -> [__m512; 2] {
    let second = first.wrapping_add(LANES);
    // SAFETY: the caller's promise.
    unsafe {
        if len == BOTH {
            return [_mm512_loadu_ps(first), _mm512_loadu_ps(second)];
        }
        let masks = masks(len);
        [_mm512_maskz_loadu_ps(masks[0], first), _mm512_maskz_loadu_ps(masks[1], second)]
    }
}

/// The same, of bfloat16.
///
/// # Safety
/// As for [`load`].
#[inline(always)]
pub(super) unsafe fn load_widened(from: *const Bf16, len: usize) -> [__m512; 2] {
    // SAFETY: as above.
    unsafe {
        let numbers = if len == BOTH {
            _mm512_loadu_si512(from.cast())
        } else {
            _mm512_maskz_loadu_epi16(u32::MAX >> (BOTH - len), from.cast())
        };
        widened(numbers)
    }
}

/// Stores so many numbers.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16; there is room for them.
#[inline(always)]
pub(super) unsafe fn store(numbers: [__m512; 2], first: *mut f32, len: usize) {
    let second = first.wrapping_add(LANES);
    // SAFETY: the caller's promise.
    unsafe {
        if len == BOTH {
            _mm512_storeu_ps(first, numbers[0]);
            _mm512_storeu_ps(second, numbers[1]);
        } else {
            let masks = masks(len);
            _mm512_mask_storeu_ps(first, masks[0], numbers[0]);
            _mm512_mask_storeu_ps(second, masks[1], numbers[1]);
        }
    }
}

/// Adds so many numbers.
///
/// # Safety
/// As for [`store`].
#[inline(always)]
pub(super) unsafe fn add(numbers: [__m512; 2], to: *mut f32, len: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        let sums = load(to, len);
        store([_mm512_add_ps(sums[0], numbers[0]), _mm512_add_ps(sums[1], numbers[1])], to, len);
    }
}

/// Rounds so many numbers and stores them.
///
/// # Safety
/// As for [`store`].
#[inline(always)]
pub(super) unsafe fn store_rounded([first, second]: [__m512; 2], to: *mut Bf16, len: usize) {
    // SAFETY: the caller's promise. The transmuted types are of one size, and every bit pattern is a value of both.
    unsafe {
        let rounded = std::mem::transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(second, first));
        if len == BOTH {
            _mm512_storeu_si512(to.cast(), rounded);
        } else {
            _mm512_mask_storeu_epi16(to.cast(), u32::MAX >> (BOTH - len), rounded);
        }
    }
}

/// Rounds numbers to bfloat16, and widens them.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16.
#[inline(always)]
pub(super) unsafe fn rounded([first, second]: [__m512; 2]) -> [__m512; 2] {
    // SAFETY: the caller's promise. Transmuted as above.
    unsafe { widened(std::mem::transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(second, first))) }
}

/// Widens bfloat16.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16.
#[inline(always)]
unsafe fn widened(numbers: __m512i) -> [__m512; 2] {
    // SAFETY: the caller's promise.
    unsafe {
        let first = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(numbers));
        let second = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64::<1>(numbers));
        [
            _mm512_castsi512_ps(_mm512_slli_epi32::<16>(first)),
            _mm512_castsi512_ps(_mm512_slli_epi32::<16>(second)),
        ]
    }
}
