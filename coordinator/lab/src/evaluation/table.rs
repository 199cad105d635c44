//! An evaluation as a person reads it.

use super::errors::ErrorSummary;
use super::held::HeldShare;
use super::reach::GoalSubset;
use super::summary::Summary;
use super::verdict::Verdict;
use crate::statistics::{milli, percent};

/// What stands before rows of a table that are about goals that can be reached.
const REACHABLE: &str = "reachable ";
/// Likewise, about those that were within reach at the end.
const AT_END: &str = "in reach ";

impl Summary {
    /// The summary as a person reads it, in lines of `columns` characters: the verdict first, then the details; the
    /// errors of each agent if `agents` says so.
    pub fn table(&self, columns: usize, agents: bool) -> String {
        let verdict = Verdict::of(self.task, &self.overall);
        format!("{}\n\n{}", verdict.table(columns), self.details(columns, agents))
    }

    fn details(&self, columns: usize, agents: bool) -> String {
        let row = |(whose, summary): (&str, &ErrorSummary)| {
            let ErrorSummary { error, agent, min, last, tail, unit: _ } = summary;
            let name = match agent {
                Some(agent) => format!("agent {agent} {error}"),
                None => format!("{whose}{error}"),
            };
            [
                name,
                milli(min.mean),
                milli(last.mean),
                milli(tail.mean),
                milli(tail.std),
                milli(tail.p50),
                milli(tail.p90),
                milli(tail.p99),
            ]
        };
        let header = ["error (mm, mrad)", "min", "final", "tail", "std", "p50", "p90", "p99"];
        let all = self.overall.iter().map(|summary| ("", summary));
        let subsets = || {
            let reachable = self.reachable.iter().map(|reachable| (REACHABLE, &reachable.subset));
            let at_end = self.within_reach_at_end.iter().map(|within| (AT_END, &within.subset));
            reachable.chain(at_end)
        };
        let of_subsets = subsets()
            .flat_map(|(whose, subset)| subset.overall.iter().map(move |summary| (whose, summary)));
        let agents = self.agents.iter().filter(|_| agents).map(|summary| ("", summary));
        let rows = all.chain(of_subsets).chain(agents).map(row);
        let errors = output::table_within(columns, header, rows);
        let all = self.success.iter().map(|success| ("", success));
        let of_subsets = subsets()
            .flat_map(|(whose, subset)| subset.success.iter().map(move |success| (whose, success)));
        let success = output::table_within(
            columns,
            ["success within", "goals", "episodes"],
            all.chain(of_subsets).map(|(whose, success)| {
                let orientation = format!("{} mrad", 1e3 * success.orientation);
                let name = match success.position {
                    Some(position) => format!("{whose}{} mm and {orientation}", 1e3 * position),
                    None => orientation,
                };
                [name, percent(success.goals), percent(success.episodes)]
            }),
        );
        let episodes = output::counted(self.episodes.len() as u64, "episode");
        let held = self.held.as_ref().map_or_else(String::new, HeldShare::line);
        let reachable = self.reachable.as_ref().map_or_else(String::new, |reachable| {
            let GoalSubset { goals, of, .. } = reachable.subset;
            format!("a controller that knows the robot reaches {goals} of the {of} hand goals\n")
        });
        let at_end = self.within_reach_at_end.as_ref().map_or_else(String::new, |within| {
            let GoalSubset { goals, .. } = within.subset;
            format!("with the base where episodes ended, {goals} were within an arm's reach\n")
        });
        format!(
            "{} of {}, seed {}; std and percentiles are those of tail\n{errors}\n\n\
             {success}\n\n{held}{reachable}{at_end}contact in {} of steps, in {} of {}: of an arm with\n\
             the base {}, a mount {}, itself {}, another arm {}",
            episodes,
            output::counted(self.steps as u64, "step"),
            self.seed,
            percent(self.contact_rate),
            self.episodes_with_contact,
            episodes,
            percent(self.contact_rate_by_kind.arm_base),
            percent(self.contact_rate_by_kind.arm_mount),
            percent(self.contact_rate_by_kind.arm_itself),
            percent(self.contact_rate_by_kind.arm_arm),
        )
    }
}

#[cfg(test)]
mod tests {
    use proto::config::TaskName;

    use super::super::reach::{Reachable, WithinReach};
    use super::super::success::Success;
    use super::super::summary::ContactRates;
    use super::*;
    use crate::statistics::{ErrorOf, Spread};

    #[test]
    fn the_table_begins_with_the_verdict_and_fits() {
        let spread = Spread { mean: 9.9999, std: 9.9999, p50: 9.9999, p90: 9.9999, p99: 9.9999 };
        let error = |error: ErrorOf, agent| ErrorSummary {
            error,
            unit: error.unit(),
            agent,
            min: spread,
            last: spread,
            tail: spread,
        };
        let overall = || vec![error(ErrorOf::Position, None), error(ErrorOf::Orientation, None)];
        let all = Success { position: Some(0.05), orientation: 0.05, goals: 1.0, episodes: 1.0 };
        let subset =
            || GoalSubset { goals: 4000, of: 4000, overall: overall(), success: vec![all; 2] };
        let summary = Summary {
            controller: None,
            checkpoint: "runs/a".into(),
            iteration: 1,
            env_steps: 1,
            task: TaskName::Trajectory,
            seed: 12_345,
            goals: None,
            steps: 100_000,
            overall: overall(),
            agents: (0..8).map(|agent| error(ErrorOf::Orientation, Some(agent))).collect(),
            success: vec![all; 2],
            held: None,
            reachable: Some(Reachable { subset: subset(), controller: Vec::new() }),
            within_reach_at_end: Some(WithinReach { subset: subset(), hands: Vec::new() }),
            contact_rate: 1.0,
            contact_rate_by_kind: ContactRates {
                arm_base: 1.0,
                arm_mount: 1.0,
                arm_itself: 1.0,
                arm_arm: 1.0,
            },
            episodes_with_contact: 1_000,
            episodes: Vec::new(),
        };
        let text = summary.table(80, true);
        assert!(text.starts_with("not within the paper's accuracy"), "{text}");
        assert!(text.contains("agent 7 orientation"), "{text}");
        assert!(!summary.table(80, false).contains("agent"), "{text}");
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}\nis too long in\n{text}");
        }
    }
}
