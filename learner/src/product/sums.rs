//! What becomes of sixteen sums.
#![expect(unsafe_code, reason = "instructions of detected processor features")]

use std::arch::x86_64::{
    __m256bh, __m256i, __m512, __m512bh, __m512i, _mm256_mask_storeu_epi16, _mm512_add_ps,
    _mm512_castsi512_ps, _mm512_castsi512_si256, _mm512_cvtepu16_epi32, _mm512_cvtne2ps_pbh,
    _mm512_cvtneps_pbh, _mm512_extracti64x4_epi64, _mm512_loadu_ps, _mm512_mask_storeu_ps,
    _mm512_maskz_loadu_ps, _mm512_slli_epi32, _mm512_storeu_ps, _mm512_storeu_si512,
};

use super::operands::Out;
use crate::number::Bf16;

/// Numbers in a register; a panel's row takes two.
pub(super) const LANES: usize = 16;

/// Rounds sixteen sums and puts the first `left` of them at `at`.
///
/// # Safety
/// Called from code that is compiled for AVX-512 with bfloat16.
#[inline(always)]
pub(super) unsafe fn put(sums: __m512, out: &mut Out<'_>, at: usize, left: usize) {
    let len = left.min(LANES);
    let mask = (0xffff_u32 >> (LANES - len)) as u16;
    // SAFETY: the caller's promise; what the mask leaves of sixteen numbers lies within the slice of `len`. The transmuted types are
    // of one size, and every bit pattern is a value of both.
    unsafe {
        let rounded = std::mem::transmute::<__m256bh, __m256i>(_mm512_cvtneps_pbh(sums));
        let widened = _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_cvtepu16_epi32(rounded)));
        match out {
            Out::Rounded(out) => {
                let out: &mut [Bf16] = &mut out[at..at + len];
                _mm256_mask_storeu_epi16(out.as_mut_ptr().cast(), mask, rounded);
            }
            Out::Widened(out) => {
                _mm512_mask_storeu_ps(out[at..at + len].as_mut_ptr(), mask, widened);
            }
            Out::Added(out) => {
                let out = &mut out[at..at + len];
                let sum = _mm512_add_ps(_mm512_maskz_loadu_ps(mask, out.as_ptr()), widened);
                _mm512_mask_storeu_ps(out.as_mut_ptr(), mask, sum);
            }
        }
    }
}

/// Rounds twice sixteen sums and puts them at `at`, side by side.
///
/// # Safety
/// As for [`put`].
#[inline(always)]
pub(super) unsafe fn put_both([first, second]: [__m512; 2], out: &mut Out<'_>, at: usize) {
    const BOTH: usize = 2 * LANES;
    // SAFETY: the caller's promise; the slices hold what is read and written. The transmuted types are of one size, and every bit pattern is a
    // value of both.
    unsafe {
        let rounded = std::mem::transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(second, first));
        let widened = |half: __m256i| {
            _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_cvtepu16_epi32(half)))
        };
        let halves = [
            widened(_mm512_castsi512_si256(rounded)),
            widened(_mm512_extracti64x4_epi64::<1>(rounded)),
        ];
        match out {
            Out::Rounded(out) => {
                let out: &mut [Bf16] = &mut out[at..at + BOTH];
                _mm512_storeu_si512(out.as_mut_ptr().cast(), rounded);
            }
            Out::Widened(out) => {
                for (out, half) in out[at..at + BOTH].chunks_exact_mut(LANES).zip(halves) {
                    _mm512_storeu_ps(out.as_mut_ptr(), half);
                }
            }
            Out::Added(out) => {
                for (out, half) in out[at..at + BOTH].chunks_exact_mut(LANES).zip(halves) {
                    let sum = _mm512_add_ps(_mm512_loadu_ps(out.as_ptr()), half);
                    _mm512_storeu_ps(out.as_mut_ptr(), sum);
                }
            }
        }
    }
}
