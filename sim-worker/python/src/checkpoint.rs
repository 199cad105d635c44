//! Checkpoints, as `octopus` writes them.
//!
//! | text | checkpoint |
//! |---|---|
//! | a checkpoint's directory | that one |
//! | `RUN`, `RUN:latest` | the newest of the run's own that is whole |
//! | `RUN:best` | the one with the lowest score |
//! | `RUN:50`, `RUN:NAME`, `RUN:TAG` | the one after 50 iterations, of that name, with that tag |
//!
//! Every file is held against its length and BLAKE3 hash in the manifest before it is believed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proto::Digest;
use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use serde::Deserialize;
use simulator::policy::file;
use simulator::robot::Robot;

use crate::config::{hash, read};

const MANIFEST: &str = "manifest.json";
const FORMAT: u32 = 1;
/// Longest text file that is read, and longest policy (bytes).
const MAX_TEXT: u64 = 1 << 20;
const MAX_POLICY: u64 = 1 << 30;
/// Longest metrics and longest file of a checkpoint (bytes).
const MAX_METRICS: u64 = 1 << 30;
const MAX_FILE: u64 = 1 << 36;
/// What training goes on from.
const STATE: &str = "state.safetensors";

/// What a checkpoint's policy is.
pub(crate) struct Checkpoint {
    pub(crate) dir: PathBuf,
    pub(crate) iteration: u64,
    pub(crate) env_steps: u64,
    pub(crate) config: Config,
    pub(crate) robot: Robot,
    /// The actors' parameters, flat.
    pub(crate) parameters: Vec<f32>,
}

#[derive(Deserialize)]
struct Manifest {
    format: u32,
    iteration: u64,
    env_steps: u64,
    digest: Digest,
    files: BTreeMap<String, Entry>,
}

#[derive(Deserialize)]
struct Entry {
    len: u64,
    blake3: String,
}

impl Entry {
    /// Why a file of this length and hash is not the one that is meant.
    fn admits(&self, len: u64, hash: &blake3::Hash) -> Result<(), String> {
        if len != self.len {
            return Err(format!("{len} bytes, the manifest says {}", self.len));
        }
        if hash.to_hex().as_str() != self.blake3 {
            return Err("content differs from its BLAKE3 hash".to_owned());
        }
        Ok(())
    }
}

#[derive(Deserialize, Default)]
struct Labels {
    #[serde(default)]
    tags: Vec<String>,
    #[serde(default)]
    score: Option<Score>,
    #[serde(default)]
    imported: bool,
}

#[derive(Deserialize)]
struct Score {
    value: f64,
}

/// The checkpoint that a text names, and what is wrong with newer ones that are passed over.
pub(crate) fn load(given: &Path) -> Result<(Checkpoint, Vec<String>), String> {
    match locate(given)? {
        Located::One(dir) => Ok((open(&dir)?, Vec::new())),
        Located::NewestOf { run, store } => newest(&run, &store),
    }
}

/// As `octopus eval` does: the newest of the run's own from which training can go on and that is whole; one that the run has not come to
/// itself only where there is no other.
fn newest(run: &Path, store: &Path) -> Result<(Checkpoint, Vec<String>), String> {
    let mut found: Vec<PathBuf> =
        directories(store).filter(|dir| iteration(dir).is_some()).collect();
    found.sort_by_key(|dir| std::cmp::Reverse(iteration(dir)));
    let recorded = recorded(store);
    let (foreign, own): (Vec<_>, Vec<_>) = found
        .into_iter()
        .partition(|dir| recorded.as_ref().is_some_and(|run| is_foreign(dir, run)));
    let mut passed_over = Vec::new();
    for dir in own.into_iter().chain(foreign) {
        let manifest = manifest(&dir);
        if manifest.as_ref().is_ok_and(|manifest| !manifest.files.contains_key(STATE)) {
            continue;
        }
        match manifest.and_then(|manifest| check(&dir, &manifest)).and_then(|()| open(&dir)) {
            Ok(checkpoint) => return Ok((checkpoint, passed_over)),
            Err(_) if !dir.exists() => {}
            Err(error) => passed_over.push(error),
        }
    }
    Err(if passed_over.is_empty() { nothing(run, store, "latest") } else { passed_over.remove(0) })
}

/// Digests of the iterations of the run that the store belongs to; none if it belongs to none. They are empty where they cannot be read.
fn recorded(store: &Path) -> Option<Vec<Digest>> {
    let run = store.parent().filter(|run| {
        store.file_name().is_some_and(|name| name == "checkpoints")
            && run.join("config.toml").is_file()
    })?;
    let bytes = read(&run.join("metrics.jsonl"), MAX_METRICS).unwrap_or_default();
    let whole = bytes.split_inclusive(|byte| *byte == b'\n').filter(|line| line.ends_with(b"\n"));
    let values = whole.map_while(|line| serde_json::from_slice::<serde_json::Value>(line).ok());
    let digests = values.enumerate().map(|(index, line)| {
        (line["iteration"] == index).then(|| line["digest"].as_str()?.parse().ok()).flatten()
    });
    Some(digests.collect::<Option<_>>().unwrap_or_default())
}

/// Whether a run that has recorded these digests has not come to the checkpoint itself. Where nothing is recorded, or its manifest cannot be
/// read, what was imported is foreign.
fn is_foreign(dir: &Path, recorded: &[Digest]) -> bool {
    match manifest(dir) {
        Ok(Manifest { iteration, digest, .. }) if iteration > 0 && !recorded.is_empty() => {
            let last = usize::try_from(iteration - 1).ok();
            last.and_then(|last| recorded.get(last)) != Some(&digest)
        }
        _ => labels(dir).imported,
    }
}

/// Holds every file that the manifest lists against its hash.
fn check(dir: &Path, manifest: &Manifest) -> Result<(), String> {
    for (name, entry) in &manifest.files {
        let path = dir.join(name);
        let shown = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        // A state may be longer than memory.
        let (len, hash) = hash(&path, MAX_FILE).map_err(|error| shown(&error))?;
        entry.admits(len, &hash).map_err(|reason| shown(&reason))?;
    }
    Ok(())
}

/// A file of a checkpoint, as its manifest says.
fn content(
    dir: &Path,
    manifest: &Manifest,
    name: &str,
    limit: u64,
) -> Result<(PathBuf, Vec<u8>), String> {
    let shown = |path: &Path, error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let path = dir.join(name);
    let entry = manifest.files.get(name);
    let entry =
        entry.ok_or_else(|| shown(&dir.join(MANIFEST), &format!("does not list {name}")))?;
    let bytes = read(&path, limit).map_err(|error| shown(&path, &error))?;
    let admitted = entry.admits(bytes.len() as u64, &blake3::hash(&bytes));
    admitted.map_err(|reason| shown(&path, &reason))?;
    Ok((path, bytes))
}

/// The checkpoint in a directory.
fn open(dir: &Path) -> Result<Checkpoint, String> {
    let shown = |path: &Path, error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let manifest = manifest(dir)?;
    let content = |name: &str, limit: u64| content(dir, &manifest, name, limit);
    let text = |name: &str| {
        let (path, bytes) = content(name, MAX_TEXT)?;
        let text = String::from_utf8(bytes).map_err(|_| shown(&path, &"is no UTF-8 text"))?;
        Ok::<_, String>((path, text))
    };
    let (path, config) = text("config.toml")?;
    let config = Config::from_resolved_toml(&config, &path.display().to_string());
    let config = config.map_err(|error| error.to_string())?;
    let (path, robot) = text("robot.toml")?;
    let robot = Robot::from_toml(&robot, &path).map_err(|error| error.to_string())?;
    let (path, bytes) = content("policy.safetensors", MAX_POLICY)?;
    let layout = ActorLayout::new(&config, &Dimensions::new(&config, robot.joints));
    let parameters = file::read(&bytes, &layout).map_err(|error| shown(&path, &error))?;
    let Manifest { iteration, env_steps, .. } = manifest;
    Ok(Checkpoint { dir: dir.to_owned(), iteration, env_steps, config, robot, parameters })
}

fn manifest(dir: &Path) -> Result<Manifest, String> {
    let path = dir.join(MANIFEST);
    let shown = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let bytes = read(&path, MAX_TEXT).map_err(|error| shown(&error))?;
    let manifest: Manifest = serde_json::from_slice(&bytes)
        .map_err(|error| shown(&format!("not a manifest: {error}")))?;
    if manifest.format != FORMAT {
        return Err(shown(&format!("format {}, this version reads {FORMAT}", manifest.format)));
    }
    Ok(manifest)
}

/// What a text names.
enum Located {
    /// A checkpoint's directory.
    One(PathBuf),
    /// The newest of a run's store.
    NewestOf { run: PathBuf, store: PathBuf },
}

fn locate(given: &Path) -> Result<Located, String> {
    if given.join(MANIFEST).is_file() {
        return Ok(Located::One(given.to_owned()));
    }
    let apart = given.to_str().filter(|_| !given.exists()).and_then(|text| text.rsplit_once(':'));
    let (run, choice) = apart.map_or((given, "latest"), |(run, choice)| (Path::new(run), choice));
    let shown = run.display();
    if !run.is_dir() {
        let is = if run.exists() { "is no directory" } else { "does not exist" };
        return Err(format!("{shown}: {is}; give a run, a checkpoint, or RUN:NAME"));
    }
    let store =
        if run.join("config.toml").is_file() { run.join("checkpoints") } else { run.to_owned() };
    if choice == "latest" {
        return Ok(Located::NewestOf { run: run.to_owned(), store });
    }
    let found = checkpoints(&store);
    let own = |dir: &PathBuf| iteration(dir).map(|iteration| (iteration, dir.clone()));
    let chosen = match choice {
        "best" => {
            let scored = found.iter().filter_map(own).filter_map(|(iteration, dir)| {
                let value = labels(&dir).score?.value;
                value.is_finite().then_some((value, iteration, dir))
            });
            let best = scored.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            best.map(|(_, iteration, dir)| (iteration, dir))
        }
        choice => {
            let number = choice.parse::<u64>().ok();
            let numbered =
                found.iter().filter_map(own).find(|(iteration, _)| Some(*iteration) == number);
            let named = || found.iter().find(|dir| name(dir) == choice).map(|dir| (0, dir.clone()));
            let tagged = || {
                let tagged =
                    found.iter().find(|dir| labels(dir).tags.iter().any(|tag| tag == choice));
                tagged.map(|dir| (0, dir.clone()))
            };
            numbered.or_else(named).or_else(tagged)
        }
    };
    chosen.map(|(_, dir)| Located::One(dir)).ok_or_else(|| nothing(run, &store, choice))
}

/// Says that there is no such checkpoint, and which there are.
fn nothing(run: &Path, store: &Path, choice: &str) -> String {
    let shown = run.display();
    let mut found = checkpoints(store);
    if found.is_empty() {
        return format!("{shown}: holds no checkpoint; give a run, a checkpoint, or RUN:NAME");
    }
    found.sort();
    let names: Vec<&str> = found.iter().rev().take(12).map(|dir| name(dir)).collect();
    format!("{shown}: holds no checkpoint `{choice}`; it has {}", names.join(", "))
}

fn name(dir: &Path) -> &str {
    dir.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

/// The iteration in the name of a run's own checkpoint.
fn iteration(dir: &Path) -> Option<u64> {
    name(dir).strip_prefix("iteration-")?.parse().ok()
}

/// All checkpoints that look whole.
fn checkpoints(store: &Path) -> Vec<PathBuf> {
    directories(store).filter(|dir| looks_whole(dir)).collect()
}

/// Directories of a store. A link is none: what it leads to is not the store's.
fn directories(store: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(store).into_iter().flatten().flatten();
    entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .map(|entry| entry.path())
}

/// Whether all listed files are there with the right length; hashes nothing.
fn looks_whole(dir: &Path) -> bool {
    let whole = |(name, entry): (&String, &Entry)| {
        let there = dir.join(name).symlink_metadata();
        there.is_ok_and(|there| there.is_file() && there.len() == entry.len)
    };
    manifest(dir).is_ok_and(|manifest| manifest.files.iter().all(whole))
}

fn labels(dir: &Path) -> Labels {
    let bytes = read(&dir.join("labels.json"), MAX_TEXT).unwrap_or_default();
    serde_json::from_slice(&bytes).unwrap_or_default()
}
