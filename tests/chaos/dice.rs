//! Numbers that are the same for the same seed everywhere.

use proto::rng::philox4x32_10;

/// Draws from a seed.
#[derive(Debug)]
pub struct Dice {
    key: [u32; 2],
    stream: u32,
    drawn: u32,
}

impl Dice {
    /// The first numbers of a seed.
    pub fn new(seed: u64) -> Self {
        Self::of(seed, 0)
    }

    /// Those of one of its streams: what is drawn from one does not depend on the others.
    pub fn of(seed: u64, stream: u32) -> Self {
        Self { key: [seed as u32, (seed >> 32) as u32], stream, drawn: 0 }
    }

    /// 32 bits.
    pub fn word(&mut self) -> u32 {
        self.drawn += 1;
        philox4x32_10([self.drawn, self.stream, 0, 0], self.key)[0]
    }

    /// A number from `first` to `last`, both included.
    pub fn between(&mut self, first: usize, last: usize) -> usize {
        first + ((u64::from(self.word()) * (last - first + 1) as u64) >> 32) as usize
    }

    /// One of several.
    pub fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.between(0, all.len() - 1)]
    }
}
