//! The actors' tensors as both exports store them: what several actors share once, and rounded where inference rounds.

use proto::config::Inference;
use proto::layout::ActorLayout;
use simulator::rollout::World;
use simulator::scalar::{bf16_bias, bf16_round};

/// One tensor of all actors.
#[derive(Debug, Clone)]
pub(crate) struct Stacked {
    /// As checkpoints call it: `hidden.0.weight`.
    pub(crate) name: String,
    /// Shape of a row: `[in, out]` of weights, else one length.
    pub(crate) shape: Vec<usize>,
    /// Rows that differ.
    pub(crate) rows: Vec<Vec<f32>>,
    /// The row of each actor.
    pub(crate) row_of: Vec<usize>,
    /// Whether all numbers are bfloat16.
    pub(crate) half: bool,
}

/// A fully connected layer of all actors; the last one is the head.
#[derive(Debug, Clone)]
pub(crate) struct Layer {
    pub(crate) weight: Stacked,
    pub(crate) bias: Stacked,
    /// LayerNorm's gain and shift behind the activation.
    pub(crate) norm: Option<[Stacked; 2]>,
}

impl Layer {
    /// Units before and in the layer.
    pub(crate) fn sizes(&self) -> [usize; 2] {
        [self.weight.shape[0], self.weight.shape[1]]
    }
}

/// All actors.
#[derive(Debug, Clone)]
pub(crate) struct Networks {
    /// The input's normalisation: mean and inverse deviation, or gain and bias.
    pub(crate) input: Option<[Stacked; 2]>,
    pub(crate) layers: Vec<Layer>,
}

impl Networks {
    /// The actors with these parameters, flat in the order of [`ActorLayout`].
    pub(crate) fn new(world: &World, parameters: &[f32]) -> Self {
        let layout = ActorLayout::new(&world.config, &world.dimensions);
        let get = |name: &str, rounding: Option<fn(f32) -> f32>, half: bool| {
            let spec = layout.get(name)?;
            let (mut rows, mut row_of) = (Vec::<Vec<f32>>::new(), Vec::new());
            for row in parameters[spec.range()].chunks_exact(spec.len() / spec.shape[0]) {
                let row: Vec<f32> =
                    row.iter().map(|&x| rounding.map_or(x, |round| round(x))).collect();
                let same = |known: &Vec<f32>| {
                    known.iter().zip(&row).all(|(a, b)| a.to_bits() == b.to_bits())
                };
                row_of.push(rows.iter().position(same).unwrap_or(rows.len()));
                if row_of.last() == Some(&rows.len()) {
                    rows.push(row);
                }
            }
            Some(Stacked {
                name: name.to_owned(),
                shape: spec.shape[1..].to_vec(),
                rows,
                row_of,
                half,
            })
        };
        let plain = |name: &str| get(name, None, false);
        let pair = |first: &str, second: &str| Some([plain(first)?, plain(second)?]);
        let n_hidden = world.config.network.hidden.len();
        let hidden = (0..n_hidden).map(|i| {
            // As `simulator::policy` packs them.
            let half = i > 0 && world.config.network.inference == Inference::Bf16;
            let name = |part: &str| format!("hidden.{i}.{part}");
            let (round, bias): (Option<fn(f32) -> f32>, Option<fn(f32) -> f32>) =
                if half { (Some(bf16_round), Some(bf16_bias)) } else { (None, None) };
            Layer {
                weight: get(&name("weight"), round, half).expect("the layout has it"),
                bias: get(&name("bias"), bias, false).expect("the layout has it"),
                norm: pair(&name("gain"), &name("shift")),
            }
        });
        let head = Layer {
            weight: plain("head.weight").expect("the layout has it"),
            bias: plain("head.bias").expect("the layout has it"),
            norm: None,
        };
        Self {
            input: pair("input.mean", "input.inverse_std")
                .or_else(|| pair("input.gain", "input.bias")),
            layers: hidden.chain([head]).collect(),
        }
    }
}
