//! A block through its channel within one process: what loan, send and receive cost without waking
//! anybody. `octopus bench transport` measures from process to process.
//!
//! `cargo bench -p channels`

use proto::agents::Joints;
use std::hint::black_box;
use std::time::Duration;

use channels::{ChannelSizes, Channels, Domain};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use proto::config::{Layers, Preset};
use proto::layout::Dimensions;

fn transport(criterion: &mut Criterion) {
    let config = Layers::new(Preset::Paper, None).resolve().expect("presets are valid");
    let sizes = ChannelSizes::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)));
    let domain = Domain::fresh();
    let channels = Channels::create(&domain, sizes).expect("room in /dev/shm");
    let receiver = channels.block_receiver().expect("a receiver");
    let sender = channels.block_sender(Duration::from_secs(1)).expect("a sender");
    let mut group = criterion.benchmark_group("block");
    group.throughput(Throughput::Bytes(4 * sizes.block_len as u64));
    group.bench_function("loan_send_receive", |bencher| {
        bencher.iter(|| {
            sender.send(sender.loan().expect("a sample")).expect("sent");
            black_box(receiver.try_receive().expect("works").expect("there").payload()[0])
        });
    });
    group.finish();
    drop((sender, receiver, channels));
    domain.remove_leftovers().expect("removable");
}

criterion_group!(benches, transport);
criterion_main!(benches);
