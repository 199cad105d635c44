//! The host's ends of its machine's channels: those of a coordinator and of a learner.

use channels::{
    ArrayReceiver, ArraySender, ChannelError, ChannelSizes, Channels, Domain, MessageReceiver,
    OrderSender,
};
use proto::config::Config;
use proto::gateway::Place;
use proto::gateway::pieces::Content;
use proto::layout::{BlockHeader, Dimensions, PolicyHeader};
use proto::message::Status;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use crate::arguments::joints_of;
use crate::network::Asked;
use crate::orders::Task;

/// See the module.
pub(super) struct HostPorts {
    pub(super) domain: Domain,
    pub(super) sizes: ChannelSizes,
    pub(super) orders: OrderSender,
    pub(super) blocks: ArrayReceiver<BlockHeader>,
    pub(super) policy: ArraySender<PolicyHeader>,
    status: MessageReceiver<Status>,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl HostPorts {
    /// Opens what `octopus join` has created, for the configuration that stands in the run directory now.
    pub(super) fn open(place: &Place, run_dir: &RunDir) -> Result<Self, ExitError> {
        let bad =
            |error: &dyn std::fmt::Display| ExitError::new(ExitCode::BadInput, error.to_string());
        let path = run_dir.config();
        let text = process::input::read_text(&path).map_err(|error| bad(&error))?;
        let config = Config::from_resolved_toml(&text, &path.display().to_string())
            .map_err(|error| bad(&error))?;
        let domain = Domain::parse(&place.domain)?;
        let sizes =
            ChannelSizes::new(&config, &Dimensions::new(&config, joints_of(&place.joints)?));
        let channels = Channels::open(&domain, sizes)?;
        Ok(Self {
            domain,
            sizes,
            orders: channels.order_sender()?,
            blocks: channels.block_receiver()?,
            policy: channels.policy_sender()?,
            status: channels.status_receiver()?,
            _channels: channels,
        })
    }

    /// The next word of a worker; a garbled one is passed over.
    pub(super) fn status(&self) -> Result<Option<Status>, ExitError> {
        loop {
            match self.status.try_receive() {
                Ok(status) => return Ok(status),
                Err(error @ ChannelError::Decode { .. }) => tracing::error!("{error}"),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Gives a policy to all workers. Whether it was one.
    pub(super) fn policy(&self, version: u64, asked: &Asked) -> Result<bool, ExitError> {
        let len = 4 * self.sizes.policy_len;
        if asked.answer.whole() != Some((&Content::Policy(version), len)) {
            return Ok(false);
        }
        let mut sample = self.policy.loan()?;
        asked.answer.copy_to(bytemuck::cast_slice_mut(sample.payload_mut()));
        sample.header_mut().version = version;
        self.policy.send(sample)?;
        Ok(true)
    }
}

/// What a block is: who made it, what it was ordered as, and what it travels as.
pub(super) struct Made {
    pub(super) worker: u32,
    pub(super) task: Task,
    pub(super) content: Content,
}

impl Made {
    pub(super) fn of(header: &BlockHeader) -> Self {
        let task = Task::Block { iteration: header.iteration, shard: header.shard };
        let content = Content::Block(bytemuck::bytes_of(header).to_vec());
        Self { worker: header.worker, task, content }
    }
}
