//! The services of a run and the ports of each process.

use std::fmt::Debug;
use std::marker::PhantomData;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{BackpressureAction, BackpressureFn, BackpressureInfo, SendError};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use serde::{Deserialize, Serialize};

use super::line::Line;
use super::sizes::{
    MESSAGE_BUFFER, ORDER_LEN, PIECE_BUFFER, POLICY_BORROWED, POLICY_BUFFER, PROGRESS_LEN,
    STATUS_LEN,
};
use super::transport::Private as Ipc;
use super::{ChannelSizes, Domain, PIECE_LEN, SHARED_MEMORY, segment};
use crate::ChannelError;
use crate::layout::{BlockHeader, PolicyHeader, SnapshotHeader, layout_hash};
use crate::message::{self, Order, PortId, Progress, Status};

type Bytes<H> = publish_subscribe::PortFactory<Ipc, [u8], H>;
type Floats<H> = publish_subscribe::PortFactory<Ipc, [Line], H>;

/// The deadline of who gives up for nobody but the kernel, see [`die_with_parent`](crate::child::die_with_parent).
pub const WHILE_THE_PARENT_LIVES: Duration = Duration::MAX;

/// Who can be woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The coordinator.
    Coordinator,
    /// The learner.
    Learner,
    /// All workers.
    Workers,
}

impl Role {
    fn service(self) -> &'static str {
        match self {
            Self::Coordinator => "wake/coordinator",
            Self::Learner => "wake/learner",
            Self::Workers => "wake/workers",
        }
    }
}

/// All services of a run, as one process sees them.
#[derive(Debug)]
pub struct Channels {
    orders: Bytes<()>,
    progress: Bytes<()>,
    status: Bytes<()>,
    policy: Floats<PolicyHeader>,
    rollouts: Floats<BlockHeader>,
    snapshot: Bytes<SnapshotHeader>,
    wake_coordinator: event::PortFactory<Ipc>,
    wake_learner: event::PortFactory<Ipc>,
    wake_workers: event::PortFactory<Ipc>,
    sizes: ChannelSizes,
    // Dropped last: services must not outlive their node.
    node: Node<Ipc>,
}

/// Whether services are made or found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Access {
    Create,
    Open,
}

/// A publish-subscribe service's limits.
#[derive(Clone, Copy)]
struct Limits {
    publishers: usize,
    subscribers: usize,
    buffer: usize,
    borrowed: usize,
    history: usize,
    overflow: bool,
}

impl Channels {
    /// Creates every service of a run: the coordinator's part.
    pub fn create(domain: &Domain, sizes: ChannelSizes) -> Result<Self, ChannelError> {
        Self::new(domain, sizes, Access::Create)
    }

    /// Opens the services that the coordinator made.
    pub fn open(domain: &Domain, sizes: ChannelSizes) -> Result<Self, ChannelError> {
        Self::new(domain, sizes, Access::Open)
    }

    fn new(domain: &Domain, sizes: ChannelSizes, access: Access) -> Result<Self, ChannelError> {
        set_log_level(LogLevel::Fatal);
        match access {
            Access::Create => domain.make_root()?,
            Access::Open => domain.check_root()?,
        }
        let node = NodeBuilder::new()
            .config(&domain.config(access == Access::Create))
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| open_error(domain.as_str(), &error))?;
        let max_workers = sizes.max_workers;
        // The coordinator, the learner and its replacement beside the workers.
        let max_nodes = max_workers + 4;
        let messages = Limits {
            publishers: 2,
            subscribers: 2,
            buffer: MESSAGE_BUFFER,
            borrowed: 1,
            history: 0,
            overflow: false,
        };

        macro_rules! service {
            ($name:expr, $payload:ty, $header:ty, $limits:expr) => {{
                let limits: Limits = $limits;
                let builder = node
                    .service_builder(&service_name($name)?)
                    .publish_subscribe::<[$payload]>()
                    .user_header::<$header>()
                    .max_publishers(limits.publishers)
                    .max_subscribers(limits.subscribers)
                    .max_nodes(max_nodes)
                    .subscriber_max_buffer_size(limits.buffer)
                    .subscriber_max_borrowed_samples(limits.borrowed)
                    .history_size(limits.history)
                    .enable_safe_overflow(limits.overflow);
                match access {
                    Access::Create => builder.create().map_err(|e| open_error($name, &e))?,
                    Access::Open => builder.open().map_err(|e| open_error($name, &e))?,
                }
            }};
        }
        let wake = |role: Role| {
            let builder = node
                .service_builder(&service_name(role.service())?)
                .event()
                .max_listeners(max_nodes)
                .max_notifiers(2 * max_nodes)
                .max_nodes(max_nodes);
            match access {
                Access::Create => builder.create().map_err(|e| open_error(role.service(), &e)),
                Access::Open => builder.open().map_err(|e| open_error(role.service(), &e)),
            }
        };

        Ok(Self {
            orders: service!(
                "orders",
                u8,
                (),
                Limits { subscribers: max_workers + 2, buffer: sizes.order_buffer, ..messages }
            ),
            progress: service!("progress", u8, (), messages),
            status: service!(
                "status",
                u8,
                (),
                Limits { publishers: max_workers, overflow: true, ..messages }
            ),
            policy: service!(
                "policy",
                Line,
                PolicyHeader,
                Limits {
                    publishers: 2,
                    // The coordinator, too: it keeps the policy of a block that cannot be made.
                    subscribers: max_workers + 1,
                    buffer: POLICY_BUFFER,
                    borrowed: POLICY_BORROWED,
                    history: POLICY_BUFFER,
                    overflow: true,
                }
            ),
            rollouts: service!(
                "rollouts",
                Line,
                BlockHeader,
                Limits {
                    publishers: max_workers,
                    subscribers: 1,
                    buffer: sizes.block_buffer,
                    borrowed: sizes.block_borrowed,
                    history: 0,
                    overflow: false,
                }
            ),
            snapshot: service!(
                "snapshot",
                u8,
                SnapshotHeader,
                Limits {
                    publishers: 2,
                    subscribers: 1,
                    buffer: PIECE_BUFFER,
                    borrowed: 1,
                    history: 0,
                    overflow: false,
                }
            ),
            wake_coordinator: wake(Role::Coordinator)?,
            wake_learner: wake(Role::Learner)?,
            wake_workers: wake(Role::Workers)?,
            sizes,
            node,
        })
    }

    /// The fixed sizes.
    pub fn sizes(&self) -> &ChannelSizes {
        &self.sizes
    }

    /// Frees what processes that died without a goodbye still hold. The coordinator calls it after
    /// it has reaped a child; a zombie still looks alive.
    pub fn clean_up_after_the_dead(&self) {
        let _ = self.node.blocking_cleanup_dead_nodes(Duration::from_millis(500));
    }

    /// A bell at the door of `role`.
    pub fn bell(&self, role: Role) -> Result<Bell, ChannelError> {
        let notifier = self.wake(role).notifier_builder().create();
        Ok(Bell(notifier.map_err(|e| port_error(role.service(), "notifier", &e))?))
    }

    /// Hears the bell of `role`.
    pub fn listener(&self, role: Role) -> Result<BellListener, ChannelError> {
        let listener = self.wake(role).listener_builder().create();
        Ok(BellListener(listener.map_err(|e| port_error(role.service(), "listener", &e))?))
    }

    fn wake(&self, role: Role) -> &event::PortFactory<Ipc> {
        match role {
            Role::Coordinator => &self.wake_coordinator,
            Role::Learner => &self.wake_learner,
            Role::Workers => &self.wake_workers,
        }
    }

    /// The coordinator's end of `orders`. A full receiver misses an order, and is named.
    pub fn order_sender(&self) -> Result<OrderSender, ChannelError> {
        let bells = vec![self.bell(Role::Workers)?, self.bell(Role::Learner)?];
        let missed = Arc::default();
        let handler = note_the_full(Arc::clone(&missed));
        let deadline = Duration::ZERO;
        let sender =
            MessageSender::new(&self.orders, "orders", bells, ORDER_LEN, deadline, handler)?;
        Ok(OrderSender { sender, missed })
    }

    /// A worker's or the learner's end of `orders`.
    pub fn order_receiver(&self) -> Result<MessageReceiver<Order>, ChannelError> {
        MessageReceiver::new(&self.orders, "orders")
    }

    /// The learner's end of `progress`.
    pub fn progress_sender(
        &self,
        deadline: Duration,
    ) -> Result<MessageSender<Progress>, ChannelError> {
        let bells = vec![self.bell(Role::Coordinator)?];
        let handler = give_up_after(deadline);
        MessageSender::new(&self.progress, "progress", bells, PROGRESS_LEN, deadline, handler)
    }

    /// The coordinator's end of `progress`.
    pub fn progress_receiver(&self) -> Result<MessageReceiver<Progress>, ChannelError> {
        MessageReceiver::new(&self.progress, "progress")
    }

    /// A worker's end of `status`.
    pub fn status_sender(&self) -> Result<MessageSender<Status>, ChannelError> {
        let bells = vec![self.bell(Role::Coordinator)?];
        let deadline = Duration::ZERO;
        let handler = give_up_after(deadline);
        MessageSender::new(&self.status, "status", bells, STATUS_LEN, deadline, handler)
    }

    /// The coordinator's end of `status`.
    pub fn status_receiver(&self) -> Result<MessageReceiver<Status>, ChannelError> {
        MessageReceiver::new(&self.status, "status")
    }

    /// The learner's end of `policy`.
    pub fn policy_sender(&self) -> Result<ArraySender<PolicyHeader>, ChannelError> {
        let bell = self.bell(Role::Workers)?;
        let (len, slots) = (self.sizes.policy_len, self.sizes.policy_slots());
        ArraySender::new(&self.policy, "policy", bell, len, slots, Duration::ZERO)
    }

    /// A worker's or the coordinator's end of `policy`.
    pub fn policy_receiver(&self) -> Result<ArrayReceiver<PolicyHeader>, ChannelError> {
        ArrayReceiver::new(&self.policy, "policy", self.sizes.policy_len)
    }

    /// A worker's end of `rollouts`.
    pub fn block_sender(
        &self,
        deadline: Duration,
    ) -> Result<ArraySender<BlockHeader>, ChannelError> {
        let bell = self.bell(Role::Learner)?;
        let len = self.sizes.block_len;
        ArraySender::new(&self.rollouts, "rollouts", bell, len, usize::MAX, deadline)
    }

    /// The learner's end of `rollouts`.
    pub fn block_receiver(&self) -> Result<ArrayReceiver<BlockHeader>, ChannelError> {
        ArrayReceiver::new(&self.rollouts, "rollouts", self.sizes.block_len)
    }

    /// The learner's end of `snapshot`; a piece waits for room no longer than `deadline`.
    pub fn snapshot_sender(&self, deadline: Duration) -> Result<PieceSender, ChannelError> {
        let bell = self.bell(Role::Coordinator)?;
        let publisher = self
            .snapshot
            .publisher_builder()
            .initial_max_slice_len(PIECE_LEN)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
            .set_backpressure_handler(give_up_after(deadline))
            .create()
            .map_err(|e| port_error("snapshot", "publisher", &e))?;
        Ok(PieceSender { publisher, bell })
    }

    /// The coordinator's end of `snapshot`.
    pub fn snapshot_receiver(&self) -> Result<PieceReceiver, ChannelError> {
        let subscriber = self.snapshot.subscriber_builder().create();
        Ok(PieceReceiver(subscriber.map_err(|e| port_error("snapshot", "subscriber", &e))?))
    }
}

/// Wakes the processes of a role.
#[derive(Debug)]
pub struct Bell(Notifier<Ipc>);

impl Bell {
    /// Rings. That nobody listens yet is no error: a receiver looks into its queue before it waits.
    pub fn ring(&self) {
        let _ = self.0.notify();
    }
}

/// Waits for a bell.
#[derive(Debug)]
pub struct BellListener(Listener<Ipc>);

impl BellListener {
    /// Waits until the bell rings or `timeout` is over. One ring may stand for many messages, so
    /// drain all queues afterwards.
    pub fn wait(&self, timeout: Duration) {
        if self.0.timed_wait(|_| {}, timeout).is_err() {
            // A broken listener must not turn its owner's loop into a busy one.
            std::thread::sleep(timeout.min(Duration::from_millis(10)));
        }
    }
}

/// Sends control messages.
#[derive(Debug)]
pub struct MessageSender<M> {
    publisher: Publisher<Ipc, [u8], ()>,
    service: &'static str,
    bells: Vec<Bell>,
    deadline: Duration,
    message: PhantomData<fn(M)>,
}

impl<M: Serialize> MessageSender<M> {
    fn new(
        factory: &Bytes<()>,
        service: &'static str,
        bells: Vec<Bell>,
        max_len: usize,
        deadline: Duration,
        when_full: impl BackpressureFn + 'static,
    ) -> Result<Self, ChannelError> {
        let publisher = factory
            .publisher_builder()
            .initial_max_slice_len(max_len)
            .max_loaned_samples(1)
            .backpressure_strategy(strategy(deadline))
            .set_backpressure_handler(when_full)
            .create()
            .map_err(|error| port_error(service, "publisher", &error))?;
        Ok(Self { publisher, service, bells, deadline, message: PhantomData })
    }

    /// Sends `message` and wakes the receivers.
    pub fn send(&self, message: &M) -> Result<(), ChannelError> {
        let bytes = message::encode(message);
        let sample = self
            .publisher
            .loan_slice_uninit(bytes.len())
            .map_err(|error| transfer_error(self.service, "loan", &error))?
            .write_from_slice(&bytes);
        sample.send().map_err(|error| send_error(self.service, self.deadline, error))?;
        self.bells.iter().for_each(Bell::ring);
        check_connections(self.service)
    }
}

/// Sends orders to all workers and the learner, and waits for none of them.
#[derive(Debug)]
pub struct OrderSender {
    sender: MessageSender<Order>,
    /// Receivers whose queues were full at the last send.
    missed: Arc<Mutex<Vec<PortId>>>,
}

impl OrderSender {
    /// Sends `order` and wakes the receivers. Returns those that it has missed, because their queues
    /// were full.
    pub fn send(&self, order: &Order) -> Result<Vec<PortId>, ChannelError> {
        self.sender.send(order)?;
        Ok(std::mem::take(&mut self.missed.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

/// Receives control messages.
#[derive(Debug)]
pub struct MessageReceiver<M> {
    subscriber: Subscriber<Ipc, [u8], ()>,
    service: &'static str,
    message: PhantomData<fn() -> M>,
}

impl<M: for<'de> Deserialize<'de>> MessageReceiver<M> {
    fn new(factory: &Bytes<()>, service: &'static str) -> Result<Self, ChannelError> {
        let subscriber = factory
            .subscriber_builder()
            .create()
            .map_err(|error| port_error(service, "subscriber", &error))?;
        Ok(Self { subscriber, service, message: PhantomData })
    }

    /// This end, as [`OrderSender::send`] names it.
    pub fn port(&self) -> PortId {
        self.subscriber.id().value()
    }

    /// The next message, if one is there.
    pub fn try_receive(&self) -> Result<Option<M>, ChannelError> {
        let sample = self
            .subscriber
            .receive()
            .map_err(|error| transfer_error(self.service, "receive", &error))?;
        check_connections(self.service)?;
        sample
            .map(|sample| {
                message::decode(sample.payload()).map_err(|reason| ChannelError::Decode {
                    service: self.service.to_owned(),
                    len: sample.payload().len(),
                    reason,
                })
            })
            .transpose()
    }
}

/// Sends arrays of `f32` that are filled in place.
#[derive(Debug)]
pub struct ArraySender<H: Debug + ZeroCopySend + Default> {
    publisher: Publisher<Ipc, [Line], H>,
    service: &'static str,
    bell: Bell,
    len: usize,
    deadline: Duration,
}

impl<H: Debug + ZeroCopySend + Default + Copy> ArraySender<H> {
    /// With `slots` arrays of length `len`, or as many as iceoryx2 takes for the worst case if that is
    /// less.
    fn new(
        factory: &Floats<H>,
        service: &'static str,
        bell: Bell,
        len: usize,
        slots: usize,
        deadline: Duration,
    ) -> Result<Self, ChannelError> {
        let publisher = factory
            .publisher_builder()
            .initial_max_slice_len(Line::count(len))
            .override_sample_preallocation(move |worst| worst.min(slots))
            .max_loaned_samples(1)
            .backpressure_strategy(strategy(deadline))
            .set_backpressure_handler(give_up_after(deadline))
            .create()
            .map_err(|error| port_error(service, "publisher", &error))?;
        Ok(Self { publisher, service, bell, len, deadline })
    }

    /// Borrows a zeroed array of the channel's length from shared memory, to be filled and sent.
    pub fn loan(&self) -> Result<ArraySampleMut<H>, ChannelError> {
        let sample = self
            .publisher
            .loan_slice(Line::count(self.len))
            .map_err(|error| transfer_error(self.service, "loan", &error))?;
        Ok(ArraySampleMut { sample, len: self.len })
    }

    /// Sends a filled array and wakes the receivers. Returns how many receivers got it.
    pub fn send(&self, array: ArraySampleMut<H>) -> Result<usize, ChannelError> {
        let receivers =
            array.sample.send().map_err(|error| send_error(self.service, self.deadline, error))?;
        self.bell.ring();
        check_connections(self.service)?;
        Ok(receivers)
    }

    /// Connects to receivers that appeared since the last send and gives them the history.
    pub fn update_connections(&self) {
        let _ = self.publisher.update_connections();
    }
}

/// An array in shared memory that is being filled.
#[derive(Debug)]
pub struct ArraySampleMut<H: Debug + ZeroCopySend> {
    sample: SampleMut<Ipc, [Line], H>,
    len: usize,
}

impl<H: Debug + ZeroCopySend> ArraySampleMut<H> {
    /// The elements, 64-byte aligned.
    pub fn payload_mut(&mut self) -> &mut [f32] {
        Line::numbers_mut(self.sample.payload_mut(), self.len)
    }

    /// The header.
    pub fn header_mut(&mut self) -> &mut H {
        self.sample.user_header_mut()
    }
}

/// Receives arrays of `f32` as views of shared memory.
#[derive(Debug)]
pub struct ArrayReceiver<H: Debug + ZeroCopySend> {
    subscriber: Subscriber<Ipc, [Line], H>,
    service: &'static str,
    len: usize,
}

impl<H: Debug + ZeroCopySend> ArrayReceiver<H> {
    fn new(factory: &Floats<H>, service: &'static str, len: usize) -> Result<Self, ChannelError> {
        let subscriber = factory
            .subscriber_builder()
            .create()
            .map_err(|error| port_error(service, "subscriber", &error))?;
        Ok(Self { subscriber, service, len })
    }

    /// The next array, if one is there. Its memory stays the sender's until the sample is dropped.
    pub fn try_receive(&self) -> Result<Option<ArraySample<H>>, ChannelError> {
        let sample = self.subscriber.receive();
        let sample = sample.map_err(|e| transfer_error(self.service, "receive", &e))?;
        check_connections(self.service)?;
        let Some(sample) = sample else { return Ok(None) };
        let (lines, len) = (sample.payload().len(), self.len);
        if lines != Line::count(len) {
            return Err(ChannelError::Decode {
                service: self.service.to_owned(),
                len: size_of_val(sample.payload()),
                reason: format!("an array of {len} numbers was expected"),
            });
        }
        Ok(Some(ArraySample { sample, len }))
    }
}

/// An array in shared memory, read-only.
#[derive(Debug)]
pub struct ArraySample<H: Debug + ZeroCopySend> {
    sample: Sample<Ipc, [Line], H>,
    len: usize,
}

impl<H: Debug + ZeroCopySend> ArraySample<H> {
    /// The elements, 64-byte aligned.
    pub fn payload(&self) -> &[f32] {
        Line::numbers(self.sample.payload(), self.len)
    }

    /// The header.
    pub fn header(&self) -> &H {
        self.sample.user_header()
    }
}

/// Sends a snapshot, piece by piece.
#[derive(Debug)]
pub struct PieceSender {
    publisher: Publisher<Ipc, [u8], SnapshotHeader>,
    bell: Bell,
}

impl PieceSender {
    /// Sends the piece of `snapshot` that begins at `header.offset`, at most [`PIECE_LEN`] bytes.
    /// Returns the offset of the next one; the same offset if the receiver's queue stayed full.
    pub fn send(&self, header: SnapshotHeader, snapshot: &[u8]) -> Result<u64, ChannelError> {
        let begin = header.offset as usize;
        let piece = &snapshot[begin..snapshot.len().min(begin + PIECE_LEN)];
        let mut sample = self
            .publisher
            .loan_slice_uninit(piece.len())
            .map_err(|error| transfer_error("snapshot", "loan", &error))?
            .write_from_slice(piece);
        *sample.user_header_mut() = SnapshotHeader { total: snapshot.len() as u64, ..header };
        // Rung first: a full queue is emptied by a receiver who is awake.
        self.bell.ring();
        match sample.send() {
            Ok(_) => {}
            Err(SendError::UnableToDeliver) => return Ok(header.offset),
            Err(error) => return Err(transfer_error("snapshot", "send", &error)),
        }
        self.bell.ring();
        check_connections("snapshot")?;
        Ok((begin + piece.len()) as u64)
    }
}

/// Receives the pieces of snapshots.
#[derive(Debug)]
pub struct PieceReceiver(Subscriber<Ipc, [u8], SnapshotHeader>);

impl PieceReceiver {
    /// The next piece, if one is there.
    pub fn try_receive(&self) -> Result<Option<PieceSample>, ChannelError> {
        let sample = self.0.receive().map_err(|e| transfer_error("snapshot", "receive", &e))?;
        check_connections("snapshot")?;
        Ok(sample.map(PieceSample))
    }
}

/// A piece of a snapshot in shared memory.
#[derive(Debug)]
pub struct PieceSample(Sample<Ipc, [u8], SnapshotHeader>);

impl PieceSample {
    /// The bytes.
    pub fn payload(&self) -> &[u8] {
        self.0.payload()
    }

    /// Where they belong.
    pub fn header(&self) -> &SnapshotHeader {
        self.0.user_header()
    }
}

fn strategy(deadline: Duration) -> BackpressureStrategy {
    if deadline.is_zero() {
        BackpressureStrategy::DiscardData
    } else {
        BackpressureStrategy::RetryUntilDelivered
    }
}

/// Retries until `deadline`, then fails the send; a zero deadline drops the sample instead.
fn give_up_after(deadline: Duration) -> impl BackpressureFn {
    move |info: &BackpressureInfo| {
        if deadline.is_zero() {
            BackpressureAction::DiscardData
        } else if info.elapsed_time < deadline {
            // Who has waited for long may be late by more, and a receiver that stands still costs
            // no processor.
            let pause = info.elapsed_time / 16;
            std::thread::sleep(pause.clamp(Duration::from_micros(50), Duration::from_millis(5)));
            BackpressureAction::Retry
        } else {
            BackpressureAction::DiscardDataAndFail
        }
    }
}

/// Drops the sample for a receiver without room, and writes down which it was.
fn note_the_full(missed: Arc<Mutex<Vec<PortId>>>) -> impl BackpressureFn {
    move |info: &BackpressureInfo| {
        missed.lock().unwrap_or_else(PoisonError::into_inner).push(info.receiver_port_id);
        BackpressureAction::DiscardData
    }
}

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    let full = format!("spaceoctopus/{}/{name}", layout_hash());
    ServiceName::new(&full).map_err(|error| open_error(name, &error))
}

fn open_error(service: &str, error: &dyn Debug) -> ChannelError {
    full(service).or_else(|| no_room(service)).unwrap_or_else(|| ChannelError::Open {
        service: service.to_owned(),
        reason: format!("{error:?}"),
        layout: layout_hash(),
    })
}

fn port_error(service: &str, port: &'static str, error: &dyn Debug) -> ChannelError {
    full(service).or_else(|| no_room(service)).unwrap_or_else(|| ChannelError::Port {
        service: service.to_owned(),
        port,
        reason: format!("{error:?}"),
    })
}

fn transfer_error(service: &str, action: &'static str, error: &dyn Debug) -> ChannelError {
    full(service).unwrap_or_else(|| ChannelError::Transfer {
        service: service.to_owned(),
        action,
        reason: format!("{error:?}"),
    })
}

/// The error of a segment that could not be made, if there was one.
fn full(service: &str) -> Option<ChannelError> {
    let segment::Shortage { needed, free } = segment::take_shortage()?;
    Some(ChannelError::Full { what: format!("channel `{service}`"), needed, free })
}

/// The error of a small file that could not be written because there is no room at all: iceoryx2 does
/// not say so.
fn no_room(service: &str) -> Option<ChannelError> {
    let free = segment::free_space(Path::new(SHARED_MEMORY)).ok()?;
    let what = format!("channel `{service}`");
    (free < segment::MARGIN).then_some(ChannelError::Full { what, needed: segment::MARGIN, free })
}

/// Fails if a connection to the other end could not be made. Ports connect while they send and receive,
/// and go on without those to whom they could not.
fn check_connections(service: &str) -> Result<(), ChannelError> {
    full(service).map_or(Ok(()), Err)
}

fn send_error(service: &str, deadline: Duration, error: SendError) -> ChannelError {
    if matches!(error, SendError::UnableToDeliver) {
        return ChannelError::Backpressure {
            service: service.to_owned(),
            waited_ms: deadline.as_millis(),
        };
    }
    transfer_error(service, "send", &error)
}
