//! The robot as environments use it: a control step, and what can be read off.

use proto::config::{Config, Integrator};

use crate::collision::{Touching, touching};
use crate::dynamics::invariants::{BaseMotion, Invariants, invariants};
use crate::dynamics::servo::servo;
use crate::dynamics::{Hand, hands};
use crate::model::{Masses, Model, Partner};
use crate::robot::Robot;
use crate::scalar::Real;
use crate::spatial::{
    Mat3, Vec3, add, euler_xyz, mat_mat, mat_vec, quaternion_to_rotation, scale, sub,
};
use crate::state::State;
use crate::step::{self, Disturbance, StepOptions, step, step_disturbed};
use crate::task::Readings;
use crate::workspace::Workspace;

/// A robot's dynamics with its scratch memory.
pub(crate) struct Physics<S: Real> {
    model: Model<S>,
    workspace: Workspace<S>,
    options: StepOptions,
    hands: Vec<Hand<S>>,
}

impl<S: Real> Physics<S> {
    /// Integrates as `config` says.
    pub(crate) fn new(config: &Config, robot: &Robot) -> Self {
        Self::with_options(robot, step_options(config))
    }

    /// Integrates as `options` say.
    pub(crate) fn with_options(robot: &Robot, options: StepOptions) -> Self {
        let model = Model::new(robot);
        let workspace = Workspace::new(&model);
        Self { model, workspace, options, hands: vec![Hand::default(); robot.n_arms] }
    }

    /// For how long a command is held (s).
    pub(crate) fn control_period(&self) -> f64 {
        self.options.control_period
    }

    /// Gives all bodies these masses from now on.
    #[inline(always)]
    pub(crate) fn weigh(&mut self, masses: &Masses<S>) {
        self.model.weigh(masses);
    }

    /// Holds joint rate commands (rad/s, arm-major) for a control period.
    #[inline(always)]
    pub(crate) fn step(&mut self, state: &mut State<S>, command: &[S]) {
        step(&self.model, &mut self.workspace, state, command, &self.options);
    }

    /// [`Physics::step`] while something acts on the robot or fails in it.
    #[inline(always)]
    pub(crate) fn step_disturbed(
        &mut self,
        state: &mut State<S>,
        command: &[S],
        disturbance: &Disturbance<S>,
    ) {
        let Self { model, workspace, options, .. } = self;
        step_disturbed(model, workspace, state, command, options, disturbance);
    }

    /// Centre of mass of the robot, world axes (m).
    #[cfg(test)]
    pub(crate) fn centre_of_mass(&mut self, state: &State<S>) -> Vec3<S> {
        self.invariants(state).centre_of_mass()
    }

    fn invariants(&mut self, state: &State<S>) -> Invariants<S> {
        let base = BaseMotion {
            position: state.base_position,
            quaternion: state.base_quaternion,
            linear: state.base_linear_velocity,
            angular: state.base_angular_velocity,
        };
        invariants(&self.model, &mut self.workspace, &base, &state.q, &state.qd)
    }

    /// Moves the robot along so that its centre of mass rests; everything turns as before.
    pub(crate) fn rest_centre_of_mass(&mut self, state: &mut State<S>) {
        let drift = self.invariants(state).velocity();
        state.base_linear_velocity = sub(state.base_linear_velocity, drift);
    }

    /// Reads off everything that tasks use, but for the last action; returns what touches.
    #[inline(always)]
    pub(crate) fn read(&mut self, state: &State<S>, readings: &mut Readings<S>) -> Touching<S> {
        readings.base_position = state.base_position;
        readings.base_quaternion = state.base_quaternion;
        readings.base_euler = euler_xyz(&quaternion_to_rotation(&state.base_quaternion));
        readings.base_linear = state.base_linear_velocity;
        readings.base_angular = state.base_angular_velocity;
        readings.q.copy_from_slice(&state.q);
        readings.qd.copy_from_slice(&state.qd);
        hands(&self.model, &mut self.workspace, state, &mut self.hands);
        for (reading, hand) in readings.hands.iter_mut().zip(&self.hands) {
            reading.position = hand.position;
            reading.euler = euler_xyz(&hand.rotation);
            reading.linear = hand.linear_velocity;
            reading.angular = hand.angular_velocity;
        }
        touching(&self.model, &mut self.workspace, state)
    }

    /// Hands of all arms when the robot was last read.
    pub(crate) fn hands(&self) -> &[Hand<S>] {
        &self.hands
    }
}

impl Physics<f32> {
    /// Axes in the world and origin (m) of a link's frame, or of the base's, of a robot that was read in this state.
    pub(crate) fn body(&self, state: &State<f32>, link: Option<usize>) -> (Mat3<f32>, Vec3<f32>) {
        let r_wb = quaternion_to_rotation(&state.base_quaternion);
        let Some(link) = link else { return (r_wb, state.base_position) };
        let pose = &self.workspace.poses[link];
        (mat_mat(&r_wb, &pose.r), add(state.base_position, mat_vec(&r_wb, pose.o)))
    }

    /// The servos' torques (N m) for `command` (rad/s) at rates `qd` (rad/s); all arm-major.
    pub(crate) fn torques(&mut self, command: &[f32], qd: &[f32], torques: &mut [f32]) {
        servo(&self.model, &mut self.workspace, command, qd);
        for (torque, link) in torques.iter_mut().zip(&self.workspace.links) {
            *torque = link.tau;
        }
    }

    /// The contacts that pushed in the last evaluation of the last step, which led to `state`.
    pub(crate) fn pushes(&self, state: &State<f32>, pushes: &mut Vec<Push<f32>>) {
        pushes.clear();
        let r_wb = quaternion_to_rotation(&state.base_quaternion);
        for contact in self.workspace.contacts.contacts.iter().filter(|c| c.force > 0.0) {
            let pair = &self.model.collision.pairs[contact.pair];
            pushes.push(Push {
                point: add(state.base_position, mat_vec(&r_wb, contact.point)),
                force: mat_vec(&r_wb, scale(contact.force, contact.normal)),
                on: pair.a,
                by: match pair.b {
                    Partner::Link(link) => Some(link),
                    Partner::Fixed(_) => None,
                },
            });
        }
    }
}

/// What tasks read off a robot in this state, but for the last action, which is zero.
pub fn readings<S: Real>(robot: &Robot, state: &State<S>) -> Readings<S> {
    let mut readings = Readings::new(&robot.joints);
    Physics::with_options(robot, StepOptions::default()).read(state, &mut readings);
    readings
}

/// A contact that pushes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push<S> {
    /// Where, in the world (m).
    pub point: Vec3<S>,
    /// Force on the first body, world axes (N).
    pub force: Vec3<S>,
    /// The first body: a link, arm-major.
    pub on: usize,
    /// The second: a link, or the base with what is welded to it.
    pub by: Option<usize>,
}

/// The integration that a configuration describes.
pub fn step_options(config: &Config) -> StepOptions {
    StepOptions {
        control_period: config.env.control_period,
        substep: config.env.substep,
        integrator: match config.env.integrator {
            Integrator::Rk4 => step::Integrator::Rk4,
            Integrator::Rk3 => step::Integrator::Rk3,
            Integrator::Euler => step::Integrator::Euler,
        },
        contacts: config.env.contacts,
    }
}
