//! What happens to a run, drawn from a seed.

use std::fmt;
use std::time::Duration;

use rustix::process::Signal;

use super::dice::Dice;

/// Something that is done to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// SIGKILL to a worker.
    KillWorker,
    /// SIGKILL to the learner.
    KillLearner,
    /// SIGKILL to the coordinator, then `octopus resume` with so many workers.
    KillCoordinator(usize),
    /// SIGSTOP to a worker: it lives, but does nothing any more.
    HangWorker,
    /// SIGSTOP to the coordinator, and SIGCONT after so long: nobody hears the others meanwhile.
    FreezeCoordinator(Duration),
    /// `octopus scale` to so many workers.
    Scale(usize),
    /// Ctrl-C, then `octopus resume` with so many workers.
    Interrupt(usize),
    /// A signal to every process of the run at once, as a supervisor or a terminal sends it, then
    /// `octopus resume` with so many workers.
    SignalAll(Signal, usize),
}

impl Act {
    /// What reports call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::KillWorker => "workers_killed",
            Self::KillLearner => "learners_killed",
            Self::KillCoordinator(_) => "coordinators_killed",
            Self::HangWorker => "workers_hung",
            Self::FreezeCoordinator(_) => "coordinators_frozen",
            Self::Scale(_) => "scalings",
            Self::Interrupt(_) => "interrupts",
            Self::SignalAll(..) => "signals_to_all",
        }
    }

    /// Whether a process is killed with signal 9.
    pub fn is_kill(self) -> bool {
        matches!(self, Self::KillWorker | Self::KillLearner | Self::KillCoordinator(_))
    }
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::KillWorker => write!(f, "kill a worker"),
            Self::KillLearner => write!(f, "kill the learner"),
            Self::KillCoordinator(n) => write!(f, "kill the coordinator, resume with {n}"),
            Self::HangWorker => write!(f, "hang a worker"),
            Self::FreezeCoordinator(time) => {
                write!(f, "freeze the coordinator for {} ms", time.as_millis())
            }
            Self::Scale(n) => write!(f, "scale to {n}"),
            Self::Interrupt(n) => write!(f, "Ctrl-C, resume with {n}"),
            Self::SignalAll(signal, n) => write!(f, "{signal:?} to all, resume with {n}"),
        }
    }
}

/// An act and its moment: `delay` after the run has done `at` iterations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event {
    /// Iterations done.
    pub at: usize,
    /// And then this long.
    pub delay: Duration,
    /// Chooses the victim among workers.
    pub victim: u32,
    /// What is done.
    pub act: Act,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { at, delay, act, .. } = self;
        write!(f, "at iteration {at} + {} ms: {act}", delay.as_millis())
    }
}

/// Everything that happens to a run, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    /// What all of it is drawn from.
    pub seed: u64,
    /// The events.
    pub events: Vec<Event>,
    /// Iterations of the run.
    pub iterations: usize,
}

/// Workers that a run of chaos has at least and at most.
const WORKERS: (usize, usize) = (1, 3);
/// How long a coordinator is frozen at least and at most (ms): beyond the time after which the runs of
/// chaos replace who is silent.
const FREEZE: (usize, usize) = (500, 6000);
/// Signals that ask a run to stop.
const STOPS: [Signal; 3] = [Signal::TERM, Signal::INT, Signal::HUP];
/// Iterations after the last event: the run must be seen to go on.
const CALM_END: usize = 30;

impl Plan {
    /// A plan with `kills` kills: of every ten, six of workers, two of the learner, two of the
    /// coordinator; beside them, of each other act one for every ten kills, of scaling two. Every
    /// act that there is happens at least once, however few kills.
    pub fn new(seed: u64, kills: usize) -> Self {
        let mut dice = Dice::new(seed);
        let tenths = |n: usize| (kills * n).div_ceil(10).max(1);
        let (learners, coordinators) = (tenths(2), tenths(2));
        let workers = kills.saturating_sub(learners + coordinators).max(1);
        let mut acts = Vec::new();
        let mut add = |n: usize, act: &mut dyn FnMut() -> Act| acts.extend((0..n).map(|_| act()));
        add(workers, &mut || Act::KillWorker);
        add(learners, &mut || Act::KillLearner);
        add(coordinators, &mut || Act::KillCoordinator(dice.between(WORKERS.0, WORKERS.1)));
        add(tenths(1), &mut || Act::HangWorker);
        add(tenths(1), &mut || {
            let (shortest, longest) = FREEZE;
            Act::FreezeCoordinator(Duration::from_millis(dice.between(shortest, longest) as u64))
        });
        add(tenths(2), &mut || Act::Scale(dice.between(WORKERS.0, WORKERS.1)));
        add(tenths(1), &mut || Act::Interrupt(dice.between(WORKERS.0, WORKERS.1)));
        add(tenths(1), &mut || {
            Act::SignalAll(dice.one_of(&STOPS), dice.between(WORKERS.0, WORKERS.1))
        });
        // Fisher and Yates.
        for last in (1..acts.len()).rev() {
            acts.swap(last, dice.between(0, last));
        }
        let mut at = 0;
        let events: Vec<Event> = acts
            .into_iter()
            .map(|act| {
                // Every fourth event does not wait until the run has got over the one before.
                let hurried = dice.between(0, 3) == 0;
                let (gap, longest) = if hurried { (0, 600) } else { (dice.between(2, 7), 60) };
                at += gap;
                let delay = Duration::from_millis(dice.between(0, longest) as u64);
                Event { at, delay, victim: dice.word(), act }
            })
            .collect();
        Self { seed, events, iterations: at + CALM_END }
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, events, iterations } = self;
        write!(f, "plan of seed {seed}: {} events, {iterations} iterations", events.len())?;
        events.iter().zip(1..).try_for_each(|(event, n)| write!(f, "\n  {n:3}. {event}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_determines_the_plan_and_the_plan_has_every_act() {
        let plan = Plan::new(5, 4);
        assert_eq!(plan, Plan::new(5, 4));
        assert_ne!(plan.events, Plan::new(6, 4).events);
        let has = |wanted: fn(Act) -> bool| plan.events.iter().any(|event| wanted(event.act));
        assert!(has(|act| act == Act::KillWorker) && has(|act| act == Act::KillLearner));
        assert!(has(|act| act == Act::HangWorker) && has(|act| matches!(act, Act::Scale(_))));
        assert!(has(|act| matches!(act, Act::KillCoordinator(_))));
        assert!(has(|act| matches!(act, Act::FreezeCoordinator(_))));
        assert!(has(|act| matches!(act, Act::Interrupt(_))));
        assert!(has(|act| matches!(act, Act::SignalAll(..))));
        assert!(plan.events.is_sorted_by_key(|event| event.at));
    }

    #[test]
    fn a_plan_has_as_many_kills_as_were_asked_for() {
        for kills in [4, 10, 37, 200] {
            let plan = Plan::new(1, kills);
            assert_eq!(plan.events.iter().filter(|event| event.act.is_kill()).count(), kills);
        }
    }
}
