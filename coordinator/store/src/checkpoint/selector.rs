//! How a user names a checkpoint, everywhere.
//!
//! | text | checkpoint |
//! |---|---|
//! | a checkpoint's directory | that one |
//! | `RUN` | the newest of the run from which training can go on |
//! | `RUN:latest` | likewise |
//! | `RUN:best` | the one with the lowest score |
//! | `RUN:50` | the one after 50 iterations |
//! | `RUN:NAME` | the one of that name |
//! | `RUN:TAG` | the one with that tag |
//!
//! `RUN` is a run directory or any directory of checkpoints. A path that holds a `:` and exists is
//! that path.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use proto::bucket_address;
use proto::run_dir::RunDir;

use super::CheckpointError;
use super::file_names::MANIFEST;
use super::name::Name;
use super::read::Checkpoint;
use super::reserved::{BEST, LATEST};
use super::store::CheckpointStore;
use crate::lock::RunLock;
use crate::runs::runs_in;

/// What a user wrote to name a checkpoint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selector {
    path: PathBuf,
    choice: Option<Name>,
}

impl Selector {
    /// Takes a path as it is, or apart at its last `:` if it does not exist.
    pub fn from_path(path: &Path) -> Result<Self, String> {
        match path.to_str() {
            Some(text) => text.parse(),
            None => Ok(Self { path: path.to_owned(), choice: None }),
        }
    }

    /// The path that it begins with: a run, a directory of checkpoints, or a checkpoint.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Which checkpoint of a run it says, by name, tag or iteration.
    pub fn choice(&self) -> Option<&Name> {
        self.choice.as_ref()
    }

    /// The same choice in another run or directory.
    #[must_use]
    pub fn elsewhere(&self, path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), choice: self.choice.clone() }
    }

    /// Whether it says which checkpoint of a run it means, or is a checkpoint's directory.
    pub fn is_explicit(&self) -> bool {
        self.choice.is_some() || matches!(self.directory(), Ok(Some(_)))
    }

    /// Store and name of the checkpoint.
    pub fn locate(&self) -> Result<(CheckpointStore, Name), CheckpointError> {
        if self.choice.is_none()
            && let Some(found) = self.directory()?
        {
            return Ok(found);
        }
        let store = store_at(&self.path)?;
        let name = match &self.choice {
            None => newest(&store)?,
            Some(choice) => choose(&store, choice)?,
        };
        Ok((store, name))
    }

    /// The checkpoint, checked against its manifest. Of a damaged newest one the log says so, and
    /// the one before is taken.
    pub fn open(&self) -> Result<Checkpoint, CheckpointError> {
        let latest = self.choice.as_ref().is_none_or(|choice| choice.as_str() == LATEST);
        if latest && (self.choice.is_some() || self.directory()?.is_none()) {
            let store = store_at(&self.path)?;
            return store.latest().map_err(|error| explain(&store, error));
        }
        let (store, name) = self.locate()?;
        store.load(&store.dir(&name)).map_err(|error| error.or_another(store.root()))
    }

    /// The checkpoint whose directory the path is, damaged or not.
    fn directory(&self) -> Result<Option<(CheckpointStore, Name)>, CheckpointError> {
        let path = &self.path;
        // `.` and `..` have no name of their own, and that of a link is not the checkpoint's.
        let elsewhere = path.file_name().is_none() || path.is_symlink();
        let whole = if elsewhere && path.exists() {
            path.canonicalize().map_err(CheckpointError::io(path, "read"))?
        } else {
            path.clone()
        };
        let Some(name) = whole.file_name().and_then(|name| name.to_str()) else { return Ok(None) };
        let name = match name.parse::<Name>() {
            Ok(name) => name,
            Err(_) if !whole.join(MANIFEST).is_file() => return Ok(None),
            Err(error) => {
                let what = format!("is a checkpoint, but its directory has to be renamed: {error}");
                return Err(CheckpointError::NotFound { path: path.clone(), what });
            }
        };
        let damaged = name.iteration().is_some() && !RunDir::new(&whole).checkpoints().is_dir();
        if !whole.is_dir() || !(whole.join(MANIFEST).exists() || damaged) {
            return Ok(None);
        }
        let parent = match whole.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        Ok(Some((CheckpointStore::new(parent), name)))
    }
}

impl FromStr for Selector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.is_empty() {
            return Err("wants a run directory, a checkpoint, or RUN:NAME".to_owned());
        }
        let path = PathBuf::from(text);
        if bucket_address::is_address(text) {
            // The first colon is the address's own.
            let (address, choice) = match text.rsplit_once(':') {
                Some((address, choice)) if !choice.contains('/') => (address, Some(choice)),
                _ => (text, None),
            };
            let choice = choice.map(str::parse).transpose().map_err(|error| format!("{error}"))?;
            return Ok(Self { path: address.into(), choice });
        }
        match text.rsplit_once(':') {
            Some((run, choice)) if !path.exists() => {
                if run.is_empty() {
                    return Err(format!("`{text}` names no run before the `:`"));
                }
                let choice = choice.parse().map_err(|error| format!("{error}"))?;
                Ok(Self { path: run.into(), choice: Some(choice) })
            }
            _ => Ok(Self { path, choice: None }),
        }
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        self.choice.iter().try_for_each(|choice| write!(f, ":{choice}"))
    }
}

/// The store that `path` means: that of a run directory, or the directory itself.
pub fn store_at(path: &Path) -> Result<CheckpointStore, CheckpointError> {
    let store = store_to_be(path)?;
    if store.root().is_dir() || path.is_dir() {
        return Ok(store);
    }
    let what = if path.to_str().is_some_and(bucket_address::is_address) {
        "is a bucket, which this command does not read; `octopus checkpoints export` brings a checkpoint from \
         it, `octopus resume` a run"
            .to_owned()
    } else if let Some(dir) =
        path.parent().filter(|dir| path.exists() && dir.join(MANIFEST).exists())
    {
        let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
        format!("is a file of a checkpoint; name its directory, {}", output::quoted(dir))
    } else {
        let is = if path.exists() { "is no directory" } else { "does not exist" };
        format!("{is}; `octopus status` lists the runs")
    };
    Err(CheckpointError::NotFound { path: path.to_owned(), what })
}

/// Like [`store_at`], for a store that need not exist yet. A checkpoint's own directory is none.
pub fn store_to_be(path: &Path) -> Result<CheckpointStore, CheckpointError> {
    if path.join(MANIFEST).exists() {
        let what = format!(
            "is a checkpoint, not a directory of them; `octopus checkpoints show {}` shows it",
            output::quoted(path)
        );
        return Err(CheckpointError::NotFound { path: path.to_owned(), what });
    }
    let run = RunDir::new(path);
    let is_run = run.config().is_file();
    Ok(CheckpointStore::new(if is_run { run.checkpoints() } else { path.to_owned() }))
}

/// Name of the newest checkpoint from which training can go on.
fn newest(store: &CheckpointStore) -> Result<Name, CheckpointError> {
    let checkpoint = store.latest().map_err(|error| explain(store, error))?;
    let name = checkpoint.dir.file_name().unwrap_or_default().to_string_lossy();
    Ok(name.parse()?)
}

/// Adds what there is to an error that says that there is nothing.
fn explain(store: &CheckpointStore, error: CheckpointError) -> CheckpointError {
    match error {
        CheckpointError::NotFound { path, .. } => {
            let what = match inventory(store).as_str() {
                "" if runs_in(&path).is_ok_and(|runs| !runs.is_empty()) => {
                    "holds runs, not checkpoints; name one of them".to_owned()
                }
                "" => match store.run() {
                    Some(run) => none_of_run(&run),
                    None => "holds no checkpoint; `octopus status` lists the runs".to_owned(),
                },
                inventory => format!(
                    "holds no checkpoint of a run's own; it has {inventory}; name one of them, such as {}",
                    output::quoted(example(store))
                ),
            };
            CheckpointError::NotFound { path, what }
        }
        other => other.or_another(store.root()),
    }
}

/// The path of the newest checkpoint of a store that has some.
fn example(store: &CheckpointStore) -> PathBuf {
    let newest = store.entries().ok().and_then(|entries| entries.into_iter().next_back());
    newest.map_or_else(|| store.root().to_owned(), |entry| store.dir(&entry.name))
}

/// How a run without a checkpoint gets one.
fn none_of_run(run: &RunDir) -> String {
    let shown = output::quoted(run.path());
    if matches!(RunLock::holder(&run.lock()), Ok(Some(_))) {
        format!(
            "holds no checkpoint yet; `octopus checkpoints commit {shown}` has the run commit one now"
        )
    } else {
        format!(
            "holds no checkpoint; `octopus resume {shown}` trains the run from its beginning and commits \
             one at its end"
        )
    }
}

fn choose(store: &CheckpointStore, choice: &Name) -> Result<Name, CheckpointError> {
    if choice.as_str() == LATEST {
        return newest(store);
    }
    let survey = store.survey()?;
    let damaged = survey.damaged.iter().map(|damaged| &damaged.name);
    let names: Vec<&Name> = survey.entries.iter().map(|entry| &entry.name).chain(damaged).collect();
    let number = choice.as_str().bytes().all(|byte| byte.is_ascii_digit());
    if number
        && let Ok(iteration) = choice.as_str().parse::<u64>()
        && let Some(name) = names.iter().find(|name| name.iteration() == Some(iteration))
    {
        return Ok((*name).clone());
    }
    if let Some(name) = names.iter().find(|name| **name == choice) {
        return Ok((*name).clone());
    }
    if choice.as_str() == BEST
        && let Some(best) = store.best()?
    {
        return Ok(best.name);
    }
    let mut tagged = survey.entries.iter().filter(|entry| entry.labels.has_tag(choice.as_str()));
    let not_found =
        |what: String| CheckpointError::NotFound { path: store.root().to_owned(), what };
    match (tagged.next(), tagged.next()) {
        (Some(entry), None) => Ok(entry.name.clone()),
        (Some(first), Some(second)) => Err(not_found(format!(
            "the tag `{choice}` is on {} and on {}; tag one of them again",
            first.name, second.name
        ))),
        (None, _) => {
            let kind = match choice.as_str() {
                BEST => "no checkpoint with a score".to_owned(),
                _ if number => format!("no checkpoint of iteration {choice}"),
                _ => format!("no checkpoint and no tag `{choice}`"),
            };
            Err(not_found(match inventory(store).as_str() {
                "" => format!("holds {kind}, and no other either"),
                inventory => format!("holds {kind}; it has {inventory}"),
            }))
        }
    }
}

/// Names and tags of a store in a sentence; of many, the last.
fn inventory(store: &CheckpointStore) -> String {
    const SHOWN: usize = 12;
    let Ok(entries) = store.entries() else { return String::new() };
    let mut names: Vec<String> = entries
        .iter()
        .rev()
        .take(SHOWN)
        .map(|entry| {
            let tags: Vec<&str> = entry.labels.tags.iter().map(Name::as_str).collect();
            if tags.is_empty() {
                entry.name.to_string()
            } else {
                format!("{} ({})", entry.name, tags.join(", "))
            }
        })
        .collect();
    if entries.len() > SHOWN {
        names.push(format!("and {} more", entries.len() - SHOWN));
    }
    names.join(", ")
}
