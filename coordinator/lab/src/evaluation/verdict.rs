//! Whether a policy is as accurate as the paper's, by both measures.

use proto::config::TaskName;

use super::errors::ErrorSummary;
use crate::statistics::{ErrorOf, Spread, milli};

/// The mean errors of an evaluation beside those that the paper reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// One a kind of error that the task is about.
    errors: Vec<Compared>,
}

/// A mean error of all goals.
#[derive(Debug, Clone, PartialEq)]
struct Compared {
    /// What it is of, with its unit in thousandths.
    name: String,
    /// What the paper reports.
    paper: f64,
    /// The minimum over time, which is what the paper's own measure is.
    min: f64,
    /// The mean of the last 20 steps.
    tail: f64,
}

impl Verdict {
    /// On the errors of all goals together.
    pub fn of(task: TaskName, overall: &[ErrorSummary]) -> Self {
        let mean = |spread: &Spread| spread.mean;
        let compared = |(error, summary): (ErrorOf, &ErrorSummary)| Compared {
            name: format!("{} (m{})", summary.error, summary.unit),
            paper: error.papers(),
            min: mean(&summary.min),
            tail: mean(&summary.tail),
        };
        Self { errors: ErrorOf::of(task).zip(overall).map(compared).collect() }
    }

    /// Whether all errors are as small as the paper's, by one of its measures.
    fn within(&self, measure: fn(&Compared) -> f64) -> bool {
        !self.errors.is_empty() && self.errors.iter().all(|error| measure(error) <= error.paper)
    }

    /// The verdict in a sentence.
    pub fn sentence(&self) -> &'static str {
        match (self.within(|error| error.min), self.within(|error| error.tail)) {
            (true, true) => "within the paper's accuracy, by both measures",
            (true, false) => {
                "within the paper's accuracy by its own measure, the minimum over time,\n\
                 but not in the last 20 steps"
            }
            (false, true) => {
                "within the paper's accuracy in the last 20 steps, but not by its own measure,\n\
                 the minimum over time"
            }
            (false, false) => "not within the paper's accuracy, by neither measure",
        }
    }

    /// The sentence, and below it the means that it is about.
    pub fn table(&self, columns: usize) -> String {
        let judged = |error: f64, paper: f64| {
            format!("{} {}", milli(error), if error <= paper { "within" } else { "beyond" })
        };
        let rows = self.errors.iter().map(|error| {
            let Compared { name, paper, min, tail } = error;
            [name.clone(), milli(*paper), judged(*min, *paper), judged(*tail, *paper)]
        });
        let header = ["mean error", "the paper's", "minimum over time", "last 20 steps"];
        format!("{}\n{}", self.sentence(), output::table_within(columns, header, rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(of: ErrorOf, min: f64, tail: f64) -> ErrorSummary {
        let spread = |mean| Spread { mean, std: 0.0, p50: mean, p90: mean, p99: mean };
        let (min, last, tail) = (spread(min), spread(tail), spread(tail));
        ErrorSummary { error: of, unit: of.unit(), agent: None, min, last, tail }
    }

    fn verdict(position: [f64; 2], orientation: [f64; 2]) -> Verdict {
        let errors = [
            error(ErrorOf::Position, position[0], position[1]),
            error(ErrorOf::Orientation, orientation[0], orientation[1]),
        ];
        Verdict::of(TaskName::Trajectory, &errors)
    }

    /// The paper has 25 mm and 40 mrad.
    #[test]
    fn all_errors_must_be_within_and_either_measure_is_judged() {
        let good = verdict([0.01, 0.02], [0.01, 0.04]);
        assert_eq!(good.sentence(), "within the paper's accuracy, by both measures");
        let late = verdict([0.01, 0.02], [0.01, 0.041]);
        assert!(late.sentence().ends_with("but not in the last 20 steps"), "{}", late.sentence());
        let bad = verdict([0.03, 0.03], [0.01, 0.01]);
        assert_eq!(bad.sentence(), "not within the paper's accuracy, by neither measure");
        let nothing = verdict([f64::NAN; 2], [f64::NAN; 2]);
        assert!(nothing.sentence().starts_with("not within"));
    }

    #[test]
    fn numbers_stand_beside_the_papers() {
        let text = verdict([0.01, 0.026], [0.01, 0.04]).table(80);
        let rows: Vec<Vec<&str>> =
            text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[3], ["position", "(mm)", "25.0", "10.0", "within", "26.0", "beyond"]);
        assert_eq!(rows[4], ["orientation", "(mrad)", "40.0", "10.0", "within", "40.0", "within"]);
        let base = Verdict::of(TaskName::Reorientation, &[error(ErrorOf::Base, 0.02, 0.031)]);
        let text = base.table(80);
        let last: Vec<&str> = text.lines().last().expect("a row").split_whitespace().collect();
        assert_eq!(last, ["base", "(mrad)", "30.0", "20.0", "within", "31.0", "beyond"]);
    }
}
