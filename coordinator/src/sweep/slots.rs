//! How many trials are under way at a time, and which processors each of them has for itself.

use process::child::{on_processors, processors};
use proto::ExitError;

/// Places for trials.
#[derive(Debug, Clone)]
pub(super) struct Slots {
    /// Processors of each; none where trials share them all.
    processors: Vec<Option<Vec<usize>>>,
    /// Threads that one of them has work for.
    threads: usize,
}

impl Slots {
    /// So many as are asked for, or as there are processors for, where a trial takes `needed` of them.
    pub(super) fn new(
        jobs: Option<usize>,
        needed: usize,
        trials: usize,
    ) -> Result<Self, ExitError> {
        // A quota of processor time counts, too, though it names no processors.
        let available = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Ok(Self::among(&processors()?, available, jobs, needed, trials))
    }

    fn among(
        processors: &[usize],
        available: usize,
        jobs: Option<usize>,
        needed: usize,
        trials: usize,
    ) -> Self {
        let jobs = jobs.unwrap_or_else(|| (available / needed.max(1)).max(1)).min(trials.max(1));
        let own = processors.len() / jobs;
        // With a quota, or more trials than processors, none has one for itself.
        if jobs == 1 || own == 0 || available < processors.len() {
            let threads = (available / jobs).max(1);
            return Self { processors: vec![None; jobs], threads };
        }
        let of = |slot: usize| processors[slot * own..(slot + 1) * own].to_vec();
        Self { processors: (0..jobs).map(|slot| Some(of(slot))).collect(), threads: own }
    }

    /// How many there are.
    pub(super) fn count(&self) -> usize {
        self.processors.len()
    }

    /// Threads that one of them has work for.
    pub(super) fn threads(&self) -> usize {
        self.threads
    }

    /// Whether each has processors of its own.
    pub(super) fn are_apart(&self) -> bool {
        self.processors.iter().all(Option::is_some)
    }

    /// Starts something in a slot.
    pub(super) fn within<T>(&self, slot: usize, start: impl FnOnce() -> T) -> Result<T, ExitError> {
        match &self.processors[slot] {
            None => Ok(start()),
            Some(own) => on_processors(own, start),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_have_processors_of_their_own_as_far_as_there_are_some() {
        let of = |available: usize, jobs, needed, trials| {
            let all: Vec<usize> = (10..18).collect();
            Slots::among(&all, available, jobs, needed, trials)
        };
        let four = of(8, None, 2, 9);
        assert_eq!((four.count(), four.threads()), (4, 2));
        assert_eq!(four.processors[3], Some(vec![16, 17]));
        // What is left over is nobody's.
        let two = of(8, None, 3, 9);
        assert_eq!(two.processors, [Some(vec![10, 11, 12, 13]), Some(vec![14, 15, 16, 17])]);
        assert_eq!(of(8, Some(3), 3, 9).processors[2], Some(vec![14, 15]));
        let few = of(8, None, 2, 2);
        assert_eq!((few.count(), few.threads()), (2, 4));
        for (shared, count) in
            [(of(8, Some(9), 2, 20), 9), (of(8, None, 16, 9), 1), (of(4, None, 2, 9), 2)]
        {
            assert_eq!((shared.count(), shared.are_apart()), (count, false));
            assert!(shared.threads() >= 1);
        }
    }
}
