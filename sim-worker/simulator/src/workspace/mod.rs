//! All scratch memory of a step: of the dynamics, and of the contacts that are followed through a substep.

mod contacts;
mod scratch;

pub(crate) use contacts::{Contact, ContactSet, OUTLOOK, Response};
pub use scratch::Workspace;
pub(crate) use scratch::{LinkPose, LinkScratch};
