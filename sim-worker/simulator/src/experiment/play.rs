//! Plays trials, in chunks on whatever threads there are.

use super::trial_loop::Play;
use super::{Recording, Trial};
use crate::env::EpisodeError;
use crate::executor::{self, Executor};
use crate::scalar::{LANES, dispatch_on};

/// Plays a trial in chunks that `executor` runs, on which the recording does not depend; `on_step` is called after every control step of a chunk of
/// [`CHUNK`] episodes.
pub fn play(
    trial: &Trial<'_>,
    executor: &dyn Executor,
    on_step: &(dyn Fn() + Sync),
) -> Result<Recording, EpisodeError> {
    let mut recording = Recording::new(trial.robot.joints, trial.episodes, trial.steps);
    let chunks = recording.chunks_mut(CHUNK).enumerate().collect();
    executor::for_each(executor, chunks, |(index, series): (usize, &mut [f32])| {
        let first = index * CHUNK;
        let n_envs = CHUNK.min(trial.episodes - first);
        play_some(trial, first, n_envs, series, &mut || on_step())
    })?;
    Ok(recording)
}

/// Episodes that [`play`] plays at a time: two lane groups of sixteen or four of eight, enough to feed the policy's registers, little enough to spread.
pub const CHUNK: usize = 2 * LANES;

/// Plays episodes `first..first + n_envs` of a trial on this thread into their part of a recording.
pub(crate) fn play_some(
    trial: &Trial<'_>,
    first: usize,
    n_envs: usize,
    series: &mut [f32],
    on_step: &mut dyn FnMut(),
) -> Result<(), EpisodeError> {
    trial.check();
    dispatch_on(trial.backend, Play { trial, first: first as u32, n_envs, series, on_step })
}
