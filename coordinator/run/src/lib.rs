//! A training run, from its checks to its last checkpoint.
//!
//! * [`session`]: the loop of a run; read it first;
//! * [`start`]: its directory, its HTTP service, and the session from its first word to its last;
//! * [`scheduler`], `trials`, `auditor`, [`supervisor`]: who rolls out what; what of it is compared; processes;
//! * [`resume_point`]: which checkpoint a run goes on from;
//! * [`committer`], [`selection`]: the thread that writes checkpoints; which one is the best;
//! * [`report`]: metrics, TensorBoard events, progress;
//! * [`preflight`], [`precision`], [`shakedown`]: what is checked and decided before a run begins;
//! * [`signals`], [`bus_error`], [`signal_isolation`], [`environment`], [`janitor`]: Ctrl-C once and twice; shared memory
//!   that is full; what children inherit; cleaning up after a kill;
//! * [`join`]: this machine helps a run of another one;
//! * [`robots`]: robots as commands name them; [`errors`]: words and exit codes of errors.

mod auditor;
pub mod bus_error;
pub mod committer;
mod deadlines;
pub mod environment;
pub mod errors;
pub mod janitor;
pub mod join;
mod loop_clock;
pub mod precision;
pub mod preflight;
pub mod report;
pub mod resume_point;
pub mod robots;
pub mod scheduler;
pub mod selection;
pub mod session;
pub mod shakedown;
pub mod signal_isolation;
pub mod signals;
pub mod start;
pub mod supervisor;
mod task;
mod trials;
