//! Bells: how a sender wakes a receiver, so that nobody polls.

use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;

use crate::transport::Private as Ipc;

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
    pub(crate) fn service(self) -> &'static str {
        match self {
            Self::Coordinator => "wake/coordinator",
            Self::Learner => "wake/learner",
            Self::Workers => "wake/workers",
        }
    }
}

/// Wakes the processes of a role.
#[derive(Debug)]
pub struct Bell(pub(crate) Notifier<Ipc>);

impl Bell {
    /// Rings. That nobody listens yet is no error: a receiver looks into its queue before it waits.
    pub fn ring(&self) {
        let _ = self.0.notify();
    }
}

/// Waits for a bell.
#[derive(Debug)]
pub struct BellListener(pub(crate) Listener<Ipc>);

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
