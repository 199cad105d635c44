//! What disturbances led to as a person reads it.

use super::disturbed::Disturbed;
use crate::statistics::{milli, percent};

pub(super) fn table(columns: usize, results: &[Disturbed], episodes: usize) -> String {
    let rows = results.iter().flat_map(|result| {
        result.errors.iter().map(move |error| {
            let soonest =
                error.steps_to_recover.map_or("–".to_owned(), |steps| steps.p50.to_string());
            [
                format!("{}, {} (m{})", result.what, error.error, error.unit),
                milli(error.before.p50),
                milli(error.at.p50),
                milli(error.peak.p50),
                milli(error.tail.p50),
                milli(error.tail.p90),
                milli(f64::from(error.threshold)),
                percent(error.recovered),
                soonest,
                percent(error.below_tail),
                result.base_turns.map_or("–".to_owned(), |turns| milli(turns.p50)),
            ]
        })
    });
    let header = [
        "worst axis, median",
        "before",
        "at",
        "peak",
        "tail",
        "tail p90",
        "below",
        "recovered",
        "steps",
        "below in tail",
        "base turns",
    ];
    format!(
        "{} each\n{}{}",
        output::counted(episodes as u64, "episode"),
        output::table_within(columns, header, rows),
        notes(results)
    )
}

/// What a push leaves, in words: where the base goes, and what that leaves to the hand.
fn notes(results: &[Disturbed]) -> String {
    let mut lines = Vec::new();
    for result in results {
        let (Some(turns), Some(within_reach)) = (result.base_turns, result.within_reach) else {
            continue;
        };
        let below: Vec<String> = result
            .errors
            .iter()
            .filter_map(|error| {
                Some(format!("{} in {}", percent(error.below_tail_within_reach?), error.error))
            })
            .collect();
        let below = match below.as_slice() {
            [] => String::new(),
            below => format!(";\n  of these end below: {}", below.join(", ")),
        };
        lines.push(format!(
            "{}: then the base turns by {} mrad, {} at 90 %;\n  {} of the goals are within the arm's reach at the end{below}",
            result.what,
            milli(turns.p50),
            milli(turns.p90),
            percent(within_reach),
        ));
    }
    if lines.is_empty() { String::new() } else { format!("\n\n{}", lines.join("\n")) }
}
