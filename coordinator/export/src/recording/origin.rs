//! What a recording says of itself: enough to play its episode again.

use std::collections::BTreeMap;

use mcap::Summary;
use mcap::read::metadata;

/// Name of the record that says where a recording comes from.
pub(super) const ABOUT: &str = "spaceoctopus";

/// What every MCAP file begins with.
pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// The episode of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedEpisode {
    /// Where the policy's checkpoint was.
    pub checkpoint: String,
    /// Digest of the checkpoint.
    pub digest: String,
    /// Seed of the goals.
    pub seed: u64,
    /// Which episode of that seed.
    pub episode: u32,
    /// Control steps.
    pub steps: usize,
}

impl RecordedEpisode {
    /// Whether a file is an MCAP file, of whomever.
    pub fn is_mcap(file: &[u8]) -> bool {
        file.starts_with(MAGIC)
    }

    /// That of an MCAP file that [`Recording`](super::Recording) has written.
    ///
    /// # Errors
    /// Why it is none of ours, in words.
    pub fn of(file: &[u8]) -> Result<Self, String> {
        let summary = Summary::read(file)
            .map_err(|error| format!("it is cut off or damaged ({error}); record it again"))?;
        let summary = summary.ok_or("it has no summary")?;
        let index = summary.metadata_indexes.iter().find(|index| index.name == ABOUT);
        let index = index.ok_or("`octopus record` did not make it")?;
        let end = index.offset.checked_add(index.length);
        if end.is_none_or(|end| end > file.len() as u64) {
            return Err("it is cut short".to_owned());
        }
        let about = metadata(file, index).map_err(|error| error.to_string())?.metadata;
        let statistics = summary.stats.as_ref().ok_or("it has no statistics")?;
        let moments = statistics.channel_message_counts.values().max().copied().unwrap_or(0);
        let steps = moments.checked_sub(1).ok_or("it holds no moment")?;
        Ok(Self {
            checkpoint: text(&about, "checkpoint")?.to_owned(),
            digest: text(&about, "digest")?.to_owned(),
            seed: number(&about, "seed")?,
            episode: number(&about, "episode")?,
            steps: usize::try_from(steps).map_err(|error| error.to_string())?,
        })
    }
}

fn text<'a>(about: &'a BTreeMap<String, String>, key: &str) -> Result<&'a str, String> {
    about.get(key).map(String::as_str).ok_or_else(|| format!("it does not say its {key}"))
}

fn number<T: std::str::FromStr>(about: &BTreeMap<String, String>, key: &str) -> Result<T, String> {
    let text = text(about, key)?;
    text.parse().map_err(|_| format!("its {key} is `{text}`, expected a number"))
}
