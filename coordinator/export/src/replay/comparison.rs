//! Numbers held against each other, bit by bit.

use serde::Serialize;

/// What came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Replay {
    /// Control steps that were kept.
    pub steps: usize,
    /// Numbers that were compared.
    pub numbers: u64,
    /// The first that differs.
    pub first: Option<Difference>,
}

/// A number that differs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Control steps since the beginning.
    pub step: usize,
    /// Which number.
    pub what: String,
    /// As it was kept.
    pub recorded: f32,
    /// As it is now.
    pub replayed: f32,
}

impl Replay {
    pub(super) fn new(steps: usize) -> Self {
        Self { steps, numbers: 0, first: None }
    }

    /// Holds numbers against each other, bit by bit, and says whether they are the same; `name` says which one it is.
    pub(super) fn compare(
        &mut self,
        step: usize,
        recorded: &[f32],
        replayed: &[f32],
        name: impl Fn(usize) -> String,
    ) -> bool {
        self.numbers += recorded.len() as u64;
        let mut pairs = recorded.iter().zip(replayed).enumerate();
        let differs = |(_, (a, b)): &(usize, (&f32, &f32))| a.to_bits() != b.to_bits();
        let Some((index, (&recorded, &replayed))) = pairs.find(differs) else { return true };
        self.first = Some(Difference { step, what: name(index), recorded, replayed });
        false
    }
}
