//! Counter-based random numbers: every number is a pure function of its address.
//!
//! No generator has a state that could be lost, shared or advanced twice. A draw is addressed by
//! the run's seed, a [`Purpose`], and the iteration, environment, step and agent it belongs to, so
//! any process can make any draw, in any order, and gets the same bits.
//!
//! The bijection is Philox4x32-10 of Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as
//! easy as 1, 2, 3", SC 2011; the tests hold its published known answers.
//!
//! **Why not a stream** such as ChaCha's: a stream's position is a state, an address is not. Philox is four
//! multiplications a round and has published known answers.

/// What a random number is for; part of its address, so that two purposes never share a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Purpose {
    /// Initial parameters of the networks.
    Initialisation = 1,
    /// Goals of training episodes.
    Goal = 2,
    /// Exploration noise of the stochastic policy.
    ActionNoise = 3,
    /// Permutation of samples into mini-batches.
    Permutation = 4,
    /// Goals of evaluation episodes: held out, because no training draw has this purpose.
    EvaluationGoal = 5,
    /// Initial states of episodes.
    InitialState = 6,
    /// Uniform actions of an exploring deterministic actor.
    RandomAction = 7,
    /// Samples that are drawn from a replay.
    Replay = 8,
    /// Errors of the sensors.
    SensorNoise = 9,
    /// Torques that disturb the joints, in experiments alone.
    JointDisturbance = 10,
    /// Resamples of runs, in statistics alone.
    Bootstrap = 11,
    /// Detours that a planner tries.
    Detour = 12,
    /// Which blocks of other machines are made a second time and compared; no number that trains.
    Audit = 13,
    /// What errs in a training episode, and by how much.
    Randomization = 14,
}

/// The address of four 32-bit random words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Address {
    /// Seed of the run.
    pub seed: u64,
    /// What the words are for.
    pub purpose: Purpose,
    /// Iteration of the run (or epoch, or tensor index, as the purpose has it).
    pub iteration: u32,
    /// Global environment index.
    pub env: u32,
    /// Control step within the episode.
    pub step: u32,
    /// What tells draws of one step apart (agent, group of four words), as the purpose has it: below 2^24.
    pub index: u32,
}

impl Address {
    /// Four uniform 32-bit words.
    #[inline]
    pub fn words(self) -> [u32; 4] {
        assert!(self.index < 1 << 24, "index {} does not fit in 24 bits", self.index);
        philox4x32_10(
            [self.step, self.index | (self.purpose as u32) << 24, self.env, self.iteration],
            [self.seed as u32, (self.seed >> 32) as u32],
        )
    }

    /// Four uniform numbers in [0, 1), multiples of 2⁻²⁴, exact in `f32`.
    #[inline]
    pub fn uniforms(self) -> [f32; 4] {
        self.words().map(|word| (word >> 8) as f32 * (1.0 / 16_777_216.0))
    }

    /// Four standard normal numbers (Box and Muller 1958), computed in `f64`, rounded to `f32`.
    #[inline]
    pub fn normals(self) -> [f32; 4] {
        let [a, b, c, d] = self.words();
        let [x, y] = box_muller(a, b);
        let [z, w] = box_muller(c, d);
        [x, y, z, w]
    }
}

fn box_muller(a: u32, b: u32) -> [f32; 2] {
    const SCALE: f64 = 1.0 / 4_294_967_296.0;
    // The half keeps the logarithm away from zero.
    let radius = libm::sqrt(-2.0 * libm::log((f64::from(a) + 0.5) * SCALE));
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(b) * SCALE);
    [(radius * cos) as f32, (radius * sin) as f32]
}

/// Ten rounds of Philox on a 128-bit counter under a 64-bit key.
#[inline]
pub fn philox4x32_10(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for round in 0..10 {
        if round > 0 {
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        let low = u64::from(counter[0]) * 0xD251_1F53;
        let high = u64::from(counter[2]) * 0xCD9E_8D57;
        counter = [
            (high >> 32) as u32 ^ counter[1] ^ key[0],
            high as u32,
            (low >> 32) as u32 ^ counter[3] ^ key[1],
            low as u32,
        ];
    }
    counter
}

/// The permutation of `0..n` for `address`, by Fisher and Yates with rejection-free scaling.
///
/// `step` of the address is not used: it counts groups of four draws.
pub fn permutation(address: Address, n: usize) -> Vec<i64> {
    let mut items: Vec<i64> = (0..n as i64).collect();
    let mut words = [0; 4];
    for (draw, last) in (1..n).rev().enumerate() {
        if draw % 4 == 0 {
            words = Address { step: (draw / 4) as u32, ..address }.words();
        }
        // Lemire's multiply-shift; its bias of n / 2^32 is far below what a permutation can show.
        let pick = (u64::from(words[draw % 4]) * (last as u64 + 1)) >> 32;
        items.swap(last, pick as usize);
    }
    items
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_meets_the_published_known_answers() {
        // kat_vectors of Random123 1.14, philox4x32 10.
        let cases = [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], [u32::MAX; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, key, expected) in cases {
            assert_eq!(philox4x32_10(counter, key), expected);
        }
    }

    fn address(step: u32) -> Address {
        Address { seed: 7, purpose: Purpose::ActionNoise, iteration: 3, env: 5, step, index: 1 }
    }

    #[test]
    fn normals_have_the_moments_of_a_standard_normal() {
        let samples: Vec<f64> =
            (0..25_000).flat_map(|step| address(step).normals()).map(f64::from).collect();
        let moment =
            |power: i32| samples.iter().map(|x| x.powi(power)).sum::<f64>() / samples.len() as f64;
        // Standard errors at n = 100,000: 0.0032, 0.0045, 0.0122 (√15/n … ), 0.031; five of each.
        assert!(moment(1).abs() < 0.016, "mean {}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.0225, "variance {}", moment(2));
        assert!(moment(3).abs() < 0.061, "third moment {}", moment(3));
        assert!((moment(4) - 3.0).abs() < 0.155, "fourth moment {}", moment(4));
    }

    #[test]
    fn a_permutation_holds_every_index_once_and_depends_on_its_address() {
        let first = permutation(address(0), 1000);
        let mut sorted = first.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..1000).collect::<Vec<_>>());
        assert_eq!(first, permutation(address(9), 1000), "the step of the address is not used");
        assert_ne!(first, permutation(Address { iteration: 4, ..address(0) }, 1000));
    }
}
