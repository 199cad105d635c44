//! What can go wrong between the processes of a run.

use std::fmt::Debug;
use std::path::Path;
use std::time::Duration;

use iceoryx2::port::SendError;
use proto::layout::layout_hash;
use proto::{ExitCode, ExitError, mib};

use crate::place::SHARED_MEMORY;
use crate::segment;

/// What can go wrong between the processes of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ChannelError {
    /// The service does not exist or has another layout.
    #[error(
        "channel `{service}` cannot be opened: {reason}; \
         all programs of a run must come from the same build (layout {layout})"
    )]
    Open {
        /// Name of the service.
        service: String,
        /// The transport's reason.
        reason: String,
        /// Layout hash of this program.
        layout: String,
    },
    /// A port could not be made.
    #[error("channel `{service}`: cannot create a {port}: {reason}")]
    Port {
        /// Name of the service.
        service: String,
        /// `publisher`, `subscriber`, `listener` or `notifier`.
        port: &'static str,
        /// The transport's reason.
        reason: String,
    },
    /// Shared memory is full.
    #[error(
        "shared memory is full: {what} needs {needed} and {place} has {free} free; make room (`octopus \
         clean` removes what killed runs left, `ls -l {place}` shows what others have there), enlarge \
         it (`mount -o remount,size=SIZE {place}`, in a container --shm-size=SIZE), or use fewer \
         --workers", needed = mib(*needed), free = mib(*free), place = SHARED_MEMORY
    )]
    Full {
        /// What could not be made.
        what: String,
        /// Bytes that it needs.
        needed: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// Nobody took the data before the deadline.
    #[error("channel `{service}`: not delivered within {waited_ms} ms; is the receiver alive?")]
    Backpressure {
        /// Name of the service.
        service: String,
        /// How long the sender waited.
        waited_ms: u128,
    },
    /// Sending or receiving failed.
    #[error("channel `{service}`: {action} failed: {reason}")]
    Transfer {
        /// Name of the service.
        service: String,
        /// `loan`, `send` or `receive`.
        action: &'static str,
        /// The transport's reason.
        reason: String,
    },
    /// A message that cannot be decoded.
    #[error("channel `{service}`: a message of {len} bytes cannot be decoded: {reason}")]
    Decode {
        /// Name of the service.
        service: String,
        /// Length of the message.
        len: usize,
        /// The decoder's reason.
        reason: String,
    },
}

impl From<ChannelError> for ExitError {
    /// Channels fail for want of shared memory, or because programs of two builds meet.
    fn from(error: ChannelError) -> Self {
        Self::new(ExitCode::Environment, error.to_string())
    }
}

pub(crate) fn open_error(service: &str, error: &dyn Debug) -> ChannelError {
    full(service).or_else(|| no_room(service)).unwrap_or_else(|| ChannelError::Open {
        service: service.to_owned(),
        reason: format!("{error:?}"),
        layout: layout_hash(),
    })
}

pub(crate) fn port_error(service: &str, port: &'static str, error: &dyn Debug) -> ChannelError {
    full(service).or_else(|| no_room(service)).unwrap_or_else(|| ChannelError::Port {
        service: service.to_owned(),
        port,
        reason: format!("{error:?}"),
    })
}

pub(crate) fn transfer_error(
    service: &str,
    action: &'static str,
    error: &dyn Debug,
) -> ChannelError {
    full(service).unwrap_or_else(|| ChannelError::Transfer {
        service: service.to_owned(),
        action,
        reason: format!("{error:?}"),
    })
}

/// The error of a segment that could not be made, if there was one.
pub(crate) fn full(service: &str) -> Option<ChannelError> {
    let segment::Shortage { needed, free } = segment::take_shortage()?;
    Some(ChannelError::Full { what: format!("channel `{service}`"), needed, free })
}

/// The error of a small file that could not be written because there is no room at all: iceoryx2 does
/// not say so.
pub(crate) fn no_room(service: &str) -> Option<ChannelError> {
    let free = segment::free_space(Path::new(SHARED_MEMORY)).ok()?;
    let what = format!("channel `{service}`");
    (free < segment::MARGIN).then_some(ChannelError::Full { what, needed: segment::MARGIN, free })
}

/// Fails if a connection to the other end could not be made. Ports connect while they send and receive,
/// and go on without those to whom they could not.
pub(crate) fn check_connections(service: &str) -> Result<(), ChannelError> {
    full(service).map_or(Ok(()), Err)
}

pub(crate) fn send_error(service: &str, deadline: Duration, error: SendError) -> ChannelError {
    if matches!(error, SendError::UnableToDeliver) {
        return ChannelError::Backpressure {
            service: service.to_owned(),
            waited_ms: deadline.as_millis(),
        };
    }
    transfer_error(service, "send", &error)
}
