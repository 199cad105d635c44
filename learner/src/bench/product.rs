//! How fast libtorch multiplies matrices: what an update could reach if it did nothing else.

use std::sync::Barrier;
use std::time::{Duration, Instant};

use proto::config::Config;
use proto::layout::Dimensions;
use tch::{Device, Kind, Tensor};

/// Rows that go through a product at once: a chunk that fits in the cache, and several of them.
const ROWS: [i64; 2] = [400, 1600];

/// How often each case has its turn: other programs may be busy during one of them.
const TURNS: usize = 3;

/// The three products of a layer.
#[derive(Debug, Clone, Copy)]
enum Product {
    Forward,
    WeightGradient,
    InputGradient,
}

/// The best rate (GFLOP/s) on the widest layer of the configuration's networks, stacked for all
/// actors, with the configuration's threads. Tried are all three products, few and many rows, and
/// threads that share a product or have agents of their own.
pub(super) fn best_rate(
    config: &Config,
    dimensions: &Dimensions,
    kind: Kind,
    device: Device,
    seconds: f64,
) -> f64 {
    let threads = config.run.learner_threads;
    let split = if device.is_cuda() { 1 } else { threads.min(dimensions.n_actors) };
    let mut groups = vec![1, split];
    groups.dedup();
    let products = [Product::Forward, Product::WeightGradient, Product::InputGradient];
    let cases = groups.len() * ROWS.len() * products.len();
    let time = Duration::from_secs_f64(seconds / (TURNS * cases) as f64);
    let [input, output] = widest(config, dimensions);
    let mut best = 0.0_f64;
    for &groups in (0..TURNS).flat_map(|_| &groups) {
        let agents = (dimensions.n_actors / groups) as i64;
        for rows in ROWS {
            for product in products {
                let operands = || operands(product, [agents, rows, input, output], kind, device);
                let flops = (2 * agents * rows * input * output) as f64;
                let rate = flops * products_per_s(groups, threads / groups, time, &operands);
                best = best.max(rate * 1e-9);
            }
        }
    }
    tch::set_num_threads(i32::try_from(threads).unwrap_or(i32::MAX));
    best
}

/// Width of the input and of the output of the layer with the most weights.
fn widest(config: &Config, dimensions: &Dimensions) -> [i64; 2] {
    let network = &config.network;
    let actor = (dimensions.actor_input(), network.hidden.as_slice(), dimensions.actor_output());
    let values = dimensions.n_actors / config.critics(dimensions.n_actors);
    let critic = (dimensions.critic_input(), network.hidden_of_critics(), values);
    [actor, critic]
        .into_iter()
        .flat_map(|(input, hidden, output)| {
            let widths: Vec<usize> = std::iter::once(input)
                .chain(hidden.iter().copied())
                .chain(std::iter::once(output))
                .collect();
            widths.windows(2).map(|pair| [pair[0] as i64, pair[1] as i64]).collect::<Vec<_>>()
        })
        .max_by_key(|[input, output]| input * output)
        .expect("a network has layers")
}

/// The two factors and the memory for what comes out.
fn operands(
    product: Product,
    [agents, rows, input, output]: [i64; 4],
    kind: Kind,
    device: Device,
) -> [Tensor; 3] {
    let tensor = |rows, columns| Tensor::full([agents, rows, columns], 0.01, (kind, device));
    match product {
        Product::Forward => [tensor(rows, input), tensor(input, output), tensor(rows, output)],
        Product::WeightGradient => {
            [tensor(rows, input).transpose(1, 2), tensor(rows, output), tensor(input, output)]
        }
        Product::InputGradient => {
            [tensor(rows, output), tensor(input, output).transpose(1, 2), tensor(rows, input)]
        }
    }
}

/// Products per second of all `groups` of agents, which multiply side by side. Counted are those of all groups over the time
/// until the last one has ended: rates of each alone, summed up, would be more than the machine can do where they took turns.
fn products_per_s(
    groups: usize,
    threads: usize,
    time: Duration,
    operands: &(dyn Fn() -> [Tensor; 3] + Sync),
) -> f64 {
    let together = Barrier::new(groups);
    let one_group = || {
        tch::set_num_threads(i32::try_from(threads.max(1)).unwrap_or(i32::MAX));
        let [a, b, out] = operands();
        let multiply = || {
            let _ = a.bmm_out(&out, &b);
        };
        multiply();
        together.wait();
        let start = Instant::now();
        let mut products = 0;
        while products == 0 || start.elapsed() < time {
            multiply();
            products += 1;
        }
        // Waits for a GPU, too.
        let _ = out.get(0).get(0).get(0).to_kind(Kind::Float).double_value(&[]);
        (products, [start, Instant::now()])
    };
    std::thread::scope(|scope| {
        let handles: Vec<_> = (0..groups).map(|_| scope.spawn(one_group)).collect();
        let done: Vec<(u32, [Instant; 2])> = handles
            .into_iter()
            .map(|handle| handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect();
        rate(&done)
    })
}

/// Products per second over the time from the first beginning to the last end; each group does the whole number of its own.
fn rate(groups: &[(u32, [Instant; 2])]) -> f64 {
    let products: u32 = groups.iter().map(|(products, _)| products).sum();
    let begin = groups.iter().map(|(_, [begin, _])| *begin).min();
    let end = groups.iter().map(|(_, [_, end])| *end).max();
    let elapsed = begin.zip(end).map_or(Duration::ZERO, |(begin, end)| end - begin);
    f64::from(products) / elapsed.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_that_took_turns_did_not_work_at_the_same_time() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        // Side by side ten a second; one after the other, on one processor, half of that.
        assert_eq!(rate(&[(10, [at(0), at(2)]), (10, [at(0), at(2)])]), 10.0);
        assert_eq!(rate(&[(10, [at(0), at(2)]), (10, [at(2), at(4)])]), 5.0);
    }
}
