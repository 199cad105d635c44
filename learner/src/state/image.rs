//! The file of a training state, written into memory that is used again.
//!
//! Training stands still while its state is copied. The names and places in the file never change
//! during a run, so they are computed once; what is left is to move each number once, into pages that
//! the process has already.

use std::collections::BTreeMap;
use std::ops::Range;

use safetensors::SafeTensors;

use super::TrainingState;
use super::file::POLICY_PREFIX;

/// What all files of a run's states have in common.
#[derive(Debug)]
pub struct Image {
    /// Everything before the first array.
    head: Vec<u8>,
    /// Where each array stands.
    places: BTreeMap<String, Range<usize>>,
    len: usize,
    /// The policy on its way into the file.
    policy: Vec<f32>,
}

impl Image {
    /// Of states like this one; also returns its file.
    pub fn new(state: &TrainingState) -> (Self, Vec<u8>) {
        let file = state.to_safetensors();
        let (head_len, metadata) =
            SafeTensors::read_metadata(&file).expect("what was just written can be read");
        // The header follows its own length, eight bytes.
        let start = 8 + head_len;
        let places = metadata
            .tensors()
            .into_iter()
            .map(|(name, info)| {
                let (from, to) = info.data_offsets;
                (name, start + from..start + to)
            })
            .collect();
        let policy = vec![0.0; state.policy_layout.len];
        (Self { head: file[..start].to_vec(), places, len: file.len(), policy }, file)
    }

    /// Writes the file of `state` into `out`, in place if it has the room.
    ///
    /// # Panics
    /// If `state` is of another configuration than the first one.
    pub fn write(&mut self, state: &TrainingState, out: &mut Vec<u8>) {
        out.resize(self.len, 0);
        out[..self.head.len()].copy_from_slice(&self.head);
        for entry in state.entries() {
            let mut slot = &mut out[self.places[&entry.name].clone()];
            for piece in entry.source.pieces() {
                let (part, rest) = slot.split_at_mut(piece.len());
                part.copy_from_slice(piece);
                slot = rest;
            }
            assert!(slot.is_empty(), "{} is of another size", entry.name);
        }
        state.write_policy(&mut self.policy);
        for tensor in &state.policy_layout.tensors {
            let place = &self.places[&format!("{POLICY_PREFIX}{}", tensor.name)];
            let data = bytemuck::cast_slice(&self.policy[tensor.range()]);
            out[place.clone()].copy_from_slice(data);
        }
    }
}
