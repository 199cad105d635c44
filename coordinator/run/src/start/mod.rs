//! The start of a run: its directory, its HTTP service, and the session from its first word to its last.
//!
//! * [`directory`]: where a run lands, and that no two take the same place;
//! * [`bucket`]: where its checkpoints go, too;
//! * [`service`]: where others see the run and ask it for something;
//! * [`session`]: everything that a session needs, and running it to its end.

pub mod bucket;
pub mod directory;
pub mod service;
pub mod session;
