//! Whether two runs, or a run and its repetition, are the same to the bit.

mod comparison;
mod differences;
mod record;
mod replay;
mod two_runs;
mod wording;

pub use self::record::Record;
pub use self::replay::{REMEDY, Replay, replay};
pub use self::two_runs::{TwoRuns, compare};
