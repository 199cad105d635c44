//! What a worker consists of, and how it says that it is alive.

use std::collections::VecDeque;
use std::time::Instant;

use channels::{
    ArrayReceiver, ArraySender, BellListener, ChannelError, ChannelSizes, Channels, Domain,
    MessageReceiver, MessageSender, Role, WHILE_THE_PARENT_LIVES,
};
use proto::layout::{BlockHeader, PolicyHeader};
use proto::message::{self, Fault, HEARTBEAT, Order, Status, WorkerId};
use proto::{ExitCode, ExitError};
use simulator::policy::Policy;
use simulator::rollout::World;

use super::arguments::Arguments;
use super::assignment::Assignment;

/// Ports, and what came in through them.
pub(super) struct Worker<'a> {
    pub(super) world: &'a World,
    pub(super) id: WorkerId,
    pub(super) incarnation: u32,
    pub(super) assignments: VecDeque<Assignment>,
    pub(super) stopping: bool,
    /// Oldest first.
    pub(super) policies: VecDeque<(u64, Policy)>,
    pub(super) heartbeat: Instant,
    pub(super) status: MessageSender<Status>,
    pub(super) orders: MessageReceiver<Order>,
    pub(super) policy: ArrayReceiver<PolicyHeader>,
    pub(super) blocks: ArraySender<BlockHeader>,
    pub(super) bell: BellListener,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl<'a> Worker<'a> {
    /// Opens the channels of a run.
    pub(super) fn connect(arguments: &Arguments, world: &'a World) -> Result<Self, ExitError> {
        let connect = || -> Result<Self, ChannelError> {
            let domain = Domain::parse(&arguments.domain)?;
            let sizes = ChannelSizes::new(&world.config, &world.dimensions);
            let channels = Channels::open(&domain, sizes)?;
            Ok(Self {
                world,
                id: arguments.worker,
                incarnation: arguments.incarnation,
                assignments: VecDeque::new(),
                stopping: false,
                policies: VecDeque::new(),
                heartbeat: Instant::now(),
                status: channels.status_sender()?,
                // Heard before anything is looked for, so that no ring is missed.
                bell: channels.listener(Role::Workers)?,
                orders: channels.order_receiver()?,
                policy: channels.policy_receiver()?,
                blocks: channels.block_sender(WHILE_THE_PARENT_LIVES)?,
                _channels: channels,
            })
        };
        connect().map_err(|error| ExitError::new(ExitCode::Environment, error.to_string()))
    }

    /// Says once in a while that the process is alive.
    pub(super) fn beat(&mut self) -> Result<(), ExitError> {
        if self.heartbeat.elapsed() < HEARTBEAT {
            return Ok(());
        }
        self.heartbeat = Instant::now();
        self.send(&self.alive())
    }

    /// The sign of life.
    pub(super) fn alive(&self) -> Status {
        let (worker, incarnation, orders) = (self.id, self.incarnation, self.orders.port());
        Status::Heartbeat { worker, incarnation, orders }
    }

    /// Says what went wrong.
    pub(super) fn fail(&self, what: &str, fault: Option<Box<Fault>>) -> Result<(), ExitError> {
        tracing::error!(worker = self.id, "{what}");
        self.send(&Status::Failed {
            worker: self.id,
            incarnation: self.incarnation,
            message: message::clip(what),
            fault,
        })
    }

    /// Sends a status.
    pub(super) fn send(&self, status: &Status) -> Result<(), ExitError> {
        self.status.send(status).map_err(|error| failure(&error))
    }
}

/// Says so if it has not been said for a while.
pub(super) fn say_alive(status: &MessageSender<Status>, heartbeat: &mut Instant, alive: &Status) {
    if heartbeat.elapsed() >= HEARTBEAT {
        *heartbeat = Instant::now();
        // A lost heartbeat is followed by another; a broken channel shows at the next send.
        let _ = status.send(alive);
    }
}

/// The exit that a broken channel leads to.
pub(super) fn failure(error: &ChannelError) -> ExitError {
    let code = match error {
        ChannelError::Full { .. } => ExitCode::Environment,
        _ => ExitCode::Failure,
    };
    ExitError::new(code, error.to_string())
}
