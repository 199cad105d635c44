//! A policy version, checked and packed for inference.

use proto::agents::MAX_JOINTS_PER_AGENT;
use proto::config::{Activation, Config, Inference, InputNorm};
use proto::layout::{ActorLayout, Dimensions};

use super::dense::Dense;
use crate::scalar::{WeightPair, elementary, pairs_are_slow};

/// Name of the tensor with the deviations, the only one that is not of a network.
const LOG_STD: &str = "log_std";

/// Name of the bias that actors of one network have of their own.
const OWN: &str = "hidden.0.bias";

/// Why flat parameters are no policy of this run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyError {
    /// Another number of parameters than the configuration's networks have.
    #[error("policy has {found} parameters, the configuration's networks have {expected}")]
    Length {
        /// Parameters that arrived.
        found: usize,
        /// Parameters of the layout.
        expected: usize,
    },
    /// NaN or infinity.
    #[error(
        "policy parameter `{tensor}` of actor {actor} holds {value}; the training has diverged"
    )]
    NotFinite {
        /// Name of the tensor.
        tensor: String,
        /// The actor.
        actor: usize,
        /// The value found.
        value: f32,
    },
    /// A standard deviation beyond all numbers.
    #[error(
        "the deviations of agent {agent} have the logarithm {log_std}, which is too large; the training has \
         diverged"
    )]
    Deviation {
        /// The agent.
        agent: usize,
        /// The largest of its logarithms.
        log_std: f32,
    },
}

/// LayerNorm's gain and shift, or a running normalisation's mean and inverse deviation.
#[derive(Debug, Clone)]
pub(super) struct Affine {
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

/// The product of a hidden layer, in the precision of inference.
#[derive(Debug, Clone)]
pub(super) enum Product {
    /// In `f32`: the first layer always, because its inputs are few and their digits are the errors that the task is about.
    Single(Dense<f32>),
    /// Of bfloat16, summed in `f32`.
    Pairs(Dense<WeightPair>),
    /// The same where pairs are slow: of each two inputs the second first.
    Widened(Dense<f32>),
}

impl Product {
    /// Units of the layer.
    pub(super) fn outputs(&self) -> usize {
        match self {
            Self::Single(dense) | Self::Widened(dense) => dense.outputs,
            Self::Pairs(dense) => dense.outputs,
        }
    }

    fn padded_outputs(&self) -> usize {
        match self {
            Self::Single(dense) | Self::Widened(dense) => dense.padded_outputs(),
            Self::Pairs(dense) => dense.padded_outputs(),
        }
    }
}

/// A hidden layer.
#[derive(Debug, Clone)]
pub(super) struct Hidden {
    pub(super) product: Product,
    pub(super) norm: Option<Affine>,
}

/// A network: of one actor, or of several that share all but the bias of the first hidden layer.
#[derive(Debug, Clone)]
pub(super) struct Network {
    pub(super) input: Option<Affine>,
    pub(super) hidden: Vec<Hidden>,
    pub(super) head: Dense<f32>,
}

/// All actors' networks of one policy version, packed for inference.
///
/// Every back end computes the same with it, so one packed policy serves every thread.
#[derive(Debug, Clone)]
pub struct Policy {
    pub(super) input: usize,
    pub(super) output: usize,
    pub(super) activation: Activation,
    pub(super) input_norm: InputNorm,
    pub(super) input_clip: f32,
    pub(super) squash_mean: bool,
    /// Factor on squashed outputs.
    pub(super) action_limit: f64,
    pub(super) networks: Vec<Network>,
    /// Which actors each network is of.
    sharing: Vec<Vec<usize>>,
    /// Which network each actor has.
    pub(super) network_of: Vec<usize>,
    /// `[actor][unit]`: the bias of the first hidden layer, filled up with zeros to whole panels.
    pub(super) first_bias: Vec<Vec<f32>>,
    /// One entry an agent; none if actors are deterministic.
    log_std: Vec<[f32; MAX_JOINTS_PER_AGENT]>,
    std: Vec<[f32; MAX_JOINTS_PER_AGENT]>,
}

impl Policy {
    /// Checks and packs `parameters`, which [`ActorLayout`] lays out for `config`.
    pub fn new(
        config: &Config,
        dimensions: &Dimensions,
        parameters: &[f32],
    ) -> Result<Self, PolicyError> {
        Self::packed(config, dimensions, parameters, pairs_are_slow())
    }

    /// As [`Policy::new`]; layers in bfloat16 in pairs or `widened`, which are two ways to the same bits.
    pub(super) fn packed(
        config: &Config,
        dimensions: &Dimensions,
        parameters: &[f32],
        widened: bool,
    ) -> Result<Self, PolicyError> {
        let layout = ActorLayout::new(config, dimensions);
        if parameters.len() != layout.len {
            return Err(PolicyError::Length { found: parameters.len(), expected: layout.len });
        }
        let n_actors = dimensions.n_actors;
        for tensor in &layout.tensors {
            let values = &parameters[tensor.range()];
            if let Some(i) = values.iter().position(|value| !value.is_finite()) {
                return Err(PolicyError::NotFinite {
                    tensor: tensor.name.clone(),
                    actor: i / (tensor.len() / n_actors),
                    value: values[i],
                });
            }
        }
        // The rows of one actor in a stacked tensor.
        let row = |name: &str, actor: usize| -> &[f32] {
            let tensor = layout.get(name).expect("the layout names its own tensors");
            let length = tensor.len() / n_actors;
            &parameters[tensor.offset + actor * length..][..length]
        };
        let affine = |first: &str, second: &str, actor: usize| Affine {
            first: row(first, actor).to_vec(),
            second: row(second, actor).to_vec(),
        };
        let sharing = sharing(n_actors, |one, other| {
            let is_of_network = |name: &str| name != LOG_STD && name != OWN;
            let mut of_network = layout.tensors.iter().filter(|tensor| is_of_network(&tensor.name));
            of_network.all(|tensor| {
                let bits = |actor| row(&tensor.name, actor).iter().map(|value| value.to_bits());
                bits(one).eq(bits(other))
            })
        });
        let mut network_of = vec![0; n_actors];
        for (network, actors) in sharing.iter().enumerate() {
            for &actor in actors {
                network_of[actor] = network;
            }
        }
        let network = &config.network;
        let networks: Vec<Network> = sharing
            .iter()
            .map(|actors| {
                let actor = actors[0];
                Network {
                    input: match network.input_norm {
                        InputNorm::None => None,
                        InputNorm::LayerNorm => Some(affine("input.gain", "input.bias", actor)),
                        InputNorm::Running => {
                            Some(affine("input.mean", "input.inverse_std", actor))
                        }
                    },
                    hidden: (0..network.hidden.len())
                        .map(|i| Hidden {
                            product: {
                                let weight = row(&format!("hidden.{i}.weight"), actor);
                                // Nobody reads that of the first layer here: each actor has its own.
                                let bias = row(&format!("hidden.{i}.bias"), actor);
                                if i == 0 || network.inference != Inference::Bf16 {
                                    Product::Single(Dense::pack(weight, bias))
                                } else if widened {
                                    Product::Widened(Dense::pack_widened(weight, bias))
                                } else {
                                    Product::Pairs(Dense::pack_pairs(weight, bias))
                                }
                            },
                            norm: network.layer_norm.then(|| {
                                affine(
                                    &format!("hidden.{i}.gain"),
                                    &format!("hidden.{i}.shift"),
                                    actor,
                                )
                            }),
                        })
                        .collect(),
                    head: Dense::pack(row("head.weight", actor), row("head.bias", actor)),
                }
            })
            .collect();
        let first_bias = (0..n_actors).map(|actor| {
            let mut bias = row(OWN, actor).to_vec();
            bias.resize(networks[network_of[actor]].hidden[0].product.padded_outputs(), 0.0);
            bias
        });
        let first_bias = first_bias.collect();
        // Actors one after the other are their agents one after the other.
        let log_std = layout.get(LOG_STD).map_or(&[][..], |tensor| &parameters[tensor.range()]);
        let of_agents = log_std.chunks_exact(dimensions.n_actions);
        let log_std: Vec<[f32; MAX_JOINTS_PER_AGENT]> = of_agents
            .map(|of_agent| {
                std::array::from_fn(|action| of_agent.get(action).copied().unwrap_or_default())
            })
            .collect();
        let std: Vec<_> = log_std.iter().map(|log_std| log_std.map(elementary::exp)).collect();
        if let Some(agent) = std.iter().position(|std| !std.iter().all(|std| std.is_finite())) {
            let log_std = log_std[agent].into_iter().fold(f32::NEG_INFINITY, f32::max);
            return Err(PolicyError::Deviation { agent, log_std });
        }
        Ok(Self {
            input: dimensions.actor_input(),
            output: dimensions.actor_output(),
            activation: network.activation,
            input_norm: network.input_norm,
            input_clip: network.input_clip as f32,
            squash_mean: network.squash_mean,
            action_limit: if config.algorithm.name.is_stochastic() {
                1.0
            } else {
                config.algorithm.maddpg.action_limit
            },
            networks,
            sharing,
            network_of,
            first_bias,
            std,
            log_std,
        })
    }

    /// P: actors of the policy.
    pub fn n_actors(&self) -> usize {
        self.network_of.len()
    }

    /// The actors by network: those of a list have the same one but for the first bias, so their environments go through it together.
    pub fn sharing(&self) -> &[Vec<usize>] {
        &self.sharing
    }

    /// Numbers that each actor's network takes.
    pub fn input(&self) -> usize {
        self.input
    }

    /// Actions that each actor chooses.
    pub fn output(&self) -> usize {
        self.output
    }

    /// Standard deviation of each action of `agent`; what is behind its actions means nothing.
    ///
    /// # Panics
    /// If actors are deterministic.
    pub fn std(&self, agent: usize) -> [f32; MAX_JOINTS_PER_AGENT] {
        self.std[agent]
    }

    /// Logarithm of the standard deviation of each action of `agent`; what is behind its actions means nothing.
    ///
    /// # Panics
    /// If actors are deterministic.
    pub fn log_std(&self, agent: usize) -> [f32; MAX_JOINTS_PER_AGENT] {
        self.log_std[agent]
    }

    /// Numbers that one lane group needs between two layers: the widest layer, in whole panels.
    pub(super) fn stride(&self) -> usize {
        let widths = self.networks.iter().flat_map(|network| {
            let hidden = network.hidden.iter().map(|hidden| hidden.product.padded_outputs());
            hidden.chain([network.head.padded_outputs()])
        });
        widths.max().unwrap_or(0).max(self.input)
    }
}

/// Actors in lists of those that are `same`, in the order of their first ones.
fn sharing(n_actors: usize, same: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut lists: Vec<Vec<usize>> = Vec::new();
    for actor in 0..n_actors {
        match lists.iter_mut().find(|list| same(list[0], actor)) {
            Some(list) => list.push(actor),
            None => lists.push(vec![actor]),
        }
    }
    lists
}
