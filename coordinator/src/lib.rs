//! The `octopus` command: everything about a run but the simulation and the learning.
//!
//! A coordinator owns a run. It resolves the configuration, refuses what the machine cannot carry
//! ([`preflight`]), makes the run directory and holds its lock ([`lock`]), creates the shared
//! memory, starts the learner and the workers ([`supervisor`]), hands out shards ([`scheduler`])
//! and commits checkpoints ([`checkpoint`]). [`session`] is the loop that does all this; read it
//! next. Around it:
//!
//! * [`cli`] and [`commands`]: the command line, one file a command;
//! * [`report`]: metrics, TensorBoard events, progress, the learning curve;
//! * [`precision`]: what `run.precision = "auto"` means on this machine;
//! * [`provenance`]: which program and machine made a run;
//! * [`output`], [`logs`]: standard output is data, standard error is for people; [`causes`] words errors;
//!   [`printable`]: nothing tells a terminal what to do;
//! * [`outputs`]: what a command may write over;
//! * [`regular`], [`own`]: files that others may have put there, read with care;
//! * [`signals`]: Ctrl-C once and twice;
//! * [`janitor`]: who cleans up when the coordinator is killed;
//! * [`environment`], [`limits`]: what a shell leaves to the processes of a run.
//!
//! It links no libtorch and starts in milliseconds.

pub mod cli;
pub mod commands;

pub mod live;
pub mod session;

pub mod scheduler;
pub mod supervisor;

pub mod base;
pub mod checkpoint;
pub mod committer;
pub mod selection;

pub mod client;
pub mod http;
pub mod peer;

pub mod environment;
pub mod janitor;
pub mod limits;
pub mod lock;
pub mod shield;
pub mod signals;
pub mod threads;

pub mod figures;
pub mod precision;
pub mod preflight;
pub mod provenance;
pub mod report;
pub mod shakedown;

pub mod causes;
pub mod files;
pub mod logs;
pub mod output;
pub mod outputs;
pub mod own;
pub mod printable;
pub mod regular;
