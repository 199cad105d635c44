//! Whether a training has diverged: it computes on, and learns nothing any more.
//!
//! A training diverges, as far as its metrics can tell, where
//!
//! * a loss, a gradient norm, a divergence or a return is no finite number;
//! * an update moves the policy by more than 10 nats (mean Kullback–Leibler divergence from the policy that
//!   collected the samples). The surrogate that an update improves is an estimate near that policy: limits in
//!   use are 0.01 to 0.5, and beyond 10 a sample's weight is off by e¹⁰;
//! * the mean return of ten iterations is below that of the first ten by more than twice its size and three
//!   times its range: worse by far than not to have trained at all.
//!
//! It has recovered after ten iterations of which none does so, and whose mean return is not below the lowest of
//! the first ones: what ends worse than it began has not come back.
//! All of it follows from the lines of the metrics, so that who resumes a run or looks at it says the same.

use std::collections::VecDeque;

use proto::run_dir::RunDir;
use serde_json::Value;
use service::live::Diverged;
use store::jsonl;

use super::line::Line;

/// What helps a training that diverges.
pub const CURE: &str =
    "going on does not help; lower optimizer.actor_lr, or let algorithm.max_kl end such updates";

/// Divergence from the sampling policy that no update means to have (nats).
const KL: f64 = 10.0;
/// Iterations that returns are means over.
const WINDOW: usize = 10;
/// How far a return may fall below the first ones, in sizes and in ranges of those.
const SIZES: f64 = 2.0;
/// See [`SIZES`].
const RANGES: f64 = 3.0;

/// What changes with an iteration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// It diverges.
    Diverged,
    /// It has recovered.
    Recovered,
}

/// What an iteration shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    iteration: u64,
    return_mean: f64,
    kl: f64,
    /// The names of numbers that are not finite.
    broken: Vec<&'static str>,
}

/// Numbers that must be finite; `explained_variance` need not, where all returns are the same.
const FINITE: [&str; 6] =
    ["return_mean", "policy_loss", "value_loss", "kl", "actor_grad_norm", "critic_grad_norm"];

impl Sample {
    fn new(iteration: u64, numbers: [Option<f64>; 6]) -> Self {
        let is_finite = |number: Option<f64>| number.is_some_and(f64::is_finite);
        let named = FINITE.iter().zip(numbers);
        let broken = named.filter(|(_, number)| !is_finite(*number)).map(|(name, _)| *name);
        let [return_mean, _, _, kl, ..] = numbers.map(|number| number.unwrap_or(f64::NAN));
        Self { iteration, return_mean, kl, broken: broken.collect() }
    }

    /// Of a line of `metrics.jsonl`, in which a number that is not finite is `null`. One that is not there at
    /// all, because another version wrote the line, says nothing; without a return the line does not.
    fn of_json(line: &Value) -> Option<Self> {
        line.get("return_mean")?;
        let numbers = FINITE.map(|name| line.get(name).map_or(Some(0.0), Value::as_f64));
        Some(Self::new(line["iteration"].as_u64()?, numbers))
    }

    /// What is wrong with the update, if anything is.
    fn fault(&self) -> Option<String> {
        if !self.broken.is_empty() {
            return Some(format!("no finite number in {}", self.broken.join(", ")));
        }
        (self.kl > KL).then(|| {
            format!("its update moved the policy by {:.0} nats, where {KL} are too many", self.kl)
        })
    }
}

impl From<&Line> for Sample {
    fn from(line: &Line) -> Self {
        let numbers = [
            line.return_mean,
            line.policy_loss,
            line.value_loss,
            line.kl,
            line.actor_grad_norm,
            line.critic_grad_norm,
        ];
        Self::new(line.iteration, numbers.map(|number| Some(f64::from(number))))
    }
}

/// Watches a training.
#[derive(Debug, Clone, Default)]
pub struct Divergence {
    /// The first returns, none of them from a training that had diverged.
    first: Vec<f64>,
    /// The last iterations.
    last: VecDeque<Sample>,
    found: Option<Diverged>,
}

impl Divergence {
    /// As the metrics of a run tell.
    pub fn recorded(run_dir: &RunDir) -> anyhow::Result<Self> {
        Ok(Self::of_lines(&jsonl::read(&run_dir.metrics_jsonl())?))
    }

    /// As these lines of its metrics tell.
    pub fn of_lines(lines: &[(String, Value)]) -> Self {
        Self::of(lines.iter().filter_map(|(_, line)| Sample::of_json(line)))
    }

    fn of(samples: impl IntoIterator<Item = Sample>) -> Self {
        let mut watch = Self::default();
        for sample in samples {
            watch.add(sample);
        }
        watch
    }

    /// What was found, unless the training has recovered.
    pub fn found(&self) -> Option<&Diverged> {
        self.found.as_ref()
    }

    /// Takes in the next iteration.
    pub fn add(&mut self, sample: Sample) -> Option<Change> {
        let iteration = sample.iteration;
        let fault = sample.fault();
        if self.first.len() < WINDOW && self.found.is_none() && sample.return_mean.is_finite() {
            self.first.push(sample.return_mean);
        }
        self.last.push_back(sample);
        if self.last.len() > WINDOW {
            self.last.pop_front();
        }
        if self.found.is_none() {
            let reason = fault.or_else(|| self.fallen())?;
            self.found = Some(Diverged { iteration, reason });
            return Some(Change::Diverged);
        }
        if !self.has_recovered() {
            return None;
        }
        self.found = None;
        Some(Change::Recovered)
    }

    /// Mean of the first returns, and how far below it is too far.
    fn first(&self) -> (f64, f64) {
        let mean = self.first.iter().sum::<f64>() / self.first.len() as f64;
        let high = self.first.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (mean, (SIZES * mean.abs()).max(RANGES * (high - self.lowest())))
    }

    /// The lowest of the first returns; infinite if there is none.
    fn lowest(&self) -> f64 {
        self.first.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Mean return of the last iterations.
    fn last(&self) -> f64 {
        self.last.iter().map(|sample| sample.return_mean).sum::<f64>() / self.last.len() as f64
    }

    /// What is wrong with the returns, if anything is.
    fn fallen(&self) -> Option<String> {
        let newest = self.last.back()?.iteration;
        if self.first.len() < WINDOW || newest < 2 * WINDOW as u64 - 1 {
            return None;
        }
        let (mean, far) = self.first();
        let last = self.last();
        (last < mean - far).then(|| {
            format!("its return has fallen to {last:.1}, from {mean:.1} in the first iterations")
        })
    }

    fn has_recovered(&self) -> bool {
        let sound =
            self.last.len() == WINDOW && self.last.iter().all(|last| last.fault().is_none());
        sound && (self.first.is_empty() || self.last() >= self.lowest())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(iteration: u64, return_mean: f64, kl: f64) -> Sample {
        let [policy_loss, value_loss, actor, critic] = [0.0, 1.0, 0.5, 0.5].map(Some);
        Sample::new(
            iteration,
            [Some(return_mean), policy_loss, value_loss, Some(kl), actor, critic],
        )
    }

    fn found(returns: &[f64], kl: impl Fn(u64) -> f64) -> Option<Diverged> {
        let samples = returns.iter().zip(0..).map(|(&value, k)| sample(k, value, kl(k)));
        Divergence::of(samples).found
    }

    #[test]
    fn an_update_that_leaves_its_policy_far_behind_is_said_at_once_and_to_the_end() {
        // As seen with a learning rate of 10: 4,454 nats, and returns from -444 to -1,800.
        let mut watch = Divergence::default();
        assert_eq!(watch.add(sample(0, -444.0, 0.01)), None);
        assert_eq!(watch.add(sample(1, -440.0, 4454.0)), Some(Change::Diverged));
        for k in 2..60 {
            assert_eq!(watch.add(sample(k, -1800.0, 0.0)), None);
        }
        let found = watch.found().expect("diverged");
        assert_eq!(found.iteration, 1);
        assert!(found.to_string().contains("4454 nats"), "{found}");
    }

    #[test]
    fn a_single_bad_update_is_recovered_from() {
        let mut watch = Divergence::default();
        let changes: Vec<_> = (0..30)
            .filter_map(|k| {
                Some((k, watch.add(sample(k, -100.0, if k == 5 { 11.0 } else { 0.1 }))?))
            })
            .collect();
        assert_eq!(changes, [(5, Change::Diverged), (15, Change::Recovered)]);
        assert_eq!(watch.found(), None);
    }

    /// A training once counted as recovered that ended at almost twice the costs that it began with.
    #[test]
    fn what_ends_worse_than_it_began_has_not_recovered() {
        let ended = |returns: f64| {
            let mut watch = Divergence::default();
            for k in 0..10 {
                watch.add(sample(k, -100.0 - k as f64, 0.1));
            }
            watch.add(sample(10, -105.0, 11.0));
            for k in 11..60 {
                watch.add(sample(k, returns, 0.0));
            }
            watch.found
        };
        assert_eq!(ended(-199.0).expect("diverged").iteration, 10);
        assert!(ended(-110.0).is_some());
        assert_eq!(ended(-109.0), None, "as low as in the beginning");
    }

    #[test]
    fn returns_that_fall_far_below_the_first_are_a_divergence_and_others_are_none() {
        let falling: Vec<f64> = (0..60).map(|k| -100.0 - 10.0 * f64::from(k)).collect();
        let seen = found(&falling, |_| 0.01).expect("diverged");
        assert!(seen.reason.contains("has fallen"), "{seen}");
        // MADDPG's first hundred thousand env-steps, every third iteration: it gets worse, then better.
        let maddpg = [-177.8, -158.9, -281.5, -249.8, -81.15, -0.57, 55.85, 117.0, 171.7, 210.1];
        let slow: Vec<f64> = maddpg.iter().flat_map(|&value| [value; 3]).collect();
        assert_eq!(found(&slow, |_| 0.0), None);
        let rising: Vec<f64> = (0..60).map(|k| -1184.0 + 20.0 * f64::from(k)).collect();
        assert_eq!(found(&rising, |_| 0.1), None);
        let still: Vec<f64> = (0..60).map(|k| 0.01 * f64::from(k % 7)).collect();
        assert_eq!(found(&still, |_| 0.1), None);
    }

    #[test]
    fn what_is_not_finite_is_named_also_where_json_says_null() {
        let line = serde_json::json!({
            "iteration": 3, "return_mean": -1.0, "policy_loss": null, "value_loss": 1.0, "kl": 0.1,
            "actor_grad_norm": 1.0, "critic_grad_norm": 1.0, "explained_variance": null,
        });
        let found = Divergence::of(Sample::of_json(&line)).found.expect("diverged");
        assert_eq!(found.reason, "no finite number in policy_loss");

        // Keys that another version does not write.
        let line = serde_json::json!({ "iteration": 3, "return_mean": -1.0, "kl": 0.1 });
        assert_eq!(Divergence::of(Sample::of_json(&line)).found, None);
        assert_eq!(Sample::of_json(&serde_json::json!({ "iteration": 3 })), None);
        let line = serde_json::json!({ "iteration": 3, "return_mean": null });
        let found = Divergence::of(Sample::of_json(&line)).found.expect("diverged");
        assert_eq!(found.reason, "no finite number in return_mean");
    }
}
