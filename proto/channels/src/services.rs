//! The services of a run, as each process sees them.

use std::fs::File;
use std::time::Duration;

use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use proto::layout::{BlockHeader, PolicyHeader, SnapshotHeader, layout_hash};
use proto::message::{Order, Progress, Status};

use crate::arrays::{ArrayReceiver, ArraySender};
use crate::backpressure::give_up_after;
use crate::bells::{Bell, BellListener, Role};
use crate::error::{open_error, port_error};
use crate::header::Shared;
use crate::line::Line;
use crate::messages::{MessageReceiver, MessageSender, OrderSender};
use crate::pieces::{PieceReceiver, PieceSender};
use crate::sizes::{
    MESSAGE_BUFFER, PIECE_BUFFER, POLICY_BORROWED, POLICY_BUFFER, PROGRESS_LEN, STATUS_LEN,
};
use crate::transport::Private as Ipc;
use crate::{ChannelError, ChannelSizes, Domain, PIECE_LEN};

type Bytes<H> = publish_subscribe::PortFactory<Ipc, [u8], H>;
type Floats<H> = publish_subscribe::PortFactory<Ipc, [Line], Shared<H>>;

/// All services of a run, as one process sees them.
#[derive(Debug)]
pub struct Channels {
    orders: Bytes<()>,
    progress: Bytes<()>,
    status: Bytes<()>,
    policy: Floats<PolicyHeader>,
    rollouts: Floats<BlockHeader>,
    snapshot: Bytes<Shared<SnapshotHeader>>,
    wake_coordinator: event::PortFactory<Ipc>,
    wake_learner: event::PortFactory<Ipc>,
    wake_workers: event::PortFactory<Ipc>,
    sizes: ChannelSizes,
    // Dropped last: services must not outlive their node.
    node: Node<Ipc>,
    /// The coordinator's lock of the domain.
    _held: Option<File>,
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
        let held = match access {
            Access::Create => {
                domain.make_root()?;
                domain.hold()
            }
            Access::Open => {
                domain.check_root()?;
                None
            }
        };
        let node = NodeBuilder::new()
            .config(&domain.config(access == Access::Create))
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| open_error(domain.as_str(), &error))?;
        let max_workers = sizes.max_workers;
        // The coordinator, the learner and its replacement beside the workers, and two of a gateway, which opens
        // the services once for each of its threads that wait for a bell.
        let max_nodes = max_workers + 6;
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
                Limits { subscribers: max_workers + 3, buffer: sizes.order_buffer, ..messages }
            ),
            progress: service!("progress", u8, (), messages),
            status: service!(
                "status",
                u8,
                (),
                // A gateway speaks for all workers of hosts.
                Limits { publishers: max_workers + 1, overflow: true, ..messages }
            ),
            policy: service!(
                "policy",
                Line,
                Shared<PolicyHeader>,
                Limits {
                    publishers: 2,
                    // The coordinator, too: it keeps the policy of a block that cannot be made. And a gateway.
                    subscribers: max_workers + 2,
                    buffer: POLICY_BUFFER,
                    borrowed: POLICY_BORROWED,
                    history: POLICY_BUFFER,
                    overflow: true,
                }
            ),
            rollouts: service!(
                "rollouts",
                Line,
                Shared<BlockHeader>,
                Limits {
                    publishers: max_workers + 1,
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
                Shared<SnapshotHeader>,
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
            _held: held,
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
        OrderSender::new(&self.orders, bells, self.sizes.order_slots())
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
        let (len, slots) = (PROGRESS_LEN, usize::MAX);
        MessageSender::new(&self.progress, "progress", bells, len, deadline, slots, handler)
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
        let (len, slots) = (STATUS_LEN, usize::MAX);
        MessageSender::new(&self.status, "status", bells, len, deadline, slots, handler)
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

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    let full = format!("spaceoctopus/{}/{name}", layout_hash());
    ServiceName::new(&full).map_err(|error| open_error(name, &error))
}
