//! End-to-end tests of the built programs: runs, crashes, bad input.

mod bad_input;
mod exactness;
mod mujoco;
mod run_directory;
