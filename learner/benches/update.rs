//! One update of small networks. `octopus bench learner` measures those of a configuration.
//!
//! `cargo bench -p learner`

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use learner::Update as _;
use learner::mappo::Mappo;
use learner::precision::Arithmetic;
use learner::state::TrainingState;
use learner::synthetic;
use proto::agents::Joints;
use proto::config::{Layers, Preset};
use proto::layout::Dimensions;
use tch::Device;

fn update(criterion: &mut Criterion) {
    let config = Layers::new(Preset::Tuned, None)
        .set("env.n_envs=32")
        .and_then(|layers| layers.set("network.hidden=[128,128]"))
        .and_then(|layers| layers.resolve())
        .expect("valid");
    let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
    let blocks = synthetic::explored_blocks(&config.network, &dimensions, 1);
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    let mut group = criterion.benchmark_group("update");
    group.throughput(Throughput::Elements(config.steps_per_iteration())).sample_size(10);
    for arithmetic in [Arithmetic::F32, Arithmetic::Bf16] {
        let mut state = TrainingState::initial(&config, &dimensions, arithmetic, Device::Cpu);
        let mut mappo = Mappo::new(&config, &dimensions, &state);
        group.bench_function(format!("2x128/{}", arithmetic.as_str()), |bencher| {
            bencher.iter(|| mappo.update(&mut state, &shards).expect("finite"));
        });
    }
    group.finish();
}

criterion_group!(benches, update);
criterion_main!(benches);
