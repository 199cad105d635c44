//! The ways to disturb, as the released scripts do it and from outside.

use proto::agents::Joints;
use std::fmt;
use std::ops::Range;

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::experiment::{Effect, Intervention};

use super::study::Study;

/// Steps in which the released script overwrites the actions of the base's task.
pub(super) const BASE_STEPS: usize = 5;
/// What it overwrites them with, and the shoulder lift's action of the trajectory task (rad/s, before scaling).
const BASE_ACTION: f64 = 1.0;
const LIFT_ACTION: f64 = 1.3;

/// What disturbs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Disturbance {
    /// Actions are overwritten.
    #[serde(rename = "override")]
    Override,
    /// Something from outside.
    #[serde(rename = "push")]
    Push,
    /// The same, and then the opposite.
    #[serde(rename = "push and pull")]
    PushAndPull,
}

impl Disturbance {
    /// All of them.
    pub(crate) const ALL: [Self; 3] = [Self::Override, Self::Push, Self::PushAndPull];
}

impl fmt::Display for Disturbance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Override => "override",
            Self::Push => "push",
            Self::PushAndPull => "push and pull",
        })
    }
}

/// A way to disturb.
pub(super) struct Case {
    pub(super) name: Disturbance,
    pub(super) what: String,
    /// The steps in which it does.
    pub(super) steps: Range<usize>,
    pub(super) interventions: Vec<Intervention>,
}

/// All ways to disturb a task of a robot with these joints.
pub(super) fn cases(study: &Study, task: TaskName, joints: &Joints) -> Vec<Case> {
    let first = study.at;
    let all_along = |steps: Range<usize>, effect| Intervention { steps, effect };
    // A force that is given and taken back leaves angular momentum, because the hand has moved meanwhile; a torque leaves none.
    let (unit, length, amount): (_, _, Box<dyn Fn(f64) -> Effect>) = if task.reaches() {
        let (arm, force) = (study.arm - 1, study.force);
        let effect = move |sign: f64| Effect::HandForce { arm, force: [sign * force, 0.0, 0.0] };
        (format!("{} N on hand {}", study.force, study.arm), 1, Box::new(effect))
    } else {
        let torque = study.torque;
        let effect = move |sign: f64| Effect::BaseTorque([0.0, 0.0, sign * torque]);
        (format!("{} N m on the base", study.torque), BASE_STEPS, Box::new(effect))
    };
    // The second joint lifts.
    let lift = joints.of_arm(study.arm - 1).start + 1;
    let n_joints = joints.n_joints();
    let (joints, value) =
        if task.reaches() { (lift..lift + 1, LIFT_ACTION) } else { (0..n_joints, BASE_ACTION) };
    let (once, twice) = (first..first + length, first + length..first + 2 * length);
    vec![
        Case {
            name: Disturbance::Override,
            what: if task.reaches() {
                format!("lift of arm {} at {value}", study.arm)
            } else {
                format!("all actions at {value}")
            },
            steps: once.clone(),
            interventions: vec![all_along(once.clone(), Effect::Action { joints, value })],
        },
        Case {
            name: Disturbance::Push,
            what: unit.clone(),
            steps: once.clone(),
            interventions: vec![all_along(once.clone(), amount(1.0))],
        },
        Case {
            name: Disturbance::PushAndPull,
            what: format!("{unit}, then back"),
            steps: first..first + 2 * length,
            interventions: vec![all_along(once, amount(1.0)), all_along(twice, amount(-1.0))],
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_overrides_and_pushes_that_are_taken_back() {
        let study = Study { arm: 3, force: 20.0, at: 10, ..Study::default() };
        let trajectory = cases(&study, TaskName::Trajectory, &Joints::of_sixes(4));
        // Arm 3's lift is joint 13.
        assert_eq!(
            trajectory[0].interventions[0].effect,
            Effect::Action { joints: 13..14, value: 1.3 }
        );
        assert_eq!(trajectory[0].steps, 10..11);
        let base = cases(&study, TaskName::Reorientation, &Joints::of_sixes(4));
        assert_eq!(base[0].interventions[0].effect, Effect::Action { joints: 0..24, value: 1.0 });
        assert_eq!(base[0].steps, 10..15);
        for cases in [trajectory, base] {
            let [push, back] = cases[2].interventions.as_slice() else { panic!("two parts") };
            assert_eq!(push.steps.len(), back.steps.len());
            assert_eq!(push.steps.end, back.steps.start);
            let impulse = |effect: &Effect| match effect {
                Effect::HandForce { force, arm: 2 } => *force,
                Effect::BaseTorque(torque) => *torque,
                other => panic!("{other:?}"),
            };
            let (there, back) = (impulse(&push.effect), impulse(&back.effect));
            for axis in 0..3 {
                assert_eq!(there[axis] + back[axis], 0.0);
            }
            assert_eq!(cases[1].interventions, cases[2].interventions[..1]);
        }
    }
}
