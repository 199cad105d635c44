//! The safetensors files of a checkpoint.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use proto::{Digest, DigestBuilder};
use safetensors::SafeTensors;
use safetensors::tensor::{Metadata, TensorInfo, TensorView};

use super::opening;

/// Prefix of the actors' tensors inside a snapshot.
pub(super) const POLICY_PREFIX: &str = "policy.";
/// Longest header that is read (bytes); those of training states have a hundredth of it.
pub(super) const MAX_HEADER: u64 = 4 << 20;
/// Bytes of a tensor that are in memory at a time.
const PIECE: usize = 1 << 20;

/// A snapshot in parts.
pub(super) struct Parts {
    /// The file of the training state.
    pub(super) state: Vec<u8>,
    /// The file of the actors.
    pub(super) policy: Vec<u8>,
    /// The digest of the state's tensors as they are here.
    pub(super) digest: Digest,
}

/// Splits a snapshot into the training state and the actors.
pub(super) fn split(bytes: &[u8]) -> Result<Parts, String> {
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
    let digest = digest_of(&state);
    let state = write(state, metadata.metadata().clone())?;
    Ok(Parts { state, policy: write(policy, None)?, digest })
}

/// The digest of all tensors of a policy file, which is that of a checkpoint without a training
/// state.
pub(super) fn digest(file: &SafeTensors<'_>) -> Digest {
    digest_of(&file.tensors())
}

/// The digest of tensors in the order of their names, as the learner computes it for its state.
fn digest_of(tensors: &[(String, TensorView<'_>)]) -> Digest {
    let mut sorted: Vec<_> = tensors.iter().collect();
    sorted.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut builder = DigestBuilder::new();
    for (name, view) in sorted {
        builder.field(name, view.data());
    }
    builder.finish()
}

/// Names, types and shapes of a file's tensors, in alphabetical order; their bytes are not read.
pub fn shapes(path: &Path) -> Result<BTreeMap<String, TensorInfo>, String> {
    TensorFile::open(path).map(|file| file.tensors)
}

/// A safetensors file of which only the header is in memory: however large it is, reading it takes
/// a buffer.
#[derive(Debug)]
pub(super) struct TensorFile {
    file: File,
    /// Where the tensors' bytes begin.
    start: u64,
    /// The `format` entry of its metadata.
    pub(super) format: Option<String>,
    /// In alphabetical order.
    pub(super) tensors: BTreeMap<String, TensorInfo>,
}

impl TensorFile {
    /// Opens a file and checks its header: the tensors fill the rest of the file without a gap.
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let text = |error: std::io::Error| error.to_string();
        let file = opening::file(path).map_err(|error| error.to_string())?;
        let len = file.metadata().map_err(text)?.len();
        let mut prefix = [0; 8];
        file.read_exact_at(&mut prefix, 0).map_err(text)?;
        let header_len = u64::from_le_bytes(prefix);
        if header_len > MAX_HEADER {
            return Err(format!("its header has {header_len} bytes, more than {MAX_HEADER}"));
        }
        let mut header = vec![0; header_len as usize];
        file.read_exact_at(&mut header, 8).map_err(text)?;
        let metadata: Metadata = serde_json::from_slice(&header)
            .map_err(|error| format!("its header is not that of safetensors: {error}"))?;
        let tensors: BTreeMap<String, TensorInfo> =
            metadata.tensors().into_iter().map(|(name, info)| (name, info.clone())).collect();

        let format = metadata.metadata().as_ref().and_then(|map| map.get("format").cloned());

        // That the tensors lie side by side, each as long as its shape says, is checked with the
        // header; that they are there is not.
        let end = metadata.data_len() as u64;
        let start = 8 + header_len;
        if end.checked_add(start) != Some(len) {
            return Err(format!("it has {len} bytes, its header says {end} after {start}"));
        }
        Ok(Self { file, start, format, tensors })
    }

    /// Shows the bytes of a tensor piece by piece; all but the last have whole numbers of any type.
    pub(super) fn pieces(
        &self,
        info: &TensorInfo,
        mut show: impl FnMut(&[u8]),
    ) -> Result<(), String> {
        let (from, to) = info.data_offsets;
        let mut buffer = vec![0; PIECE.min(to - from)];
        for place in (from..to).step_by(PIECE) {
            let piece = &mut buffer[..PIECE.min(to - place)];
            self.file
                .read_exact_at(piece, self.start + place as u64)
                .map_err(|error| error.to_string())?;
            show(piece);
        }
        Ok(())
    }
}
