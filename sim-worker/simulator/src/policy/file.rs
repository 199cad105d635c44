//! Actors as a safetensors file: as checkpoints hold them, and smaller.
//!
//! A checkpoint holds every tensor in `f32`, one row an actor, also where actors share a network. [`compact`] stores
//! equal rows once, with a tensor `NAME.rows` (U8) that says which row each actor has, and weights in bfloat16 where inference
//! rounds them to that anyway. [`read`] reads both, to policies of the same bits.

use std::collections::HashMap;

use proto::config::{Config, Inference};
use proto::layout::{ActorLayout, Dimensions, TensorSpec};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use crate::scalar::bf16_round;

/// What follows a tensor's name in that of the tensor which says which row each actor has.
const ROWS: &str = ".rows";

/// Why bytes are no actors of a configuration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyFileError {
    /// No safetensors file.
    #[error("no safetensors file: {0}")]
    Format(String),
    /// A tensor is not there.
    #[error("tensor `{0}` is missing; is the file one of this configuration?")]
    Missing(String),
    /// A tensor is of another type or shape.
    #[error("tensor `{name}` is {found}, the configuration wants {expected}")]
    Tensor {
        /// Its name.
        name: String,
        /// What it is.
        found: String,
        /// What would do.
        expected: String,
    },
}

/// The actors' parameters of a file, flat, in the order of [`ActorLayout`].
pub fn read(bytes: &[u8], layout: &ActorLayout) -> Result<Vec<f32>, PolicyFileError> {
    let file = SafeTensors::deserialize(bytes)
        .map_err(|error| PolicyFileError::Format(error.to_string()))?;
    let mut flat = vec![0.0; layout.len];
    for spec in &layout.tensors {
        let name = &spec.name;
        let tensor = file.tensor(name).map_err(|_| PolicyFileError::Missing(name.clone()))?;
        let rows = rows(&file, spec)?;
        let stored = rows.as_ref().map_or(spec.shape[0], |(stored, _)| *stored);
        let expected_shape = [&[stored], &spec.shape[1..]].concat();
        let wrong = |expected: String| PolicyFileError::Tensor {
            name: name.clone(),
            found: format!("{:?} {:?}", tensor.dtype(), tensor.shape()),
            expected,
        };
        if tensor.shape() != expected_shape {
            return Err(wrong(format!("F32 {expected_shape:?}")));
        }
        let values: Vec<f32> = match tensor.dtype() {
            Dtype::F32 => {
                let numbers = tensor.data().as_chunks().0.iter();
                numbers.map(|bytes| f32::from_le_bytes(*bytes)).collect()
            }
            Dtype::BF16 => {
                let numbers = tensor.data().as_chunks().0.iter();
                let wide = |bytes| f32::from_bits(u32::from(u16::from_le_bytes(bytes)) << 16);
                numbers.map(|bytes| wide(*bytes)).collect()
            }
            _ => return Err(wrong("F32 or BF16".to_owned())),
        };
        let place = &mut flat[spec.range()];
        match rows {
            None => place.copy_from_slice(&values),
            Some((stored, of_actor)) => {
                let length = values.len() / stored.max(1);
                for (to, row) in place.chunks_exact_mut(length).zip(of_actor) {
                    to.copy_from_slice(&values[row * length..(row + 1) * length]);
                }
            }
        }
    }
    Ok(flat)
}

/// How many rows a tensor has in the file, and which of them each actor has, if the file says so.
fn rows(
    file: &SafeTensors<'_>,
    spec: &TensorSpec,
) -> Result<Option<(usize, Vec<usize>)>, PolicyFileError> {
    let name = format!("{}{ROWS}", spec.name);
    let Ok(tensor) = file.tensor(&name) else { return Ok(None) };
    let of_actor: Vec<usize> = tensor.data().iter().map(|&row| row.into()).collect();
    let stored = file.tensor(&spec.name).ok().and_then(|stored| stored.shape().first().copied());
    let stored = stored.unwrap_or(0);
    let whole = tensor.dtype() == Dtype::U8 && of_actor.len() == spec.shape[0];
    if !whole || of_actor.iter().any(|&row| row >= stored) {
        return Err(PolicyFileError::Tensor {
            name,
            found: format!("{:?} {of_actor:?}", tensor.dtype()),
            expected: format!("{} rows (U8) below {stored}", spec.shape[0]),
        });
    }
    Ok(Some((stored, of_actor)))
}

/// A small file of actors that act with the same bits; `parameters` are flat, in the order of [`ActorLayout`].
///
/// # Panics
/// If `parameters` are of another configuration, or of more than 256 actors.
pub fn compact(config: &Config, dimensions: &Dimensions, parameters: &[f32]) -> Vec<u8> {
    let layout = ActorLayout::new(config, dimensions);
    assert_eq!(parameters.len(), layout.len, "parameters of this configuration");
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
    for spec in &layout.tensors {
        let n_actors = spec.shape[0];
        let length = spec.len() / n_actors;
        let rounded = config.network.inference == Inference::Bf16 && is_rounded(&spec.name);
        let (mut known, mut of_actor, mut data) = (HashMap::new(), Vec::new(), Vec::new());
        for row in parameters[spec.range()].chunks_exact(length) {
            let bytes: Vec<u8> = if rounded {
                let upper = |x: f32| ((bf16_round(x).to_bits() >> 16) as u16).to_le_bytes();
                row.iter().flat_map(|&x| upper(x)).collect()
            } else {
                row.iter().flat_map(|x| x.to_le_bytes()).collect()
            };
            let next = known.len();
            let index = *known.entry(bytes.clone()).or_insert(next);
            if index == next {
                data.extend(bytes);
            }
            of_actor.push(u8::try_from(index).expect("at most 256 actors"));
        }
        if known.len() < n_actors {
            tensors.push((format!("{}{ROWS}", spec.name), Dtype::U8, vec![n_actors], of_actor));
        }
        let shape = [&[known.len()], &spec.shape[1..]].concat();
        let dtype = if rounded { Dtype::BF16 } else { Dtype::F32 };
        tensors.push((spec.name.clone(), dtype, shape, data));
    }
    let views = tensors.iter().map(|(name, dtype, shape, data)| {
        let view = TensorView::new(*dtype, shape.clone(), data);
        (name, view.expect("as many bytes as the shape says"))
    });
    safetensors::serialize(views, None).expect("a file in memory")
}

/// Whether inference in bfloat16 rounds a tensor: weights of hidden layers after the first.
fn is_rounded(name: &str) -> bool {
    let layer = name.strip_prefix("hidden.").and_then(|rest| rest.strip_suffix(".weight"));
    layer.is_some_and(|layer| layer != "0")
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;
    use crate::policy::tests::parameters;
    use crate::policy::{Policy, Scratch};

    /// A configuration with actors of eight agents, of which those of one kind share all but the first bias; their parameters.
    fn shared(inference: Inference) -> (Config, Dimensions, Vec<f32>) {
        let mut config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        config.network.hidden = vec![16, 24];
        config.network.inference = inference;
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let mut flat = parameters(&config, &dimensions, 3);
        for spec in &ActorLayout::new(&config, &dimensions).tensors {
            if spec.name != "hidden.0.bias" {
                let length = spec.len() / 8;
                let place = &mut flat[spec.range()];
                for actor in 2..8 {
                    place.copy_within(actor % 2 * length..(actor % 2 + 1) * length, actor * length);
                }
            }
        }
        (config, dimensions, flat)
    }

    fn means(config: &Config, dimensions: &Dimensions, flat: &[f32]) -> Vec<u32> {
        let policy = Policy::new(config, dimensions, flat).expect("a policy");
        let mut scratch = Scratch::<f32>::new(&policy, 1);
        let seen: Vec<f32> = (0..policy.input()).map(|i| (0.7 * i as f32).sin()).collect();
        let mut all = Vec::new();
        for actor in 0..policy.n_actors() {
            let mut means = vec![0.0; policy.output()];
            policy.mean(&[actor], &seen, &mut scratch, &mut means);
            all.extend(means.iter().map(|mean| mean.to_bits()));
        }
        all
    }

    #[test]
    fn a_small_file_is_the_same_policy() {
        for inference in [Inference::F32, Inference::Bf16] {
            let (config, dimensions, flat) = shared(inference);
            let layout = ActorLayout::new(&config, &dimensions);
            let small = compact(&config, &dimensions, &flat);
            let read_back = read(&small, &layout).expect("a policy");
            assert_eq!(read_back == flat, inference == Inference::F32, "rounding shows");
            assert_eq!(
                means(&config, &dimensions, &flat),
                means(&config, &dimensions, &read_back),
                "{inference:?}"
            );
            assert!(small.len() < 4 * flat.len() / 2, "{} of {}", small.len(), 4 * flat.len());
            // What is small already stays as it is.
            assert_eq!(compact(&config, &dimensions, &read_back), small);
        }
    }

    #[test]
    fn a_file_of_something_else_is_refused_in_words() {
        let (config, dimensions, flat) = shared(Inference::F32);
        let layout = ActorLayout::new(&config, &dimensions);
        let whole = compact(&config, &dimensions, &flat);
        let refused = |bytes: &[u8], word: &str| {
            let error = read(bytes, &layout).expect_err("refused").to_string();
            assert!(error.contains(word), "{error}");
        };
        refused(b"no file", "no safetensors");
        refused(&whole[..whole.len() - 1], "no safetensors");
        let one = [0_u8; 4];
        let view = TensorView::new(Dtype::F32, vec![1], &one).expect("a view");
        let first = layout.tensors[0].name.as_str();
        let other = |name: &str| {
            safetensors::serialize([(name.to_owned(), view.clone())], None).expect("a file")
        };
        refused(&other("else"), "is missing");
        refused(&other(first), "wants");
        let rows = TensorView::new(Dtype::U8, vec![4], &[0, 0, 0, 9]).expect("a view");
        let file = [(first.to_owned(), view.clone()), (format!("{first}.rows"), rows)];
        refused(&safetensors::serialize(file, None).expect("a file"), "8 rows");
    }
}
