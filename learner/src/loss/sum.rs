//! Sums of rows as libtorch makes them.
//!
//! A row goes into four times eight interleaved chains, and what is left over into a sum of its own. So that no chain becomes long, it is put aside after
//! some terms: cascade summation (Higham, "The accuracy of floating point summation", SIAM Journal on Scientific Computing 1993), as in libtorch's
//! `SumKernel.cpp` on a processor with AVX2.

/// Numbers in a register of AVX2.
const LANES: usize = 8;

/// Registers that are added to in turns.
const CHAINS: usize = 4;

const LEVELS: usize = 4;

/// So many terms, or more, are added before a chain is put aside.
pub(super) const TERMS: usize = 16;

/// Σ x.
#[inline(always)]
pub(super) fn sum(row: &[f32]) -> f32 {
    let (vectors, rest) = row.as_chunks::<LANES>();
    let (blocks, odd) = vectors.as_chunks::<CHAINS>();
    let mut levels = [[[0.0f32; LANES]; CHAINS]; LEVELS];
    let power = (usize::BITS - blocks.len().max(2).saturating_sub(1).leading_zeros()) as usize;
    let power = (power / LEVELS).max(TERMS.ilog2() as usize);
    let whole = blocks.len() >> power << power;
    for (index, block) in blocks.iter().enumerate() {
        add(&mut levels[0], block);
        let done = index + 1;
        if done > whole || !done.is_multiple_of(1 << power) {
            continue;
        }
        for level in 1..LEVELS {
            let below = std::mem::replace(&mut levels[level - 1], [[0.0; LANES]; CHAINS]);
            add(&mut levels[level], &below);
            if done >> (level * power) & ((1 << power) - 1) != 0 {
                break;
            }
        }
    }
    let [mut chains, above @ ..] = levels;
    for level in &above {
        add(&mut chains, level);
    }
    let [mut first, others @ ..] = chains;
    for vector in odd {
        add_lanes(&mut first, vector);
    }
    for chain in &others {
        add_lanes(&mut first, chain);
    }
    let rest = rest.iter().fold(0.0, |sum, x| sum + x);
    first.iter().fold(rest, |sum, x| sum + x)
}

#[inline(always)]
fn add(sums: &mut [[f32; LANES]; CHAINS], terms: &[[f32; LANES]; CHAINS]) {
    for (sums, terms) in sums.iter_mut().zip(terms) {
        add_lanes(sums, terms);
    }
}

#[inline(always)]
fn add_lanes(sums: &mut [f32; LANES], terms: &[f32; LANES]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term;
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use tch::{Device, Kind, Tensor};

    use super::*;

    #[test]
    fn sums_have_libtorchs_bits() {
        if !std::arch::is_x86_feature_detected!("avx2") {
            return;
        }
        tch::manual_seed(6);
        for len in (0..700).chain([1600, 4096, 16_384, 70_001]) {
            let rows = Tensor::randn([2, len], (Kind::Float, Device::Cpu));
            let theirs = rows.sum_dim_intlist(&[1i64][..], false, Kind::Float);
            let theirs = Vec::<f32>::try_from(theirs).expect("f32");
            let numbers = Vec::<f32>::try_from(rows.view([-1])).expect("f32");
            for (row, theirs) in theirs.iter().enumerate() {
                let ours = sum(&numbers[row * len as usize..][..len as usize]);
                assert_eq!(ours.to_bits(), theirs.to_bits(), "{len} numbers: {ours}, {theirs}");
            }
        }
    }
}
