//! The safetensors files of a checkpoint.

use proto::{Digest, DigestBuilder};
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;

/// Prefix of the actors' tensors inside a snapshot.
pub(super) const POLICY_PREFIX: &str = "policy.";

/// Splits a snapshot into the training state and the actors.
pub(super) fn split(bytes: &[u8]) -> Result<(Vec<u8>, Vec<u8>), String> {
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| error.to_string())?;
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| error.to_string())?;
    let mut policy: Vec<(String, TensorView<'_>)> = Vec::new();
    let mut state = Vec::new();
    for (name, view) in tensors.tensors() {
        match name.strip_prefix(POLICY_PREFIX) {
            Some(name) => policy.push((name.to_owned(), view)),
            None => state.push((name, view)),
        }
    }
    if policy.is_empty() || state.is_empty() {
        return Err(format!("{} policy and {} state tensors", policy.len(), state.len()));
    }
    let write = |tensors, metadata| {
        safetensors::serialize(tensors, metadata).map_err(|error| error.to_string())
    };
    Ok((write(state, metadata.metadata().clone())?, write(policy, None)?))
}

/// All tensors of a file, in alphabetical order.
pub(super) fn sorted<'a>(file: &SafeTensors<'a>) -> Vec<(String, TensorView<'a>)> {
    let mut tensors = file.tensors();
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    tensors
}

/// The digest of all tensors of a file: of a state file that of the training state, as the learner
/// computes it; of a policy file that of a checkpoint without a training state.
pub(super) fn digest(file: &SafeTensors<'_>) -> Digest {
    let mut builder = DigestBuilder::new();
    for (name, view) in sorted(file) {
        builder.field(&name, view.data());
    }
    builder.finish()
}
