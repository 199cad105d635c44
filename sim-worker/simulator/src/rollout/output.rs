//! Where episodes are written: into a block for training.

use std::ops::Range;

use proto::layout::{BlockLayout, Dimensions, EpisodeMetrics};

use super::extremes::Extremes;
use crate::scalar::{LANES, Real};
use crate::task::Errors;

/// The receiver of episodes: a block, at the places of its layout.
pub(crate) struct Output<'a> {
    /// The places.
    pub(crate) layout: &'a BlockLayout,
    /// The memory.
    pub(crate) block: &'a mut [f32],
}

/// Which rows a lane group fills.
#[derive(Clone, Copy)]
pub(crate) struct Row<'a> {
    /// Local index of the environment in the first lane.
    pub(crate) group: usize,
    /// N.
    pub(crate) n_envs: usize,
    /// T.
    pub(crate) n_steps: usize,
    pub(crate) dimensions: &'a Dimensions,
}

impl Output<'_> {
    /// Clears what no step writes: flags that stay zero, and the gaps between arrays.
    pub(crate) fn begin(&mut self) {
        let Self { layout, block } = self;
        block[layout.terminated.clone()].fill(0.0);
        block[layout.truncated.clone()].fill(0.0);
        let arrays = [
            &layout.observation,
            &layout.state,
            &layout.action,
            &layout.log_prob,
            &layout.reward,
            &layout.terminated,
            &layout.truncated,
            &layout.metrics,
        ];
        let mut end = 0;
        for array in arrays {
            block[end..array.start].fill(0.0);
            end = array.end;
        }
        block[end..].fill(0.0);
    }

    /// What agents (`[A][O]`) and critics (`[S]`) see before `step`.
    #[inline(always)]
    pub(crate) fn look<S: Real>(
        &mut self,
        row: Row<'_>,
        step: usize,
        observations: &[S],
        state: &[S],
    ) {
        let Self { layout, block } = self;
        let Row { group, n_envs: n, n_steps, dimensions } = row;
        let o = dimensions.observation;
        for (agent, seen) in observations.chunks_exact(o).enumerate() {
            let at = ((agent * (n_steps + 1) + step) * n + group) * o;
            write_rows(&mut block[from(&layout.observation, at)], n - group, seen);
        }
        if !state.is_empty() {
            let at = (step * n + group) * state.len();
            write_rows(&mut block[from(&layout.state, at)], n - group, state);
        }
    }

    /// What `agent` does in `step`.
    #[inline(always)]
    pub(crate) fn act<S: Real>(
        &mut self,
        row: Row<'_>,
        step: usize,
        agent: usize,
        sample: &[S],
        log_prob: S,
    ) {
        let Self { layout, block } = self;
        let Row { group, n_envs: n, n_steps, .. } = row;
        let at = (agent * n_steps + step) * n + group;
        let actions = from(&layout.action, at * sample.len());
        write_rows(&mut block[actions], n - group, sample);
        write_rows(&mut block[from(&layout.log_prob, at)], n - group, &[log_prob]);
    }

    /// What `step` led to.
    #[inline(always)]
    pub(crate) fn step<S: Real>(&mut self, row: Row<'_>, step: usize, rewards: &[S]) {
        let Self { layout, block } = self;
        let Row { group, n_envs: n, n_steps, .. } = row;
        for (agent, &reward) in rewards.iter().enumerate() {
            let at = (agent * n_steps + step) * n + group;
            write_rows(&mut block[from(&layout.reward, at)], n - group, &[reward]);
        }
        if step + 1 == n_steps {
            let last = from(&layout.truncated, step * n + group);
            let lanes = S::LANES.min(n - group);
            block[last][..lanes].fill(1.0);
        }
    }

    /// The metrics of finished episodes.
    #[inline(always)]
    pub(crate) fn end<S: Real>(
        &mut self,
        row: Row<'_>,
        errors: &Errors<S>,
        extremes: &Extremes<S>,
    ) {
        let Self { layout, block } = self;
        let Row { group, n_envs: n, dimensions, .. } = row;
        let k = dimensions.n_metrics;
        let places = EpisodeMetrics::new(dimensions.n_arms);
        let metrics = &mut block[from(&layout.metrics, group * k)];
        for lane in 0..S::LANES.min(n - group) {
            let out = &mut metrics[lane * k..(lane + 1) * k];
            let mut put = |range: Range<usize>, values: &[S]| {
                for (slot, value) in out[range].iter_mut().zip(values) {
                    *slot = value.lane(lane) as f32;
                }
            };
            let one = |place: usize| place..place + 1;
            put(places.final_position.clone(), &errors.position_norm);
            put(places.final_orientation.clone(), &errors.orientation_norm);
            put(places.min_position.clone(), &extremes.position);
            put(places.min_orientation.clone(), &extremes.orientation);
            put(one(places.final_base), &[errors.base_norm]);
            put(one(places.min_base), &[extremes.base]);
            put(one(places.contact_steps), &[extremes.contact_steps]);
            put(one(places.contact_pairs), &[extremes.contact_pairs]);
        }
    }
}

/// The part of `array` from its element `at` on.
#[inline(always)]
fn from(array: &Range<usize>, at: usize) -> Range<usize> {
    array.start + at..array.end
}

/// Turns lanes into rows: `rows[lane][feature] = features[feature][lane]`, for at most `n` lanes.
#[inline(always)]
pub(crate) fn write_rows<S: Real>(rows: &mut [f32], n: usize, features: &[S]) {
    let width = features.len();
    let lanes = S::LANES.min(n);
    let rows = &mut rows[..lanes * width];
    for (feature, &value) in features.iter().enumerate() {
        let mut values = [0.0_f32; LANES];
        for (i, slot) in values.iter_mut().enumerate().take(S::LANES) {
            *slot = value.lane(i) as f32;
        }
        if lanes == S::LANES {
            for (lane, &value) in values.iter().enumerate().take(S::LANES) {
                rows[lane * width + feature] = value;
            }
        } else {
            for (lane, &value) in values[..lanes].iter().enumerate() {
                rows[lane * width + feature] = value;
            }
        }
    }
}
