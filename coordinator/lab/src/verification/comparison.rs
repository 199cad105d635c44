//! Where two sequences of digests part.

use output::grouped;
use proto::Digest;
use serde::Serialize;

use super::record::Iteration;
use super::wording::iterations;

/// How two sequences of digests compare.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Comparison {
    /// Iterations that both have.
    pub(super) common: u64,
    /// Of these, how many agree before the first that does not.
    pub(super) agreeing: u64,
    /// The first iteration that does not agree.
    pub(super) parting: Option<Parting>,
}

/// Two training states that should be one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Parting {
    /// The iteration, from 0.
    pub(super) iteration: u64,
    /// Env-steps trained on until then, on either side.
    pub(super) env_steps: [u64; 2],
    /// The digests.
    pub(super) digests: [Digest; 2],
}

impl Comparison {
    /// Compares what both have. Each side counts upwards without gaps; `b` may begin later.
    pub(super) fn of(a: &[Iteration], b: &[Iteration]) -> Self {
        let from = b.first().map_or(u64::MAX, |first| first.iteration);
        let pairs = || a.iter().skip_while(|line| line.iteration < from).zip(b);
        let parting = pairs().find(|(a, b)| a.digest != b.digest).map(|(a, b)| Parting {
            iteration: a.iteration,
            env_steps: [a.env_steps, b.env_steps],
            digests: [a.digest, b.digest],
        });
        let common = pairs().count() as u64;
        let agreeing = parting.map_or(common, |parting| parting.iteration - from);
        Self { common, agreeing, parting }
    }

    /// What it found, in words; `names` are those of the two sides.
    pub(super) fn sentence(&self, names: [&str; 2]) -> String {
        let Some(Parting { iteration, env_steps, digests }) = self.parting else {
            return format!("the same for {}; none differs", iterations(self.agreeing));
        };
        let width = names.map(|name| name.chars().count()).into_iter().max().unwrap_or(0);
        let side = |i: usize| {
            let state = format!("{}  {} env-steps", digests[i], grouped(env_steps[i]));
            // Beside long names there is no room.
            if width + state.len() + 4 <= output::COLUMNS {
                format!("  {:width$}  {state}", names[i])
            } else {
                format!("  {}\n    {state}", names[i])
            }
        };
        format!(
            "the same for {}, then they part at iteration {iteration}:\n{}\n{}",
            iterations(self.agreeing),
            side(0),
            side(1)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Iterations from `first` on whose digests are filled with the given bytes.
    fn lines(first: u64, digests: &[u8]) -> Vec<Iteration> {
        let line = |(iteration, &byte): (u64, &u8)| Iteration {
            iteration,
            env_steps: 8 * (iteration + 1),
            digest: Digest([byte; 16]),
        };
        (first..).zip(digests).map(line).collect()
    }

    #[test]
    fn the_first_of_several_differences_is_named() {
        let comparison = Comparison::of(&lines(0, &[1, 2, 3, 4]), &lines(0, &[1, 2, 9, 4, 5]));
        assert_eq!((comparison.common, comparison.agreeing), (4, 2));
        let parting = comparison.parting.expect("they differ");
        assert_eq!((parting.iteration, parting.env_steps), (2, [24, 24]));
        assert_eq!(parting.digests, [Digest([3; 16]), Digest([9; 16])]);
    }

    #[test]
    fn a_repetition_that_begins_later_is_compared_from_there() {
        let all = lines(0, &[1, 2, 3, 4]);
        let comparison = Comparison::of(&all, &lines(2, &[3, 4]));
        assert_eq!(comparison, Comparison { common: 2, agreeing: 2, parting: None });
        let comparison = Comparison::of(&all, &lines(2, &[3, 9]));
        assert_eq!((comparison.agreeing, comparison.parting.map(|p| p.iteration)), (1, Some(3)));
    }

    #[test]
    fn a_difference_is_shown_with_both_digests() {
        let comparison = Comparison::of(&lines(0, &[1, 2]), &lines(0, &[1, 3]));
        let digest = |byte: &str| byte.repeat(16);
        assert_eq!(
            comparison.sentence(["runs/a", "b"]),
            format!(
                "the same for 1 iteration, then they part at iteration 1:\n  runs/a  {}  16 env-steps\n  \
                 b       {}  16 env-steps",
                digest("02"),
                digest("03")
            )
        );
        let long = "runs/trajectory-20261124-with-another-seed";
        let sentence = comparison.sentence([long, "b"]);
        assert!(sentence.contains(&format!("  {long}\n    {}", digest("02"))), "{sentence}");
        assert!(sentence.lines().all(|line| line.chars().count() <= 80), "{sentence}");
    }
}
