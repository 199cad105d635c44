//! The actors' tensors as both exports store them: what several actors share once, and rounded where inference rounds.

use proto::config::Inference;
use proto::layout::ActorLayout;
use simulator::rollout::World;
use simulator::scalar::{bf16_bias, bf16_round};

/// What becomes of a number that inference rounds.
type Rounding = fn(f32) -> f32;

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
        let get = |name: &str, rounding: Option<Rounding>, half: bool| {
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
            let (round, bias): (Option<Rounding>, Option<Rounding>) =
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

#[cfg(test)]
mod tests {
    use proto::config::{Layers, ParameterSharing, Preset};
    use simulator::policy::initial_parameters;
    use simulator::robot::Robot;

    use super::*;

    #[test]
    fn rows_that_actors_share_are_stored_once_and_rounded_where_inference_rounds() {
        let mut config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        config.network.hidden = vec![8, 6];
        config.network.parameter_sharing = ParameterSharing::None;
        let robot = Robot::builtin("paper").expect("built in");
        let world = World::new(&config, &robot);
        let mut parameters = initial_parameters(&config, &world.dimensions, 1);
        let layout = ActorLayout::new(&config, &world.dimensions);
        // Shoulders share the second layer, and so do wrists.
        let spec = layout.get("hidden.1.weight").expect("exists");
        let length = spec.len() / 8;
        for actor in 2..8 {
            let from = spec.offset + actor % 2 * length;
            parameters.copy_within(from..from + length, spec.offset + actor * length);
        }
        let networks = Networks::new(&world, &parameters);
        let [first, second, head] = networks.layers.as_slice() else { panic!("three layers") };
        assert_eq!((first.weight.rows.len(), first.weight.half), (8, false));
        assert_eq!(second.weight.row_of, [0, 1, 0, 1, 0, 1, 0, 1]);
        assert_eq!((second.weight.rows.len(), second.sizes()), (2, [8, 6]));
        assert!(second.weight.half && !head.weight.half);
        let lower = second.weight.rows.iter().flatten().map(|x| x.to_bits() & 0xffff);
        assert_eq!(lower.max(), Some(0));
        for (x, rounded) in parameters[spec.range()].iter().zip(&second.weight.rows[0]) {
            assert!((x - rounded).abs() <= x.abs() / 256.0, "{x} {rounded}");
        }
        // All biases begin with zero.
        assert_eq!(head.bias.rows, [[0.0; 3]]);
        assert_eq!(networks.input.map(|input| input.map(|of| of.rows.len())), Some([1, 1]));
    }
}
