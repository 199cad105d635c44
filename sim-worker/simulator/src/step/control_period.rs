//! A control period: substeps of Runge–Kutta or Euler, and the projection back onto what free flight cannot change.

use super::derivative::{Contacts, derivative};
use super::disturbance::Disturbance;
use super::flat_state::{
    ANGULAR, JOINTS, LINEAR, QUATERNION, base_of, lay_out, normalise, read3, read4, take_back,
};
use super::options::{Integrator, StepOptions};
use crate::dynamics::invariants::{Invariants, invariants};
use crate::model::Model;
use crate::scalar::{Kernel, Real};
use crate::spatial::{Vec6, mul_add, quaternion_exp, quaternion_normalised, quaternion_product};
use crate::state::State;
use crate::workspace::Workspace;

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
    if options.contacts {
        let whole = options.control_period / options.n_whole() as f64;
        ws.contacts.begin_period(model, options.stable_frequency(whole), &state.qd, command);
    }
    lay_out(ws, state);
    let before = if options.integrator == Integrator::Euler {
        None
    } else {
        let base = base_of(&ws.y);
        Some(invariants(model, ws, &base, &state.q, &state.qd))
    };
    let impulse = substeps(model, ws, command, options, disturbance);
    if let Some(mut before) = before {
        let time = S::splat(options.control_period);
        if disturbance.is_some() {
            before.struck(impulse, time);
        }
        restore(model, ws, &before, time);
    }
    take_back(ws, state);
}

/// Takes `ws.y` through the period; returns the impulse of what disturbs.
#[inline(always)]
fn substeps<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    command: &[S],
    options: &StepOptions,
    disturbance: Option<&Disturbance<S>>,
) -> Vec6<S> {
    let stages = stages(options.integrator);
    // The mass at a contact comes from the evaluation before; the first one is made for that alone.
    let mut to_warm_up = options.contacts;
    let mut impulse = Vec6::zero();
    let mut now = 0.0;
    for h in options.substeps() {
        ws.y0.copy_from_slice(&ws.y);
        let mut stage = 0;
        while stage < stages.len() {
            let contacts = match (options.contacts && !to_warm_up, stage) {
                (false, _) => Contacts::Off,
                (true, 0) => Contacts::Find { now, h },
                (true, _) => Contacts::Push,
            };
            // The only call: inlined, it is most of the program.
            derivative(model, ws, command, contacts, disturbance);
            if to_warm_up {
                to_warm_up = false;
                continue;
            }
            if options.integrator == Integrator::Euler {
                euler_update(ws, model.n_joints(), S::splat(h));
                break;
            }
            let (reach, weight) = stages[stage];
            let (weight, reach) = (S::splat(weight * h), S::splat(reach * h));
            if disturbance.is_some() {
                impulse.ang = mul_add(weight, ws.outside.ang, impulse.ang);
                impulse.lin = mul_add(weight, ws.outside.lin, impulse.lin);
            }
            runge_kutta_update(ws, (stage, stages.len()), reach, weight);
            stage += 1;
        }
        now += h;
    }
    impulse
}

/// Runge–Kutta's tableau, a row a stage: how far the next stage reaches, and the weight of this one; Euler uses its first row alone.
#[inline(always)]
fn stages(integrator: Integrator) -> &'static [(f64, f64)] {
    match integrator {
        Integrator::Rk4 => {
            &[(0.5, 1.0 / 6.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 3.0), (0.0, 1.0 / 6.0)]
        }
        Integrator::Rk3 => &[(1.0 / 3.0, 0.25), (2.0 / 3.0, 0.0), (0.0, 0.75)],
        Integrator::Euler => &[(0.0, 1.0)],
    }
}

/// Adds the derivative `ws.k` of a stage to the weighted sum, and puts `ws.y` where the next stage is, or after the last one at the substep's end.
#[inline(always)]
fn runge_kutta_update<S: Real>(
    ws: &mut Workspace<S>,
    (stage, n_stages): (usize, usize),
    reach: S,
    weight: S,
) {
    // One length, so that no index is checked.
    let len = ws.y.len();
    let (y, y0, k, sum) = (&mut ws.y[..len], &ws.y0[..len], &ws.k[..len], &mut ws.sum[..len]);
    if stage == 0 {
        for i in 0..len {
            sum[i] = k[i].mul_add(weight, y0[i]);
            y[i] = k[i].mul_add(reach, y0[i]);
        }
    } else if stage + 1 < n_stages {
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

/// Puts the base of `ws.y` where it has the invariants `before` again, after `time` (s).
#[inline(always)]
fn restore<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, before: &Invariants<S>, time: S) {
    let mut base = base_of(&ws.y);
    // The flat array leaves the workspace while it is lent.
    let y = std::mem::take(&mut ws.y);
    let (q, qd) = y[JOINTS..].split_at(model.n_joints());
    let after = invariants(model, ws, &base, q, qd);
    ws.y = y;
    before.restore(&after, &mut base, time);
    ws.y[..QUATERNION].copy_from_slice(&base.position);
    ws.y[LINEAR..ANGULAR].copy_from_slice(&base.linear);
    ws.y[ANGULAR..JOINTS].copy_from_slice(&base.angular);
}
