//! End-to-end tests of the built programs: runs, crashes, bad input.

mod algorithms;
mod bad_input;
mod bench;
mod chaos;
mod checkpoints;
mod exactness;
mod experiment;
mod failures;
mod golden;
mod guide;
mod http;
mod mujoco;
mod reproduce;
mod run_directory;
mod verify;
