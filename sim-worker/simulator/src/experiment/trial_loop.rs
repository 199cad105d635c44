//! The loop that plays a trial's episodes, environments in lanes.

use super::Trial;
use super::chunk::Chunk;
use super::recording::record;
use super::stepper::{Aims, Stepper};
use crate::env::EpisodeError;
use crate::scalar::{LaneFn, Real};
use crate::task::goal::GoalAddress;

/// Episodes `first..first + n_envs` of a trial, and where they are recorded.
pub(super) struct Play<'t, 'a> {
    pub(super) trial: &'t Trial<'a>,
    pub(super) first: u32,
    pub(super) n_envs: usize,
    pub(super) series: &'t mut [f32],
    pub(super) on_step: &'t mut dyn FnMut(),
}

impl LaneFn for Play<'_, '_> {
    type Output = Result<(), EpisodeError>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let Self { trial, first, n_envs, series, on_step } = self;
        let Trial { players, interventions, steps, .. } = trial;
        let steps = *steps;
        let envs = Chunk { seed: trial.goals.seed, first, n_envs };
        let drawn = GoalAddress { env: trial.goals.env + first, ..trial.goals };
        let given = trial.given.get(first as usize..).unwrap_or_default();
        let goals = Aims { drawn, given, fixed: &trial.fixed };
        let mut stepper =
            Stepper::<S>::new((trial.robot, trial.options), players, envs, goals, trial.delay);
        stepper.assign(players, &trial.phase(0).arms);
        for step in 0..=steps {
            stepper.read();
            if step > 0 {
                for (index, group) in stepper.groups.iter().enumerate() {
                    record(series, (index * S::LANES, n_envs), (step - 1, steps), group);
                }
            }
            if step == steps {
                break;
            }
            let arms = &trial.phase(step).arms;
            let is_handed_over = step > 0 && trial.phase(step - 1).arms != *arms;
            if is_handed_over && stepper.assign(players, arms) {
                stepper.read();
            }
            stepper.think(players, arms, &trial.sensors, step)?;
            let happening = interventions.iter().filter(|happens| happens.steps.contains(&step));
            let effects = happening.map(|happens| &happens.effect);
            stepper.advance(players, arms, &effects, step)?;
            on_step();
        }
        Ok(())
    }
}
