//! Headers that travel beside a sample.

use std::fmt::Debug;

use bytemuck::Pod;
use iceoryx2::prelude::ZeroCopySend;

/// What may travel as the header of a sample: plain numbers without padding, declared in [`proto::layout`].
pub trait Header: Pod + Default + Debug + Send + Sync {}

impl<H: Pod + Default + Debug + Send + Sync> Header for H {}

/// A header in shared memory. `proto` declares headers and knows nothing of iceoryx2; this is what makes
/// them its.
#[derive(Debug, Clone, Copy, Default)]
#[repr(transparent)]
pub(crate) struct Shared<H>(pub(crate) H);

#[expect(unsafe_code, reason = "iceoryx2's promise for plain numbers of another crate")]
// SAFETY: `H` is `Pod`: it has a fixed layout without padding, is valid whatever its bytes are, holds no
// pointer, and needs no drop. `Shared` is transparent.
unsafe impl<H: Header> ZeroCopySend for Shared<H> {}
