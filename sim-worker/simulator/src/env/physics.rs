//! The dynamics as environments use them: home, a control step, and what can be read off.

use proto::config::{Config, Integrator};
use proto::layout::JOINTS_PER_AGENT;

use super::EpisodeError;
use crate::collision::{Touching, touching};
use crate::dynamics::{
    self, Disturbance, Hand, StepOptions, Workspace, hands, step, step_disturbed,
};
use crate::robot::{JOINTS_PER_ARM, Model, Robot};
use crate::scalar::{Mask, Real};
use crate::spatial::{euler_xyz, quaternion_to_rotation};
use crate::state::State;
use crate::task::{Home, HomeArm, Readings};

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
}

/// The integration that a configuration describes.
pub fn step_options(config: &Config) -> StepOptions {
    StepOptions {
        control_period: config.env.control_period,
        substep: config.env.substep,
        integrator: match config.env.integrator {
            Integrator::Rk4 => dynamics::Integrator::Rk4,
            Integrator::Rk3 => dynamics::Integrator::Rk3,
            Integrator::Euler => dynamics::Integrator::Euler,
        },
        contacts: config.env.contacts,
    }
}

/// The robot's home pose, by forward kinematics in `f64`.
pub(crate) fn home(robot: &Robot) -> Home {
    let mut physics = Physics::<f64>::with_options(robot, StepOptions::default());
    let mut readings = Readings::new(robot.n_arms);
    physics.read(&State::home(robot), &mut readings);
    let max_rates = robot.max_rates();
    let arms = robot.arms.iter().enumerate().map(|(index, arm)| HomeArm {
        q: arm.home,
        command_limit: std::array::from_fn(|joint| max_rates[index * JOINTS_PER_ARM + joint]),
        position: readings.hands[index].position,
        euler: readings.hands[index].euler,
        // At home the base's axes are the world's.
        mount: std::array::from_fn(|axis| arm.mount.rotation.column(axis).into_owned().into()),
    });
    Home {
        base_position: readings.base_position,
        base_euler: readings.base_euler,
        arms: arms.collect(),
    }
}

/// Largest sensible magnitudes. Nothing physical comes near them: the servos command at most a few
/// rad/s, and momentum is conserved.
const LIMITS: [(&str, f64); 6] = [
    ("base position (m)", 1e3),
    ("base quaternion", 1.1),
    ("base velocity (m/s)", 1e3),
    ("base angular velocity (rad/s)", 1e3),
    ("joint angle (rad)", 1e4),
    ("joint rate (rad/s)", 1e3),
];

/// Refuses a state with a number that is none or beyond all bounds.
///
/// The group's first lane holds local environment `group` of `n_envs`, the shard's first one has
/// the global index `first`.
#[inline(always)]
pub(crate) fn check<S: Real>(
    state: &State<S>,
    first: u32,
    group: usize,
    n_envs: usize,
    step: usize,
) -> Result<(), EpisodeError> {
    let parts: [&[S]; 6] = [
        &state.base_position,
        &state.base_quaternion,
        &state.base_linear_velocity,
        &state.base_angular_velocity,
        &state.q,
        &state.qd,
    ];
    let mut fine = S::Mask::splat(true);
    for (part, (_, limit)) in parts.iter().zip(LIMITS) {
        let limit = S::splat(limit);
        for x in *part {
            // False for NaN.
            fine = fine & x.abs().le(limit);
        }
    }
    if fine.all() {
        return Ok(());
    }
    for lane in 0..S::LANES.min(n_envs - group) {
        for (part, (quantity, limit)) in parts.iter().zip(LIMITS) {
            for (index, x) in part.iter().enumerate() {
                let value = x.lane(lane);
                if value.abs() <= limit {
                    continue;
                }
                let is_joint = quantity.starts_with("joint");
                return Err(EpisodeError::State {
                    env: first + (group + lane) as u32,
                    step,
                    agent: is_joint.then_some(index / JOINTS_PER_AGENT),
                    quantity,
                    value,
                    limit,
                    moment: None,
                });
            }
        }
    }
    // Only repeated lanes are left, and they repeat a lane that was looked at.
    unreachable!("a lane beyond the last environment differs from the environment it repeats");
}
