//! The parameters of all actors' and critics' networks: names, places, initial values.
//!
//! Actors and critics are multi-layer perceptrons of one shape. The parameters of all actors stand
//! in one tensor `[A, P]`, one row an actor (see [`proto::layout`]), and so do those of the critics, so that an optimiser step is a handful of operations
//! and, of networks that are not shared, a gradient norm is the norm of a row. A named parameter is a range of columns; its view
//! `[A, in, out]` (weights multiply row vectors from the left) is what checkpoints hold.
//!
//! A shared network is kept once for each agent that it is: row r of a stack of N networks holds network
//! r mod N, as agents of one role stand [`AGENTS_PER_ARM`](proto::layout::AGENTS_PER_ARM) rows apart. Rows of one network are equal
//! except for the bias of the first hidden layer, which tells the agents apart. An update learns the first N rows and
//! every row's first bias ([`NetworkSpec::learned`]); after it [`NetworkSpec::unify`] makes the others equal again.

use std::collections::BTreeSet;
use std::ops::Range;

use proto::config::{Config, CriticState, InputNorm, Network, ParameterSharing};
use proto::layout::Dimensions;
use proto::rng::{Address, Purpose};
use tch::Tensor;

use crate::gradient_norm::squared_norms;
use crate::memory::sum_over_rows;

/// Name, shape and columns of one parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parameter {
    /// Name, such as `hidden.0.weight`.
    pub name: String,
    /// Shape of one agent's part.
    pub shape: Vec<i64>,
    /// First column.
    pub offset: i64,
}

impl Parameter {
    /// Number of columns.
    pub fn len(&self) -> i64 {
        self.shape.iter().product()
    }

    /// Whether it has no columns.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Its columns in an array `[A, P]`.
    pub fn columns(&self) -> Range<usize> {
        self.offset as usize..(self.offset + self.len()) as usize
    }

    /// The parameter's part `[A, …]` of `flat` `[A, P]`, in the same memory.
    pub fn view(&self, flat: &Tensor) -> Tensor {
        self.of_rows(flat, flat.size()[0])
    }

    /// The same of the first `rows` rows, by one operation.
    fn of_rows(&self, flat: &Tensor, rows: i64) -> Tensor {
        let mut shape = vec![rows];
        shape.extend(&self.shape);
        let mut strides = vec![flat.stride()[0]];
        strides.extend((0..self.shape.len()).map(|d| self.shape[d + 1..].iter().product::<i64>()));
        flat.as_strided(&shape, &strides, flat.storage_offset() + self.offset)
    }
}

/// The parameter in which the agents of a shared network differ.
const OWN: &str = "hidden.0.bias";

/// Which network of an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NetworkKind {
    /// Mean and deviation of the action, or the action itself.
    Actor,
    /// Expected return.
    Critic,
}

impl NetworkKind {
    /// The prefix of its names in a training state.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Critic => "critic",
        }
    }
}

/// Shape of a stack of networks.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkSpec {
    /// Actor or critic.
    pub kind: NetworkKind,
    /// A: rows, one an actor; of critics that agents share (`network.shared_critics`) one a critic.
    pub rows: usize,
    /// N: networks that differ in more than the first hidden bias; divides A.
    pub n_networks: usize,
    /// Width of the input.
    pub input: i64,
    /// Widths of the hidden layers.
    pub hidden: Vec<i64>,
    /// Width of the output; of a critic one for each agent whose it is.
    pub output: i64,
    /// Actions of an agent.
    pub n_actions: usize,
    /// Whether the input has a learned gain and bias after its standardisation.
    pub input_layer_norm: bool,
    /// Whether each hidden activation is standardised, with a learned gain and shift.
    pub layer_norm: bool,
    /// The parameters in the order of `proto::layout::ActorLayout`.
    pub parameters: Vec<Parameter>,
    /// P: columns.
    pub len: i64,
}

impl NetworkSpec {
    /// The actors or critics of a configuration.
    pub fn new(kind: NetworkKind, config: &Config, dimensions: &Dimensions) -> Self {
        let network = &config.network;
        let (input, hidden, output) = match kind {
            NetworkKind::Actor => {
                (dimensions.actor_input(), network.hidden.as_slice(), dimensions.actor_output())
            }
            NetworkKind::Critic => {
                let outputs = dimensions.n_actors / config.critics(dimensions.n_actors);
                (dimensions.critic_input(), network.hidden_of_critics(), outputs)
            }
        };
        let rows = match kind {
            NetworkKind::Actor => dimensions.n_actors,
            NetworkKind::Critic => config.critics(dimensions.n_actors),
        };
        let hidden: Vec<i64> = hidden.iter().map(|&width| width as i64).collect();
        let input_layer_norm = network.input_norm == InputNorm::LayerNorm;
        let mut parameters = Vec::new();
        let mut len = 0;
        let mut add = |name: String, shape: &[i64]| {
            let parameter = Parameter { name, shape: shape.to_vec(), offset: len };
            len += parameter.len();
            parameters.push(parameter);
        };
        let (mut width, output) = (input as i64, output as i64);
        if input_layer_norm {
            add("input.gain".to_owned(), &[width]);
            add("input.bias".to_owned(), &[width]);
        }
        for (layer, &units) in hidden.iter().enumerate() {
            add(format!("hidden.{layer}.weight"), &[width, units]);
            add(format!("hidden.{layer}.bias"), &[units]);
            if network.layer_norm {
                add(format!("hidden.{layer}.gain"), &[units]);
                add(format!("hidden.{layer}.shift"), &[units]);
            }
            width = units;
        }
        add("head.weight".to_owned(), &[width, output]);
        add("head.bias".to_owned(), &[output]);
        if kind == NetworkKind::Actor && config.algorithm.name.is_stochastic() {
            add("log_std".to_owned(), &[output]);
        }
        let sees_what_actors_see =
            kind == NetworkKind::Actor || network.critic_state == CriticState::Own;
        let all_alike = network.parameter_sharing == ParameterSharing::All;
        let n_networks =
            if sees_what_actors_see || all_alike { network.actor_networks(rows) } else { rows };
        Self {
            kind,
            rows,
            n_networks,
            n_actions: dimensions.n_actions,
            input: input as i64,
            hidden,
            output,
            input_layer_norm,
            layer_norm: network.layer_norm,
            parameters,
            len,
        }
    }

    /// The parameter called `name`.
    ///
    /// # Panics
    /// If the network has none of that name.
    pub fn get(&self, name: &str) -> &Parameter {
        self.parameters
            .iter()
            .find(|parameter| parameter.name == name)
            .unwrap_or_else(|| panic!("no parameter `{name}` in {:?}", self.kind))
    }

    /// The view of `name` in `flat`.
    pub fn view(&self, name: &str, flat: &Tensor) -> Tensor {
        self.get(name).view(flat)
    }

    /// Initial parameters `[A, P]`: orthogonal weights (Saxe, McClelland and Ganguli 2014), gain √2
    /// for hidden layers, `head_gain` for the actors' head and 1 for the critics'; zero biases, unit
    /// gains, the initial deviations of the configuration.
    pub fn initial(&self, network: &Network, seed: u64) -> Tensor {
        let mut flat = vec![0.0f32; self.rows * self.len as usize];
        let (networks, repeats) = flat.split_at_mut(self.n_networks * self.len as usize);
        for (network_index, row) in networks.chunks_exact_mut(self.len as usize).enumerate() {
            for (index, parameter) in self.parameters.iter().enumerate() {
                let start = parameter.offset as usize;
                let slot = &mut row[start..start + parameter.len() as usize];
                match parameter.name.rsplit('.').next() {
                    Some("weight") => {
                        let gain = match (parameter.name.as_str(), self.kind) {
                            ("head.weight", NetworkKind::Actor) => network.head_gain,
                            ("head.weight", NetworkKind::Critic) => 1.0,
                            _ => std::f64::consts::SQRT_2,
                        };
                        // Actors and critics draw from different addresses.
                        let tensor =
                            index as u32 + 1000 * u32::from(self.kind == NetworkKind::Critic);
                        let address = Address {
                            seed,
                            purpose: Purpose::Initialisation,
                            iteration: tensor,
                            env: network_index as u32,
                            step: 0,
                            index: 0,
                        };
                        let [rows, columns] = parameter.shape[..] else {
                            unreachable!("weights have two dimensions")
                        };
                        orthogonal(address, rows as usize, columns as usize, gain, slot);
                    }
                    Some("gain") => slot.fill(1.0),
                    Some("log_std") => {
                        let agents_per_actor = slot.len() / self.n_actions;
                        for (i, joints) in slot.chunks_exact_mut(self.n_actions).enumerate() {
                            let agent = network_index * agents_per_actor + i;
                            joints.fill(network.initial_log_std_of(agent) as f32);
                        }
                    }
                    _ => slot.fill(0.0),
                }
            }
        }
        // Row r is network r mod N.
        for rows in repeats.chunks_exact_mut(networks.len()) {
            rows.copy_from_slice(networks);
        }
        Tensor::from_slice(&flat).view([self.rows as i64, self.len])
    }

    /// Whether a network is several agents'.
    pub fn is_shared(&self) -> bool {
        self.n_networks < self.rows
    }

    /// The specification of a part of the rows, which are either all agents of one network or all there are.
    #[must_use]
    pub fn part(&self, rows: &[usize]) -> Self {
        let networks: BTreeSet<usize> = rows.iter().map(|row| row % self.n_networks).collect();
        Self { rows: rows.len(), n_networks: networks.len(), ..self.clone() }
    }

    /// K: rows of a network.
    pub fn rows_per_network(&self) -> i64 {
        (self.rows / self.n_networks) as i64
    }

    /// The columns of a row that are learned there: all of the first N rows, of others the first hidden bias.
    pub fn learned_columns(&self, row: usize) -> Range<i64> {
        if row < self.n_networks { 0..self.len } else { self.own_columns() }
    }

    /// The columns of [`OWN`].
    fn own_columns(&self) -> Range<i64> {
        let own = self.get(OWN);
        own.offset..own.offset + own.len()
    }

    /// What is learned of a tensor `[A, P]`, in the same memory: its first N rows, and the first hidden bias of the others,
    /// if there are others.
    pub fn learned_parts(&self, flat: &Tensor) -> Vec<Tensor> {
        let (networks, rows) = (self.n_networks as i64, self.rows as i64);
        let others = self.is_shared().then(|| {
            let columns = self.own_columns();
            flat.narrow(0, networks, rows - networks).narrow(
                1,
                columns.start,
                columns.end - columns.start,
            )
        });
        std::iter::once(flat.narrow(0, 0, networks)).chain(others).collect()
    }

    /// What is learned of a parameter, in the same memory: `[N, …]`, of the first hidden bias `[A, H]`.
    pub fn learned(&self, name: &str, flat: &Tensor) -> Tensor {
        let rows = if name == OWN { self.rows } else { self.n_networks };
        self.get(name).of_rows(flat, rows as i64)
    }

    /// The logarithms of the deviations `[A, U]`, each actor's that of its network. In the parameters' memory where no network is shared.
    pub fn log_std(&self, flat: &Tensor) -> Tensor {
        let learned = self.learned("log_std", flat);
        let (networks, actions) = learned.size2().expect("[N, U]");
        let each = self.rows_per_network();
        learned.unsqueeze(0).expand([each, networks, actions], false).reshape([-1, actions])
    }

    /// Squared gradient norm of what an optimiser moves together: a network, with the first hidden
    /// biases of all its agents; the same for each of the A rows.
    pub fn squared_norms(&self, gradient: &Tensor) -> Vec<f32> {
        let columns: Vec<Range<i64>> =
            (0..self.rows).map(|row| self.learned_columns(row)).collect();
        let mut norms = squared_norms(gradient, &columns);
        let others = norms.split_off(self.n_networks);
        if !others.is_empty() {
            let others = sum_over_rows(&others, self.n_networks);
            norms.iter_mut().zip(others).for_each(|(norm, others)| *norm += others);
        }
        norms.iter().copied().cycle().take(self.rows).collect()
    }

    /// Copies what is learned in `part` to all rows of `[A, P]` where it belongs, which may be the same memory.
    pub fn spread(&self, part: &Tensor, rows: &Tensor) {
        if part.data_ptr() == rows.data_ptr() {
            self.unify(rows);
            return;
        }
        let networks = self.n_networks as i64;
        let learned = part.narrow(0, 0, networks);
        for first in (0..self.rows as i64).step_by(self.n_networks) {
            rows.narrow(0, first, networks).copy_(&learned);
        }
        if self.is_shared() {
            let own = self.own_columns();
            let of = |tensor: &Tensor| tensor.narrow(1, own.start, own.end - own.start);
            of(rows).copy_(&of(part));
        }
    }

    /// Copies the shared columns of each network's first row of `flat` to its other rows.
    pub fn unify(&self, flat: &Tensor) {
        if !self.is_shared() {
            return;
        }
        // [K, N, P]
        let rows = flat.view([-1, self.n_networks as i64, self.len]);
        let own = self.own_columns();
        for shared in [0..own.start, own.end..self.len] {
            let mut part = rows.narrow(2, shared.start, shared.end - shared.start);
            let first = part.narrow(0, 0, 1).copy();
            part.copy_(&first);
        }
    }
}

/// Fills `out` `[rows, columns]` with a random matrix of orthonormal rows or columns, whichever are
/// fewer, times `gain`: Gram and Schmidt, twice, in `f64`, on normal vectors.
fn orthogonal(address: Address, rows: usize, columns: usize, gain: f64, out: &mut [f32]) {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut normals = (0u32..).flat_map(|step| Address { step, ..address }.normals());
    let mut basis: Vec<f64> = Vec::with_capacity(count * length);
    for vector in 0..count {
        basis.extend(normals.by_ref().take(length).map(f64::from));
        let (earlier, current) = basis.split_at_mut(vector * length);
        // Twice is enough (Kahan; Giraud, Langou and Rozložník 2005).
        for _ in 0..2 {
            for other in earlier.chunks_exact(length) {
                let overlap = dot(other, current);
                current.iter_mut().zip(other).for_each(|(x, y)| *x -= overlap * y);
            }
        }
        let norm = dot(current, current).sqrt();
        for x in current {
            *x /= norm;
        }
    }
    for (vector, values) in basis.chunks_exact(length).enumerate() {
        for (position, value) in values.iter().enumerate() {
            let (row, column) =
                if rows <= columns { (vector, position) } else { (position, vector) };
            out[row * columns + column] = (gain * value) as f32;
        }
    }
}

/// Eight partial sums in a fixed order, so that the compiler may use vectors.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a8.remainder().iter().zip(b8.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a8.zip(b8) {
        for lane in 0..8 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Config, Layers, Preset, TaskName};
    use proto::layout::ActorLayout;
    use tch::{Device, Kind};

    use super::*;

    fn config(assignments: &[&str]) -> Config {
        assignments
            .iter()
            .fold(Layers::new(Preset::Release, Some(TaskName::Trajectory)), |layers, a| {
                layers.set(a).expect("well formed")
            })
            .resolve()
            .expect("valid")
    }

    #[test]
    fn parameters_are_named_and_shaped_as_policies_are_published() {
        for (norm, algorithm) in ["layer_norm", "none", "running"]
            .into_iter()
            .flat_map(|norm| ["mappo", "ppo", "maddpg"].map(|algorithm| (norm, algorithm)))
        {
            let config = config(&[
                &format!("algorithm.name={algorithm}"),
                &format!("network.input_norm={norm}"),
            ]);
            let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
            let spec = NetworkSpec::new(NetworkKind::Actor, &config, &dimensions);
            let published = ActorLayout::new(&config, &dimensions);
            let running = |name: &str| name == "input.mean" || name == "input.inverse_std";
            let expected: Vec<_> = published
                .tensors
                .iter()
                .filter(|tensor| !running(&tensor.name))
                .map(|t| (t.name.clone(), t.shape[1..].iter().map(|&n| n as i64).collect()))
                .collect();
            let ours: Vec<(String, Vec<i64>)> =
                spec.parameters.iter().map(|p| (p.name.clone(), p.shape.clone())).collect();
            assert_eq!(ours, expected);
        }
    }

    #[test]
    fn wrists_may_begin_with_another_deviation() {
        let offset = ["network.initial_log_std=-0.75", "network.wrist_log_std_offset=0.5"];
        let arm = [[-0.75f32; 3], [-0.25; 3]].concat();
        for (variant, expected) in [
            (&["network.parameter_sharing=none"][..], arm.repeat(2)),
            (&["network.parameter_sharing=roles"], arm.repeat(2)),
            (&["network.parameter_sharing=all"], vec![-0.75; 12]),
            (&["algorithm.name=ppo", "network.critic_state=own"], arm.repeat(2)),
        ] {
            let config = config(&[&offset[..], variant].concat());
            let spec = NetworkSpec::new(
                NetworkKind::Actor,
                &config,
                &Dimensions::new(&config, Joints::of_sixes(2)),
            );
            let log_std = spec.view("log_std", &spec.initial(&config.network, 5)).contiguous();
            assert_eq!(
                Vec::<f32>::try_from(log_std.view([-1])).expect("f32"),
                expected,
                "{variant:?}"
            );
        }
    }

    #[test]
    fn initial_weights_are_orthogonal_and_differ_between_agents() {
        let config = config(&["network.hidden=[24,40]"]);
        let spec = NetworkSpec::new(
            NetworkKind::Actor,
            &config,
            &Dimensions::new(&config, Joints::of_sixes(2)),
        );
        let flat = spec.initial(&config.network, 5);
        assert_eq!(flat, spec.initial(&config.network, 5));
        assert_ne!(flat, spec.initial(&config.network, 6));
        for (name, gain) in
            [("hidden.0.weight", 2.0), ("hidden.1.weight", 2.0), ("head.weight", 1e-4)]
        {
            let weight = spec.view(name, &flat).to_kind(Kind::Double);
            let (_, rows, columns) = weight.size3().expect("[A, in, out]");
            let product = if rows <= columns {
                weight.bmm(&weight.transpose(1, 2))
            } else {
                weight.transpose(1, 2).bmm(&weight)
            };
            let size = rows.min(columns);
            let identity = Tensor::eye(size, (Kind::Double, Device::Cpu)) * gain;
            // Entries are rounded to f32: 2⁻²⁴ each, times the gain, summed in quadrature.
            let error = (product - identity).abs().max().double_value(&[]);
            assert!(error < 1e-6 * gain, "{name}: {error}");
            assert_ne!(weight.get(0), weight.get(1), "{name}");
        }
        assert_eq!(spec.view("hidden.1.bias", &flat).abs().max().double_value(&[]), 0.0);
        assert_eq!(spec.view("input.gain", &flat).min().double_value(&[]), 1.0);
    }

    #[test]
    fn a_shared_network_is_learned_in_one_row_but_for_the_first_bias() {
        let config = config(&["network.parameter_sharing=all", "network.hidden=[4]"]);
        let spec = NetworkSpec::new(
            NetworkKind::Critic,
            &config,
            &Dimensions::new(&config, Joints::of_sixes(1)),
        );
        let gradient = Tensor::arange(2 * spec.len, (Kind::Float, Device::Cpu)).view([2, spec.len]);
        let [bias, head] =
            ["hidden.0.bias", "head.weight"].map(|name| spec.learned(name, &gradient).copy());
        assert_eq!((bias.size(), head.size()), (vec![2, 4], vec![1, 4, 1]));
        spec.unify(&gradient);
        let head = spec.view("head.weight", &gradient);
        assert_eq!(head.get(0), head.get(1));
        assert_eq!(spec.view("hidden.0.bias", &gradient), bias, "unlike each other");
        // The norm counts shared columns once and every agent's bias.
        let once = spec.len - 4;
        let norms = spec.squared_norms(&Tensor::ones([2, spec.len], (Kind::Float, Device::Cpu)));
        assert_eq!(norms, [(once + 8) as f32; 2]);
    }
}
