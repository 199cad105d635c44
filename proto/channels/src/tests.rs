use proto::agents::Joints;
use std::fs::{Metadata, Permissions};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use proto::config::{Layers, Preset};
use proto::layout::{BlockHeader, Dimensions, PolicyHeader, SnapshotHeader};
use proto::message::{Order, Progress, RunEnd, Status};

use crate::*;

/// A domain that leaves nothing, also when a test fails.
struct TestDomain(Domain);

impl TestDomain {
    fn new() -> Self {
        Self(Domain::fresh())
    }
}

impl Drop for TestDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_leftovers();
    }
}

const SIZES: ChannelSizes = ChannelSizes {
    max_workers: 4,
    block_len: 1000,
    policy_len: 100,
    order_buffer: 64,
    block_buffer: 2,
    block_borrowed: 4,
};
const DEADLINE: Duration = Duration::from_millis(100);

#[test]
fn orders_reach_every_receiver_and_ring_the_bell() {
    let domain = TestDomain::new();
    let coordinator = Channels::create(&domain.0, SIZES).expect("create");
    let worker = Channels::open(&domain.0, SIZES).expect("open");
    let orders = coordinator.order_sender().expect("sender");
    let receivers = [worker.order_receiver().expect("a"), worker.order_receiver().expect("b")];
    let bell = worker.listener(Role::Workers).expect("listener");
    orders.send(&Order::Stop(RunEnd::Over)).expect("send");
    bell.wait(Duration::from_secs(5));
    for receiver in &receivers {
        assert_eq!(receiver.try_receive().expect("receive"), Some(Order::Stop(RunEnd::Over)));
        assert_eq!(receiver.try_receive().expect("receive"), None);
    }
}

#[test]
fn an_order_that_a_full_receiver_misses_names_that_receiver() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let orders = channels.order_sender().expect("sender");
    let [quick, slow] = [(); 2].map(|()| channels.order_receiver().expect("receiver"));
    for _ in 0..SIZES.order_buffer {
        assert!(orders.send(&Order::Snapshot).expect("send").is_nobody());
        assert_eq!(quick.try_receive().expect("receive"), Some(Order::Snapshot));
    }
    assert_eq!(
        orders.send(&Order::Stop(RunEnd::Over)).expect("send"),
        Missed::By(vec![slow.port()])
    );
    assert_eq!(quick.try_receive().expect("receive"), Some(Order::Stop(RunEnd::Over)));
    assert_eq!(slow.try_receive().expect("receive"), Some(Order::Snapshot));
    assert!(
        orders.send(&Order::Stop(RunEnd::Over)).expect("send").is_nobody(),
        "there is room again"
    );
}

#[test]
fn an_order_without_a_slot_is_missed_by_all_until_somebody_reads() {
    let domain = TestDomain::new();
    let sizes = ChannelSizes { max_workers: 40, order_buffer: 4, ..SIZES };
    let channels = Channels::create(&domain.0, sizes).expect("create");
    let orders = channels.order_sender().expect("sender");
    let quick = channels.order_receiver().expect("receiver");
    // Each stands still when the queue of the one before is full: no two hold the same.
    let mut still = Vec::new();
    let mut sent = 0;
    let missed = loop {
        if sent % sizes.order_buffer == 0 {
            still.push(channels.order_receiver().expect("receiver"));
        }
        let missed = orders.send(&Order::Snapshot).expect("no error");
        if missed == Missed::ByAll {
            break missed;
        }
        assert!(!missed.includes(quick.port()), "after {sent}");
        assert_eq!(quick.try_receive().expect("receive"), Some(Order::Snapshot));
        sent += 1;
        assert!(sent < 40 * sizes.order_buffer, "no end");
    };
    assert!(missed.includes(quick.port()) && !missed.is_nobody());
    assert!(sent >= 16 * sizes.order_buffer, "{sent}");
    let awake = still.remove(0);
    while awake.try_receive().expect("receive").is_some() {}
    let missed = orders.send(&Order::Stop(RunEnd::Over)).expect("no error");
    assert!(!missed.includes(quick.port()) && !missed.includes(awake.port()));
    assert_eq!(quick.try_receive().expect("receive"), Some(Order::Stop(RunEnd::Over)));
}

#[test]
fn every_worker_of_a_run_can_be_sent_its_fill_at_once() {
    for workers in [1, 8, 33, 256] {
        let workers_set = format!("run.workers={workers}");
        let layers = Layers::new(Preset::Tuned, None).set(&workers_set).expect("a key");
        let config = layers.resolve().expect("valid");
        let sizes = ChannelSizes::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)));
        assert!(sizes.max_workers >= 2 * workers, "{sizes:?}");
        assert!(sizes.order_buffer >= ORDERS_PER_WORKER * sizes.max_workers, "{sizes:?}");
        // All else is of one worker each.
        let [.., (name, messages)] = sizes.shared_memory(workers);
        let bound = (12 << 20) + (640 << 10) * workers as u64;
        assert!(messages <= bound, "{name} of {workers} workers take {messages} bytes");
    }
}

#[test]
fn orders_of_many_workers_take_what_was_reckoned_with() {
    let domain = TestDomain::new();
    let sizes = ChannelSizes { max_workers: 512, order_buffer: 1024, ..SIZES };
    let channels = Channels::create(&domain.0, sizes).expect("create");
    let before = domain.0.size();
    let orders = channels.order_sender().expect("sender");
    let receivers: Vec<_> =
        (0..257).map(|_| channels.order_receiver().expect("receiver")).collect();
    orders.send(&Order::Stop(RunEnd::Over)).expect("send");
    for receiver in &receivers {
        assert_eq!(receiver.try_receive().expect("receive"), Some(Order::Stop(RunEnd::Over)));
    }
    let taken = domain.0.size() - before;
    assert!(taken < 24 << 20, "{taken} bytes");
}

#[test]
fn who_reports_waits_for_a_coordinator_that_stands_still() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let receiver = channels.progress_receiver().expect("receiver");
    let digest = proto::Digest([9; 16]);
    let (iteration, shard, worker, incarnation, duplicate) = (9, 9, 9, 9, false);
    let last = Progress::BlockReceived { iteration, shard, worker, incarnation, duplicate, digest };
    let first_heard = std::sync::Barrier::new(2);
    std::thread::scope(|scope| {
        let learner = scope.spawn(|| {
            let learner = Channels::open(&domain.0, SIZES).expect("open");
            let sender = learner.progress_sender(WHILE_THE_PARENT_LIVES).expect("sender");
            sender.send(&Progress::Heartbeat).expect("waits");
            first_heard.wait();
            // Twice as many as there is room for.
            for _ in 1..128 {
                sender.send(&Progress::Heartbeat).expect("waits");
            }
            sender.send(&last).expect("waits");
            // Messages live in the sender's memory: it stays until the receiver has them.
            std::thread::sleep(DEADLINE);
        });
        // Nobody waits for a receiver that has not yet taken anything from this sender: to iceoryx2 it is not there.
        let mut heard = Vec::new();
        while heard.is_empty() {
            heard.extend(receiver.try_receive().expect("receive"));
        }
        first_heard.wait();
        std::thread::sleep(3 * DEADLINE);
        assert!(!learner.is_finished(), "there is no room");
        while heard.last() != Some(&last) {
            match receiver.try_receive().expect("receive") {
                Some(message) => heard.push(message),
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
        assert_eq!(heard.len(), 129, "nothing is lost");
    });
}

#[test]
fn a_block_is_written_and_read_in_the_same_memory() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.block_sender(DEADLINE).expect("sender");
    let receiver = channels.block_receiver().expect("receiver");
    let mut block = sender.loan().expect("loan");
    assert_eq!(block.payload_mut().as_ptr() as usize % 64, 0, "aligned for vector loads");
    block.payload_mut()[999] = 42.0;
    *block.header_mut() = BlockHeader { iteration: 3, shard: 1, ..BlockHeader::default() };
    assert_eq!(sender.send(block).expect("send"), 1);
    let block = receiver.try_receive().expect("receive").expect("one block");
    assert_eq!((block.header().iteration, block.header().shard), (3, 1));
    assert_eq!((block.payload().len(), block.payload()[999]), (1000, 42.0));
}

#[test]
fn a_full_learner_makes_the_worker_wait_and_then_fail() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.block_sender(DEADLINE).expect("sender");
    let _receiver = channels.block_receiver().expect("receiver");
    for _ in 0..SIZES.block_buffer {
        sender.send(sender.loan().expect("loan")).expect("there is room");
    }
    let error = sender.send(sender.loan().expect("loan")).expect_err("the queue is full");
    assert!(error.to_string().contains("not delivered within 100 ms"), "{error}");
}

#[test]
fn the_learner_can_hold_two_iterations_of_one_worker() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.block_sender(DEADLINE).expect("sender");
    let receiver = channels.block_receiver().expect("receiver");
    let mut held = Vec::new();
    for index in 0..SIZES.block_borrowed {
        let mut block = sender.loan().expect("loan");
        block.payload_mut()[0] = index as f32;
        sender.send(block).expect("send");
        held.push(receiver.try_receive().expect("receive").expect("a block"));
    }
    let values: Vec<f32> = held.iter().map(|block| block.payload()[0]).collect();
    assert_eq!(values, [0.0, 1.0, 2.0, 3.0]);
}

#[test]
fn a_late_worker_gets_the_newest_policies() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.policy_sender().expect("sender");
    for version in 0..5 {
        let mut policy = sender.loan().expect("loan");
        *policy.header_mut() = PolicyHeader { version };
        sender.send(policy).expect("send");
    }
    let receiver = channels.policy_receiver().expect("receiver");
    sender.update_connections();
    let mut versions = Vec::new();
    while let Some(policy) = receiver.try_receive().expect("receive") {
        versions.push(policy.header().version);
    }
    assert_eq!(versions, [3, 4]);
}

#[test]
fn policies_go_on_while_every_receiver_holds_what_it_may() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.policy_sender().expect("sender");
    let send = |version| {
        let mut policy = sender.loan().expect("a slot is free");
        policy.payload_mut()[0] = version as f32;
        *policy.header_mut() = PolicyHeader { version };
        sender.send(policy).expect("send");
    };
    let workers: Vec<_> =
        (0..SIZES.max_workers).map(|_| channels.policy_receiver().expect("receiver")).collect();
    let coordinator = channels.policy_receiver().expect("receiver");
    let mut held = Vec::new();
    // Each worker stands still in the middle of another policy.
    for (version, worker) in workers.iter().enumerate() {
        send(version as u64);
        while let Some(policy) = worker.try_receive().expect("receive") {
            held.retain(|(holder, _)| *holder != version);
            held.push((version, policy));
        }
    }
    let first = SIZES.max_workers as u64;
    let kept: Vec<_> = (first..first + 3)
        .map(|version| {
            send(version);
            let mut newest = None;
            while let Some(policy) = coordinator.try_receive().expect("receive") {
                newest = Some(policy);
            }
            newest.expect("a policy")
        })
        .collect();
    for version in first + 3..first + 50 {
        send(version);
    }
    for (version, policy) in &held {
        assert_eq!(policy.payload()[0], *version as f32, "nobody writes over what is held");
    }
    for (version, policy) in (first..).zip(&kept) {
        assert_eq!(policy.payload()[0], version as f32, "nobody writes over what is held");
    }
    // Who was asleep finds the newest two.
    for worker in &workers {
        let mut versions = Vec::new();
        while let Some(policy) = worker.try_receive().expect("receive") {
            versions.push(policy.header().version);
        }
        assert_eq!(versions, [first + 48, first + 49]);
    }
}

#[test]
fn a_run_takes_no_more_than_its_budget() {
    let domain = TestDomain::new();
    let n_workers = SIZES.max_workers;
    let coordinator = Channels::create(&domain.0, SIZES).expect("create");
    let orders = coordinator.order_sender().expect("port");
    let _heard = (
        coordinator.progress_receiver().expect("port"),
        coordinator.status_receiver().expect("port"),
        coordinator.snapshot_receiver().expect("port"),
        coordinator.policy_receiver().expect("port"),
        coordinator.listener(Role::Coordinator).expect("port"),
    );
    let learner = Channels::open(&domain.0, SIZES).expect("open");
    let (policy, blocks) = (learner.policy_sender(), learner.block_receiver());
    let (policy, blocks) = (policy.expect("port"), blocks.expect("port"));
    let _said = (
        learner.progress_sender(DEADLINE).expect("port"),
        learner.snapshot_sender(DEADLINE).expect("port"),
        learner.order_receiver().expect("port"),
        learner.listener(Role::Learner).expect("port"),
    );
    let workers: Vec<_> =
        (0..n_workers).map(|_| Channels::open(&domain.0, SIZES).expect("open")).collect();
    let ports: Vec<_> = workers
        .iter()
        .map(|worker| {
            let blocks = worker.block_sender(DEADLINE).expect("port");
            let policies = worker.policy_receiver().expect("port");
            let orders = worker.order_receiver().expect("port");
            let status = worker.status_sender().expect("port");
            (blocks, policies, orders, status, worker.listener(Role::Workers).expect("port"))
        })
        .collect();
    // All that can connect is connected.
    policy.update_connections();
    orders.send(&Order::Stop(RunEnd::Over)).expect("send");
    for (block, policies, orders, status, _) in &ports {
        block.update_connections();
        policies.try_receive().expect("receive");
        orders.try_receive().expect("receive");
        status.send(&Status::Heartbeat { worker: 0, incarnation: 0, orders: 0 }).expect("send");
    }
    blocks.try_receive().expect("receive");

    let budget: u64 = SIZES.shared_memory(n_workers).iter().map(|(_, bytes)| bytes).sum();
    let taken = domain.0.size();
    let mut files = files(&domain.0.root());
    files.sort_by_key(|(_, metadata)| std::cmp::Reverse(metadata.blocks()));
    let largest: Vec<_> = files
        .iter()
        .take(10)
        .map(|(path, metadata)| format!("{} {}", path.display(), metadata.blocks() * 512))
        .collect();
    assert!(taken <= budget, "{taken} bytes are taken, {budget} were reckoned with: {largest:#?}");
    // Nobody is kept away from a run by a budget that is far too large.
    assert!(3 * taken > budget, "{taken} bytes are taken, {budget} were reckoned with");
}

#[test]
fn a_snapshot_larger_than_the_queue_arrives_whole() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let receiver = channels.snapshot_receiver().expect("receiver");
    let bytes: Vec<u8> = (0..7 * PIECE_LEN + 123).map(|index| (index % 251) as u8).collect();
    let expected = bytes.clone();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let learner = Channels::open(&domain.0, SIZES).expect("open");
            let sender = learner.snapshot_sender(Duration::from_millis(1)).expect("sender");
            let mut header = SnapshotHeader { iteration: 9, ..SnapshotHeader::default() };
            while (header.offset as usize) < bytes.len() {
                header.offset = sender.send(header, &bytes).expect("send");
            }
            // Pieces live in the sender's memory: it stays until the receiver has them.
            std::thread::sleep(Duration::from_millis(300));
        });
        let mut received = Vec::new();
        while received.len() < expected.len() {
            match receiver.try_receive().expect("receive") {
                Some(piece) => {
                    assert_eq!(piece.header().offset, received.len() as u64);
                    assert_eq!(piece.header().total, expected.len() as u64);
                    received.extend_from_slice(piece.payload());
                }
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
        assert!(received == expected, "the bytes differ");
    });
}

#[test]
fn status_of_a_crowd_overflows_instead_of_blocking() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.status_sender().expect("sender");
    let receiver = channels.status_receiver().expect("receiver");
    for worker in 0..200 {
        sender
            .send(&Status::Heartbeat { worker, incarnation: 0, orders: 0 })
            .expect("never blocks");
    }
    let mut last = None;
    while let Some(status) = receiver.try_receive().expect("receive") {
        last = Some(status);
    }
    assert_eq!(last, Some(Status::Heartbeat { worker: 199, incarnation: 0, orders: 0 }));
}

/// All files of a domain, with what the system knows about them.
fn files(directory: &Path) -> Vec<(PathBuf, Metadata)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).expect("readable") {
        let path = entry.expect("an entry").path();
        let metadata = path.symlink_metadata().expect("there");
        if metadata.is_dir() {
            found.extend(files(&path));
        } else {
            found.push((path, metadata));
        }
    }
    found
}

#[test]
fn every_file_is_its_owners_alone_and_has_all_its_pages() {
    let domain = TestDomain::new();
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    let sender = channels.block_sender(DEADLINE).expect("sender");
    let receiver = channels.block_receiver().expect("receiver");
    let _bell = channels.listener(Role::Learner).expect("listener");
    sender.send(sender.loan().expect("loan")).expect("send");
    assert!(receiver.try_receive().expect("receive").is_some(), "connected");

    let root = domain.0.root();
    let mode = |metadata: &Metadata| metadata.mode() & 0o777;
    assert_eq!(mode(&root.metadata().expect("there")), 0o700, "nobody else looks into it");
    let files = files(&root);
    assert!(files.len() > 20, "services, segments, connections, sockets, locks: {files:#?}");
    for (path, metadata) in &files {
        assert_eq!(mode(metadata) & 0o077, 0, "{}: {:o}", path.display(), mode(metadata));
        assert!(metadata.blocks() * 512 >= metadata.len(), "{} has holes", path.display());
    }
    let sizes: u64 = files.iter().map(|(_, metadata)| metadata.blocks() * 512).sum();
    assert_eq!(domain.0.size(), sizes);
}

#[test]
fn a_segment_that_does_not_fit_is_an_error_that_says_so() {
    let domain = TestDomain::new();
    let sizes = ChannelSizes { block_len: 1 << 40, ..SIZES };
    let channels = Channels::create(&domain.0, sizes).expect("create");
    let error = channels.block_sender(DEADLINE).expect_err("more than any machine has");
    let error = error.to_string();
    for part in ["shared memory is full: channel `rollouts` needs", " GiB", "octopus clean"] {
        assert!(error.contains(part), "{error}");
    }
    // What failed is over: the next error has its own reason.
    channels.status_sender().expect("there is room for this");
}

#[test]
fn a_directory_that_others_can_look_into_is_refused() {
    let domain = TestDomain::new();
    std::fs::create_dir(domain.0.root()).expect("mkdir");
    std::fs::set_permissions(domain.0.root(), Permissions::from_mode(0o755)).expect("chmod");
    for refused in [Channels::create(&domain.0, SIZES), Channels::open(&domain.0, SIZES)] {
        let error = refused.expect_err("not private").to_string();
        assert!(error.contains("mode 700") && error.contains("mode 755"), "{error}");
    }
}

#[test]
fn nothing_is_left_behind() {
    let domain = TestDomain::new();
    {
        let channels = Channels::create(&domain.0, SIZES).expect("create");
        let _sender = channels.block_sender(DEADLINE).expect("sender");
        assert!(Domain::list().expect("list").contains(&domain.0), "a live domain is seen");
    }
    domain.0.remove_leftovers().expect("remove");
    assert!(!Domain::list().expect("list").contains(&domain.0));
}

#[test]
fn opening_what_nobody_made_says_so() {
    let domain = TestDomain::new();
    let error = Channels::open(&domain.0, SIZES).expect_err("nobody created it").to_string();
    assert!(error.contains("same build"), "{error}");
    assert!(Domain::parse("octopus-0-../../etc").is_err());
    assert_eq!(Domain::parse(domain.0.as_str()).expect("own name"), domain.0);
}

/// `octopus clean` in another container saw no process of a run, and removed its memory.
#[test]
fn a_domain_is_held_as_long_as_its_coordinator_lives() {
    let domain = TestDomain::new();
    assert!(!domain.0.is_held());
    let channels = Channels::create(&domain.0, SIZES).expect("create");
    assert!(domain.0.is_held());
    drop(channels);
    assert!(!domain.0.is_held());
}

/// A run that began just then was never held.
#[test]
fn a_domain_is_held_also_where_somebody_looked_when_it_was_made() {
    let domain = TestDomain::new();
    domain.0.make_root().expect("made");
    let look = std::fs::File::create(domain.0.root().join("held")).expect("made");
    look.lock_shared().expect("free");
    let looker = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(20));
        drop(look);
    });
    let _channels = Channels::create(&domain.0, SIZES).expect("create");
    looker.join().expect("no panic");
    assert!(domain.0.is_held());
}
