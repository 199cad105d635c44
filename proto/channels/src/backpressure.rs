//! What a sender does when a receiver has no room.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use iceoryx2::port::{BackpressureAction, BackpressureFn, BackpressureInfo};
use iceoryx2::prelude::BackpressureStrategy;
use proto::message::PortId;

/// The deadline of who gives up for nobody but the kernel, see `process::child::die_with_parent`.
pub const WHILE_THE_PARENT_LIVES: Duration = Duration::MAX;

pub(crate) fn strategy(deadline: Duration) -> BackpressureStrategy {
    if deadline.is_zero() {
        BackpressureStrategy::DiscardData
    } else {
        BackpressureStrategy::RetryUntilDelivered
    }
}

/// Retries until `deadline`, then fails the send; a zero deadline drops the sample instead.
pub(crate) fn give_up_after(deadline: Duration) -> impl BackpressureFn {
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
pub(crate) fn note_the_full(missed: Arc<Mutex<Vec<PortId>>>) -> impl BackpressureFn {
    move |info: &BackpressureInfo| {
        missed.lock().unwrap_or_else(PoisonError::into_inner).push(info.receiver_port_id);
        BackpressureAction::DiscardData
    }
}
