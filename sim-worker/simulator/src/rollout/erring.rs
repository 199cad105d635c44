//! The robot of one environment of a training, where drives and masses may err, alone.

use proto::rng::Purpose;

use super::randomization::Randomized;
use super::world::World;
use crate::task::goal::GoalAddress;

/// What errs in one environment of a block.
pub struct Erring(Randomized<f32>);

impl std::fmt::Debug for Erring {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Erring").finish_non_exhaustive()
    }
}

impl Erring {
    /// In environment `env`, counted over all shards, of an iteration of a run with this seed; none if nothing can err there.
    pub fn of_training(world: &World, seed: u64, iteration: u32, env: u32) -> Option<Self> {
        let goals = GoalAddress { seed, purpose: Purpose::Goal, iteration, env };
        let ranges = &world.config.task.randomization;
        Randomized::draw(ranges, (&world.robot, &world.task), (goals, |_| env)).map(Self)
    }

    /// Factors on masses and inertias, of the base first, then of the links of all types of arms; none where masses do not err.
    pub fn mass_factors(&self) -> &[f32] {
        &self.0.mass_factors
    }

    /// The rates that joints have in the next control period where these are commanded (rad/s, arm-major).
    pub fn drive(&mut self, commands: &[f32]) -> &[f32] {
        self.0.drive(commands)
    }
}
