//! The checkpoint service over HTTP, beside a live run or alone.
//!
//! ```text
//! GET    /                                     the page, for people
//! GET    /page/{file}                          a file of the page
//! GET    /health                               alive
//! GET    /metrics                              Prometheus
//! GET    /openapi.json                         this list, for programs
//! GET    /v1/checkpoints                       all checkpoints
//! POST   /v1/checkpoints                       commit one now (live run)
//! GET    /v1/checkpoints/{name}                one; also `latest`, `best` or a tag
//! PUT    /v1/checkpoints/{name}                upload one as a tar archive
//! DELETE /v1/checkpoints/{name}                remove one
//! GET    /v1/checkpoints/{name}/archive        download one as a tar archive
//! GET    /v1/checkpoints/{name}/files/{file}   download one file, or a range of its bytes
//! GET    /v1/checkpoints/{name}/differences/{other}  what differs between two
//! PUT    /v1/checkpoints/{name}/pin            keep one for ever; DELETE lets go of it
//! PUT    /v1/checkpoints/{name}/tags/{tag}     give one a name; DELETE takes it away
//! GET    /v1/events                            all that happens, as it happens
//! GET    /v1/metrics                           lines of the metrics, as they grow
//! GET    /v1/evaluations                       lines of the evaluations, likewise
//! GET    /v1/status                            what the live run is doing
//! PUT    /v1/workers                           change the live run's number of workers
//! GET    /v1/runs                              all runs, of a service of a directory of runs
//! GET    /runs/{run}/{path}                    the service of one of them
//! ```
//!
//! A [`Service`] owns one thread, on which a runtime serves all connections; work on disks goes to
//! threads of that runtime's pool. Whoever may ask is decided in `access`, how long and how much a client
//! may take in `connections`, `minimum_rate`, `request_body` and `places`. Every failure is a `Problem`, JSON
//! with a status code.
//!
//! A run's service takes a free port and writes it into `run.lock`, where `octopus status` and `octopus scale`
//! find it.

mod access;
mod archives;
mod bodies;
mod checkpoints;
mod connection_slots;
mod connections;
mod context;
mod counting;
mod differences;
mod document;
mod events;
mod exposition;
mod files;
mod limits;
mod log_lines;
mod metrics;
mod minimum_rate;
mod own_token;
mod page;
mod params;
mod places;
mod problem;
mod ranges;
mod recorded;
mod request_body;
mod requests;
mod router;
mod run;
mod run_directory;
mod runs;
mod service;
mod token;
mod upload_space;
mod uploads;

pub use access::check_address;
pub use checkpoints::{CheckpointDetail, CheckpointList};
pub use limits::Limits;
pub use own_token::{OwnToken, STORE_TOKEN_FILE, TOKEN_FILE};
pub use problem::ErrorBody;
pub use run::{CommitAnswer, ScaleAnswer, ScaleRequest};
pub use run_directory::{RunAtAGlance, RunList};
pub use service::{Service, ServiceSpec};
pub use token::{TOKEN_VARIABLE, Token};

#[cfg(test)]
mod tests;
