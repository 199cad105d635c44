//! The frame of a page that stands alone: no script, nothing fetched.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use store::provenance::{Provenance, Utc};

/// A page as HTML; `generator` says which command makes it.
pub(crate) fn document(generator: &str, title: &str, body: &Markup) -> String {
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content=(generator);
                title { "SpaceOctopus: " (title) }
                style { (PreEscaped(include_str!("document.css"))) }
            }
            body { (body) }
        }
    };
    markup.into_string()
}

/// When a page is made, and what made the numbers on it: rows of a list of terms.
pub(crate) fn made(provenance: &Provenance) -> Markup {
    let Provenance { version, commit, build, system, processor, processors, .. } = provenance;
    html! {
        dt { "made" } dd { (Utc::now()) }
        dt { "program" } dd { (version) ", commit " code { (commit) } ", " (build) " build" }
        dt { "machine" } dd { (processor) ", " (output::counted(*processors as u64, "processor")) ", " (system) }
    }
}
