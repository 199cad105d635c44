//! A worker in a thread, with the test as coordinator and learner.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use channels::{ArraySample, ChannelSizes, Channels, Domain, MessageReceiver};
use proto::ExitCode;
use proto::config::{Layers, Preset};
use proto::layout::{BlockHeader, PolicyHeader};
use proto::message::{Order, RunEnd, Status};
use proto::run_dir::RunDir;
use simulator::policy::initial_parameters as parameters;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};

use super::process::Worker;
use super::worker_loop::serve;
use super::*;

/// Longest that any of these tests waits for anything.
const PATIENCE: Duration = Duration::from_mins(1);

struct TestDomain(Domain);

impl Drop for TestDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_leftovers();
    }
}

fn world() -> World {
    let config = Layers::new(Preset::Tuned, None)
        .set("env.n_envs=6")
        .and_then(|layers| layers.set("env.n_shards=3"))
        .and_then(|layers| layers.set("task.episode_steps=2"))
        .and_then(|layers| layers.set("network.hidden=[8]"))
        .and_then(|layers| layers.set("algorithm.mini_batches=1"))
        .and_then(|layers| layers.resolve())
        .expect("valid");
    World::new(&config, &Robot::builtin("paper").expect("built in"))
}

/// Waits for `receive` to give something.
fn wait_for<T>(mut receive: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(value) = receive() {
            return value;
        }
        assert!(start.elapsed() < PATIENCE, "nothing came within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The next status that is no heartbeat.
fn next_status(receiver: &MessageReceiver<Status>) -> Status {
    wait_for(|| match receiver.try_receive().expect("receive") {
        Some(Status::Heartbeat { .. }) => None,
        other => other,
    })
}

fn arguments(domain: &Domain) -> Arguments {
    Arguments {
        run_dir: PathBuf::new(),
        worker: 2,
        incarnation: 1,
        domain: domain.as_str().to_owned(),
        parent: None,
        pin: None,
    }
}

#[test]
fn a_worker_makes_what_is_ordered_and_nothing_else() {
    let world = world();
    let domain = TestDomain(Domain::fresh());
    let sizes = ChannelSizes::new(&world.config, &world.dimensions);
    let channels = Channels::create(&domain.0, sizes).expect("create");
    let orders = channels.order_sender().expect("orders");
    let status = channels.status_receiver().expect("status");
    let blocks = channels.block_receiver().expect("blocks");
    let policies = channels.policy_sender().expect("policies");
    let flat = parameters(&world.config, &world.dimensions, 5);

    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let mut worker = Worker::connect(&arguments(&domain.0), &world).expect("connect");
            serve(&mut worker)
        });
        assert!(matches!(next_status(&status), Status::Ready { worker: 2, incarnation: 1, .. }));
        let order = |worker, incarnation, shards: &[u32]| Order::Rollout {
            worker,
            incarnation,
            iteration: 4,
            policy_version: 3,
            shards: shards.to_vec(),
        };
        // For others: another worker, a predecessor. For this one: before its policy is there.
        orders.send(&order(1, 1, &[0])).expect("send");
        orders.send(&order(2, 0, &[0])).expect("send");
        orders.send(&order(2, 1, &[2, 1])).expect("send");
        orders.send(&order(2, 1, &[1])).expect("a re-sent order");
        for version in [2, 3] {
            let mut sample = policies.loan().expect("loan");
            sample.payload_mut().copy_from_slice(&flat);
            *sample.header_mut() = PolicyHeader { version };
            policies.send(sample).expect("send");
        }
        let policy = world.policy(&flat).expect("a policy");
        for shard in [2, 1] {
            let block: ArraySample<BlockHeader> =
                wait_for(|| blocks.try_receive().expect("receive"));
            let header = *block.header();
            assert_eq!(
                (header.iteration, header.policy_version, header.shard, header.worker),
                (4, 3, shard, 2)
            );
            assert_eq!((header.incarnation, header.n_envs, header.n_steps), (1, 2, 2));
            let spec =
                RolloutSpec { seed: world.config.run.seed, iteration: 4, shard, policy: &policy };
            let mut expected = vec![0.0; world.block_layout().len];
            rollout(&world, &spec, &mut expected, &mut |_| {}).expect("a block");
            assert!(block.payload() == expected, "a block is a pure function of its order");
            assert!(matches!(
                next_status(&status),
                Status::BlockDone { worker: 2, incarnation: 1, iteration: 4, shard: done,
                    env_steps: 4, .. } if done == shard
            ));
        }
        // A shard that does not exist: said, and survived.
        orders.send(&order(2, 1, &[9])).expect("send");
        let Status::Failed { message, .. } = next_status(&status) else { panic!("not refused") };
        assert!(message.contains("shard 9"), "{message}");
        // A policy that is none is the end: orders for it would wait for ever.
        let mut sample = policies.loan().expect("loan");
        sample.payload_mut().fill(f32::NAN);
        *sample.header_mut() = PolicyHeader { version: 4 };
        policies.send(sample).expect("send");
        let Status::Failed { message, .. } = next_status(&status) else { panic!("not refused") };
        assert!(message.contains("policy version 4"), "{message}");
        let error = worker.join().expect("no panic").expect_err("an end");
        assert!(error.message.contains("policy version 4"), "{error}");
    });
    assert!(blocks.try_receive().expect("receive").is_none(), "nothing was made twice");
}

/// A coordinator that stands still while its workers come up never hears that they are ready: their first
/// word is pushed out of its queue by those that follow.
#[test]
fn every_sign_of_life_says_where_orders_are_taken() {
    let world = world();
    let domain = TestDomain(Domain::fresh());
    let sizes = ChannelSizes::new(&world.config, &world.dimensions);
    let channels = Channels::create(&domain.0, sizes).expect("create");
    let orders = channels.order_sender().expect("orders");
    let status = channels.status_receiver().expect("status");
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let mut worker = Worker::connect(&arguments(&domain.0), &world).expect("connect");
            serve(&mut worker)
        });
        let first = wait_for(|| status.try_receive().expect("receive"));
        let Status::Ready { orders: port, .. } = first else { panic!("{first:?}") };
        let next = wait_for(|| status.try_receive().expect("receive"));
        assert_eq!(next, Status::Heartbeat { worker: 2, incarnation: 1, orders: port });
        orders.send(&Order::Stop(RunEnd::Over)).expect("send");
        worker.join().expect("no panic").expect("a clean end");
    });
}

#[test]
fn a_worker_without_a_run_says_what_is_missing() {
    let error = load(&RunDir::new("no/such/run")).expect_err("no such run");
    assert_eq!(error.code, ExitCode::RunDirectory);
    assert!(error.message.contains("no/such/run/config.toml"), "{error}");
    let domain = TestDomain(Domain::fresh());
    let error = Worker::connect(&arguments(&domain.0), &world()).err().expect("no services");
    assert_eq!(error.code, ExitCode::Environment);
}
