//! Episodes of the experiments in a page that plays them: one file beside the report, and links into it.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use maud::{Markup, html};
use service::page;

use crate::contender::Contender;
use crate::experiments::report::PlayedEpisode;
use crate::script::Recording;
use crate::standalone::enclosed;

/// The file's name beside the report.
pub(super) const FILE: &str = "episodes.html";

/// The file, its policies called by their tasks, as recordings call them; none where the program was built without its page.
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
    Ok(page::single(&files))
}

/// Whether a file at the place of ours was made by this program.
pub(super) fn is_ours(text: &str) -> bool {
    text.starts_with(page::SINGLE_MARK)
}

/// The address of an episode in the file.
fn link(recording: &Recording) -> anyhow::Result<String> {
    let mut packed = DeflateEncoder::new(Vec::new(), Compression::best());
    packed.write_all(&serde_json::to_vec(recording)?)?;
    Ok(format!("{FILE}#play={}", URL_SAFE_NO_PAD.encode(packed.finish()?)))
}

/// Links to the first episodes of an experiment's trials.
pub(super) fn links(episodes: &[PlayedEpisode]) -> anyhow::Result<Markup> {
    let mut each = Vec::with_capacity(episodes.len());
    for PlayedEpisode { what, recording } in episodes {
        each.push((what, link(recording)?));
    }
    Ok(html! {
        @if !each.is_empty() {
            details {
                summary { "Watch it: the first episode of every setting" }
                ul {
                    @for (what, link) in &each { li { a href=(link) { (what) } } }
                }
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

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
