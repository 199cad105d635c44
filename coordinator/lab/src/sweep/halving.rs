//! Successive halving: which trials go on (Jamieson and Talwalkar, "Non-stochastic best arm identification and
//! hyperparameter optimization", 2016).
//!
//! Configurations are what is compared, by the mean score of their seeds: a lucky seed says nothing about the next one. Who
//! goes on is a function of the scores alone, not of the order in which they came. So a sweep that was stopped, or one of whose
//! trials had to be tried twice, ends as one that was not.

/// What is known of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// Which configuration it is of.
    pub configuration: usize,
    /// Its score at each rung, and last at the end of the budget; the smaller, the better.
    pub scores: Vec<Option<f64>>,
    /// Whether it can go on.
    pub condition: Condition,
}

/// Whether a trial can go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    /// It can.
    Fit,
    /// It has failed.
    Failed,
    /// Its scores cannot be told, for a file of it is damaged. It has not lost by that.
    Damaged,
}

/// What a trial does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// It has to reach this rung and to be scored there; the last one is the end of the budget.
    Rung(usize),
    /// It has been scored at this rung, and waits for others.
    Wait(usize),
    /// Others were better at this rung.
    Stopped(usize),
    /// It has been scored at this rung, where another seed of its configuration has failed.
    AnotherFailed(usize),
    /// It has failed on its way to this rung.
    Failed(usize),
    /// It has been scored at the end of its budget.
    Done,
}

/// What each trial does next, where the best 1 of `reduction` configurations go on from each rung, rounded up.
pub fn next(trials: &[Standing], reduction: f64) -> Vec<Next> {
    let rungs = trials.first().map_or(0, |trial| trial.scores.len());
    let configurations = trials.iter().map(|trial| trial.configuration + 1).max().unwrap_or(0);
    let mut alive: Vec<usize> = (0..configurations).collect();
    let mut next = vec![Next::Done; trials.len()];
    for rung in 0..rungs {
        let mut is_decided = true;
        for (trial, next) in trials.iter().zip(&mut next) {
            if !alive.contains(&trial.configuration) {
                continue;
            }
            *next = match (trial.scores[rung], trial.condition) {
                (Some(_), _) if rung + 1 == rungs => Next::Done,
                (Some(_), _) => Next::Wait(rung),
                (None, Condition::Damaged) => {
                    // Who goes on would be another one once the file is put back.
                    is_decided = false;
                    Next::Failed(rung)
                }
                (None, Condition::Failed) => Next::Failed(rung),
                (None, Condition::Fit) => {
                    is_decided = false;
                    Next::Rung(rung)
                }
            };
        }
        if !is_decided || rung + 1 == rungs {
            break;
        }
        let survivors = survivors(trials, &alive, rung, reduction);
        for (trial, next) in trials.iter().zip(&mut next) {
            let leaves =
                alive.contains(&trial.configuration) && !survivors.contains(&trial.configuration);
            if leaves && trial.scores[rung].is_some() {
                // All others are scored or have failed.
                let fails = |other: &Standing| {
                    other.configuration == trial.configuration && other.scores[rung].is_none()
                };
                let another_failed = trials.iter().any(fails);
                *next =
                    if another_failed { Next::AnotherFailed(rung) } else { Next::Stopped(rung) };
            }
        }
        alive = survivors;
    }
    // Whoever has come to the end stays there, though better ones were added, or another seed failed, since.
    for (trial, next) in trials.iter().zip(&mut next) {
        let is_held = matches!(next, Next::Wait(_) | Next::Stopped(_) | Next::AnotherFailed(_));
        if is_held && trial.scores[rungs - 1].is_some() {
            *next = Next::Done;
        }
    }
    next
}

/// The best of the configurations in `alive` at a rung. One with a seed that has failed, or whose score is no number, is never
/// among them.
fn survivors(trials: &[Standing], alive: &[usize], rung: usize, reduction: f64) -> Vec<usize> {
    let mean = |configuration: usize| {
        let own = trials.iter().filter(|trial| trial.configuration == configuration);
        let scores: Vec<f64> =
            own.map(|trial| trial.scores[rung].unwrap_or(f64::INFINITY)).collect();
        scores.iter().sum::<f64>() / scores.len() as f64
    };
    let mut ranked: Vec<(f64, usize)> = alive.iter().map(|of| (mean(*of), *of)).collect();
    ranked.retain(|(mean, _)| mean.is_finite());
    // Of equal ones the first in the file.
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    ranked.truncate(kept(alive.len(), reduction));
    ranked.into_iter().map(|(_, configuration)| configuration).collect()
}

/// How many of `n` configurations go on from a rung.
pub fn kept(n: usize, reduction: f64) -> usize {
    (n as f64 / reduction).ceil() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Trials of two rungs and the end, two seeds a configuration.
    fn trials(scores: &[[Option<f64>; 3]]) -> Vec<Standing> {
        let of = |(index, scores): (usize, &[Option<f64>; 3])| Standing {
            configuration: index / 2,
            scores: scores.to_vec(),
            condition: Condition::Fit,
        };
        scores.iter().enumerate().map(of).collect()
    }

    const NEW: [Option<f64>; 3] = [None; 3];

    fn at_first(score: f64) -> [Option<f64>; 3] {
        [Some(score), None, None]
    }

    #[test]
    fn nobody_goes_on_before_all_have_come_to_a_rung() {
        let mut all = trials(&[at_first(1.0), at_first(9.0), at_first(2.0), NEW]);
        let expected = [Next::Wait(0), Next::Wait(0), Next::Wait(0), Next::Rung(0)];
        assert_eq!(next(&all, 2.0), expected);
        // The means are 5 and 3: one lucky seed is not enough.
        all[3].scores[0] = Some(4.0);
        let expected = [Next::Stopped(0), Next::Stopped(0), Next::Rung(1), Next::Rung(1)];
        assert_eq!(next(&all, 2.0), expected);
    }

    #[test]
    fn who_goes_on_is_the_same_in_whatever_order_scores_came() {
        let rows = [[3.0, 4.0], [2.0, 2.0], [1.0, 1.0], [5.0, 5.0]];
        let scores = |at: usize, of: usize| Some(rows[of][at]);
        let all: Vec<Standing> = (0..4)
            .map(|of| Standing {
                configuration: of,
                scores: vec![scores(0, of), if of == 2 { scores(1, of) } else { None }, None],
                condition: Condition::Fit,
            })
            .collect();
        let expected = [Next::Stopped(0), Next::Rung(1), Next::Wait(1), Next::Stopped(0)];
        assert_eq!(next(&all, 2.0), expected);
        let mut whole = all.clone();
        whole[1].scores[1] = Some(2.0);
        whole[2].scores[2] = Some(0.5);
        assert_eq!(next(&whole, 2.0)[1..3], [Next::Stopped(1), Next::Done]);
        // A score of a rung that it was not to reach changes nothing.
        whole[0].scores[1] = Some(0.0);
        assert_eq!(next(&whole, 2.0)[0], Next::Stopped(0));
    }

    #[test]
    fn who_has_failed_does_not_go_on_and_holds_nobody_up() {
        let mut all = trials(&[at_first(1.0), NEW, at_first(2.0), at_first(2.0)]);
        all[1].condition = Condition::Failed;
        let expected = [Next::AnotherFailed(0), Next::Failed(0), Next::Rung(1), Next::Rung(1)];
        assert_eq!(next(&all, 2.0), expected);
        // Also where that leaves nobody, or less than there is room for.
        all[2].scores[0] = Some(f64::NAN);
        let expected =
            [Next::AnotherFailed(0), Next::Failed(0), Next::Stopped(0), Next::Stopped(0)];
        assert_eq!(next(&all, 2.0), expected);
        all[2].scores[0] = Some(2.0);
        assert_eq!(next(&all, 1.0)[0], Next::AnotherFailed(0));
    }

    #[test]
    fn who_has_come_to_the_end_stays_there() {
        let whole = [Some(5.0), Some(5.0), Some(5.0)];
        let mut all = trials(&[whole, whole, at_first(9.0), at_first(9.0)]);
        let before = [Next::Done, Next::Done, Next::Stopped(0), Next::Stopped(0)];
        assert_eq!(next(&all, 2.0), before);
        // Better ones are added to the file.
        all.extend(trials(&[NEW, NEW]).into_iter().map(|new| Standing { configuration: 2, ..new }));
        all.extend(trials(&[NEW, NEW]).into_iter().map(|new| Standing { configuration: 3, ..new }));
        assert_eq!(next(&all, 2.0)[..2], [Next::Done, Next::Done]);
        for new in &mut all[4..] {
            new.scores[0] = Some(1.0);
        }
        let after = [before, [Next::Rung(1); 4]].concat();
        assert_eq!(next(&all, 2.0), after);
        // The other seed of a configuration fails, when it is trained once more.
        let mut seeds = trials(&[whole, NEW]);
        seeds[1].condition = Condition::Failed;
        assert_eq!(next(&seeds, 2.0), [Next::Done, Next::Failed(0)]);
    }

    #[test]
    fn without_rungs_all_go_to_the_end() {
        let trial =
            |score| Standing { configuration: 0, scores: vec![score], condition: Condition::Fit };
        let all = [trial(None), trial(Some(1.0)), trial(Some(f64::INFINITY))];
        assert_eq!(next(&all, 2.0), [Next::Rung(0), Next::Done, Next::Done]);
        assert_eq!(next(&[], 2.0), []);
        assert_eq!([kept(4, 2.0), kept(5, 2.0), kept(1, 4.0), kept(9, 3.0)], [2, 3, 1, 3]);
    }

    /// Else a rung would be decided without a trial whose file is put back later.
    #[test]
    fn nobody_goes_on_while_scores_cannot_be_told() {
        let mut all = trials(&[at_first(1.0), at_first(2.0), at_first(3.0), NEW]);
        all[3].condition = Condition::Damaged;
        let expected = [Next::Wait(0), Next::Wait(0), Next::Wait(0), Next::Failed(0)];
        assert_eq!(next(&all, 2.0), expected);
        all[3].condition = Condition::Failed;
        assert_eq!(next(&all, 2.0)[0], Next::Rung(1), "it has lost");
    }
}
