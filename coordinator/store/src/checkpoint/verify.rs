//! The thorough check of a checkpoint: not only that it is as it was committed, but that it makes
//! sense.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use proto::config::{Config, Precision};
use proto::layout::{ActorLayout, Dimensions};
use proto::{Digest, DigestBuilder};
use safetensors::Dtype;
use serde::Serialize;
use simulator::robot::Robot;
use utoipa::ToSchema;

use super::CheckpointError;
use super::file_names::{POLICY, ROBOT, STATE};
use super::manifest::Manifest;
use super::name::Name;
use super::read::{self, small_files};
use super::state_layout::{INVERSE_STD, MEAN, Numbers, STATE_FORMAT, StateLayout, is_moment};
use super::store::CheckpointStore;
use super::tensors::{POLICY_PREFIX, TensorFile};

/// What a learner adds to the variance of an input before it takes the root.
const VARIANCE_FLOOR: f64 = 1e-6;

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
    /// tensors are readable, all numbers finite, all tensors of the names, types and shapes that the
    /// configuration asks for; that the digest in the manifest is that of the tensors, and its
    /// counters theirs; that the actors are those of the training state. An error means that there
    /// is no such checkpoint.
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
    let wanted = match Wanted::of(dir) {
        Ok(wanted) => Some(wanted),
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
            let state = (file == STATE).then_some(&wanted).and_then(Option::as_ref);
            let digest = read_through(&tensors, state.map(|wanted| &wanted.state), &mut problems)?;
            match &wanted {
                Some(wanted) if file == POLICY => {
                    let layout = &wanted.actors;
                    let shapes =
                        layout.tensors.iter().map(|spec| (&spec.name, Dtype::F32, &spec.shape));
                    fits(&tensors, shapes, &mut problems);
                }
                Some(wanted) => {
                    makes_sense(&tensors, &manifest, wanted, &mut problems)?;
                    if problems.is_empty() {
                        let policy = TensorFile::open(&dir.join(POLICY))?;
                        acts(&policy, &tensors, wanted, &mut problems)?;
                        standardises(&policy, &tensors, &mut problems)?;
                    }
                }
                None => {}
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

/// What the files of a checkpoint must hold, by its configuration and robot.
struct Wanted {
    config: Config,
    actors: ActorLayout,
    state: StateLayout,
}

impl Wanted {
    /// Of the checkpoint in `dir`, if its configuration and robot make sense.
    fn of(dir: &Path) -> Result<Self, CheckpointError> {
        let (config, robot) = small_files(dir)?;
        let path = dir.join(ROBOT);
        let robot = Robot::from_toml(&robot, &path)
            .map_err(|error| CheckpointError::damaged(&path, error.to_string()))?;
        let dimensions = Dimensions::new(&config, robot.joints);
        let actors = ActorLayout::new(&config, &dimensions);
        let state = StateLayout::new(&config, &dimensions);
        Ok(Self { config, actors, state })
    }
}

/// Reads all tensors once: their digest, and a report of every one whose numbers make no sense, of a
/// training state by its layout.
fn read_through(
    file: &TensorFile,
    layout: Option<&StateLayout>,
    problems: &mut Vec<String>,
) -> Result<Digest, String> {
    let mut digest = DigestBuilder::new();
    for (name, info) in &file.tensors {
        let (from, to) = info.data_offsets;
        digest.begin(name, (to - from) as u64);
        let (mut finite, mut zero) = (true, true);
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        file.pieces(info, |piece| {
            digest.piece(piece);
            for number in numbers(info.dtype, piece).into_iter().flatten() {
                finite &= number.is_finite();
                zero &= number == 0.0;
                least = least.min(number);
                most = most.max(number);
            }
        })?;
        let range = layout.and_then(|layout| layout.tensors.get(name));
        let holds = match range.map_or(Numbers::Any, |tensor| tensor.numbers) {
            _ if !finite => Some("a number that is not finite"),
            Numbers::Weights if zero && to > from => Some("nothing but zeros"),
            Numbers::NotNegative if least < 0.0 => Some("a negative number"),
            Numbers::Share if least < 0.0 || most > 1.0 => Some("a number outside of 0 to 1"),
            _ => None,
        };
        if let Some(what) = holds {
            problems.push(format!("tensor `{name}` holds {what}"));
        }
    }
    Ok(digest.finish())
}

/// Reports what is missing in, too much in, or of another type or shape than the wanted tensors.
fn fits<'a>(
    file: &TensorFile,
    wanted: impl Iterator<Item = (&'a String, Dtype, &'a Vec<usize>)>,
    problems: &mut Vec<String>,
) {
    let mut known = BTreeSet::new();
    for (name, dtype, shape) in wanted {
        known.insert(name);
        match file.tensors.get(name) {
            Some(info) if (info.dtype, &info.shape) == (dtype, shape) => {}
            Some(info) => problems.push(format!(
                "tensor `{name}` is {:?} {:?}, the configuration wants {dtype:?} {shape:?}",
                info.dtype, info.shape
            )),
            None => problems.push(format!("tensor `{name}` is missing")),
        }
    }
    for name in file.tensors.keys().filter(|name| !known.contains(name)) {
        problems.push(format!("tensor `{name}` is unknown to the configuration"));
    }
}

/// Reports what a learner would refuse in a training state, or could not have written.
fn makes_sense(
    file: &TensorFile,
    manifest: &Manifest,
    wanted: &Wanted,
    problems: &mut Vec<String>,
) -> Result<(), String> {
    if file.format.as_deref() != Some(STATE_FORMAT) {
        let found = file.format.as_deref().unwrap_or("none");
        problems.push(format!("its format is `{found}`, expected `{STATE_FORMAT}`"));
    }
    let misplaced = |name: &&String| name.starts_with(POLICY_PREFIX);
    for name in file.tensors.keys().filter(misplaced) {
        problems.push(format!("tensor `{name}` belongs into {POLICY}"));
    }
    let shapes = wanted.state.tensors.iter();
    fits(file, shapes.map(|(name, tensor)| (name, tensor.dtype, &tensor.shape)), problems);

    let steps = manifest.iteration.checked_mul(wanted.config.steps_per_iteration());
    if steps != Some(manifest.env_steps) {
        problems.push(format!(
            "{} env-steps are not those of {} iterations of {} each",
            manifest.env_steps,
            manifest.iteration,
            wanted.config.steps_per_iteration()
        ));
    }
    let episodes = manifest.iteration.saturating_mul(wanted.config.env.n_envs as u64);
    for (name, said) in [
        ("counters.iteration", manifest.iteration),
        ("counters.env_steps", manifest.env_steps),
        ("replay.episodes", episodes),
    ] {
        if let Some(is) = counter(file, name)?
            && is != said
        {
            problems.push(format!("`{name}` is {is}, not {said}, as the manifest says"));
        }
    }
    let expected: &[u64] = match wanted.config.run.precision {
        // As an earlier version left it.
        Precision::Auto => &[16, 32],
        Precision::Bf16 => &[16],
        Precision::F32 => &[32],
    };
    if let Some(bits) = counter(file, "counters.precision")?
        && !expected.contains(&bits)
    {
        let expected: Vec<String> = expected.iter().map(ToString::to_string).collect();
        let expected = expected.join(" or ");
        problems.push(format!("`counters.precision` is {bits}, expected {expected}"));
    }
    Ok(())
}

/// A counter, if it is there and is one number.
fn counter(file: &TensorFile, name: &str) -> Result<Option<u64>, String> {
    let Some(info) = file.tensors.get(name) else { return Ok(None) };
    let mut bytes = Vec::new();
    if info.data_offsets.1 - info.data_offsets.0 == size_of::<u64>() {
        file.pieces(info, |piece| bytes.extend_from_slice(piece))?;
    }
    Ok(bytes.try_into().ok().map(u64::from_le_bytes))
}

/// Reports published actors that are not those of the training state. Both files fit the layouts.
fn acts(
    policy: &TensorFile,
    state: &TensorFile,
    wanted: &Wanted,
    problems: &mut Vec<String>,
) -> Result<(), String> {
    let floor = wanted.config.network.min_log_std as f32;
    for spec in wanted.actors.tensors.iter().filter(|spec| !is_moment(&spec.name)) {
        let of_state = format!("actor.{}", spec.name);
        let (Some(ours), Some(theirs)) =
            (policy.tensors.get(&spec.name), state.tensors.get(&of_state))
        else {
            continue;
        };
        let hash = |file: &TensorFile, info, floored| {
            let mut hasher = blake3::Hasher::new();
            file.pieces(info, |piece| {
                if floored {
                    // As it is published.
                    for bytes in piece.chunks_exact(4) {
                        let number = f32::from_le_bytes(bytes.try_into().expect("chunks of four"));
                        hasher.update(&number.max(floor).to_le_bytes());
                    }
                } else {
                    hasher.update(piece);
                }
            })?;
            Ok::<_, String>(hasher.finalize())
        };
        if hash(policy, ours, false)? != hash(state, theirs, spec.name == "log_std")? {
            problems.push(format!("tensor `{of_state}` is not `{}` of {POLICY}", spec.name));
        }
    }
    Ok(())
}

/// Reports a published running normalisation of the input that is not the one of the training state. Both files
/// fit the layouts.
fn standardises(
    policy: &TensorFile,
    state: &TensorFile,
    problems: &mut Vec<String>,
) -> Result<(), String> {
    let all = |file: &TensorFile, name: &str| -> Result<Option<Vec<f64>>, String> {
        let Some(info) = file.tensors.get(name) else { return Ok(None) };
        let mut all = Vec::new();
        file.pieces(info, |piece| all.extend(numbers(info.dtype, piece).into_iter().flatten()))?;
        Ok(Some(all))
    };
    let of_state = |name: &str| all(state, &format!("observation_norm.{name}"));
    let (Some(mean), Some(m2), Some(count)) =
        (of_state("mean")?, of_state("m2")?, of_state("count")?)
    else {
        return Ok(());
    };
    let count = count.first().copied().unwrap_or(0.0);
    let wanted = |index: usize| {
        // Nothing was seen yet.
        if count == 0.0 {
            (0.0, 1.0)
        } else {
            (mean[index], (m2[index] / count + VARIANCE_FLOOR).sqrt().recip())
        }
    };
    let [means, inverse_stds] = [all(policy, MEAN)?, all(policy, INVERSE_STD)?];
    for (name, published, of) in [
        (MEAN, means, &(|index| wanted(index).0) as &dyn Fn(usize) -> f64),
        (INVERSE_STD, inverse_stds, &|index| wanted(index).1),
    ] {
        // Rounded to f32, after some operations in f64.
        let is = |(index, number): (usize, &f64)| {
            let of = of(index);
            (number - of).abs()
                <= 2.0 * f64::from(f32::EPSILON) * of.abs() + f64::from(f32::MIN_POSITIVE)
        };
        // One row a network: where agents share one, it has the moments of all of them.
        let published = published.filter(|published| published.len() == mean.len());
        if published.is_some_and(|published| !published.iter().enumerate().all(is)) {
            problems.push(format!("`observation_norm` is not `{name}` of {POLICY}"));
        }
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
