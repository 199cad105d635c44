//! Integration of the equations of motion over a control period.
//!
//! **Why Runge–Kutta of third order at 16 ms.** For the stiffness of contacts that a scheme keeps stable the
//! third order needs fewer evaluations than the fourth, and both are far more accurate than what they are
//! compared with. The start of a period is cut finer, because that is where the servos answer.

use super::disturbance::{Disturbance, disturb_bodies, disturb_joints};
use crate::collision;
use crate::dynamics::aba::{aba, world_acceleration};
use crate::dynamics::invariants::{BaseMotion, invariants};
use crate::dynamics::kinematics::{poses, poses_of_arm, velocities};
use crate::dynamics::servo::{push_of_angle_contacts, servo};
use crate::model::Model;
use crate::scalar::{Kernel, Real};
use crate::spatial::{
    Vec6, mat_t_vec, mul_add, quaternion_exp, quaternion_normalised, quaternion_product,
    quaternion_to_rotation,
};
use crate::state::State;
use crate::workspace::Workspace;

/// Scheme that advances the state by one substep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Classical Runge–Kutta of fourth order; the quaternion is integrated as four numbers and normalised after each substep. At the end of a period
    /// momentum and centre of mass are put right (see `invariants`).
    Rk4,
    /// Heun's Runge–Kutta of third order, otherwise as [`Integrator::Rk4`]: with as many evaluations, contacts a fifth stiffer.
    Rk3,
    /// Semi-implicit Euler: velocities first, positions with the new velocities, the quaternion by the exponential map. MuJoCo's `Euler`.
    Euler,
}

/// How a control period is integrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOptions {
    /// Time a command is held (s).
    pub control_period: f64,
    /// Length of a substep (s); the period is cut into the nearest whole number of equal ones. Runge–Kutta cuts the first one, in which the servos
    /// answer a new command, in a quarter, a quarter and a half.
    pub substep: f64,
    /// Scheme.
    pub integrator: Integrator,
    /// Whether contacts push.
    pub contacts: bool,
}

impl Default for StepOptions {
    /// What training runs: 0.4 s in Runge–Kutta substeps of 16 ms, with contacts.
    ///
    /// Over 20 s of random commands the mean distance to the converged solution is a tenth of what semi-implicit Euler at 1 ms leaves. Two things do
    /// it: the start of a period is cut finer, where torques leave their limits and the servos' fastest mode, 100 /s, decays; and the base is put
    /// right by the invariants. Contacts and that mode, not accuracy, ask for the 16 ms.
    fn default() -> Self {
        Self { control_period: 0.4, substep: 0.016, integrator: Integrator::Rk3, contacts: true }
    }
}

impl StepOptions {
    /// Number of whole substeps in a control period, at least one.
    fn n_whole(&self) -> usize {
        (self.control_period / self.substep).round().max(1.0) as usize
    }

    /// Parts of the first whole substep.
    fn start(&self) -> &'static [f64] {
        match self.integrator {
            Integrator::Rk4 | Integrator::Rk3 => &[0.25, 0.25, 0.5],
            Integrator::Euler => &[1.0],
        }
    }

    /// Lengths of the substeps of a period (s).
    fn substeps(&self) -> impl Iterator<Item = f64> + use<> {
        let (n, start) = (self.n_whole(), self.start());
        let whole = self.control_period / n as f64;
        start.iter().copied().chain(std::iter::repeat_n(1.0, n - 1)).map(move |part| part * whole)
    }

    /// Frequency of contacts (rad/s) up to which substeps of length `h` (s) are stable.
    ///
    /// The largest for which |R(λ h)| < 1 for the modes of a contact, λ² + (2 ζ ω r + c) λ + ω² r = 0, whatever the servo damps on top, c up to 100 /s, and
    /// however wrong the mass is, r from 0.3 to 1.6; with R the scheme's stability function. Semi-implicit Euler ends at ω h = 2 without any of that.
    fn stable_frequency(&self, h: f64) -> f64 {
        let reach = match self.integrator {
            Integrator::Rk4 => 2.0,
            Integrator::Rk3 => 1.8,
            Integrator::Euler => 1.0,
        };
        reach / h
    }
}

// Layout of a flat state: displacement of the base since the period's start, quaternion, velocities, q, q̇. The displacement is small, so
// single precision keeps three digits more than it would in the position.
const QUATERNION: usize = 3;
const LINEAR: usize = 7;
const ANGULAR: usize = 10;
const JOINTS: usize = 13;

/// Advances `state` by one control period with joint rate commands (rad/s) held constant.
///
/// Shape: `command` `n_joints`, arm-major.
///
/// # Panics
/// If the lengths of `command` or of the state differ from the model's.
#[inline(always)]
pub fn step<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &mut State<S>,
    command: &[S],
    options: &StepOptions,
) {
    S::compiled(Step { model, ws, state, command, options, disturbance: None });
}

/// [`step`] while `disturbance` acts, constant over the period.
///
/// # Panics
/// If the lengths of `command`, of the state or of `disturbance` differ from the model's.
#[inline(always)]
pub fn step_disturbed<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &mut State<S>,
    command: &[S],
    options: &StepOptions,
    disturbance: &Disturbance<S>,
) {
    disturbance.check(model);
    S::compiled(Step { model, ws, state, command, options, disturbance: Some(disturbance) });
}

/// The arguments of [`step_disturbed`]; without a disturbance, those of [`step`].
struct Step<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    state: &'a mut State<S>,
    command: &'a [S],
    options: &'a StepOptions,
    disturbance: Option<&'a Disturbance<S>>,
}

impl<S: Real> Kernel<S> for Step<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { model, ws, state, command, options, disturbance } = self;
        advance(model, ws, state, command, options, disturbance);
    }
}

#[inline(always)]
fn advance<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &mut State<S>,
    command: &[S],
    options: &StepOptions,
    disturbance: Option<&Disturbance<S>>,
) {
    let n = model.n_joints();
    assert!(command.len() == n && state.q.len() == n && state.qd.len() == n, "joints");
    let whole = options.control_period / options.n_whole() as f64;
    if options.contacts {
        ws.contacts.begin_period(model, options.stable_frequency(whole), &state.qd, command);
    }
    let mut now = 0.0;

    for i in 0..3 {
        ws.y[i] = S::zero();
        ws.y[LINEAR + i] = state.base_linear_velocity[i];
        ws.y[ANGULAR + i] = state.base_angular_velocity[i];
    }
    for i in 0..4 {
        ws.y[QUATERNION + i] = state.base_quaternion[i];
    }
    ws.y[JOINTS..JOINTS + n].copy_from_slice(&state.q);
    ws.y[JOINTS + n..].copy_from_slice(&state.qd);
    let to_restore = options.integrator != Integrator::Euler;
    let before = if to_restore {
        let base = base_of(&ws.y);
        Some(invariants(model, ws, &base, &state.q, &state.qd))
    } else {
        None
    };

    // Runge–Kutta's tableau; Euler uses its first row alone.
    let stages: &[(f64, f64)] = match options.integrator {
        Integrator::Rk4 => {
            &[(0.5, 1.0 / 6.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 3.0), (0.0, 1.0 / 6.0)]
        }
        Integrator::Rk3 => &[(1.0 / 3.0, 0.25), (2.0 / 3.0, 0.0), (0.0, 0.75)],
        Integrator::Euler => &[(0.0, 1.0)],
    };
    // The mass at a contact comes from the evaluation before; the first one is made for that alone.
    let mut to_warm_up = options.contacts;
    let mut impulse = Vec6::zero();
    for h in options.substeps() {
        ws.y0.copy_from_slice(&ws.y);
        let mut stage = 0;
        while stage < stages.len() {
            let (reach, weight) = stages[stage];
            let contacts = match (options.contacts && !to_warm_up, stage) {
                (false, _) => Contacts::Off,
                (true, 0) => Contacts::Find { now, h },
                (true, _) => Contacts::Push,
            };
            derivative(model, ws, command, contacts, disturbance);
            if to_warm_up {
                to_warm_up = false;
                continue;
            }
            if options.integrator == Integrator::Euler {
                euler_update(ws, n, S::splat(h));
                break;
            }
            let (weight, reach) = (S::splat(weight * h), S::splat(reach * h));
            if disturbance.is_some() {
                impulse.ang = mul_add(weight, ws.outside.ang, impulse.ang);
                impulse.lin = mul_add(weight, ws.outside.lin, impulse.lin);
            }
            // One length, so that no index is checked.
            let len = ws.y.len();
            let (y, y0, k, sum) =
                (&mut ws.y[..len], &ws.y0[..len], &ws.k[..len], &mut ws.sum[..len]);
            if stage == 0 {
                for i in 0..len {
                    sum[i] = k[i].mul_add(weight, y0[i]);
                    y[i] = k[i].mul_add(reach, y0[i]);
                }
            } else if stage + 1 < stages.len() {
                for i in 0..len {
                    sum[i] = k[i].mul_add(weight, sum[i]);
                    y[i] = k[i].mul_add(reach, y0[i]);
                }
            } else {
                for i in 0..len {
                    y[i] = k[i].mul_add(weight, sum[i]);
                }
                normalise(ws);
            }
            stage += 1;
        }
        now += h;
    }

    if let Some(mut before) = before {
        if disturbance.is_some() {
            before.struck(impulse, S::splat(options.control_period));
        }
        let mut base = base_of(&ws.y);
        let y = std::mem::take(&mut ws.y);
        let (q, qd) = y[JOINTS..].split_at(n);
        let after = invariants(model, ws, &base, q, qd);
        ws.y = y;
        before.restore(&after, &mut base, S::splat(options.control_period));
        ws.y[..QUATERNION].copy_from_slice(&base.position);
        ws.y[LINEAR..ANGULAR].copy_from_slice(&base.linear);
        ws.y[ANGULAR..JOINTS].copy_from_slice(&base.angular);
    }
    for i in 0..3 {
        state.base_position[i] += ws.y[i];
        state.base_linear_velocity[i] = ws.y[LINEAR + i];
        state.base_angular_velocity[i] = ws.y[ANGULAR + i];
    }
    for i in 0..4 {
        state.base_quaternion[i] = ws.y[QUATERNION + i];
    }
    state.q.copy_from_slice(&ws.y[JOINTS..JOINTS + n]);
    state.qd.copy_from_slice(&ws.y[JOINTS + n..]);
}

/// What an evaluation does about contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Contacts {
    /// Nothing.
    Off,
    /// Finds contacts and pushes at them: at the start of a substep of length `h`, `now` after the period's (s).
    Find { now: f64, h: f64 },
    /// Pushes at the contacts found.
    Push,
}

/// The derivative of `ws.y` into `ws.k`.
#[inline(always)]
fn derivative<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    command: &[S],
    contacts: Contacts,
    disturbance: Option<&Disturbance<S>>,
) {
    let n = model.n_joints();
    let quaternion = read4(&ws.y, QUATERNION);
    let linear = read3(&ws.y, LINEAR);
    let angular = read3(&ws.y, ANGULAR);
    let r_wb = quaternion_to_rotation(&quaternion);
    ws.base_v = Vec6 { ang: angular, lin: mat_t_vec(&r_wb, linear) };

    // The flat arrays leave the workspace while it is lent.
    let y = std::mem::take(&mut ws.y);
    let mut k = std::mem::take(&mut ws.k);
    let (q, qd) = y[JOINTS..].split_at(n);
    velocities(model, ws, q, qd);
    servo(model, ws, command, qd);
    if let Some(disturbance) = disturbance {
        disturb_joints(ws, disturbance);
    }
    if contacts == Contacts::Off {
        ws.take_off_outside_forces();
    } else {
        push_of_angle_contacts(model, ws, q, qd);
        if let Contacts::Find { now, h } = contacts {
            poses(model, ws);
            if disturbance.is_some() {
                ws.contacts.wake_all();
            }
            collision::find(model, ws, now, h);
        } else {
            for arm in 0..model.n_arms {
                if ws.contacts.touches_arm(arm) {
                    poses_of_arm(model, ws, arm);
                }
            }
        }
        if ws.contacts.any() {
            collision::push(model, ws);
        } else {
            ws.take_off_outside_forces();
        }
    }
    if let Some(disturbance) = disturbance {
        disturb_bodies(model, ws, disturbance, &r_wb, read3(&y, 0));
    }
    let (k_q, k_qd) = k[JOINTS..].split_at_mut(n);
    k_q.copy_from_slice(qd);
    let a = aba(model, ws, qd, k_qd);
    let a_w = world_acceleration(ws.base_v, a, &r_wb);
    let half = S::splat(0.5);
    let [w0, w1, w2] = angular;
    let rate = quaternion_product(&quaternion, &[S::zero(), half * w0, half * w1, half * w2]);
    k[..3].copy_from_slice(&linear);
    k[QUATERNION..LINEAR].copy_from_slice(&rate);
    k[LINEAR..ANGULAR].copy_from_slice(&a_w);
    k[ANGULAR..JOINTS].copy_from_slice(&a.ang);
    ws.y = y;
    ws.k = k;
}

/// Velocities with `ws.k`, then positions with the new velocities.
#[inline(always)]
fn euler_update<S: Real>(ws: &mut Workspace<S>, n: usize, h: S) {
    let (y, k) = (&mut ws.y, &ws.k);
    for i in (LINEAR..JOINTS).chain(JOINTS + n..JOINTS + 2 * n) {
        y[i] = k[i].mul_add(h, y[i]);
    }
    for i in 0..3 {
        y[i] = y[LINEAR + i].mul_add(h, y[i]);
    }
    for i in 0..n {
        y[JOINTS + i] = y[JOINTS + n + i].mul_add(h, y[JOINTS + i]);
    }
    let w = read3(y, ANGULAR);
    let turn = quaternion_exp([w[0] * h, w[1] * h, w[2] * h]);
    let q = quaternion_normalised(&quaternion_product(&read4(y, QUATERNION), &turn));
    y[QUATERNION..LINEAR].copy_from_slice(&q);
}

/// The base's part of a flat state.
#[inline(always)]
fn base_of<S: Real>(y: &[S]) -> BaseMotion<S> {
    BaseMotion {
        position: read3(y, 0),
        quaternion: read4(y, QUATERNION),
        linear: read3(y, LINEAR),
        angular: read3(y, ANGULAR),
    }
}

#[inline(always)]
fn normalise<S: Real>(ws: &mut Workspace<S>) {
    let q = quaternion_normalised(&read4(&ws.y, QUATERNION));
    ws.y[QUATERNION..LINEAR].copy_from_slice(&q);
}

#[inline(always)]
fn read3<S: Real>(y: &[S], at: usize) -> [S; 3] {
    [y[at], y[at + 1], y[at + 2]]
}

#[inline(always)]
fn read4<S: Real>(y: &[S], at: usize) -> [S; 4] {
    [y[at], y[at + 1], y[at + 2], y[at + 3]]
}
