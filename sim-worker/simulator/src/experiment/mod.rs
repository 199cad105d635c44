//! Episodes with deterministic actions in which things happen: other policies take over, arms fail, bodies are pushed.
//!
//! A [`Trial`] says what is played: which [`Player`] moves which arm from which step on ([`Phase`]), where hands and base shall go, what disturbs
//! ([`Intervention`], [`SensorNoise`], a delay, another robot than the policies know). [`play`] plays its episodes, several side by side, and
//! returns a [`Recording`] of every error and pose after every step. An evaluation is a trial in which nothing happens (see [`crate::evaluate`]).
//!
//! Everything random is addressed by seed, episode and step, so a recording depends neither on threads nor on how episodes lie in lanes.
//!
//! An [`Episode`] is the same for one environment, a step at a time, for whoever takes hold of it. A [`Motion`] is what given commands make of a
//! robot, for whoever looks at it closely.
//!
//! **Why a loop of its own.** The loop of training ([`crate::rollout`]) explores, pays and writes blocks; this
//! one has several policies, interventions, noise and a record. One loop for both would carry the branches of
//! each through the other. A test holds them together: without exploration and interventions both give the same
//! bits.

mod chunk;
mod episode;
mod event;
mod goals;
mod group;
mod intervention;
mod motion;
mod noise;
mod play;
mod recording;
mod seat;
mod skeleton;
mod stepper;
mod trial;
mod trial_loop;

pub use episode::{Episode, Member, ScriptError, Snapshot};
pub use event::{
    Control, Event, EventError, GoalPurpose, LONGEST_DELAY, Script, Start, TimedEvent,
};
pub use goals::{EvaluationGoals, FixedGoals};
pub use intervention::{Effect, Intervention};
pub use motion::Motion;
pub use noise::SensorNoise;
pub(crate) use play::play_some;
pub use play::{CHUNK, play};
pub use recording::{MOST_RECORDED, Pose, Recording, TAIL_STEPS};
pub use skeleton::Skeleton;
pub use trial::{Driver, Phase, Player, Trial};

#[cfg(test)]
mod tests;
