//! The ends of channels that carry control messages.

use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureFn, LoanError};
use iceoryx2::service::port_factory::publish_subscribe;
use proto::message::{self, Order, PortId};
use serde::{Deserialize, Serialize};

use crate::ChannelError;
use crate::backpressure::{note_the_full, strategy};
use crate::bells::Bell;
use crate::error::{check_connections, port_error, send_error, transfer_error};
use crate::sizes::ORDER_LEN;
use crate::transport::Private as Ipc;

/// A service whose samples are bytes.
type Bytes = publish_subscribe::PortFactory<Ipc, [u8], ()>;

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
    pub(crate) fn new(
        factory: &Bytes,
        service: &'static str,
        bells: Vec<Bell>,
        max_len: usize,
        deadline: Duration,
        slots: usize,
        when_full: impl BackpressureFn + 'static,
    ) -> Result<Self, ChannelError> {
        let publisher = factory
            .publisher_builder()
            .initial_max_slice_len(max_len)
            .override_sample_preallocation(move |worst| worst.min(slots))
            .max_loaned_samples(1)
            .backpressure_strategy(strategy(deadline))
            .set_backpressure_handler(when_full)
            .create()
            .map_err(|error| port_error(service, "publisher", &error))?;
        Ok(Self { publisher, service, bells, deadline, message: PhantomData })
    }

    /// Sends `message` and wakes the receivers.
    pub fn send(&self, message: &M) -> Result<(), ChannelError> {
        if self.try_send(message)? {
            return Ok(());
        }
        Err(transfer_error(self.service, "loan", &LoanError::OutOfMemory))
    }

    /// Likewise; whether there was a slot for it.
    fn try_send(&self, message: &M) -> Result<bool, ChannelError> {
        let bytes = message::encode(message);
        let sample = match self.publisher.loan_slice_uninit(bytes.len()) {
            Ok(sample) => sample.write_from_slice(&bytes),
            Err(LoanError::OutOfMemory) => return Ok(false),
            Err(error) => return Err(transfer_error(self.service, "loan", &error)),
        };
        sample.send().map_err(|error| send_error(self.service, self.deadline, error))?;
        self.bells.iter().for_each(Bell::ring);
        check_connections(self.service)?;
        Ok(true)
    }
}

/// Who has not got an order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Missed {
    /// These, often none: their queues were full.
    By(Vec<PortId>),
    /// All: queues of receivers that do not read hold so many different orders that no slot is left.
    ByAll,
}

impl Missed {
    /// Whether the receiver is one of them.
    pub fn includes(&self, receiver: PortId) -> bool {
        match self {
            Self::By(receivers) => receivers.contains(&receiver),
            Self::ByAll => true,
        }
    }

    /// Whether all have it.
    pub fn is_nobody(&self) -> bool {
        matches!(self, Self::By(receivers) if receivers.is_empty())
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
    /// With `slots` orders, or as many as iceoryx2 takes for the worst case if that is less.
    pub(crate) fn new(
        factory: &Bytes,
        bells: Vec<Bell>,
        slots: usize,
    ) -> Result<Self, ChannelError> {
        let missed = Arc::default();
        let handler = note_the_full(Arc::clone(&missed));
        let (len, deadline) = (ORDER_LEN, Duration::ZERO);
        let sender = MessageSender::new(factory, "orders", bells, len, deadline, slots, handler)?;
        Ok(Self { sender, missed })
    }

    /// Sends `order` and wakes the receivers. Returns those that it has missed.
    pub fn send(&self, order: &Order) -> Result<Missed, ChannelError> {
        if !self.sender.try_send(order)? {
            return Ok(Missed::ByAll);
        }
        let mut missed = self.missed.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Missed::By(std::mem::take(&mut missed)))
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
    pub(crate) fn new(factory: &Bytes, service: &'static str) -> Result<Self, ChannelError> {
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
