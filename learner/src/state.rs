//! The training state: everything that an interrupted run needs to go on as if nothing had happened.
//!
//! It is a set of named arrays, written as one [safetensors](https://github.com/huggingface/safetensors)
//! file that Python reads without our code:
//!
//! | name | type, shape |
//! |---|---|
//! | `actor.<parameter>`, `critic.<parameter>` | f32 `[P, …]`, the names of [`NetworkSpec`] |
//! | `actor.adam.m.<parameter>`, `….v.<parameter>`, likewise `critic` | f32 `[P, …]` |
//! | `actor.adam.steps`, `critic.adam.steps` | i64 `[P]` |
//! | `actor.rate` | f64 `[P]`: share of the scheduled learning rate; only with `optimizer.target_kl` |
//! | `value_norm.mean`, `.mean_square`, `.debias` | f64 `[P]` |
//! | `observation_norm.mean`, `.m2`, `.count` | f64 `[A, O]`, `[A, O]`, `[1]`; running normalisation only |
//! | `state_norm.mean`, `.m2`, `.count` | f64 `[1, S]`, `[1, S]`, `[1]`; likewise, unless critics see observations |
//! | `target_actor.<parameter>`, `target_critic.<parameter>` | f32 `[P, …]`; MADDPG only, like the next |
//! | `replay.observation`, `.state`, `.action`, `.reward`, `.future` | f32, see [`Replay`](crate::maddpg::replay::Replay) |
//! | `replay.episodes` | u64 `[1]`: episodes that were ever put in |
//! | `previous_policy` | f32, flat: the policy published before, which overlapping workers still use |
//! | `counters.iteration`, `counters.env_steps` | u64 `[1]`; the iteration is also the policy version |
//! | `counters.precision` | u64 `[1]`: bits of the products' operands, 16 or 32 |
//!
//! `P` are the actors: one for each of the `A` agents, or one for all.
//!
//! For readers who want the policies alone, the file repeats them as `policy.<name>`, exactly as
//! workers got them (`proto::layout::ActorLayout`); a restore does not need these.
//!
//! The [`Digest`] is that of all other names in alphabetical order, each with its array's little-endian
//! bytes, so anyone can recompute it from the file.

pub mod image;

use std::collections::BTreeMap;
use std::ops::Range;

use proto::config::{AlgorithmName, Config, CriticState, InputNorm as InputNormKind};
use proto::layout::{ActorLayout, BlockLayout, Dimensions};
use proto::{Digest, DigestBuilder};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use tch::{Device, Kind, Tensor};

use crate::LearnerError;
use crate::adam::Adam;
use crate::input_norm::InputNorm;
use crate::maddpg::OffPolicy;
use crate::memory::bytes;
use crate::network::{NetworkKind, NetworkSpec};
use crate::precision::Arithmetic;
use crate::value_norm::ValueNorm;

/// The `format` entry of a state's metadata.
pub const FORMAT: &str = "spaceoctopus training state 1";

/// What the names of the repeated policies begin with.
const POLICY_PREFIX: &str = "policy.";

/// The parameters of one kind of network and their optimiser.
#[derive(Debug)]
pub struct NetworkState {
    /// Names and places.
    pub spec: NetworkSpec,
    /// `[A, P]`: parameters.
    pub flat: Tensor,
    /// Moments.
    pub adam: Adam,
}

/// Everything that training changes.
#[derive(Debug)]
pub struct TrainingState {
    /// The policies.
    pub actor: NetworkState,
    /// The critics.
    pub critic: NetworkState,
    /// Share of the scheduled learning rate in force, one an actor; only if it follows the KL divergence.
    pub actor_rate: Option<Vec<f64>>,
    /// Moments of the returns.
    pub value_norm: ValueNorm,
    /// Moments of the observations, one row an agent.
    pub observation_norm: Option<InputNorm>,
    /// Moments of the critic state.
    pub state_norm: Option<InputNorm>,
    /// Targets and replay; MADDPG only.
    pub off_policy: Option<OffPolicy>,
    /// Iterations trained on; also the version of the policy.
    pub iteration: u64,
    /// Env-steps trained on.
    pub env_steps: u64,
    /// The policy before the last update, as it was published.
    pub previous_policy: Vec<f32>,
    /// The products' arithmetic.
    pub arithmetic: Arithmetic,
    policy_layout: ActorLayout,
    min_log_std: f64,
    device: Device,
}

/// One named array, row-major.
struct Entry<'a> {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    source: Source<'a>,
}

impl Entry<'_> {
    /// Number of bytes.
    fn len(&self) -> usize {
        self.shape.iter().product::<usize>() * self.dtype.bitsize() / 8
    }
}

enum Source<'a> {
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
    fn pieces(&self) -> impl Iterator<Item = &[u8]> {
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
    /// The state before the first iteration.
    pub fn initial(
        config: &Config,
        dimensions: &Dimensions,
        arithmetic: Arithmetic,
        device: Device,
    ) -> Self {
        let network = |kind| {
            let spec = NetworkSpec::new(kind, config, dimensions);
            let flat = spec.initial(&config.network, config.run.seed).to_device(device);
            let adam = Adam::new(&flat);
            NetworkState { spec, flat, adam }
        };
        let running = config.network.input_norm == InputNormKind::Running;
        let own = config.network.critic_state == CriticState::Own;
        let policy_layout = ActorLayout::new(config, dimensions);
        let (actor, critic) = (network(NetworkKind::Actor), network(NetworkKind::Critic));
        let off_policy = (config.algorithm.name == AlgorithmName::Maddpg)
            .then(|| OffPolicy::new(config, dimensions, &actor, &critic));
        let mut state = Self {
            actor,
            critic,
            off_policy,
            actor_rate: (config.optimizer.target_kl > 0.0).then(|| vec![1.0; dimensions.n_actors]),
            value_norm: ValueNorm::new(dimensions.n_actors, device),
            observation_norm: running
                .then(|| InputNorm::new(dimensions.n_agents, dimensions.observation)),
            state_norm: (running && !own).then(|| InputNorm::new(1, dimensions.state)),
            iteration: 0,
            env_steps: 0,
            previous_policy: vec![0.0; policy_layout.len],
            arithmetic,
            policy_layout,
            min_log_std: config.network.min_log_std,
            device,
        };
        state.remember_policy();
        state
    }

    /// Takes the observations before each step of an iteration's blocks into the running normalisers.
    pub fn see(&mut self, dimensions: &Dimensions, shards: &[&[f32]]) {
        let layout = BlockLayout::new(dimensions);
        let Dimensions { n_steps: t, n_envs: n, observation: o, state: s, .. } = *dimensions;
        if let Some(norm) = &mut self.observation_norm {
            let rows: Vec<Vec<&[f32]>> = (0..norm.rows)
                .map(|agent| {
                    let start = layout.observation.start + agent * (t + 1) * n * o;
                    shards.iter().map(|shard| &shard[start..start + t * n * o]).collect()
                })
                .collect();
            norm.update(&rows);
            if self.actor.spec.is_shared() {
                norm.pool(self.actor.spec.n_networks);
            }
        }
        if let Some(norm) = &mut self.state_norm {
            let start = layout.state.start;
            norm.update(&[shards.iter().map(|shard| &shard[start..start + t * n * s]).collect()]);
        }
    }

    /// Begins an update with the blocks of one iteration, ordered by shard: the policy so far becomes the
    /// previous one, and normalisers that have seen nothing see these samples.
    pub(crate) fn begin_update(&mut self, dimensions: &Dimensions, shards: &[&[f32]]) {
        assert_eq!(shards.len(), dimensions.n_shards, "all shards of an iteration");
        let block_len = BlockLayout::new(dimensions).len;
        for shard in shards {
            assert_eq!(shard.len(), block_len, "a block of this run's layout");
        }
        self.remember_policy();
        if self.iteration == 0 {
            self.see(dimensions, shards);
        }
    }

    /// Ends it: later normalisers see the samples now, after these were learned from as the policy that
    /// acted saw them.
    pub(crate) fn end_update(
        &mut self,
        dimensions: &Dimensions,
        shards: &[&[f32]],
        env_steps: u64,
    ) {
        if self.iteration > 0 {
            self.see(dimensions, shards);
        }
        self.iteration += 1;
        self.env_steps += env_steps;
    }

    /// Keeps the policy as it is now as the previous one.
    pub fn remember_policy(&mut self) {
        let mut policy = std::mem::take(&mut self.previous_policy);
        self.write_policy(&mut policy);
        self.previous_policy = policy;
    }

    /// All arrays, sorted by name.
    fn entries(&self) -> Vec<Entry<'_>> {
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

    /// The state as the bytes of a safetensors file. [`image::Image`] makes the same faster.
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

    /// Writes the actors into `out`, a policy as it is published.
    ///
    /// # Panics
    /// If `out` is not of the layout's length.
    #[expect(unsafe_code, reason = "parameters are read while nobody trains")]
    pub fn write_policy(&self, out: &mut [f32]) {
        let layout = &self.policy_layout;
        assert_eq!(out.len(), layout.len, "a policy has {} numbers", layout.len);
        let norm = self.observation_norm.as_ref().map(InputNorm::mean_and_inverse_std);
        let flat = self.actor.flat.to_device(Device::Cpu);
        // SAFETY: parameters are filled when they are made, and only read until the end of this function.
        let parameters: &[f32] = bytemuck::cast_slice(unsafe { bytes(&flat) });
        let row_len = flat.size()[1] as usize;
        for tensor in &layout.tensors {
            let slot = &mut out[tensor.range()];
            match (tensor.name.as_str(), &norm) {
                ("input.mean", Some((mean, _))) => slot.copy_from_slice(mean),
                ("input.inverse_std", Some((_, inverse_std))) => slot.copy_from_slice(inverse_std),
                (name, _) => {
                    let columns = self.actor.spec.get(name).columns();
                    let rows = parameters.chunks_exact(row_len);
                    for (part, row) in slot.chunks_exact_mut(columns.len().max(1)).zip(rows) {
                        part.copy_from_slice(&row[columns.clone()]);
                    }
                    if name == "log_std" {
                        for x in slot {
                            *x = x.max(self.min_log_std as f32);
                        }
                    }
                }
            }
        }
    }

    /// The device that it lives on.
    pub fn device(&self) -> Device {
        self.device
    }
}

fn chunks<const N: usize>(data: &[u8]) -> impl Iterator<Item = [u8; N]> {
    data.chunks_exact(N).map(|chunk| chunk.try_into().expect("chunks have N bytes"))
}

#[cfg(test)]
mod tests;
