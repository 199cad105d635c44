//! The robot, its dynamics and tasks, the inference of policies, and whole episodes: pure functions.
//!
//! Nothing here knows a process, a thread, a clock, a file or a channel, so that the same code with the
//! same bits runs in workers, in commands and in WebAssembly. Who has threads lends them, see [`executor`].
//!
//! From the bottom up, which is also an order to read in:
//!
//! * [`scalar`]: the numbers everything is generic over, `f64` or `f32` lanes, one
//!   environment a lane;
//! * [`spatial`]: three- and six-dimensional vectors, rotations;
//! * [`robot`]: descriptions from files, checked and completed; MJCF;
//! * [`state`], [`model`], [`workspace`]: what changes, what does not, laid out for the hot path, and scratch memory;
//! * [`dynamics`]: the articulated-body algorithm, kinematics, servos;
//! * [`collision`]: what touches, and how it pushes;
//! * [`mod@step`]: integrators, and what disturbs from outside;
//! * [`simulate`]: open loop, from commands to a trajectory;
//! * `inverse_kinematics`, `posture`: joint angles that bring hands to poses, one at a time and in lanes;
//! * [`task`]: goals, observations, critic states, rewards;
//! * [`policy`]: the actors, evaluated without libtorch;
//! * [`mod@env`]: the robot with its sensors, as loops over episodes use it;
//! * [`mod@rollout`]: whole episodes that explore, for training, as pure functions of their addresses;
//! * [`stepping`]: the environments of a rollout, stepped by who acts outside;
//! * [`experiment`], [`evaluate`]: whole episodes with deterministic actions, in which things may happen;
//! * [`controller`]: a controller that is not learned, beside which policies stand;
//! * [`reach`]: which goals can be reached at all;
//! * [`plan`]: a motion that brings hands to poses, found by trying in the simulator;
//! * [`random_motion`]: the dynamics under random commands, for measurements.
//!
//! Models are immutable and shared, all scratch memory is owned by a workspace, and no inner loop
//! allocates. Read [`mod@rollout`] next.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors, see `scalar`"
)]
#![expect(
    clippy::needless_range_loop,
    reason = "an index that runs through several arrays at once says more than nested zips"
)]

pub mod scalar;
pub mod spatial;

pub mod robot;

pub mod state;

pub mod executor;

pub mod model;

pub mod workspace;

pub mod dynamics;

pub mod collision;

pub mod step;

pub mod simulate;

pub mod task;

pub mod policy;

pub mod env;

pub mod rollout;

pub mod stepping;

pub mod experiment;

pub mod evaluate;

mod inverse_kinematics;

mod posture;

pub mod controller;

pub mod reach;

pub mod plan;

pub mod random_motion;
