//! Checkpoints, as `octopus` writes them.
//!
//! | text | checkpoint |
//! |---|---|
//! | a checkpoint's directory | that one |
//! | `RUN`, `RUN:latest` | the newest of the run's own that is whole |
//! | `RUN:best` | of the run's own the one with the lowest score |
//! | `RUN:50`, `RUN:NAME`, `RUN:TAG` | the one after 50 iterations, of that name, with that tag |

use std::path::{Path, PathBuf};

use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use simulator::policy::file;
use simulator::robot::Robot;

use crate::directories::{directories, iteration, name};
use crate::labels::Labels;
use crate::manifest::{MANIFEST, Manifest};
use crate::newest::{Ownership, candidates};

/// Longest text file that is read, and longest policy (bytes).
const MAX_TEXT: u64 = 1 << 20;
const MAX_POLICY: u64 = 1 << 30;

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

/// The checkpoint that a text names, and what is wrong with newer ones that are passed over.
pub(crate) fn load(given: &Path) -> Result<(Checkpoint, Vec<String>), String> {
    match locate(given)? {
        Located::One(dir) => Ok((open(&dir, &Manifest::read(&dir)?)?, Vec::new())),
        Located::NewestOf { run, store } => newest(&run, &store),
    }
}

/// The newest that is whole; one that the run has not come to itself only where there is no other.
fn newest(run: &Path, store: &Path) -> Result<(Checkpoint, Vec<String>), String> {
    let mut passed_over = Vec::new();
    for (dir, manifest) in candidates(store) {
        let whole = manifest.and_then(|manifest| manifest.check(&dir).map(|()| manifest));
        match whole.and_then(|manifest| open(&dir, &manifest)) {
            Ok(checkpoint) => return Ok((checkpoint, passed_over)),
            Err(_) if !dir.exists() => {}
            Err(error) => passed_over.push(error),
        }
    }
    Err(if passed_over.is_empty() { nothing(run, store, "latest") } else { passed_over.remove(0) })
}

/// The checkpoint in a directory that has this manifest.
fn open(dir: &Path, manifest: &Manifest) -> Result<Checkpoint, String> {
    let shown = |path: &Path, error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let text = |name: &str| {
        let (path, bytes) = manifest.content(dir, name, MAX_TEXT)?;
        let text = String::from_utf8(bytes).map_err(|_| shown(&path, &"is no UTF-8 text"))?;
        Ok::<_, String>((path, text))
    };
    let (path, config) = text("config.toml")?;
    let config = Config::from_resolved_toml(&config, &path.display().to_string());
    let config = config.map_err(|error| error.to_string())?;
    let (path, robot) = text("robot.toml")?;
    let robot = Robot::from_toml(&robot, &path).map_err(|error| error.to_string())?;
    let (path, bytes) = manifest.content(dir, "policy.safetensors", MAX_POLICY)?;
    let layout = ActorLayout::new(&config, &Dimensions::new(&config, robot.joints));
    let parameters = file::read(&bytes, &layout).map_err(|error| shown(&path, &error))?;
    let Manifest { iteration, env_steps, .. } = *manifest;
    Ok(Checkpoint { dir: dir.to_owned(), iteration, env_steps, config, robot, parameters })
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
    let chosen = choose(&store, choice).map_err(|error| format!("{shown}: {error}"))?;
    chosen.map(Located::One).ok_or_else(|| nothing(run, &store, choice))
}

/// The checkpoint of a store that a choice other than `latest` means.
fn choose(store: &Path, choice: &str) -> Result<Option<PathBuf>, String> {
    let found = checkpoints(store);
    let number = choice.parse::<u64>().ok();
    let numbered = || found.iter().find(|dir| number.is_some() && iteration(dir) == number);
    let named = || found.iter().find(|dir| name(dir) == choice);
    let best = || (choice == "best").then(|| best(store, &found)).flatten();
    if let Some(dir) = numbered().or_else(named).or_else(best) {
        return Ok(Some(dir.clone()));
    }
    let mut tagged =
        found.iter().filter(|dir| Labels::read(dir).tags.iter().any(|tag| tag == choice));
    match (tagged.next(), tagged.next()) {
        // Killed while it moved a tag, `octopus` leaves it on both.
        (Some(first), Some(second)) => Err(format!(
            "the tag `{choice}` is on {} and on {}; tag one of them again",
            name(first),
            name(second)
        )),
        (first, _) => Ok(first.cloned()),
    }
}

/// The run's own checkpoint with the lowest score; of equal ones the earliest. What was copied into the store brings its score, and is not what
/// the run has come to.
fn best<'a>(store: &Path, found: &'a [PathBuf]) -> Option<&'a PathBuf> {
    let ownership = Ownership::of(store);
    let own = found.iter().filter_map(|dir| Some((iteration(dir)?, dir)));
    let own = own.filter(|(_, dir)| !ownership.is_foreign(dir, Manifest::read(dir).ok().as_ref()));
    let scored = own.filter_map(|(iteration, dir)| {
        let value = Labels::read(dir).score?.value;
        value.is_finite().then_some((value, iteration, dir))
    });
    let best = scored.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    best.map(|(.., dir)| dir)
}

/// Says that there is no such checkpoint, and which there are.
fn nothing(run: &Path, store: &Path, choice: &str) -> String {
    let shown = run.display();
    let found = checkpoints(store);
    if found.is_empty() {
        return format!("{shown}: holds no checkpoint; give a run, a checkpoint, or RUN:NAME");
    }
    let names: Vec<&str> = found.iter().rev().take(12).map(|dir| name(dir)).collect();
    format!("{shown}: holds no checkpoint `{choice}`; it has {}", names.join(", "))
}

/// All checkpoints that look whole, by name.
fn checkpoints(store: &Path) -> Vec<PathBuf> {
    let looks_whole =
        |dir: &PathBuf| Manifest::read(dir).is_ok_and(|manifest| manifest.looks_whole(dir));
    let mut found: Vec<PathBuf> = directories(store).filter(looks_whole).collect();
    found.sort();
    found
}
