//! Episodes of the experiments in a page that plays them: one file beside the report, and links into it.

use std::collections::BTreeMap;

use drawing::{Link, Place};
use maud::{Markup, html};
use service::page;

use super::reports::Reports;
use crate::contender::Contender;
use crate::experiments::report::PlayedEpisode;
use crate::script::Recording;
use crate::standalone::enclosed;

/// The file's name beside the report.
pub(super) const FILE: &str = "episodes.html";

/// The file, its policies called by their tasks, as recordings call them; none where the page is not there.
pub(super) fn file(policies: &[Contender]) -> anyhow::Result<Option<String>> {
    if !page::is_built() {
        return Ok(None);
    }
    let mut files = Vec::new();
    for policy in policies {
        // A controller does not play in the page.
        let Some(checkpoint) = policy.checkpoint() else { return Ok(None) };
        files.extend(enclosed(checkpoint, policy.task().as_str())?);
    }
    Ok(page::single(&files, None))
}

/// Whether a file at the place of ours was made by this program.
pub(super) fn is_ours(text: &str) -> bool {
    text.starts_with(page::SINGLE_MARK)
}

/// The address of an episode in the file.
fn link(recording: &Recording) -> anyhow::Result<String> {
    Ok(format!("{FILE}#play={}", recording.fragment()?))
}

/// Links to the first episodes of all trials, by what these are called.
#[derive(Debug, Default)]
pub(super) struct Links(BTreeMap<String, String>);

impl Links {
    /// To what all experiments kept.
    pub(super) fn of(reports: &Reports) -> anyhow::Result<Self> {
        let Reports { precision, disturbance, arm_failure, base_mass, reassembly, noise } = reports;
        let kept = [
            &precision.episodes,
            &disturbance.episodes,
            &arm_failure.episodes,
            &base_mass.episodes,
            &reassembly.episodes,
            &noise.episodes,
        ];
        let all = kept.into_iter().flatten();
        all.map(|PlayedEpisode { what, recording }| Ok((what.clone(), link(recording)?)))
            .collect::<anyhow::Result<_>>()
            .map(Self)
    }

    /// The address of a trial's episode.
    pub(super) fn get(&self, what: &str) -> Option<&str> {
        self.0.get(what).map(String::as_str)
    }

    /// A link to a trial's episode at a place of a figure.
    pub(super) fn at(&self, what: &str, at: Place) -> Option<Link> {
        let to = self.get(what)?.to_owned();
        Some(Link { to, what: format!("Watch: {what}"), at })
    }

    /// A list of those of some trials.
    pub(super) fn list(&self, episodes: &[PlayedEpisode]) -> Markup {
        let each =
            episodes.iter().filter_map(|PlayedEpisode { what, .. }| Some((what, self.get(what)?)));
        let each: Vec<_> = each.collect();
        html! {
            @if !each.is_empty() {
                details {
                    summary { "Watch it: the first episode of every setting" }
                    ul {
                        @for (what, link) in &each { li { a href=(link) { (what) } } }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    use flate2::read::DeflateDecoder;

    use super::super::reports::tests::reports;
    use super::*;

    #[test]
    fn a_link_holds_the_recording() {
        let episodes = &reports().disturbance.episodes;
        assert!(episodes.len() > 4, "{episodes:?}");
        for PlayedEpisode { recording, .. } in episodes {
            let link = link(recording).expect("a link");
            let packed = link.strip_prefix("episodes.html#play=").expect("into the file");
            let bytes = URL_SAFE_NO_PAD.decode(packed).expect("base64");
            let mut text = String::new();
            DeflateDecoder::new(&bytes[..]).read_to_string(&mut text).expect("deflate");
            let back: Recording = serde_json::from_str(&text).expect("a recording");
            assert_eq!(back, *recording);
        }
    }
}
