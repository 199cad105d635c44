//! Lane groups side by side in a register.
//!
//! A shard of eight environments is a lane group, and fills half of a register of 512 bits. Groups of actors that share a network stand side by side in
//! one: their weights are the same.

use crate::scalar::{LANES, Real};

/// At most so many lane groups fill a register.
pub(super) const MAX_JOINED: usize = LANES;

/// How many lane groups fill a register.
#[inline(always)]
pub(super) fn joined<S: Real>() -> usize {
    S::Register::LANES / S::LANES
}

/// How lane groups stand in registers.
pub(super) trait Packing<S: Real> {
    type Register: Real;
    /// Groups in a register.
    const GROUPS: usize;
    /// One number of each group in a register; their rows are `stride` apart.
    fn join(rows: &[S], stride: usize) -> Self::Register;
    /// What group `i` of a register has.
    fn part(register: Self::Register, i: usize) -> S;
}

/// So many groups as a register has room for.
pub(super) struct Full;

impl<S: Real> Packing<S> for Full {
    type Register = S::Register;
    const GROUPS: usize = S::Register::LANES / S::LANES;

    #[inline(always)]
    fn join(rows: &[S], stride: usize) -> S::Register {
        S::join(rows, stride)
    }

    #[inline(always)]
    fn part(register: S::Register, i: usize) -> S {
        S::part(register, i)
    }
}

/// One group.
pub(super) struct Single;

impl<S: Real> Packing<S> for Single {
    type Register = S;
    const GROUPS: usize = 1;

    #[inline(always)]
    fn join(rows: &[S], _: usize) -> S {
        rows[0]
    }

    #[inline(always)]
    fn part(register: S, _: usize) -> S {
        register
    }
}
