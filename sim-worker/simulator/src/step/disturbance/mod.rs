//! What acts on the robot from outside, and what fails in it.
//!
//! It is an option of the step, not a second dynamics. Forces from outside, torques and limp servos are applied
//! in functions of their own, called only where there are any, so what training runs is the code and the bits
//! that it would be without. The projection onto the invariants gets the impulse, and pairs that may touch do not
//! sleep, because commands no longer bound speeds.

use crate::collision;
use crate::dynamics::kinematics::poses_of_arm;
use crate::model::Model;
use crate::robot::Joints;
use crate::scalar::{Kernel, Mask, Real};
use crate::spatial::{Mat3, Vec3, Vec6, add, cross_add, mat_t_vec, mat_vec};
use crate::workspace::Workspace;

/// Forces from outside, torques at the joints, and servos without power, over a control period.
///
/// Training knows none of it: [`step`](super::step) runs the same code without.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance<S> {
    /// Force on each hand, at the origin of its tool frame, world axes (N); length `n_arms`.
    pub hand_force: Vec<Vec3<S>>,
    /// Torque on the base, world axes (N m).
    pub base_torque: Vec3<S>,
    /// Torque added to that of each servo (N m), arm-major; length `n_joints`.
    pub joint_torque: Vec<S>,
    /// Part of its torque that each servo gives, arm-major: one, or zero where the joint is limp. The drive's inertia stays; length `n_joints`.
    pub servo: Vec<S>,
    /// Wrenches on any bodies, as many as there are.
    pub wrenches: Vec<Wrench<S>>,
}

/// A force and a torque on one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench<S> {
    /// The link, arm-major; none is the base.
    pub link: Option<usize>,
    /// Where the force pulls, fixed to the body: link frame, or base frame (m).
    pub point: Vec3<S>,
    /// World axes (N).
    pub force: Vec3<S>,
    /// World axes (N m).
    pub torque: Vec3<S>,
}

impl<S: Real> Disturbance<S> {
    /// No disturbance of a robot with these joints.
    pub fn none(joints: &Joints) -> Self {
        let zero = S::zero();
        Self {
            hand_force: vec![[zero; 3]; joints.n_arms()],
            base_torque: [zero; 3],
            joint_torque: vec![zero; joints.n_joints()],
            servo: vec![S::one(); joints.n_joints()],
            wrenches: Vec::new(),
        }
    }

    /// Asserts that it is one of this robot.
    pub(super) fn check(&self, model: &Model<S>) {
        assert_eq!(self.hand_force.len(), model.n_arms(), "one force an arm");
        let joints = (self.joint_torque.len(), self.servo.len());
        assert_eq!(joints, (model.n_joints(), model.n_joints()), "one torque and servo a joint");
        let mut links = self.wrenches.iter().filter_map(|wrench| wrench.link);
        assert!(links.all(|link| link < model.n_joints()), "links of the robot");
    }
}

/// Weakens the servos' torques and adds those from outside: changes `tau` of `ws.links`.
#[inline(always)]
pub(super) fn disturb_joints<S: Real>(ws: &mut Workspace<S>, disturbance: &Disturbance<S>) {
    S::compiled(OnJoints { ws, disturbance });
}

/// Puts the forces from outside on base and links, on top of the contacts', and leaves their wrench on the whole robot in `ws.outside`.
///
/// `r_wb` is the base's attitude, `travelled` its way since the period's start, world axes (m). Reads the links' `sin` and `cos`; fills `poses` of arms
/// whose hands are pushed at.
#[inline(always)]
pub(super) fn disturb_bodies<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    disturbance: &Disturbance<S>,
    r_wb: &Mat3<S>,
    travelled: Vec3<S>,
) {
    S::compiled(OnBodies { model, ws, disturbance, r_wb, travelled });
}

// In functions of their own, so that the code around them is the same with and without them.

struct OnJoints<'a, S: Real> {
    ws: &'a mut Workspace<S>,
    disturbance: &'a Disturbance<S>,
}

impl<S: Real> Kernel<S> for OnJoints<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { ws, disturbance } = self;
        for i in 0..ws.links.len() {
            let tau = &mut ws.links[i].tau;
            *tau = disturbance.servo[i].mul_add(*tau, disturbance.joint_torque[i]);
        }
    }
}

struct OnBodies<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    disturbance: &'a Disturbance<S>,
    r_wb: &'a Mat3<S>,
    travelled: Vec3<S>,
}

impl<S: Real> Kernel<S> for OnBodies<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, ws, disturbance, r_wb, travelled } = self;
        let torque = disturbance.base_torque;
        ws.base_f_ext.ang = add(ws.base_f_ext.ang, mat_t_vec(r_wb, torque));
        let mut outside = Vec6 { ang: torque, lin: [S::zero(); 3] };
        for arm in 0..model.n_arms {
            let force = disturbance.hand_force[arm];
            let largest = force[0].abs().max(force[1].abs()).max(force[2].abs());
            if !largest.gt(S::zero()).any() {
                continue;
            }
            poses_of_arm(model, ws, arm);
            let last = model.joints.of_arm(arm).end - 1;
            let pose = ws.poses[last];
            let point = add(pose.o, mat_vec(&pose.r, model.arms[arm].tool_position));
            collision::push_link(ws, last, point, mat_t_vec(r_wb, force));
            let from_start = add(travelled, mat_vec(r_wb, point));
            outside.ang = cross_add(from_start, force, outside.ang);
            outside.lin = add(outside.lin, force);
        }
        for wrench in &disturbance.wrenches {
            let force = mat_t_vec(r_wb, wrench.force);
            let torque = mat_t_vec(r_wb, wrench.torque);
            let point = match wrench.link {
                None => {
                    let ext = &mut ws.base_f_ext;
                    ext.ang = cross_add(wrench.point, force, add(ext.ang, torque));
                    ext.lin = add(ext.lin, force);
                    wrench.point
                }
                Some(link) => {
                    poses_of_arm(model, ws, model.joints.arm_of(link));
                    let pose = ws.poses[link];
                    let point = add(pose.o, mat_vec(&pose.r, wrench.point));
                    collision::push_link(ws, link, point, force);
                    let ext = &mut ws.links[link].f_ext;
                    ext.ang = add(ext.ang, mat_t_vec(&pose.r, torque));
                    point
                }
            };
            let from_start = add(travelled, mat_vec(r_wb, point));
            outside.ang = cross_add(from_start, wrench.force, add(outside.ang, wrench.torque));
            outside.lin = add(outside.lin, wrench.force);
        }
        ws.outside = outside;
    }
}

#[cfg(test)]
mod tests;
