//! Sensors that err.

use proto::rng::Purpose;
use serde::{Deserialize, Serialize};

use super::intervention::Lanes;
use crate::scalar::Real;
use crate::spatial::{
    euler_xyz, quaternion_exp, quaternion_normalised, quaternion_product, quaternion_to_rotation,
};
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

    /// Numbers that are drawn in a step for a robot with `n_arms` arms.
    pub(super) fn draws(n_arms: usize) -> usize {
        12 + n_arms * 24
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
        lanes.normals(Purpose::SensorNoise, step, drawn);
        let position = S::splat(self.position);
        let angle = S::splat(self.angle);
        let velocity = S::splat(self.velocity);
        let rate = S::splat(self.rate);
        let (base, rest) = drawn.split_at(12);
        err(&mut readings.base_position, position, &base[..3]);
        let mut turn = [S::zero(); 3];
        err(&mut turn, angle, &base[3..6]);
        readings.base_quaternion = quaternion_normalised(&quaternion_product(
            &readings.base_quaternion,
            &quaternion_exp(turn),
        ));
        readings.base_euler = euler_xyz(&quaternion_to_rotation(&readings.base_quaternion));
        err(&mut readings.base_linear, velocity, &base[6..9]);
        err(&mut readings.base_angular, rate, &base[9..]);
        let n = readings.q.len();
        err(&mut readings.q, angle, &rest[..n]);
        err(&mut readings.qd, rate, &rest[n..2 * n]);
        for (arm, hand) in readings.hands.iter_mut().enumerate() {
            let own = &rest[2 * n + 12 * arm..2 * n + 12 * (arm + 1)];
            err(&mut hand.position, position, &own[..3]);
            err(&mut hand.euler, angle, &own[3..6]);
            err(&mut hand.linear, velocity, &own[6..9]);
            err(&mut hand.angular, rate, &own[9..]);
        }
    }
}

/// Adds `std` times standard normal numbers.
#[inline(always)]
fn err<S: Real>(values: &mut [S], std: S, normals: &[S]) {
    for i in 0..values.len() {
        values[i] = std.mul_add(normals[i], values[i]);
    }
}
