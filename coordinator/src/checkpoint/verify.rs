//! The thorough check of a checkpoint: not only that it is as it was committed, but that it makes
//! sense.

use std::path::{Path, PathBuf};

use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::Serialize;
use sim_worker::robot::Robot;
use utoipa::ToSchema;

use super::manifest::Manifest;
use super::name::Name;
use super::store::CheckpointStore;
use super::tensors::{self, POLICY_PREFIX};
use super::{CONFIG, CheckpointError, POLICY, ROBOT, STATE, read};

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
        let dir = self.dir(name);
        if !dir.is_dir() {
            return Err(CheckpointError::absent(&self.root, name));
        }
        Ok(examine(&dir))
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
    let layout = match small_files(dir) {
        Ok((config, robot)) => {
            Some(ActorLayout::new(&config, &Dimensions::new(&config, robot.n_arms)))
        }
        Err(reason) => {
            found.problems.push(reason);
            None
        }
    };
    let mut files = vec![POLICY];
    if manifest.has_state() {
        files.push(STATE);
    }
    for file in files {
        let mut problems = Vec::new();
        let outcome =
            std::fs::read(dir.join(file)).map_err(|error| error.to_string()).and_then(|bytes| {
                let tensors =
                    SafeTensors::deserialize(&bytes).map_err(|error| error.to_string())?;
                found.tensors += tensors.len();
                finite(&tensors, &mut problems);
                if file == POLICY {
                    if let Some(layout) = &layout {
                        fits(&tensors, layout, &mut problems);
                    }
                } else {
                    counters(&tensors, &manifest, &mut problems);
                }
                let described = if manifest.has_state() { STATE } else { POLICY };
                if file == described {
                    let digest = tensors::digest(&tensors);
                    if digest != manifest.digest {
                        let said = manifest.digest;
                        problems.push(format!("digest {digest}, the manifest says {said}"));
                    }
                }
                Ok(())
            });
        problems.extend(outcome.err());
        let path = dir.join(file);
        found
            .problems
            .extend(problems.into_iter().map(|problem| format!("{}: {problem}", path.display())));
    }
    found
}

/// Configuration and robot, if both make sense.
fn small_files(dir: &Path) -> Result<(Config, Robot), String> {
    let text = |name: &str| {
        let path = dir.join(name);
        let text = std::fs::read_to_string(&path);
        text.map(|text| (text, path.clone()))
            .map_err(|error| format!("{}: {error}", path.display()))
    };
    let (config, path) = text(CONFIG)?;
    let config = Config::from_resolved_toml(&config, &path.display().to_string())
        .map_err(|error| error.to_string())?;
    let (robot, path) = text(ROBOT)?;
    let robot = Robot::from_toml(&robot, &path).map_err(|error| error.to_string())?;
    Ok((config, robot))
}

/// Reports every tensor with a number that is not finite.
fn finite(tensors: &SafeTensors<'_>, problems: &mut Vec<String>) {
    for (name, view) in tensors::sorted(tensors) {
        if numbers(&view).is_some_and(|mut numbers| numbers.any(|number| !number.is_finite())) {
            problems.push(format!("tensor `{name}` holds a number that is not finite"));
        }
    }
}

/// Reports what is missing in, too much in, or of another shape than the actors' layout.
fn fits(tensors: &SafeTensors<'_>, layout: &ActorLayout, problems: &mut Vec<String>) {
    for spec in &layout.tensors {
        let expected = (Dtype::F32, spec.shape.as_slice());
        match tensors.tensor(&spec.name) {
            Ok(view) if (view.dtype(), view.shape()) == expected => {}
            Ok(view) => problems.push(format!(
                "tensor `{}` is {:?} {:?}, the configuration wants F32 {:?}",
                spec.name,
                view.dtype(),
                view.shape(),
                spec.shape
            )),
            Err(_) => problems.push(format!("tensor `{}` is missing", spec.name)),
        }
    }
    for (name, _) in tensors::sorted(tensors) {
        if layout.get(&name).is_none() {
            problems.push(format!("tensor `{name}` is unknown to the configuration"));
        }
    }
}

/// Compares the counters in the training state with those of the manifest.
fn counters(tensors: &SafeTensors<'_>, manifest: &Manifest, problems: &mut Vec<String>) {
    for (name, said) in
        [("counters.iteration", manifest.iteration), ("counters.env_steps", manifest.env_steps)]
    {
        let Ok(view) = tensors.tensor(name) else { continue };
        if view.data() != said.to_le_bytes() {
            problems.push(format!("`{name}` is not {said}, as the manifest says"));
        }
    }
    for (name, _) in tensors::sorted(tensors) {
        if name.starts_with(POLICY_PREFIX) {
            problems.push(format!("tensor `{name}` belongs into {POLICY}"));
        }
    }
}

/// A tensor's numbers, if they are of a type that training states have.
pub(super) fn numbers<'a>(view: &TensorView<'a>) -> Option<Box<dyn Iterator<Item = f64> + 'a>> {
    fn chunks<'a, const N: usize>(
        data: &'a [u8],
        number: fn([u8; N]) -> f64,
    ) -> Box<dyn Iterator<Item = f64> + 'a> {
        let bytes = |chunk: &[u8]| <[u8; N]>::try_from(chunk).expect("chunks have N bytes");
        Box::new(data.chunks_exact(N).map(move |chunk| number(bytes(chunk))))
    }
    let data = view.data();
    Some(match view.dtype() {
        Dtype::F32 => chunks::<4>(data, |bytes| f64::from(f32::from_le_bytes(bytes))),
        Dtype::F64 => chunks::<8>(data, f64::from_le_bytes),
        Dtype::I64 => chunks::<8>(data, |bytes| i64::from_le_bytes(bytes) as f64),
        Dtype::U64 => chunks::<8>(data, |bytes| u64::from_le_bytes(bytes) as f64),
        _ => return None,
    })
}
