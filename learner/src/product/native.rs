//! What the processor multiplies bfloat16 with.

#[cfg(target_arch = "x86_64")]
use crate::features::Features;

/// What it has: nobody but [`Native::detect`] can make one. Without AVX-512 it has nothing, and nobody can make one at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Native {
    #[cfg(target_arch = "x86_64")]
    Pairs(Pairs),
    #[cfg(target_arch = "x86_64")]
    Tiles(Tiles),
    /// Every processor can do this, slowly. It shows whether what surrounds the instructions is right.
    #[cfg(test)]
    Plain,
}

/// Instructions for pairs of numbers (AVX-512 BF16).
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pairs(());

/// Those and instructions for tiles of numbers (AMX), which this process may use.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Tiles(());

impl Native {
    /// The fastest that this processor has, if it has any.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn detect() -> Option<Self> {
        Self::tiles().or_else(Self::pairs)
    }

    /// Other processors have none.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn detect() -> Option<Self> {
        None
    }

    /// All that can be tested here.
    #[cfg(test)]
    pub(crate) fn all() -> Vec<Self> {
        let all = [Some(Self::Plain)].into_iter();
        #[cfg(target_arch = "x86_64")]
        let all = all.chain([Self::pairs(), Self::tiles()]);
        all.flatten().collect()
    }

    #[cfg(target_arch = "x86_64")]
    fn pairs() -> Option<Self> {
        let has_pairs = matches!(Features::detect(), Features::Avx512Bf16(_));
        has_pairs.then_some(Self::Pairs(Pairs(())))
    }

    /// Asks the kernel for leave to use them, too. Leaf 7, bits 24 and 22 of EDX: tiles, and products of bfloat16 in them. With AVX-512 there is that leaf.
    #[cfg(target_arch = "x86_64")]
    fn tiles() -> Option<Self> {
        Self::pairs()?;
        let features = std::arch::x86_64::__cpuid_count(7, 0).edx;
        let has_tiles = features >> 24 & 1 == 1 && features >> 22 & 1 == 1;
        (has_tiles && may_use_tiles()).then_some(Self::Tiles(Tiles(())))
    }
}

/// Asks the kernel for tiles' eight kilobytes of state in each thread (Linux, `Documentation/arch/x86/xstate.rst`). Whoever uses tiles without is killed.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
#[expect(unsafe_code, reason = "no safe function stands for this system call")]
fn may_use_tiles() -> bool {
    const REQUEST_PERMISSION: libc::c_ulong = 0x1023;
    const TILE_DATA: libc::c_ulong = 18;
    // SAFETY: it reads and writes no memory of ours.
    unsafe { libc::syscall(libc::SYS_arch_prctl, REQUEST_PERMISSION, TILE_DATA) == 0 }
}

/// Elsewhere that is not known.
#[cfg(all(target_arch = "x86_64", not(target_os = "linux")))]
fn may_use_tiles() -> bool {
    false
}
