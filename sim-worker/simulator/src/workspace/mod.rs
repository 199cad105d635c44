//! All scratch memory of a step: of the dynamics, and of the contacts that are followed through a substep.

mod contact_set;
mod scratch;

pub(crate) use contact_set::{Contact, ContactSet, OUTLOOK, Response};
pub use scratch::Workspace;
pub(crate) use scratch::{LinkPose, LinkScratch};
