//! Law of a run: every env-step is accounted for.

use std::collections::BTreeMap;

use proto::message::{Accounting, IterationReport};
use proto::{ExitCode, ExitError};
use service::live::Totals;

/// Env-steps by iteration, as far as the coordinator has heard of them.
#[derive(Debug, Default)]
pub(super) struct StepAccounts {
    /// Env-steps that workers said they produced.
    produced: BTreeMap<u64, u64>,
    /// Env-steps that died with workers.
    lost: BTreeMap<u64, u64>,
    /// Env-steps that hosts made for comparison: those that were the same, and the others.
    compared: BTreeMap<u64, u64>,
    differing: BTreeMap<u64, u64>,
    /// Of the last iterations that are over: what workers said they produced, and what of it stands in their accounts.
    closed: BTreeMap<u64, Closed>,
    /// Env-steps of blocks of which their workers spoke after their iteration was over, and that nobody took.
    late: u64,
    /// Sums of this session.
    pub(super) totals: Totals,
}

#[derive(Debug)]
struct Closed {
    said: u64,
    counted: u64,
}

/// Iterations that are over and of which workers may still speak.
const KEPT: usize = 4;

impl StepAccounts {
    /// A worker says that it has sent a block.
    pub(super) fn produced(&mut self, iteration: u64, env_steps: u64) {
        if let Some(Closed { said, counted }) = self.closed.get_mut(&iteration) {
            // Of a block that was trained on, its worker may speak late; of more than have come, one was made in vain.
            *said += env_steps;
            self.late += said.saturating_sub(*counted);
            *counted = (*said).max(*counted);
            return;
        }
        if self.closed.keys().next().is_some_and(|first| iteration < *first) {
            return;
        }
        *self.produced.entry(iteration).or_default() += env_steps;
    }

    /// A block died with its worker.
    pub(super) fn lost(&mut self, iteration: u64, env_steps: u64) {
        *self.lost.entry(iteration).or_default() += env_steps;
    }

    /// A host has made a block for comparison, with the same bits: a second copy, and dropped.
    pub(super) fn compared(&mut self, iteration: u64, env_steps: u64) {
        *self.compared.entry(iteration).or_default() += env_steps;
    }

    /// A host has made a block for comparison with other bits.
    pub(super) fn differs(&mut self, iteration: u64, env_steps: u64) {
        *self.differing.entry(iteration).or_default() += env_steps;
    }

    /// All processes are gone, and with them `env_steps` that the learner had received and not
    /// trained on.
    pub(super) fn all_lost(&mut self, env_steps: u64) {
        let died: u64 = self.lost.values().chain(self.differing.values()).sum();
        let died = died + std::mem::take(&mut self.late);
        // They may be trained on again.
        self.closed.clear();
        let compared: u64 = self.compared.values().sum();
        self.totals.produced += env_steps + died + compared;
        self.totals.received += env_steps + compared;
        self.totals.duplicate += compared;
        self.totals.lost += env_steps + died;
        for map in [&mut self.produced, &mut self.lost, &mut self.compared, &mut self.differing] {
            map.clear();
        }
    }

    /// Completes an iteration's account, which must add up to `planned` trained env-steps.
    pub(super) fn close(
        &mut self,
        report: &mut IterationReport,
        planned: u64,
    ) -> Result<(), ExitError> {
        let iteration = report.iteration;
        let accounting: &mut Accounting = &mut report.accounting;
        let said = self.produced.remove(&iteration).unwrap_or(0);
        let died = self.lost.remove(&iteration).unwrap_or(0);
        // A worker that died between sending a block and saying so produced it all the same; one
        // that said so but whose block never arrived lost it.
        accounting.lost = died.max(said.saturating_sub(accounting.received));
        let counted = said.max(accounting.received);
        self.closed.insert(iteration, Closed { said, counted });
        while self.closed.len() > KEPT {
            self.closed.pop_first();
        }
        accounting.lost += std::mem::take(&mut self.late);
        // What was compared did not go by the learner.
        accounting.lost += self.differing.remove(&iteration).unwrap_or(0);
        let compared = self.compared.remove(&iteration).unwrap_or(0);
        accounting.received += compared;
        accounting.duplicate += compared;
        accounting.produced = accounting.received + accounting.lost;
        if accounting.trained != planned
            || accounting.received != accounting.trained + accounting.duplicate
        {
            return Err(ExitError::new(
                ExitCode::Failure,
                format!("iteration {iteration} does not add up: {accounting:?}, planned {planned}"),
            ));
        }
        self.totals.add(accounting);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closed(books: &mut StepAccounts, iteration: u64, received: u64) -> Accounting {
        let mut report = IterationReport { iteration, ..IterationReport::default() };
        let duplicate = received - 128;
        report.accounting =
            Accounting { received, trained: 128, duplicate, ..Accounting::default() };
        books.close(&mut report, 128).expect("adds up");
        report.accounting
    }

    #[test]
    fn a_block_that_comes_when_its_iteration_is_over_is_lost_once() {
        let mut books = StepAccounts::default();
        // Four blocks are ordered, one of them twice; the learner has taken four when it trains.
        books.produced(3, 96);
        assert_eq!(closed(&mut books, 3, 128).lost, 0);
        // A word about one that it has taken, then one about the copy.
        books.produced(3, 32);
        books.produced(3, 32);
        let next = closed(&mut books, 4, 128);
        assert_eq!((next.lost, next.produced), (32, 160));
        // Of the copy its worker spoke in time.
        books.produced(5, 160);
        assert_eq!(closed(&mut books, 5, 128).lost, 32);
        assert_eq!(closed(&mut books, 6, 128).lost, 0);
        for iteration in 7..12 {
            closed(&mut books, iteration, 128);
        }
        books.produced(3, 32);
        assert!(books.produced.is_empty() && books.closed.len() == KEPT);
    }

    #[test]
    fn what_hosts_made_for_comparison_is_a_duplicate_or_lost() {
        let mut books = StepAccounts::default();
        books.produced(3, 128);
        books.produced(3, 32);
        books.compared(3, 64);
        books.differs(3, 16);
        books.lost(3, 8);
        let mut report = IterationReport { iteration: 3, ..IterationReport::default() };
        report.accounting = Accounting { received: 128, trained: 128, ..Accounting::default() };
        books.close(&mut report, 128).expect("adds up");
        // Of what was said to be sent 32 did not arrive, and of the comparisons 16 were wrong.
        let Accounting { produced, received, trained, duplicate, lost } = report.accounting;
        assert_eq!((received, trained, duplicate, lost), (192, 128, 64, 48));
        assert_eq!(produced, trained + duplicate + lost);
        assert_eq!(books.totals.produced, produced);
        // Once.
        let mut next = IterationReport { iteration: 4, ..IterationReport::default() };
        next.accounting = Accounting { received: 128, trained: 128, ..Accounting::default() };
        books.close(&mut next, 128).expect("adds up");
        assert_eq!(next.accounting.produced, 128);
    }
}
