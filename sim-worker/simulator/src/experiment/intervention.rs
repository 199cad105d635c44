//! What happens in an episode.

use std::ops::Range;

use proto::rng::{Address, Purpose};
use serde::{Deserialize, Serialize};

use super::chunk::Chunk;
use crate::env::draw_normals;
use crate::robot::Joints;
use crate::scalar::Real;
use crate::step::{Disturbance, Wrench};

/// Something that happens in every episode, from a control step on.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervention {
    /// The control steps in which it does.
    pub steps: Range<usize>,
    /// What happens.
    pub effect: Effect,
}

/// What happens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Effect {
    /// Actions are replaced, after clipping and before scaling.
    Action {
        /// The joints, arm-major.
        joints: Range<usize>,
        /// The action (rad/s).
        value: f64,
    },
    /// A force pulls at a hand.
    HandForce {
        /// The arm.
        arm: usize,
        /// World axes (N).
        force: [f64; 3],
    },
    /// A torque turns the base; world axes (N m).
    BaseTorque([f64; 3]),
    /// A torque disturbs every joint, drawn anew in each control step.
    JointTorque {
        /// Standard deviation (N m).
        std: f64,
    },
    /// The servos of an arm give no torque.
    Limp {
        /// The arm.
        arm: usize,
    },
    /// A force and a torque act on a body.
    Wrench {
        /// The body: 0 is the base, 1 + l is link l, arm-major.
        body: usize,
        /// Where the force pulls, fixed to the body: base frame or link frame (m).
        point: [f64; 3],
        /// World axes (N).
        force: [f64; 3],
        /// World axes (N m).
        torque: [f64; 3],
    },
}

/// Episodes in the lanes of a group; lanes beyond the last episode repeat it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes {
    pub(super) envs: Chunk,
    /// The group's first episode among them.
    pub(super) group: usize,
}

impl Lanes {
    /// Fills `out` with standard normal numbers, each lane with its episode's own.
    #[inline(always)]
    pub(super) fn normals<S: Real>(self, purpose: Purpose, step: usize, out: &mut [S]) {
        let Chunk { seed, first, n_envs } = self.envs;
        let address_of = |lane: usize| {
            let env = first + (self.group + lane).min(n_envs - 1) as u32;
            Some(Address { seed, purpose, iteration: 0, env, step: step as u32, index: 0 })
        };
        draw_normals(address_of, out);
    }
}

impl Effect {
    /// Replaces actions.
    #[inline(always)]
    pub(super) fn replace<S: Real>(&self, action: &mut [S]) {
        if let Self::Action { joints, value } = self {
            action[joints.clone()].fill(S::splat(*value));
        }
    }

    /// Adds what acts on the robot; returns whether anything does. `drawn` is scratch memory, `n_joints`.
    #[inline(always)]
    pub(super) fn disturb<S: Real>(
        &self,
        joints: &Joints,
        lanes: Lanes,
        step: usize,
        drawn: &mut [S],
        disturbance: &mut Disturbance<S>,
    ) -> bool {
        match self {
            Self::Action { .. } => return false,
            Self::HandForce { arm, force } => {
                for (slot, component) in disturbance.hand_force[*arm].iter_mut().zip(force) {
                    *slot += S::splat(*component);
                }
            }
            Self::BaseTorque(torque) => {
                for (slot, component) in disturbance.base_torque.iter_mut().zip(torque) {
                    *slot += S::splat(*component);
                }
            }
            Self::JointTorque { std } => {
                lanes.normals(Purpose::JointDisturbance, step, drawn);
                for (slot, normal) in disturbance.joint_torque.iter_mut().zip(drawn) {
                    *slot = normal.mul_add(S::splat(*std), *slot);
                }
            }
            Self::Limp { arm } => disturbance.servo[joints.of_arm(*arm)].fill(S::zero()),
            Self::Wrench { body, point, force, torque } => {
                disturbance.wrenches.push(Wrench {
                    link: body.checked_sub(1),
                    point: point.map(S::splat),
                    force: force.map(S::splat),
                    torque: torque.map(S::splat),
                });
            }
        }
        true
    }
}
