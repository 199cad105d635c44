//! Sensors that err.

use crate::robot::Joints;
use crate::scalar::Real;
use crate::spatial::{
    euler_xyz, quaternion_exp, quaternion_normalised, quaternion_product, quaternion_to_rotation,
};
use crate::task::Readings;

/// Standard deviations of what sensors add to readings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deviations<S> {
    /// Of positions of base and hands, each axis (m).
    pub(crate) position: S,
    /// Of joint angles, of the base's attitude about each axis and of hands' Euler angles (rad).
    pub(crate) angle: S,
    /// Of linear velocities, each axis (m/s).
    pub(crate) velocity: S,
    /// Of joint rates and angular velocities, each axis (rad/s).
    pub(crate) rate: S,
}

impl<S: Real> Deviations<S> {
    /// Standard normal numbers that the errors of a robot with these joints are made of.
    pub(crate) fn draws(joints: &Joints) -> usize {
        12 + 12 * joints.n_arms() + 2 * joints.n_joints()
    }

    /// Adds errors to `readings`, made of `normals`, [`Deviations::draws`] of them.
    #[inline(always)]
    pub(crate) fn add_to(&self, normals: &[S], readings: &mut Readings<S>) {
        let Self { position, angle, velocity, rate } = *self;
        let (base, rest) = normals.split_at(12);
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
