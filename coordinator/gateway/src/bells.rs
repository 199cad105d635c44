//! Bells that are heard while something else is waited for.

use std::sync::mpsc::Sender;

use channels::{ChannelSizes, Channels, Domain, Role};
use proto::message::HEARTBEAT;
use proto::{ExitCode, ExitError};

/// Puts an event down whenever the bell of `role` rings, until nobody takes events any more.
///
/// Ports may not wander between threads, so the thread opens the services for itself.
pub(crate) fn listen<E: Send + 'static>(
    domain: &Domain,
    sizes: ChannelSizes,
    role: Role,
    events: Sender<E>,
    event: fn() -> E,
) -> Result<(), ExitError> {
    let domain = domain.clone();
    let listen = move || {
        let opened = Channels::open(&domain, sizes)
            .and_then(|channels| Ok((channels.listener(role)?, channels)));
        let (bell, _channels) = match opened {
            Ok(opened) => opened,
            // Whoever waits for events looks into its queues now and then all the same.
            Err(error) => return tracing::error!("{error}"),
        };
        loop {
            bell.wait(HEARTBEAT);
            if events.send(event()).is_err() {
                return;
            }
        }
    };
    let thread = std::thread::Builder::new().name("bell".to_owned()).spawn(listen);
    thread.map(drop).map_err(|error| {
        ExitError::new(ExitCode::Environment, format!("cannot start a thread: {error}"))
    })
}
