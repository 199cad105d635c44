//! What all experiments found.

use crate::experiments::{
    ReportOf, arm_failure, base_mass, disturbance, noise, precision, reassembly,
};

/// What all experiments found.
#[derive(Debug)]
pub(super) struct Reports {
    pub(super) precision: ReportOf<precision::Study>,
    pub(super) disturbance: ReportOf<disturbance::Study>,
    pub(super) arm_failure: ReportOf<arm_failure::Study>,
    pub(super) base_mass: ReportOf<base_mass::Study>,
    pub(super) reassembly: ReportOf<reassembly::Study>,
    pub(super) noise: ReportOf<noise::Study>,
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::LazyLock;

    use super::*;
    use crate::experiments::common::{Beside, Common};
    use crate::experiments::{Experiment, perform};
    use crate::identity::ControllerName;

    pub(in super::super) fn small() -> Common {
        Common { episodes: Some(2), steps: 72, ..Common::default() }
    }

    fn made<E: Experiment>(experiment: &E) -> ReportOf<E> {
        perform(experiment, &experiment.resting_lab()).expect("a report")
    }

    /// What a robot that never moves by itself leads to.
    pub(in super::super) fn reports() -> &'static Reports {
        static REPORTS: LazyLock<Reports> = LazyLock::new(|| {
            let common = small();
            Reports {
                precision: made(&precision::Study { common: common.clone(), agents: false }),
                disturbance: made(&disturbance::Study {
                    common: common.clone(),
                    at: 40,
                    ..disturbance::Study::default()
                }),
                arm_failure: made(&arm_failure::Study {
                    common: common.clone(),
                    ..arm_failure::Study::default()
                }),
                base_mass: made(&base_mass::Study {
                    common: common.clone(),
                    masses: vec![200.0, 400.0],
                    ..base_mass::Study::default()
                }),
                reassembly: made(&reassembly::Study {
                    common: common.clone(),
                    ..reassembly::Study::default()
                }),
                noise: made(&noise::Study {
                    common,
                    sensors: vec![0.0, 5.0],
                    torques: vec![0.0, 5.0],
                    delays: vec![0.0],
                    arm_masses: vec![1.0],
                    beside: vec![Beside::Controller(ControllerName::Jacobian)],
                }),
            }
        });
        &REPORTS
    }
}
