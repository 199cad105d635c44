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
//! * [`provenance`]: which program and machine made a run;
//! * [`output`], [`logs`]: standard output is data, standard error is for people;
//! * [`signals`]: Ctrl-C once and twice;
//! * [`janitor`]: who cleans up when the coordinator is killed.
//!
//! It links no libtorch and starts in milliseconds.

pub mod cli;
pub mod commands;

pub mod live;
pub mod session;

pub mod scheduler;
pub mod supervisor;

pub mod checkpoint;
pub mod committer;
pub mod selection;

pub mod client;
pub mod http;

pub mod janitor;
pub mod lock;
pub mod signals;
pub mod threads;

pub mod figures;
pub mod preflight;
pub mod provenance;
pub mod report;

pub mod files;
pub mod logs;
pub mod output;
