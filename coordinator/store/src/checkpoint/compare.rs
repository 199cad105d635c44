//! What differs between two checkpoints.

use std::collections::{BTreeMap, BTreeSet};

use proto::config::Config;
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use serde::Serialize;
use utoipa::ToSchema;

use super::file_names::{POLICY, STATE};
use super::read::Checkpoint;
use super::verify::numbers;
use super::{CheckpointError, opening};

/// A configuration key with two values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct KeyDifference {
    /// The dotted key.
    pub key: String,
    /// Its value in the first checkpoint; none if it has no such key.
    pub a: Option<String>,
    /// Its value in the second.
    pub b: Option<String>,
}

/// A tensor in which two checkpoints differ.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TensorDifference {
    /// File and name, `policy.safetensors/head.weight`.
    pub tensor: String,
    /// Type and shape in the first checkpoint, `F32 [8, 64, 3]`; none if it has no such tensor.
    pub a: Option<String>,
    /// Type and shape in the second.
    pub b: Option<String>,
    /// Largest absolute difference of two numbers, if the shapes are the same.
    pub max_abs: Option<f64>,
    /// Euclidean norm of all differences, if the shapes are the same.
    pub norm: Option<f64>,
}

/// What differs between two checkpoints.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Difference {
    /// Whether nothing below differs.
    pub same: bool,
    /// Keys of the configuration.
    pub config: Vec<KeyDifference>,
    /// Whether the robots' descriptions are the same text.
    pub same_robot: bool,
    /// Tensors that are the same to the bit.
    pub equal_tensors: usize,
    /// The others.
    pub tensors: Vec<TensorDifference>,
}

/// Compares configuration, robot and all tensors of two checkpoints.
pub fn compare(a: &Checkpoint, b: &Checkpoint) -> Result<Difference, CheckpointError> {
    compare_files(a, b, &[POLICY, STATE])
}

/// Compares configuration, robot and actors of two checkpoints, whatever their training states hold.
pub fn compare_policies(a: &Checkpoint, b: &Checkpoint) -> Result<Difference, CheckpointError> {
    compare_files(a, b, &[POLICY])
}

fn compare_files(
    a: &Checkpoint,
    b: &Checkpoint,
    files: &[&str],
) -> Result<Difference, CheckpointError> {
    let config = keys(&leaves(&a.config), &leaves(&b.config));
    let same_robot = a.robot_toml == b.robot_toml;
    let mut equal_tensors = 0;
    let mut tensors = Vec::new();
    for &file in files {
        let (left, right) = (content(a, file)?, content(b, file)?);
        let (left, right) = (parse(a, file, left.as_deref())?, parse(b, file, right.as_deref())?);
        let names: BTreeSet<&String> = left.keys().chain(right.keys()).collect();
        for name in names {
            match difference(left.get(name), right.get(name)) {
                Some(found) => {
                    tensors.push(TensorDifference { tensor: format!("{file}/{name}"), ..found });
                }
                None => equal_tensors += 1,
            }
        }
    }
    let same = config.is_empty() && same_robot && tensors.is_empty();
    Ok(Difference { same, config, same_robot, equal_tensors, tensors })
}

/// The keys of a configuration, as [`flatten`] has them.
pub(super) fn leaves(config: &Config) -> BTreeMap<String, String> {
    flatten(&toml::from_str(&config.to_toml()).unwrap_or_default())
}

/// Dotted keys and their values as TOML.
pub fn flatten(table: &toml::Table) -> BTreeMap<String, String> {
    fn walk(prefix: &str, table: &toml::Table, into: &mut BTreeMap<String, String>) {
        for (name, value) in table {
            let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
            match value {
                toml::Value::Table(inner) => walk(&key, inner, into),
                value => {
                    into.insert(key, value.to_string());
                }
            }
        }
    }
    let mut flat = BTreeMap::new();
    walk("", table, &mut flat);
    flat
}

fn keys(a: &BTreeMap<String, String>, b: &BTreeMap<String, String>) -> Vec<KeyDifference> {
    let all: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    all.into_iter()
        .filter(|key| a.get(*key) != b.get(*key))
        .map(|key| KeyDifference {
            key: key.clone(),
            a: a.get(key).cloned(),
            b: b.get(key).cloned(),
        })
        .collect()
}

/// A file's bytes, if the checkpoint has it.
fn content(checkpoint: &Checkpoint, file: &str) -> Result<Option<Vec<u8>>, CheckpointError> {
    if !checkpoint.manifest.files.contains_key(file) {
        return Ok(None);
    }
    let path = checkpoint.dir.join(file);
    opening::bytes(&path, u64::MAX).map(Some)
}

fn parse<'a>(
    checkpoint: &Checkpoint,
    file: &str,
    bytes: Option<&'a [u8]>,
) -> Result<BTreeMap<String, TensorView<'a>>, CheckpointError> {
    let Some(bytes) = bytes else { return Ok(BTreeMap::new()) };
    let tensors = SafeTensors::deserialize(bytes)
        .map_err(|error| CheckpointError::damaged(&checkpoint.dir.join(file), error.to_string()))?;
    Ok(tensors.tensors().into_iter().collect())
}

/// How two tensors differ, without their name; nothing if they are the same.
fn difference(a: Option<&TensorView<'_>>, b: Option<&TensorView<'_>>) -> Option<TensorDifference> {
    let describe = |view: &TensorView<'_>| format!("{:?} {:?}", view.dtype(), view.shape());
    let mut found = TensorDifference {
        tensor: String::new(),
        a: a.map(describe),
        b: b.map(describe),
        max_abs: None,
        norm: None,
    };
    let (Some(a), Some(b)) = (a, b) else { return Some(found) };
    if (a.dtype(), a.shape()) != (b.dtype(), b.shape()) {
        return Some(found);
    }
    if a.data() == b.data() {
        return None;
    }
    if let (Some(left), Some(right)) = (numbers(a.dtype(), a.data()), numbers(b.dtype(), b.data()))
    {
        let (mut max, mut squares) = (0.0_f64, 0.0);
        for (x, y) in left.zip(right) {
            max = max.max((x - y).abs());
            squares += (x - y).powi(2);
        }
        found.max_abs = Some(max);
        found.norm = Some(squares.sqrt());
    }
    Some(found)
}
