//! A block of a run as a file: its arrays as safetensors, with everything that they follow from.

use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use proto::config::Config;
use proto::layout::{AGENTS_PER_ARM, BlockLayout, Dimensions};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use simulator::robot::Robot;
use simulator::rollout::World;

/// Of this description.
const FORMAT: &str = "1";

/// Which block of a run it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockAddress {
    /// Seed of the run.
    pub seed: u64,
    /// The iteration.
    pub iteration: u64,
    /// The shard.
    pub shard: u32,
}

/// A block with its world and address.
#[derive(Debug)]
pub struct Block {
    /// The world that it was made in.
    pub world: Arc<World>,
    /// Which it is.
    pub address: BlockAddress,
    /// Its numbers, as `world.block_layout()` places them.
    pub numbers: Vec<f32>,
}

/// Name, place and shape of every array.
fn arrays(
    dimensions: &Dimensions,
    layout: &BlockLayout,
) -> [(&'static str, Range<usize>, Vec<usize>); 8] {
    let Dimensions {
        n_agents: a,
        n_steps: t,
        n_envs: n,
        n_actions: u,
        observation: o,
        state: s,
        ..
    } = *dimensions;
    [
        ("observation", layout.observation.clone(), vec![a, t + 1, n, o]),
        ("state", layout.state.clone(), vec![t + 1, n, s]),
        ("action", layout.action.clone(), vec![a, t, n, u]),
        ("log_prob", layout.log_prob.clone(), vec![a, t, n]),
        ("reward", layout.reward.clone(), vec![a, t, n]),
        ("terminated", layout.terminated.clone(), vec![t, n]),
        ("truncated", layout.truncated.clone(), vec![t, n]),
        ("metrics", layout.metrics.clone(), vec![n, dimensions.n_metrics]),
    ]
}

impl Block {
    /// The bytes of its file.
    ///
    /// # Errors
    /// What keeps it from being put together.
    pub fn write(&self) -> Result<Vec<u8>, String> {
        let Self { world, address: BlockAddress { seed, iteration, shard }, numbers } = self;
        let views = arrays(&world.dimensions, world.block_layout())
            .into_iter()
            .map(|(name, range, shape)| {
                let bytes = bytemuck::cast_slice(&numbers[range]);
                Ok((name, TensorView::new(Dtype::F32, shape, bytes)?))
            })
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>();
        let about = [
            ("format", FORMAT.to_owned()),
            ("seed", seed.to_string()),
            ("iteration", iteration.to_string()),
            ("shard", shard.to_string()),
            ("config", world.config.to_toml()),
            ("robot", world.robot.to_toml()),
        ];
        let about = about.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        views
            .and_then(|views| safetensors::serialize(views, Some(about)))
            .map_err(|error| error.to_string())
    }

    /// The block in a file.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(file: &[u8]) -> Result<Self, String> {
        let wrong = |error: safetensors::SafeTensorError| format!("no safetensors: {error}");
        let (_, header) = SafeTensors::read_metadata(file).map_err(wrong)?;
        let none = HashMap::new();
        let about = header.metadata().as_ref().unwrap_or(&none);
        let text = |key: &str| {
            about.get(key).map(String::as_str).ok_or_else(|| {
                format!("says nothing of its {key}: expected a block of `octopus rollout --out`")
            })
        };
        let format = text("format")?;
        if format != FORMAT {
            return Err(format!("is of format {format:?}, expected {FORMAT}"));
        }
        let number = |key: &str| {
            let text = text(key)?;
            text.parse::<u64>().map_err(|_| format!("{key} is {text:?}, expected a whole number"))
        };
        let shard = u32::try_from(number("shard")?).map_err(|_| "shard is too large".to_owned())?;
        let address =
            BlockAddress { seed: number("seed")?, iteration: number("iteration")?, shard };
        let config = Config::from_resolved_toml(text("config")?, "its config")
            .map_err(|error| error.to_string())?;
        let robot = Robot::from_toml(text("robot")?, Path::new("its robot"))
            .map_err(|error| error.to_string())?;
        // Before anything of that size is made.
        let dimensions = Dimensions::new(&config, robot.joints);
        let layout = BlockLayout::new(&dimensions);
        let arrays = arrays(&dimensions, &layout);
        let tensors = SafeTensors::deserialize(file).map_err(wrong)?;
        for (name, _, shape) in &arrays {
            let tensor = tensors.tensor(name).map_err(|error| error.to_string())?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                return Err(format!(
                    "{name} is {:?} of shape {:?}, expected F32 of {shape:?}",
                    tensor.dtype(),
                    tensor.shape()
                ));
            }
        }
        let mut numbers = vec![0.0; layout.len];
        for (name, range, _) in arrays {
            let tensor = tensors.tensor(name).map_err(|error| error.to_string())?;
            for (slot, bytes) in numbers[range].iter_mut().zip(tensor.data().chunks_exact(4)) {
                *slot = f32::from_le_bytes(bytes.try_into().expect("four bytes"));
            }
        }
        Ok(Self { world: Arc::new(World::new(&config, &robot)), address, numbers })
    }

    /// The actions of an agent in a control step, before clipping and scaling: `[N, U]`.
    pub fn actions(&self, agent: usize, step: usize) -> &[f32] {
        let Dimensions { n_steps, n_envs, n_actions, .. } = self.world.dimensions;
        let width = n_envs * n_actions;
        let at = self.world.block_layout().action.start + (agent * n_steps + step) * width;
        &self.numbers[at..at + width]
    }

    /// What environment `env` did in a control step: its actions joint after joint, before scaling. Where the task adds to what agents say, as the next
    /// observations tell it, else as agents say it, before clipping.
    pub fn executed(&self, env: usize, step: usize) -> Vec<f32> {
        let Dimensions { joints, n_agents, n_steps, n_envs, n_actions, observation, .. } =
            self.world.dimensions;
        if self.world.config.task.posture.gain == 0.0 {
            let at = env * n_actions;
            let of_agent = |agent| {
                let own = joints.of_agent(agent).len();
                &self.actions(agent, step)[at..at + own]
            };
            return (0..n_agents).flat_map(of_agent).copied().collect();
        }
        // An arm's observations end with its last action, which has room for that of the longest arm.
        let first = self.world.block_layout().observation.start;
        let of_arm = |shoulder: usize| {
            let row = (shoulder * (n_steps + 1) + step + 1) * n_envs + env;
            let end = first + (row + 1) * observation;
            let at = end - joints.longest_arm();
            &self.numbers[at..at + joints.of_arm(shoulder / AGENTS_PER_ARM).len()]
        };
        (0..n_agents).step_by(AGENTS_PER_ARM).flat_map(of_arm).copied().collect()
    }
}
