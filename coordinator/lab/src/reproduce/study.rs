//! What is asked of a reproduction, and what that asks of each experiment.

use std::path::PathBuf;

use proto::ExitError;

use crate::evaluation::{EPISODES_OR_STEPS, check_recorded};
use crate::experiments::common::{Beside, Common};
use crate::experiments::{base_mass, disturbance, noise};
use crate::identity::ControllerName;

/// Episodes of a setting with `--quick`.
const QUICK_EPISODES: u32 = 10;
/// Where a policy of `trajectory` lies beside the others that learned with a robot that errs, if there is one.
const ROBUST: &str = "robust";
/// Coarser settings with `--quick`.
const QUICK_MASSES: [f64; 5] = [100.0, 200.0, 400.0, 700.0, 1000.0];

/// What is asked of a reproduction.
#[derive(Debug, Clone)]
pub struct Study {
    /// A directory that holds `trajectory` and `reorientation`; none with a controller.
    pub policies: Option<PathBuf>,
    /// A controller that is not learned, instead of policies.
    pub controller: Option<ControllerName>,
    /// Runs, or files of learning curves, whose curves the page shows.
    pub curves: Vec<PathBuf>,
    /// Where everything goes.
    pub out: PathBuf,
    /// Fewer episodes and fewer settings.
    pub quick: bool,
    /// Episodes of a setting; as many as each experiment has by itself if none are given.
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    pub steps: u32,
    /// Seed of goals and noise.
    pub seed: u64,
}

/// Refuses episodes that are too short for an experiment, or too many to be recorded.
pub fn check_episodes(episodes: Option<u32>, steps: u32) -> Result<(), ExitError> {
    let (episodes, steps) = (episodes.unwrap_or(1) as usize, steps as usize);
    check_recorded(episodes, steps, EPISODES_OR_STEPS)?;
    disturbance::Study::default().check_steps(steps)
}

impl Study {
    /// What all its experiments share.
    pub(super) fn common(&self) -> Common {
        Common {
            policies: self.policies.clone(),
            controller: self.controller,
            episodes: self.episodes.or(self.quick.then_some(QUICK_EPISODES)),
            steps: self.steps,
            seed: self.seed,
            ..Common::default()
        }
    }

    /// The masses of the base that are tried.
    pub(super) fn base_mass(&self) -> base_mass::Study {
        let study = base_mass::Study { common: self.common(), ..base_mass::Study::default() };
        if self.quick { base_mass::Study { masses: QUICK_MASSES.into(), ..study } } else { study }
    }

    /// The strengths of noise, torques, delay and mass that are; policies beside the yardsticks, and beside those that learned
    /// with a robot that errs.
    pub(super) fn noise(&self) -> noise::Study {
        let robust = self.policies.iter().map(|policies| policies.join(ROBUST));
        let robust = robust.filter(|path| path.exists()).map(Beside::Policy);
        let yardsticks = [ControllerName::Postures, ControllerName::Jacobian];
        let beside = match self.controller {
            None => robust.chain(yardsticks.map(Beside::Controller)).collect(),
            Some(_) => Vec::new(),
        };
        let study = noise::Study { common: self.common(), beside, ..noise::Study::default() };
        if !self.quick {
            return study;
        }
        noise::Study {
            sensors: vec![0.0, 5.0, 20.0, 50.0],
            torques: vec![0.0, 5.0, 20.0],
            arm_masses: vec![0.5, 1.0, 2.0, 3.0],
            ..study
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiments::Experiment as _;
    use crate::experiments::command_line::typed;

    #[test]
    fn the_page_names_commands_that_can_be_typed() {
        let study = Study {
            policies: Some("of mine/it's".into()),
            controller: None,
            curves: Vec::new(),
            out: "x".into(),
            quick: true,
            episodes: None,
            steps: 200,
            seed: 3,
        };
        assert_eq!(
            typed(&study.base_mass().command()),
            "octopus experiment base-mass '--policies=of mine/it'\\''s' --episodes=10 --steps=200 \
             --seed=3 --masses=100,200,400,700,1000 --thresholds=0.01,0.02,0.03,0.05,0.1"
        );
    }
}
