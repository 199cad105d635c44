//! Files that last.
//!
//! * [`checkpoint`]: the store of checkpoints, its catalogue, archives, comparisons and checks;
//! * [`lock`]: one coordinator a run directory;
//! * [`recorded`], [`budgets`], [`jsonl`]: what a run wrote about its iterations;
//! * [`run_files`]: the configuration and the robot of a run, read back; [`runs`]: which runs there are;
//! * [`provenance`]: which program and machine made something;
//! * [`files`]: files that are whole or absent; [`temporary`]: what they are called before; [`outputs`]: what a command may write over;
//! * [`stamp`]: whether a file is still the one that was looked at before;
//! * [`regular_files`], [`owned_files`]: files that others may have put there, read with care;
//! * [`scratch`]: directories that do not last, and those that killed processes have left.

pub mod budgets;
pub mod checkpoint;
pub mod files;
pub mod jsonl;
pub mod lock;
pub mod outputs;
pub mod owned_files;
pub mod provenance;
pub mod recorded;
pub mod regular_files;
pub mod run_files;
pub mod runs;
pub mod scratch;
pub mod stamp;
pub mod temporary;
