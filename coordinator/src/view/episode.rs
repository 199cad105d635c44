//! An episode that was kept in a file: what the page saved, or a recording of `octopus record`.

use std::path::{Path, PathBuf};

use export::RecordedEpisode;
use lab::script::{self, Recording, TookPart};
use lab::trained::open_checkpoint;
use proto::{ExitCode, ExitError};
use simulator::experiment::{Script, Start};
use store::checkpoint::{Checkpoint, CheckpointStore, Name, Selector};
use store::regular_files;

/// Longest file that is read (bytes).
const MAX_BYTES: u64 = 1 << 30;

/// An episode and what acts in it.
pub(super) struct Episode {
    file: PathBuf,
    pub(super) recording: Recording,
    /// In the order in which the recording counts them.
    policies: Vec<PathBuf>,
}

impl Episode {
    /// That in a file; none where the path names no file. `policies` are those that the command line names.
    pub(super) fn read(file: &Path, policies: &[PathBuf]) -> anyhow::Result<Option<Self>> {
        if !file.is_file() {
            return Ok(None);
        }
        let bytes = regular_files::read(file, MAX_BYTES)
            .map_err(|error| bad(file, &format!("cannot be read: {error}")))?;
        let mut policies = policies.to_vec();
        let recording = if RecordedEpisode::is_mcap(&bytes) {
            let found = RecordedEpisode::of(&bytes).map_err(|what| {
                bad(file, &format!("cannot be played here: {what}; Foxglove and Rerun open it"))
            })?;
            if policies.is_empty() {
                policies.push(PathBuf::from(&found.checkpoint));
            }
            of_recorded(found)
        } else {
            script::read(file)?
        };
        if policies.is_empty() {
            let wants = match recording.policies.first() {
                Some(first) => format!("`{}` of digest {}", first.name, first.digest),
                None => "a policy".to_owned(),
            };
            let message = format!("wants {wants}; name it with --policy CHECKPOINT");
            return Err(bad(file, &message).into());
        }
        Ok(Some(Self { file: file.to_owned(), recording, policies }))
    }

    /// Its policies, which must be those that took part.
    pub(super) fn open(&self) -> anyhow::Result<Vec<Checkpoint>> {
        let opened: Vec<Checkpoint> = self
            .policies
            .iter()
            .map(|path| open_checkpoint(path))
            .collect::<anyhow::Result<_>>()?;
        let given: Vec<&Checkpoint> = opened.iter().collect();
        self.recording.check(&given).map_err(|what| bad(&self.file, &what))?;
        Ok(opened)
    }

    /// The one directory of checkpoints that all of its policies lie in. The recording then has their names there.
    pub(super) fn store(&mut self) -> anyhow::Result<CheckpointStore> {
        let opened = self.open()?;
        let mut store: Option<CheckpointStore> = None;
        let mut names = Vec::new();
        for path in &self.policies {
            let selector = Selector::from_path(path).map_err(|what| bad(path, &what))?;
            let (found, name) = selector.locate()?;
            if let Some(store) = &store
                && store.root() != found.root()
            {
                let message = format!(
                    "its policies lie in {} and in {}; a service serves one directory of checkpoints, \
                     --out FILE.html takes any",
                    store.root().display(),
                    found.root().display()
                );
                return Err(bad(&self.file, &message).into());
            }
            store = Some(found);
            names.push(name);
        }
        self.rename(&names.iter().map(Name::as_str).collect::<Vec<_>>(), &opened);
        Ok(store.expect("there is a policy"))
    }

    /// Calls its policies by other names.
    pub(super) fn rename(&mut self, names: &[&str], policies: &[Checkpoint]) {
        let named = names.iter().zip(policies).map(|(name, policy)| TookPart {
            name: (*name).to_owned(),
            digest: policy.manifest.digest.to_string(),
        });
        self.recording.policies = named.collect();
    }
}

/// What plays a recorded episode again.
fn of_recorded(found: RecordedEpisode) -> Recording {
    let RecordedEpisode { checkpoint, digest, seed, episode, steps } = found;
    let start = Start { seed, episode, ..Start::default() };
    Recording {
        policies: vec![TookPart { name: checkpoint, digest }],
        script: Script { start, steps, events: Vec::new() },
    }
}

fn bad(file: &Path, what: &str) -> ExitError {
    ExitError::new(ExitCode::BadInput, format!("{}: {what}", file.display()))
}
