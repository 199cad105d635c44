//! The worker process: it rolls out policies in the [`simulator`] for a learner.

pub mod worker;
