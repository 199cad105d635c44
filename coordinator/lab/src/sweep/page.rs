//! The page of a sweep: which configuration is the best, how all of them learned, and what they cost. It stands alone: no
//! script, nothing fetched.

use std::path::PathBuf;

use maud::{Markup, PreEscaped, html};
use output::grouped;
use store::provenance::Provenance;

use super::outcome::{ConfigurationOutcome, Outcome, TrialOutcome, minutes};
use super::study::Study;
use crate::document::{document, made};
use crate::figures::families::{Over, families};
use crate::figures::learning::learning;
use crate::figures::recorded;
use crate::statistics::percent;

/// Stands in every page of ours, and so in none of others.
pub const GENERATOR: &str = "octopus sweep";
/// Most configurations whose curves are drawn: as many as can be told apart.
const DRAWN: usize = 8;

/// The page as HTML.
pub fn page(title: &str, study: &Study, outcome: &Outcome) -> anyhow::Result<String> {
    let body = html! {
        h1 { "Sweep " (title) }
        (head(study, outcome))
        (configurations(outcome))
        (curves(outcome)?)
        (trials(outcome))
        h2 { "The sweep" }
        pre { (study.text) }
    };
    Ok(document(GENERATOR, &format!("sweep {title}"), &body))
}

fn head(study: &Study, outcome: &Outcome) -> Markup {
    let provenance = Provenance::gather();
    let sum = |read: fn(&TrialOutcome) -> f64| outcome.trials.iter().map(read).sum::<f64>();
    let env_steps = outcome.trials.iter().map(|trial| trial.env_steps).sum();
    html! {
        dl {
            (made(&provenance))
            dt { "trials" } dd {
                (output::counted(study.trials.len() as u64, "trial")) " of "
                (output::counted(study.configurations.len() as u64, "configuration"))
            }
            dt { "cost" } dd {
                (grouped(env_steps)) " env-steps; trainings of " (minutes(sum(|trial| trial.wall_s))) " min together, "
                (minutes(sum(|trial| trial.cpu_s))) " min of processor time"
            }
        }
    }
}

fn configurations(outcome: &Outcome) -> Markup {
    html! {
        h2 id="configurations" { "Configurations" }
        p { "The best first. A score is the mean of the errors in the last 20 steps in units of the paper's accuracy, on held-out goals: 1 is as good as the \
            paper, and less is better. Numbers are means over the seeds; in brackets is the 95 % bootstrap interval, which of three seeds is all that they span. \
            At the end the goals are others than at the rungs. Missed are goals that can be reached and whose hand ends further than 30 mm or 60 mrad away." }
        div class="scroll" { table {
            thead { tr { @for cell in Outcome::HEADER { th { (cell) } } th { "iterations" } th { "env-steps" } th { "processors (min)" } } }
            tbody { @for of in &outcome.configurations { (configuration(of)) } }
        } }
    }
}

fn configuration(of: &ConfigurationOutcome) -> Markup {
    html! {
        tr {
            @for cell in of.row() { td { (cell) } }
            td { @if let Some(iteration) = of.iteration { (grouped(iteration)) } }
            td { (grouped(of.env_steps)) }
            td { (minutes(of.cpu_s)) }
        }
    }
}

/// The learning curves of the best configurations, of all trials that have one.
fn curves(outcome: &Outcome) -> anyhow::Result<Markup> {
    let best = outcome.configurations.iter().take(DRAWN);
    let trials =
        best.flat_map(|of| outcome.trials.iter().filter(|trial| trial.configuration == of.name));
    let runs: Vec<PathBuf> =
        trials.filter(|trial| trial.iterations >= 2).map(|trial| trial.run_dir.clone()).collect();
    if runs.is_empty() {
        return Ok(html! {});
    }
    let more = outcome.configurations.len() > DRAWN;
    let (curves, _) = recorded::read_all(&runs)?;
    let picture = learning(&families(&curves, Over::EnvSteps), Over::EnvSteps)?;
    Ok(html! {
        h2 id="learning" { "Learning" }
        figure {
            (PreEscaped(picture))
            figcaption { "Mean over the seeds of a configuration within its 95 % bootstrap interval, as far as all of them have come. The legend has the keys in \
                which they differ. Returns are of training episodes, exploration included; errors of deterministic actions on held-out goals, in the last steps."
                @if more { " Only the best " (DRAWN) " are drawn." }
            }
        }
    })
}

fn trials(outcome: &Outcome) -> Markup {
    html! {
        h2 id="trials" { "Trials" }
        div class="scroll" { table {
            thead { tr { @for cell in Outcome::TRIALS { th { (cell) } } th { "missed" } th { "contact" } th { "digest" } } }
            tbody { @for trial in &outcome.trials { (trial_row(trial)) } }
        } }
    }
}

fn trial_row(trial: &TrialOutcome) -> Markup {
    let scored = trial.scored.as_ref();
    let missed = scored.and_then(|scored| scored.reachable.as_ref());
    html! {
        tr {
            @for cell in trial.row() { td { (cell) } }
            td { @if let Some(of) = missed { (percent(of.missed)) } }
            td { @if let Some(scored) = scored { (percent(scored.contact_rate)) } }
            td {
                @if let Some(digest) = &trial.digest { span class="digest" { (digest) } }
                @if let Some(failure) = &trial.failure { div class="fails" { (failure) } }
            }
        }
    }
}
