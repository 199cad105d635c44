//! The thorough check of a checkpoint: not only that it is as it was committed, but that it makes
//! sense.

use std::path::{Path, PathBuf};

use proto::layout::{ActorLayout, Dimensions};
use proto::{Digest, DigestBuilder};
use safetensors::Dtype;
use serde::Serialize;
use simulator::robot::Robot;
use utoipa::ToSchema;

use super::manifest::Manifest;
use super::name::Name;
use super::read::{self, small_files};
use super::store::CheckpointStore;
use super::tensors::{POLICY_PREFIX, TensorFile};
use super::{CheckpointError, POLICY, ROBOT, STATE};

/// What a thorough check found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Verification {
    /// The checkpoint's directory.
    #[schema(value_type = String)]
    pub dir: PathBuf,
    /// Files that were checked.
    pub files: usize,
    /// Length of these (bytes).
    pub bytes: u64,
    /// Tensors that were checked.
    pub tensors: usize,
    /// Everything that is wrong, each with the file that it is wrong in; empty if all is well.
    pub problems: Vec<String>,
}

impl Verification {
    /// Whether nothing is wrong.
    pub fn is_whole(&self) -> bool {
        self.problems.is_empty()
    }
}

impl CheckpointStore {
    /// Checks a checkpoint thoroughly: length and hash of every file; that configuration, robot and
    /// tensors are readable, all numbers finite, the actors of the shapes that the configuration
    /// asks for; that the digest in the manifest is that of the tensors, and its counters theirs.
    /// An error means that there is no such checkpoint.
    pub fn verify(&self, name: &Name) -> Result<Verification, CheckpointError> {
        Ok(examine(&self.existing(name)?))
    }
}

/// Checks the checkpoint in `dir`.
pub(super) fn examine(dir: &Path) -> Verification {
    let mut found =
        Verification { dir: dir.to_owned(), files: 0, bytes: 0, tensors: 0, problems: Vec::new() };
    let manifest = match Manifest::read(dir) {
        Ok(manifest) => manifest,
        Err(error) => {
            found.problems.push(error.to_string());
            return found;
        }
    };
    for (name, entry) in &manifest.files {
        found.files += 1;
        found.bytes += entry.len;
        if let Err(error) = read::check_file(&dir.join(name), entry) {
            found.problems.push(error.to_string());
        }
    }
    if !found.problems.is_empty() {
        // What follows would only say the same again, in more words.
        return found;
    }
    let layout = match layout(dir) {
        Ok(layout) => Some(layout),
        Err(error) => {
            found.problems.push(error.to_string());
            None
        }
    };
    let mut files = vec![POLICY];
    if manifest.has_state() {
        files.push(STATE);
    }
    for file in files {
        let path = dir.join(file);
        let mut problems = Vec::new();
        let outcome = TensorFile::open(&path).and_then(|tensors| {
            found.tensors += tensors.tensors.len();
            let digest = read_through(&tensors, &mut problems)?;
            if file == POLICY {
                if let Some(layout) = &layout {
                    fits(&tensors, layout, &mut problems);
                }
            } else {
                counters(&tensors, &manifest, &mut problems)?;
            }
            let described = if manifest.has_state() { STATE } else { POLICY };
            if file == described && digest != manifest.digest {
                let said = manifest.digest;
                problems.push(format!("digest {digest}, the manifest says {said}"));
            }
            Ok(())
        });
        problems.extend(outcome.err());
        found
            .problems
            .extend(problems.into_iter().map(|problem| format!("{}: {problem}", path.display())));
    }
    found
}

/// The place of the actors' tensors, if configuration and robot make sense.
fn layout(dir: &Path) -> Result<ActorLayout, CheckpointError> {
    let (config, robot) = small_files(dir)?;
    let path = dir.join(ROBOT);
    let robot = Robot::from_toml(&robot, &path)
        .map_err(|error| CheckpointError::damaged(&path, error.to_string()))?;
    Ok(ActorLayout::new(&config, &Dimensions::new(&config, robot.n_arms)))
}

/// Reads all tensors once: their digest, and a report of every one with a number that is not finite.
fn read_through(file: &TensorFile, problems: &mut Vec<String>) -> Result<Digest, String> {
    let mut digest = DigestBuilder::new();
    for (name, info) in &file.tensors {
        let (from, to) = info.data_offsets;
        digest.begin(name, (to - from) as u64);
        let mut finite = true;
        file.pieces(info, |piece| {
            digest.piece(piece);
            let mut numbers = numbers(info.dtype, piece).into_iter().flatten();
            finite = finite && numbers.all(f64::is_finite);
        })?;
        if !finite {
            problems.push(format!("tensor `{name}` holds a number that is not finite"));
        }
    }
    Ok(digest.finish())
}

/// Reports what is missing in, too much in, or of another shape than the actors' layout.
fn fits(file: &TensorFile, layout: &ActorLayout, problems: &mut Vec<String>) {
    for spec in &layout.tensors {
        let expected = (Dtype::F32, spec.shape.as_slice());
        match file.tensors.get(&spec.name) {
            Some(info) if (info.dtype, info.shape.as_slice()) == expected => {}
            Some(info) => problems.push(format!(
                "tensor `{}` is {:?} {:?}, the configuration wants F32 {:?}",
                spec.name, info.dtype, info.shape, spec.shape
            )),
            None => problems.push(format!("tensor `{}` is missing", spec.name)),
        }
    }
    for name in file.tensors.keys().filter(|name| layout.get(name).is_none()) {
        problems.push(format!("tensor `{name}` is unknown to the configuration"));
    }
}

/// Compares the counters in the training state with those of the manifest.
fn counters(
    file: &TensorFile,
    manifest: &Manifest,
    problems: &mut Vec<String>,
) -> Result<(), String> {
    for (name, said) in
        [("counters.iteration", manifest.iteration), ("counters.env_steps", manifest.env_steps)]
    {
        let Some(info) = file.tensors.get(name) else { continue };
        let mut same = info.data_offsets.1 - info.data_offsets.0 == size_of::<u64>();
        file.pieces(info, |piece| same = same && piece == said.to_le_bytes())?;
        if !same {
            problems.push(format!("`{name}` is not {said}, as the manifest says"));
        }
    }
    for name in file.tensors.keys().filter(|name| name.starts_with(POLICY_PREFIX)) {
        problems.push(format!("tensor `{name}` belongs into {POLICY}"));
    }
    Ok(())
}

/// The numbers in a tensor's bytes, if they are of a type that training states have.
pub(super) fn numbers(dtype: Dtype, data: &[u8]) -> Option<Box<dyn Iterator<Item = f64> + '_>> {
    fn chunks<'a, const N: usize>(
        data: &'a [u8],
        number: fn([u8; N]) -> f64,
    ) -> Box<dyn Iterator<Item = f64> + 'a> {
        let bytes = |chunk: &[u8]| <[u8; N]>::try_from(chunk).expect("chunks have N bytes");
        Box::new(data.chunks_exact(N).map(move |chunk| number(bytes(chunk))))
    }
    Some(match dtype {
        Dtype::F32 => chunks::<4>(data, |bytes| f64::from(f32::from_le_bytes(bytes))),
        Dtype::F64 => chunks::<8>(data, f64::from_le_bytes),
        Dtype::I64 => chunks::<8>(data, |bytes| i64::from_le_bytes(bytes) as f64),
        Dtype::U64 => chunks::<8>(data, |bytes| u64::from_le_bytes(bytes) as f64),
        _ => return None,
    })
}
