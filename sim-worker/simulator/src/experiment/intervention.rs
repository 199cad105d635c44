//! What happens in an episode.

use std::ops::Range;

use proto::rng::{Address, Purpose};

use crate::robot::JOINTS_PER_ARM;
use crate::scalar::Real;
use crate::step::Disturbance;

/// Something that happens in every episode, from a control step on.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervention {
    /// The control steps in which it does.
    pub steps: Range<usize>,
    /// What happens.
    pub effect: Effect,
}

/// What happens.
#[derive(Debug, Clone, PartialEq)]
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
}

/// Episodes in the lanes of a group; lanes beyond the last episode repeat it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes {
    pub(super) seed: u64,
    /// Global index of the chunk's first episode, and the group's first in the chunk.
    pub(super) first: u32,
    pub(super) group: usize,
    /// Episodes of the chunk.
    pub(super) n_envs: usize,
}

impl Lanes {
    /// Fills `out` with standard normal numbers, each lane with its episode's own.
    #[inline(always)]
    pub(super) fn normals<S: Real>(self, purpose: Purpose, step: usize, out: &mut [S]) {
        for lane in 0..S::LANES {
            let env = self.first + (self.group + lane).min(self.n_envs - 1) as u32;
            for (index, four) in out.chunks_mut(4).enumerate() {
                let address = Address {
                    seed: self.seed,
                    purpose,
                    iteration: 0,
                    env,
                    step: step as u32,
                    index: index as u32,
                };
                for (slot, normal) in four.iter_mut().zip(address.normals()) {
                    slot.set_lane(lane, f64::from(normal));
                }
            }
        }
    }
}

impl Intervention {
    /// Replaces actions.
    #[inline(always)]
    pub(super) fn replace<S: Real>(&self, action: &mut [S]) {
        if let Effect::Action { joints, value } = &self.effect {
            action[joints.clone()].fill(S::splat(*value));
        }
    }

    /// Adds what acts on the robot; returns whether anything does. `drawn` is scratch memory, `n_joints`.
    #[inline(always)]
    pub(super) fn disturb<S: Real>(
        &self,
        lanes: Lanes,
        step: usize,
        drawn: &mut [S],
        disturbance: &mut Disturbance<S>,
    ) -> bool {
        match &self.effect {
            Effect::Action { .. } => return false,
            Effect::HandForce { arm, force } => {
                for (slot, component) in disturbance.hand_force[*arm].iter_mut().zip(force) {
                    *slot += S::splat(*component);
                }
            }
            Effect::BaseTorque(torque) => {
                for (slot, component) in disturbance.base_torque.iter_mut().zip(torque) {
                    *slot += S::splat(*component);
                }
            }
            Effect::JointTorque { std } => {
                lanes.normals(Purpose::JointDisturbance, step, drawn);
                for (slot, normal) in disturbance.joint_torque.iter_mut().zip(drawn) {
                    *slot = normal.mul_add(S::splat(*std), *slot);
                }
            }
            Effect::Limp { arm } => {
                let first = arm * JOINTS_PER_ARM;
                disturbance.servo[first..first + JOINTS_PER_ARM].fill(S::zero());
            }
        }
        true
    }
}
