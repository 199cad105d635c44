//! The folded layers of stacked networks, and the buffers that both implementations of the passes fill.

use std::ops::Range;

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use crate::network::NetworkSpec;

/// Weights in the products' precision, and buffers.
#[derive(Debug)]
pub(super) struct Stack {
    pub(super) spec: NetworkSpec,
    pub(super) activation: Activation,
    pub(super) kind: Kind,
    pub(super) device: Device,
    /// `[N, in, H]` of each hidden layer, folded, in `kind`.
    pub(super) weight: Vec<Tensor>,
    /// `[N, U, H]`: the head, transposed, folded.
    pub(super) head: Tensor,
    /// `[N, U, 1]`.
    pub(super) head_bias: Tensor,
    /// Where weights and biases stand in a row of parameters: of each hidden layer, then of the head.
    pub(super) columns: Vec<[Range<usize>; 2]>,
    pub(super) buffers: Buffers,
}

/// Flat memory for the largest chunk; chunks are its beginning.
#[derive(Debug, Default)]
pub(super) struct Buffers {
    pub(super) rows: i64,
    /// After the activation, of each layer; before it where the passes are plain Rust. Those need it again only with LayerNorm: without one all layers share a
    /// buffer, which is left alone where products go through the units at once.
    active: Vec<Tensor>,
    /// After the standardisation, of each layer; with libtorch's operations empty without LayerNorm.
    standard: Vec<Tensor>,
    /// Reciprocal deviations `[N, R, 1]` of the last pass.
    pub(super) inverse_std: Vec<Tensor>,
    /// Gradients, alternating.
    gradient: [Option<Tensor>; 2],
    /// Weight gradients of each layer in `kind`.
    pub(super) weight_gradient: Vec<Tensor>,
    chunk: Chunk,
}

/// The beginnings of the buffers, as chunks of so many rows have them: `[N, rows, H]` of each layer.
#[derive(Debug, Default)]
struct Chunk {
    rows: i64,
    active: Vec<Tensor>,
    standard: Vec<Tensor>,
    gradient: Vec<Tensor>,
}

impl Stack {
    /// Layers of the networks `spec`, with products in `kind`.
    pub(super) fn new(
        spec: &NetworkSpec,
        activation: Activation,
        kind: Kind,
        device: Device,
    ) -> Self {
        let networks = spec.n_networks as i64;
        let zeros = |shape: &[i64], kind| Tensor::zeros(shape, (kind, device));
        let mut weight = Vec::new();
        let mut width = spec.input;
        for &units in &spec.hidden {
            weight.push(zeros(&[networks, width, units], kind));
            width = units;
        }
        let weight_gradient = weight.iter().map(Tensor::zeros_like).collect();
        let columns = (0..=spec.hidden.len())
            .map(|layer| {
                let (weight, bias) = names(spec, layer);
                [spec.get(&weight).columns(), spec.get(&bias).columns()]
            })
            .collect();
        Self {
            spec: spec.clone(),
            activation,
            kind,
            device,
            weight,
            head: zeros(&[networks, spec.output, width], Kind::Float),
            head_bias: zeros(&[networks, spec.output, 1], Kind::Float),
            columns,
            buffers: Buffers { weight_gradient, ..Buffers::default() },
        }
    }

    /// N.
    pub(super) fn networks(&self) -> i64 {
        self.spec.n_networks as i64
    }

    /// Biases of hidden layer `layer`: A in the first, N in the others.
    pub(super) fn biases(&self, layer: usize) -> i64 {
        if layer == 0 { self.spec.rows as i64 } else { self.networks() }
    }

    /// Flat memory for `rows` rows of `width` features.
    pub(super) fn flat(&self, rows: i64, width: i64, kind: Kind) -> Tensor {
        Tensor::zeros([self.networks() * rows * width], (kind, self.device))
    }

    /// Rows `[N, R, F]` by actor, `[A, B, F]`.
    pub(super) fn rows_by_actor(&self, rows: &Tensor) -> Tensor {
        let (networks, each) = (self.networks(), self.spec.rows_per_network());
        let (_, r, f) = rows.size3().expect("[N, R, F]");
        let by_actor = rows.view([networks, r / each, each, f]).permute([2, 0, 1, 3]);
        by_actor.reshape([each * networks, r / each, f])
    }

    /// Units of the widest hidden layer.
    pub(super) fn widest(&self) -> i64 {
        self.spec.hidden.iter().copied().max().unwrap_or(1)
    }

    /// Gets buffers for `rows` rows; those after the standardisation only where `standard` asks for them.
    pub(super) fn reserve(&mut self, rows: i64, standard: bool) {
        let layers = |stack: &Self| {
            let hidden = stack.spec.hidden.iter();
            hidden.map(|&h| stack.flat(rows, h, stack.kind)).collect::<Vec<_>>()
        };
        if standard && !self.spec.layer_norm {
            let shared = self.flat(rows, self.widest(), self.kind);
            self.buffers.active = self.weight.iter().map(|_| shared.shallow_clone()).collect();
        } else {
            self.buffers.active = layers(self);
        }
        if standard {
            self.buffers.standard = layers(self);
        }
        let gradient = || Some(self.flat(rows, self.widest(), self.kind));
        self.buffers.gradient = [gradient(), gradient()];
        self.buffers.rows = rows;
        self.buffers.chunk = Chunk::default();
    }

    /// From now on chunks have so many rows.
    pub(super) fn cut(&mut self, rows: i64) {
        if self.buffers.chunk.rows == rows {
            return;
        }
        let layers = self.spec.hidden.iter().copied().enumerate();
        let cut = |buffers: &[Tensor]| {
            let each = buffers.iter().zip(&self.spec.hidden);
            each.map(|(flat, &width)| self.chunk(flat, rows, width)).collect()
        };
        let gradient = |layer: usize, width| {
            let flat = &self.buffers.gradient[(self.spec.hidden.len() - 1 - layer) % 2];
            self.chunk(flat.as_ref().expect("reserved"), rows, width)
        };
        self.buffers.chunk = Chunk {
            rows,
            active: cut(&self.buffers.active),
            standard: cut(&self.buffers.standard),
            gradient: layers.map(|(layer, width)| gradient(layer, width)).collect(),
        };
    }

    /// A layer's chunk of [`Buffers::active`], `[N, rows, H]`.
    pub(super) fn active(&self, layer: usize) -> Tensor {
        self.buffers.chunk.active[layer].shallow_clone()
    }

    /// A layer's chunk of [`Buffers::standard`], `[N, rows, H]`.
    pub(super) fn standard(&self, layer: usize) -> Tensor {
        self.buffers.chunk.standard[layer].shallow_clone()
    }

    /// The chunk for the gradient by a layer's activations, `[N, rows, H]`; two buffers alternate.
    pub(super) fn gradient(&self, layer: usize) -> Tensor {
        self.buffers.chunk.gradient[layer].shallow_clone()
    }

    /// The gain and shift that precede hidden layer `layer` (or the head, for the last index).
    pub(super) fn preceding(&self, layer: usize, flat: &Tensor) -> Option<(Tensor, Tensor)> {
        let names = match layer {
            0 if self.spec.input_layer_norm => ("input.gain".to_owned(), "input.bias".to_owned()),
            0 => return None,
            _ if self.spec.layer_norm => {
                (format!("hidden.{}.gain", layer - 1), format!("hidden.{}.shift", layer - 1))
            }
            _ => return None,
        };
        Some((self.spec.learned(&names.0, flat), self.spec.learned(&names.1, flat)))
    }

    /// Names of the weight and bias of hidden layer `layer`, or of the head for the last index.
    pub(super) fn names(&self, layer: usize) -> (String, String) {
        names(&self.spec, layer)
    }

    /// `[N, rows, width]` at the beginning of a flat buffer.
    pub(super) fn chunk(&self, flat: &Tensor, rows: i64, width: i64) -> Tensor {
        flat.as_strided([self.networks(), rows, width], [rows * width, width, 1], 0)
    }
}

fn names(spec: &NetworkSpec, layer: usize) -> (String, String) {
    if layer == spec.hidden.len() {
        ("head.weight".to_owned(), "head.bias".to_owned())
    } else {
        (format!("hidden.{layer}.weight"), format!("hidden.{layer}.bias"))
    }
}
