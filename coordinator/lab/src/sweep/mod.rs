//! Sweeps: many trainings that differ in keys of their configurations and in their seeds.
//!
//! * [`study`]: the trials; [`record`]: what is known of each beside its run;
//! * [`score`]: how its policy does on held-out goals; [`halving`]: which trials go on;
//! * [`outcome`], [`page`]: what has come of all of them.

pub mod halving;
pub mod outcome;
pub mod page;
pub mod record;
pub mod score;
pub mod study;
