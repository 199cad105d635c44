//! How long a run still takes.

use std::time::Duration;

use indicatif::HumanDuration;

/// Time over which the rate is a mean (s): longer than evaluations and checkpoints disturb it, shorter
/// than a person who scales a run waits to see it.
const HORIZON: f64 = 20.0;

/// An estimate by the rate of late, which no time limit is beyond.
#[derive(Debug, Clone, Default)]
pub struct Eta {
    /// Env-steps and seconds, fading.
    steps: f64,
    seconds: f64,
}

impl Eta {
    /// Takes in an iteration of so many env-steps at so many a second.
    pub fn iteration(&mut self, env_steps: u64, env_steps_per_s: f64) {
        let seconds = env_steps as f64 / env_steps_per_s;
        if !(seconds.is_finite() && seconds > 0.0) {
            return;
        }
        let fade = (-seconds / HORIZON).exp();
        self.steps = self.steps * fade + env_steps as f64;
        self.seconds = self.seconds * fade + seconds;
    }

    /// Time for `left` env-steps, and no more than the time limit leaves, if there is one. None if there
    /// is nothing to train any more, or nothing is known.
    pub fn estimate(&self, left: u64, limit_left: Option<Duration>) -> Option<Duration> {
        if left == 0 || self.steps <= 0.0 {
            return None;
        }
        let seconds = left as f64 * self.seconds / self.steps;
        // A thousand years are as good as any longer time.
        let budget = Duration::from_secs_f64(seconds.min(3e10));
        Some(limit_left.map_or(budget, |limit| limit.min(budget)))
    }
}

/// An estimate as a person reads it. What is left to be done takes a second at least.
pub(super) fn shown(estimate: Option<Duration>) -> String {
    let Some(estimate) = estimate else { return "ending".to_owned() };
    format!("eta {}", HumanDuration(estimate.max(Duration::from_secs(1))))
}

/// The same where there is little room: `eta 3m`.
pub(super) fn brief(estimate: Option<Duration>) -> String {
    let Some(estimate) = estimate else { return "ending".to_owned() };
    format!("eta {:#}", HumanDuration(estimate.max(Duration::from_secs(1))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_budget_takes_as_long_as_the_rate_of_late_says() {
        let mut eta = Eta::default();
        assert_eq!(eta.estimate(100, None), None, "nothing is known");
        for _ in 0..100 {
            eta.iteration(200, 100.0);
        }
        assert_eq!(eta.estimate(1000, None), Some(Duration::from_secs(10)));
        // Ten times the rate, for ten times as long as is looked back.
        for _ in 0..100 {
            eta.iteration(2000, 1000.0);
        }
        let seconds = eta.estimate(1000, None).expect("known").as_secs_f64();
        assert!((seconds - 1.0).abs() < 0.01, "{seconds}");
    }

    #[test]
    fn a_time_limit_ends_it_sooner() {
        let mut eta = Eta::default();
        eta.iteration(200, 100.0);
        let limit = Duration::from_secs(3);
        assert_eq!(eta.estimate(1000, Some(limit)), Some(limit));
        assert_eq!(eta.estimate(100, Some(limit)), Some(Duration::from_secs(1)));
    }

    #[test]
    fn nothing_that_is_left_takes_no_time() {
        let mut eta = Eta::default();
        eta.iteration(1_000_000, 1e6);
        let shown_for = |left, limit| shown(eta.estimate(left, limit));
        assert_eq!(shown_for(1, None), "eta 1 second");
        assert_eq!(shown_for(1_000_000_000, Some(Duration::ZERO)), "eta 1 second");
        assert_eq!(shown_for(0, None), "ending");
        assert_eq!(brief(Some(Duration::ZERO)), "eta 1s");
        assert_eq!(brief(Some(Duration::from_mins(3))), "eta 3m");
    }
}
