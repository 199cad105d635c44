//! The ends of channels that carry arrays of `f32`, written and read in shared memory.

use std::time::Duration;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::publish_subscribe;

use crate::ChannelError;
use crate::backpressure::{give_up_after, strategy};
use crate::bells::Bell;
use crate::error::{check_connections, port_error, send_error, transfer_error};
use crate::header::{Header, Shared};
use crate::line::Line;
use crate::transport::Private as Ipc;

/// A service whose samples are arrays of `f32` with a header.
type Floats<H> = publish_subscribe::PortFactory<Ipc, [Line], Shared<H>>;

/// Sends arrays of `f32` that are filled in place.
#[derive(Debug)]
pub struct ArraySender<H: Header> {
    publisher: Publisher<Ipc, [Line], Shared<H>>,
    service: &'static str,
    bell: Bell,
    len: usize,
    deadline: Duration,
}

impl<H: Header> ArraySender<H> {
    /// With `slots` arrays of length `len`, or as many as iceoryx2 takes for the worst case if that is
    /// less.
    pub(crate) fn new(
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
pub struct ArraySampleMut<H: Header> {
    sample: SampleMut<Ipc, [Line], Shared<H>>,
    len: usize,
}

impl<H: Header> ArraySampleMut<H> {
    /// The elements, 64-byte aligned.
    pub fn payload_mut(&mut self) -> &mut [f32] {
        Line::numbers_mut(self.sample.payload_mut(), self.len)
    }

    /// The header.
    pub fn header_mut(&mut self) -> &mut H {
        &mut self.sample.user_header_mut().0
    }
}

/// Receives arrays of `f32` as views of shared memory.
#[derive(Debug)]
pub struct ArrayReceiver<H: Header> {
    subscriber: Subscriber<Ipc, [Line], Shared<H>>,
    service: &'static str,
    len: usize,
}

impl<H: Header> ArrayReceiver<H> {
    pub(crate) fn new(
        factory: &Floats<H>,
        service: &'static str,
        len: usize,
    ) -> Result<Self, ChannelError> {
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
pub struct ArraySample<H: Header> {
    sample: Sample<Ipc, [Line], Shared<H>>,
    len: usize,
}

impl<H: Header> ArraySample<H> {
    /// The elements, 64-byte aligned.
    pub fn payload(&self) -> &[f32] {
        Line::numbers(self.sample.payload(), self.len)
    }

    /// The header.
    pub fn header(&self) -> &H {
        &self.sample.user_header().0
    }
}
