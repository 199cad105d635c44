//! The training state as a file: its fingerprint, safetensors out and in.

use std::collections::BTreeMap;

use proto::config::Config;
use proto::layout::Dimensions;
use proto::{Digest, DigestBuilder};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use tch::{Device, Kind, Tensor};

use super::arrays::Entry;
use super::{OffPolicy, TrainingState};
use crate::LearnerError;
use crate::precision::Arithmetic;

/// The `format` entry of a state's metadata.
pub const FORMAT: &str = "spaceoctopus training state 1";

/// What the names of the repeated policies begin with.
pub(super) const POLICY_PREFIX: &str = "policy.";

impl TrainingState {
    /// The fingerprint of the state.
    pub fn digest(&self) -> Digest {
        let mut builder = DigestBuilder::new();
        for entry in self.entries() {
            builder.begin(&entry.name, entry.len() as u64);
            for piece in entry.source.pieces() {
                builder.piece(piece);
            }
        }
        builder.finish()
    }

    /// The state as the bytes of a safetensors file. [`Image`](super::image::Image) makes the same faster.
    pub fn to_safetensors(&self) -> Vec<u8> {
        let view = |dtype, shape: &[usize], data| {
            TensorView::new(dtype, shape.to_vec(), data).expect("an entry's bytes fit its shape")
        };
        let own: Vec<_> = self
            .entries()
            .into_iter()
            .map(|entry| {
                let data: Vec<u8> = entry.source.pieces().flatten().copied().collect();
                (entry.name, entry.dtype, entry.shape, data)
            })
            .collect();
        let own =
            own.iter().map(|(name, dtype, shape, data)| (name.clone(), view(*dtype, shape, data)));
        let mut policy = vec![0.0; self.policy_layout.len];
        self.write_policy(&mut policy);
        let published = self.policy_layout.tensors.iter().map(|tensor| {
            let data = bytemuck::cast_slice(&policy[tensor.range()]);
            (format!("{POLICY_PREFIX}{}", tensor.name), view(Dtype::F32, &tensor.shape, data))
        });
        let views = own.chain(published);
        // One entry only: the order of several would differ from run to run.
        let metadata = [("format".to_owned(), FORMAT.to_owned())].into();
        safetensors::serialize(views, Some(metadata)).expect("names and shapes are valid")
    }

    /// Restores a state of this configuration, exactly.
    pub fn from_safetensors(
        data: &[u8],
        config: &Config,
        dimensions: &Dimensions,
        device: Device,
    ) -> Result<Self, LearnerError> {
        let refuse = |message: String| LearnerError::State(message);
        let (_, header) = SafeTensors::read_metadata(data)
            .map_err(|error| refuse(format!("no valid safetensors file: {error}")))?;
        let format = header.metadata().as_ref().and_then(|map| map.get("format"));
        if format.map(String::as_str) != Some(FORMAT) {
            let found = format.map_or("none", String::as_str);
            return Err(refuse(format!("its format is `{found}`, expected `{FORMAT}`")));
        }
        let file = SafeTensors::deserialize(data)
            .map_err(|error| refuse(format!("no valid safetensors file: {error}")))?;

        let mut state = Self::initial(config, dimensions, Arithmetic::F32, device);
        let mut arrays = BTreeMap::new();
        for entry in state.entries() {
            let Entry { name, dtype, shape, .. } = entry;
            let view = file.tensor(&name).map_err(|_| {
                refuse(format!("tensor `{name}` is missing, expected {dtype:?} {shape:?}"))
            })?;
            if view.dtype() != dtype || view.shape() != shape {
                return Err(refuse(format!(
                    "tensor `{name}` is {:?} {:?}, expected {dtype:?} {shape:?}; \
                     was it trained with another configuration?",
                    view.dtype(),
                    view.shape(),
                )));
            }
            let finite = match dtype {
                Dtype::F32 => chunks::<4>(view.data()).all(|b| f32::from_le_bytes(b).is_finite()),
                Dtype::F64 => chunks::<8>(view.data()).all(|b| f64::from_le_bytes(b).is_finite()),
                _ => true,
            };
            if !finite {
                return Err(refuse(format!("tensor `{name}` holds a number that is not finite")));
            }
            arrays.insert(name, view.data().to_vec());
        }
        if let Some(name) = file
            .names()
            .into_iter()
            .find(|name| !name.starts_with(POLICY_PREFIX) && !arrays.contains_key(*name))
        {
            return Err(refuse(format!(
                "tensor `{name}` is unknown; was it trained with another configuration?"
            )));
        }
        state.fill(&arrays)?;
        Ok(state)
    }

    /// Overwrites everything by `arrays`, which hold every entry in its size.
    fn fill(&mut self, arrays: &BTreeMap<String, Vec<u8>>) -> Result<(), LearnerError> {
        let f64s = |name: &str| -> Vec<f64> {
            chunks::<8>(&arrays[name]).map(f64::from_le_bytes).collect()
        };
        let u64_of = |name: &str| chunks::<8>(&arrays[name]).map(u64::from_le_bytes).sum::<u64>();
        for network in [&mut self.actor, &mut self.critic] {
            let kind = network.spec.kind.as_str();
            let parts =
                [("", &network.flat), ("adam.m.", &network.adam.m), ("adam.v.", &network.adam.v)];
            for parameter in &network.spec.parameters {
                for (prefix, flat) in parts {
                    let mut view = parameter.view(flat);
                    let data = &arrays[&format!("{kind}.{prefix}{}", parameter.name)];
                    view.copy_(&Tensor::from_data_size(data, &view.size(), Kind::Float));
                }
            }
            let steps = &arrays[&format!("{kind}.adam.steps")];
            network.adam.steps = chunks::<8>(steps).map(i64::from_le_bytes).collect();
        }
        if let Some(OffPolicy { target_actor, target_critic, replay }) = &mut self.off_policy {
            for (network, target) in [(&self.actor, target_actor), (&self.critic, target_critic)] {
                for parameter in &network.spec.parameters {
                    let mut view = parameter.view(target);
                    let name = format!("target_{}.{}", network.spec.kind.as_str(), parameter.name);
                    let data = &arrays[&name];
                    view.copy_(&Tensor::from_data_size(data, &view.size(), Kind::Float));
                }
            }
            for (name, slot) in replay.arrays_mut() {
                let numbers = chunks::<4>(&arrays[&format!("replay.{name}")]);
                slot.iter_mut().zip(numbers).for_each(|(x, bytes)| *x = f32::from_le_bytes(bytes));
            }
            replay.episodes = u64_of("replay.episodes");
        }
        if let Some(rate) = &mut self.actor_rate {
            *rate = f64s("actor.rate");
        }
        let norm = &mut self.value_norm;
        for (name, moment) in [
            ("mean", &mut norm.mean),
            ("mean_square", &mut norm.mean_square),
            ("debias", &mut norm.debias),
        ] {
            moment.copy_(&Tensor::from_slice(&f64s(&format!("value_norm.{name}"))));
        }
        let norms = [
            ("observation_norm", &mut self.observation_norm),
            ("state_norm", &mut self.state_norm),
        ];
        for (prefix, norm) in norms {
            let Some(norm) = norm else { continue };
            norm.mean = f64s(&format!("{prefix}.mean"));
            norm.m2 = f64s(&format!("{prefix}.m2"));
            norm.count = f64s(&format!("{prefix}.count"))[0];
        }
        self.previous_policy =
            chunks::<4>(&arrays["previous_policy"]).map(f32::from_le_bytes).collect();
        self.iteration = u64_of("counters.iteration");
        self.env_steps = u64_of("counters.env_steps");
        self.arithmetic = match u64_of("counters.precision") {
            16 => Arithmetic::Bf16,
            32 => Arithmetic::F32,
            bits => {
                return Err(LearnerError::State(format!(
                    "`counters.precision` is {bits}, expected 16 or 32"
                )));
            }
        };
        Ok(())
    }
}

fn chunks<const N: usize>(data: &[u8]) -> impl Iterator<Item = [u8; N]> {
    data.chunks_exact(N).map(|chunk| chunk.try_into().expect("chunks have N bytes"))
}
