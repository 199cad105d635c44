//! Sensors that err.

use proto::rng::Purpose;
use serde::{Deserialize, Serialize};

use super::intervention::Lanes;
use crate::env::Deviations;
use crate::robot::Joints;
use crate::scalar::Real;
use crate::task::Readings;

/// Standard deviations of what sensors add to everything that policies see, drawn anew in each control step, independent and normal.
///
/// Hands are seen by sensors of their own: their errors do not follow from those of the joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorNoise {
    /// Of positions of base and hands, each axis (m).
    pub position: f64,
    /// Of joint angles, of the base's attitude about each axis and of hands' Euler angles (rad).
    pub angle: f64,
    /// Of linear velocities, each axis (m/s).
    pub velocity: f64,
    /// Of joint rates and angular velocities, each axis (rad/s).
    pub rate: f64,
}

impl SensorNoise {
    /// Sensors that do not err.
    pub const NONE: Self = Self { position: 0.0, angle: 0.0, velocity: 0.0, rate: 0.0 };

    /// Whether any sensor errs.
    pub(super) fn any(&self) -> bool {
        *self != Self::NONE
    }

    /// Numbers that are drawn in a step for a robot with these joints.
    pub(super) fn draws(joints: &Joints) -> usize {
        Deviations::<f64>::draws(joints)
    }

    /// Adds errors to `readings`; `drawn` is scratch memory, [`SensorNoise::draws`] numbers.
    #[inline(always)]
    pub(super) fn add_to<S: Real>(
        &self,
        lanes: Lanes,
        step: usize,
        drawn: &mut [S],
        readings: &mut Readings<S>,
    ) {
        let Self { position, angle, velocity, rate } = *self;
        lanes.normals(Purpose::SensorNoise, step, drawn);
        let deviations = Deviations {
            position: S::splat(position),
            angle: S::splat(angle),
            velocity: S::splat(velocity),
            rate: S::splat(rate),
        };
        deviations.add_to(drawn, readings);
    }
}
