//! The training state as named arrays.

use std::ops::Range;

use safetensors::Dtype;
use tch::{Device, Tensor};

use super::{OffPolicy, TrainingState};
use crate::memory::bytes;

/// One named array, row-major.
pub(super) struct Entry<'a> {
    pub(super) name: String,
    pub(super) dtype: Dtype,
    pub(super) shape: Vec<usize>,
    pub(super) source: Source<'a>,
}

impl Entry<'_> {
    /// Number of bytes.
    pub(super) fn len(&self) -> usize {
        self.shape.iter().product::<usize>() * self.dtype.bitsize() / 8
    }
}

pub(super) enum Source<'a> {
    /// Some columns of a row-major `[A, P]` array in the processor's memory.
    Columns {
        flat: Tensor,
        columns: Range<usize>,
    },
    Tensor(Tensor),
    F32(&'a [f32]),
    F64(&'a [f64]),
    I64(&'a [i64]),
    U64(u64),
}

impl Source<'_> {
    /// A tensor, brought to the processor and into one piece if it is not there already.
    fn tensor(tensor: &Tensor) -> Self {
        Self::Tensor(tensor.to_device(Device::Cpu).contiguous())
    }

    /// The bytes, in order; those of columns are one piece a row, where they lie.
    #[expect(unsafe_code, reason = "a source's bytes are read while nobody trains")]
    pub(super) fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        fn whole(memory: &[u8]) -> (&[u8], usize, Range<usize>) {
            (memory, memory.len(), 0..memory.len())
        }
        let (memory, row_len, piece) = match self {
            Self::Columns { flat, columns } => {
                let of = |column: usize| column * size_of::<f32>();
                // SAFETY: a source borrows the state, which is filled when it is made and which an update
                // has to itself.
                (
                    unsafe { bytes(flat) },
                    of(flat.size()[1] as usize),
                    of(columns.start)..of(columns.end),
                )
            }
            // SAFETY: as above.
            Self::Tensor(tensor) => whole(unsafe { bytes(tensor) }),
            Self::F32(values) => whole(bytemuck::cast_slice(values)),
            Self::F64(values) => whole(bytemuck::cast_slice(values)),
            Self::I64(values) => whole(bytemuck::cast_slice(values)),
            Self::U64(value) => whole(bytemuck::bytes_of(value)),
        };
        memory.chunks_exact(row_len.max(1)).map(move |row| &row[piece.clone()])
    }
}

impl TrainingState {
    /// All arrays, sorted by name.
    pub(super) fn entries(&self) -> Vec<Entry<'_>> {
        let mut entries = Vec::new();
        let mut add = |name: String, dtype, shape: Vec<usize>, source| {
            entries.push(Entry { name, dtype, shape, source });
        };
        for network in [&self.actor, &self.critic] {
            let kind = network.spec.kind.as_str();
            let parts =
                [("", &network.flat), ("adam.m.", &network.adam.m), ("adam.v.", &network.adam.v)];
            for (prefix, flat) in parts {
                let flat = flat.to_device(Device::Cpu);
                for parameter in &network.spec.parameters {
                    let rows = flat.size()[0];
                    let shape = std::iter::once(&rows).chain(&parameter.shape).map(|&n| n as usize);
                    let name = format!("{kind}.{prefix}{}", parameter.name);
                    let source = Source::Columns {
                        flat: flat.shallow_clone(),
                        columns: parameter.columns(),
                    };
                    add(name, Dtype::F32, shape.collect(), source);
                }
            }
            let steps = &network.adam.steps;
            let name = format!("{kind}.adam.steps");
            add(name, Dtype::I64, vec![steps.len()], Source::I64(steps));
        }
        if let Some(OffPolicy { target_actor, target_critic, replay }) = &self.off_policy {
            for (network, target) in [(&self.actor, target_actor), (&self.critic, target_critic)] {
                let flat = target.to_device(Device::Cpu);
                for parameter in &network.spec.parameters {
                    let rows = flat.size()[0];
                    let shape = std::iter::once(&rows).chain(&parameter.shape).map(|&n| n as usize);
                    let name = format!("target_{}.{}", network.spec.kind.as_str(), parameter.name);
                    let source = Source::Columns {
                        flat: flat.shallow_clone(),
                        columns: parameter.columns(),
                    };
                    add(name, Dtype::F32, shape.collect(), source);
                }
            }
            for (name, shape, values) in replay.arrays() {
                add(format!("replay.{name}"), Dtype::F32, shape, Source::F32(values));
            }
            let episodes = Source::U64(replay.episodes);
            add("replay.episodes".to_owned(), Dtype::U64, vec![1], episodes);
        }
        if let Some(rate) = &self.actor_rate {
            add("actor.rate".to_owned(), Dtype::F64, vec![rate.len()], Source::F64(rate));
        }
        let norm = &self.value_norm;
        for (name, moment) in
            [("mean", &norm.mean), ("mean_square", &norm.mean_square), ("debias", &norm.debias)]
        {
            let shape = vec![moment.numel()];
            let source = Source::tensor(moment);
            add(format!("value_norm.{name}"), Dtype::F64, shape, source);
        }
        let norms =
            [("observation_norm", &self.observation_norm), ("state_norm", &self.state_norm)];
        for (prefix, norm) in norms {
            let Some(norm) = norm else { continue };
            let shape = vec![norm.rows, norm.features];
            add(format!("{prefix}.mean"), Dtype::F64, shape.clone(), Source::F64(&norm.mean));
            add(format!("{prefix}.m2"), Dtype::F64, shape, Source::F64(&norm.m2));
            let count = std::slice::from_ref(&norm.count);
            add(format!("{prefix}.count"), Dtype::F64, vec![1], Source::F64(count));
        }
        let shape = vec![self.previous_policy.len()];
        let source = Source::F32(&self.previous_policy);
        add("previous_policy".to_owned(), Dtype::F32, shape, source);
        let bits = self.arithmetic.kind().elt_size_in_bytes() as u64 * 8;
        let counters =
            [("iteration", self.iteration), ("env_steps", self.env_steps), ("precision", bits)];
        for (name, value) in counters {
            add(format!("counters.{name}"), Dtype::U64, vec![1], Source::U64(value));
        }
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        entries
    }
}
