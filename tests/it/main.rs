//! End-to-end tests of the built programs: runs, crashes, bad input.

mod algorithms;
mod bad_input;
mod bench;
mod chaos;
mod checkpoints;
mod command_line;
mod damage;
mod environment;
mod exactness;
mod experiment;
mod failures;
mod files;
mod film;
mod golden;
mod guide;
mod http;
mod imports;
mod mujoco;
mod other_users;
mod page;
mod precision;
mod reproduce;
mod run_directory;
mod shared_memory;
mod signals;
mod verify;
