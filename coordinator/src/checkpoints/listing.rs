//! `list` and `show`.

use std::time::{SystemTime, UNIX_EPOCH};

use output::{age, counted, grouped, size};
use proto::{ExitCode, ExitError};
use serde::Serialize;
use store::checkpoint::{Entry, Kind, Labels, Manifest, POLICY, STATE, Survey, shapes, store_at};
use store::provenance::Utc;
use store::runs::runs_in;

use crate::checkpoints::from_bucket::{self, Found};
use crate::checkpoints::options::{ListArgs, ShowArgs};

/// Lists a store.
pub(super) fn list(args: &ListArgs) -> anyhow::Result<()> {
    if let Some(survey) = from_bucket::survey(&args.store)? {
        if survey.is_empty() && !args.json {
            return output::line(&format!("no checkpoints in {}", args.store.display()));
        }
        return print(&survey, args.json);
    }
    let store = store_at(&args.store)?;
    let survey = store.survey()?;
    store.heal_catalogue();
    if survey.is_empty() && !args.json {
        let root = store.root().display();
        return output::line(&match runs_in(store.root()).map_or(0, |runs| runs.len()) {
            0 => format!("no checkpoints in {root}"),
            runs => format!(
                "no checkpoints in {root}, but {}; name one of them, as in \
                 `octopus checkpoints list {}`",
                counted(runs as u64, "run"),
                output::quoted(store.root().join("RUN"))
            ),
        });
    }
    print(&survey, args.json)
}

fn print(survey: &Survey, json: bool) -> anyhow::Result<()> {
    if json {
        return output::json(survey);
    }
    let Survey { entries, damaged } = survey;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
    let mut lines = Vec::new();
    if !entries.is_empty() {
        lines.push(listed(entries, now, output::columns()));
    }
    lines.extend(damaged.iter().map(|entry| format!("{}: damaged: {}", entry.name, entry.reason)));
    output::line(&lines.join("\n"))
}

/// Checkpoints as a table, at the time `now` (s since 1970).
fn listed(entries: &[Entry], now: u64, columns: usize) -> String {
    let rows = entries.iter().map(|entry| {
        let score = entry.labels.score.as_ref();
        [
            entry.name.to_string(),
            grouped(entry.iteration),
            grouped(entry.env_steps),
            size(entry.bytes),
            score.map_or_else(|| "-".to_owned(), |score| format!("{:.4}", score.value)),
            labels(&entry.labels, entry.kind),
            age(now.saturating_sub(entry.created_unix_s)),
        ]
    });
    let header = ["name", "iteration", "env-steps", "size", "score", "labels", "age"];
    output::table_within(columns, header, rows)
}

/// A tensor of a checkpoint.
#[derive(Debug, Serialize)]
struct Tensor {
    file: &'static str,
    name: String,
    dtype: String,
    shape: Vec<usize>,
}

/// Everything about a checkpoint; the form of `show --json`.
#[derive(Debug, Serialize)]
struct Shown {
    #[serde(flatten)]
    entry: Entry,
    manifest: Manifest,
    tensors: Vec<Tensor>,
    /// What is wrong with it, as `verify` says it.
    problems: Vec<String>,
}

/// Shows one checkpoint.
pub(super) fn show(args: &ShowArgs) -> anyhow::Result<()> {
    let found = Found::of(&args.checkpoint)?;
    let entry = found.entry()?;
    let dir = found.store.dir(&found.name);
    let manifest = Manifest::read(&dir)?;
    let problems = found.store.verify(&found.name)?.problems;
    let mut tensors = Vec::new();
    for file in [POLICY, STATE] {
        if !manifest.files.contains_key(file) {
            continue;
        }
        // What cannot be read is among the problems.
        let Ok(found) = shapes(&dir.join(file)) else { continue };
        tensors.extend(found.into_iter().map(|(name, info)| Tensor {
            file,
            name,
            dtype: format!("{:?}", info.dtype),
            shape: info.shape,
        }));
    }
    let damaged = !problems.is_empty();
    let shown = Shown { entry, manifest, tensors, problems };
    if args.json {
        output::json(&shown)?;
    } else {
        output::line(&describe(&shown, output::columns(), args.tensors))?;
    }
    if damaged {
        let message = "the checkpoint is damaged; copy it again, or take another one (`octopus checkpoints list`)";
        return Err(ExitError::new(ExitCode::RunDirectory, message).into());
    }
    Ok(())
}

/// An error of an evaluation in the unit that it is read in: its name ends in that of the unit that
/// it has, metres or radians.
fn error_in_words(name: &str, error: f64) -> String {
    match (name.strip_suffix("_m"), name.strip_suffix("_rad")) {
        (Some(name), _) => format!("{name} {:.1} mm", 1e3 * error),
        (_, Some(name)) => format!("{name} {:.1} mrad", 1e3 * error),
        _ => format!("{name} {error:.4}"),
    }
}

/// What the checkpoint is in a few words.
fn summary(shown: &Shown) -> String {
    let Shown { entry, tensors, problems, .. } = shown;
    let state = if problems.is_empty() { "whole" } else { "damaged" };
    let what = match entry.kind {
        Kind::Training => "training goes on from it",
        Kind::Composed => "actors of several checkpoints",
        Kind::Policy => "actors only",
    };
    format!("{state}: {what}, {}, {}", size(entry.bytes), counted(tensors.len() as u64, "tensor"))
}

/// The summary first, then what is known of it, then its files; its tensors if they are wanted.
fn describe(shown: &Shown, columns: usize, with_tensors: bool) -> String {
    let Shown { entry, manifest, tensors, problems } = shown;
    let committed = Utc::from_unix(entry.created_unix_s);
    let mut lines = vec![
        format!("{:12}{}", "summary", summary(shown)),
        format!("{:12}{}", "checkpoint", entry.dir.display()),
        format!("{:12}{}", "kind", entry.kind.as_str()),
        format!("{:12}{}", "iteration", grouped(entry.iteration)),
        format!("{:12}{}", "env-steps", grouped(entry.env_steps)),
        format!("{:12}{}", "digest", entry.digest),
        format!("{:12}{committed}", "committed"),
        format!("{:12}{}", "labels", labels(&entry.labels, entry.kind)),
    ];
    if let Some(score) = &entry.labels.score {
        let errors: Vec<String> =
            score.errors.iter().map(|(name, error)| error_in_words(name, *error)).collect();
        lines.push(format!(
            "{:12}{:.6} over {} of {} steps, seed {}",
            "score",
            score.value,
            counted(score.episodes, "episode"),
            score.steps,
            score.seed
        ));
        lines.extend(errors.iter().map(|error| format!("{:12}{error}", "")));
    }
    let checked = if problems.is_empty() { "whole" } else { "damaged:" };
    lines.push(format!("{:12}{checked}", "files"));
    lines.extend(problems.iter().map(|problem| format!("{:12}{problem}", "")));
    for key in ["version", "commit", "host", "processor", "started"] {
        if let Some(value) = manifest.provenance.get(key).and_then(|value| value.as_str()) {
            lines.push(format!("{key:12}{value}"));
        }
    }
    if !manifest.origins.is_empty() {
        let rows = manifest.origins.iter().map(|origin| {
            [
                format!("agent {}", origin.agent),
                format!("agent {} of {}", origin.source_agent, origin.run),
                grouped(origin.iteration),
                abridged(&origin.digest.to_string()),
            ]
        });
        let header = ["actor", "origin", "iteration", "digest"];
        lines.extend([String::new(), output::table_within(columns, header, rows)]);
    }
    lines.push(String::new());
    let files = manifest
        .files
        .iter()
        .map(|(name, file)| [name.clone(), grouped(file.len), abridged(&file.blake3)]);
    lines.push(output::table_within(columns, ["file", "bytes", "BLAKE3"], files));
    lines.push(String::new());
    if !with_tensors {
        let all = counted(tensors.len() as u64, "tensor");
        lines.push(format!("--tensors lists the {all}, --json all digits of the hashes"));
        return lines.join("\n");
    }
    let rows = tensors.iter().map(|tensor| {
        let shape: Vec<String> = tensor.shape.iter().map(ToString::to_string).collect();
        let file = tensor.file.trim_end_matches(".safetensors");
        [format!("{file}/{}", tensor.name), tensor.dtype.clone(), shape.join(" × ")]
    });
    lines.push(output::table_within(columns, ["tensor", "type", "shape"], rows));
    lines.join("\n")
}

/// As much of a hash as tells it from others.
fn abridged(hash: &str) -> String {
    format!("{}…", hash.chars().take(16).collect::<String>())
}

/// Labels in a few words.
fn labels(labels: &Labels, kind: Kind) -> String {
    let mut words: Vec<&str> = Vec::new();
    if kind != Kind::Training {
        words.push(kind.as_str());
    }
    if labels.pinned {
        words.push("pinned");
    }
    if labels.milestone {
        words.push("milestone");
    }
    words.extend(labels.tags.iter().map(store::checkpoint::Name::as_str));
    if words.is_empty() { "-".to_owned() } else { words.join(", ") }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proto::Digest;
    use store::checkpoint::{Name, Score};

    use super::*;

    #[test]
    fn a_listing_fits_and_lists_all_labels() {
        let name = |text: &str| text.parse::<Name>().expect("a name");
        let labels = Labels {
            pinned: true,
            milestone: true,
            tags: vec![name("best"), name("latest"), name("paper-figure-3")],
            score: Some(Score {
                value: 1234.5678,
                errors: BTreeMap::new(),
                episodes: 100,
                steps: 200,
                seed: 1,
            }),
            ..Labels::default()
        };
        let entry = Entry {
            name: name("iteration-00012345"),
            dir: "runs/a".into(),
            kind: Kind::Training,
            iteration: 12_345,
            env_steps: 999_999_999,
            digest: Digest([7; 16]),
            created_unix_s: 0,
            bytes: 999_900_000,
            labels,
            origins: Vec::new(),
        };
        let text = listed(&[entry], 3000, 80);
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{text}");
        }
        for word in ["iteration-00012345", "1234.5678", "pinned,", "paper-figure-3", "50 min"] {
            assert!(text.contains(word), "{word} is not whole in\n{text}");
        }
    }
}
