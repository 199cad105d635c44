//! Open loop: commands in, a trajectory out.

use numpy::{PyArrayMethods as _, PyUntypedArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulator::simulate::{Precision, SimulationRow, simulate_from};
use simulator::state::State;
use simulator::step::{Integrator, StepOptions};

use crate::errors::{guarded, runtime, value};
use crate::numbers::{array, by_arm, double};
use crate::robot;
use crate::signals::Looks;

/// Substeps between two looks for signals, but at least a control step: some milliseconds.
const PIECE: usize = 256;

/// Simulates a robot from home under joint velocity commands [T, joints] (rad/s, arm after arm), as `octopus simulate` does.
///
/// Returns arrays by name, a row a control step, after it: "t" [T] (s), "base_position" [T, 3] (m), "base_quaternion" [T, 4] (w first),
/// "base_linear_velocity" [T, 3] (m/s, world), "base_angular_velocity" [T, 3] (rad/s, base axes), "joint_angles" and "joint_rates"
/// [T, arms, J] (rad, rad/s; J are the joints of the longest arm), "hands" [T, arms, 3] (m, world), "contacts" [T] (touching pairs).
///
/// `precision` is "f32", as training runs it, or "f64"; `integrator` "rk3", "rk4" or "euler"; `substep` and `control_period` are in seconds.
/// `ValueError` says what is wrong with an argument, `RuntimeError` that the simulation blew up. Ctrl-C ends it.
#[pyfunction]
#[pyo3(signature = (actions, robot = None, *, precision = "f32", integrator = "rk3", substep = 0.016, control_period = 0.4, contacts = true))]
#[expect(clippy::too_many_arguments, reason = "those of the command line")]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    actions: Bound<'py, PyAny>,
    robot: Option<Bound<'py, PyAny>>,
    precision: &str,
    integrator: &str,
    substep: f64,
    control_period: f64,
    contacts: bool,
) -> PyResult<Bound<'py, PyDict>> {
    guarded(|| {
        let robot = robot::of_argument(robot.as_ref(), "paper")?;
        let single = match precision {
            "f32" => true,
            "f64" => false,
            other => {
                return Err(value(format!("precision {other:?}: expected \"f32\" or \"f64\"")));
            }
        };
        let integrator = match integrator {
            "rk4" => Integrator::Rk4,
            "rk3" => Integrator::Rk3,
            "euler" => Integrator::Euler,
            other => {
                return Err(value(format!(
                    "integrator {other:?}: expected \"rk4\", \"rk3\" or \"euler\""
                )));
            }
        };
        check_steps(control_period, substep)?;
        let n_joints = robot.n_joints();
        let actions = double(&actions, "actions")?;
        let shape = actions.shape().to_vec();
        if shape.len() != 2 || shape[1] != n_joints {
            return Err(value(format!(
                "actions has shape {shape:?}, expected [steps, {n_joints}]"
            )));
        }
        let numbers = actions.try_readonly()?.as_slice()?.to_vec();
        if let Some(at) = numbers.iter().position(|x| !x.is_finite()) {
            return Err(value(format!(
                "step {}, joint {}: the action is {}, expected a finite number",
                at / n_joints,
                at % n_joints,
                numbers[at]
            )));
        }
        let options = StepOptions { control_period, substep, integrator, contacts };
        let precision = if single { Precision::F32 } else { Precision::F64 };
        let rows = py.detach(|| {
            let actions: Vec<Vec<f64>> =
                numbers.chunks_exact(n_joints).map(<[f64]>::to_vec).collect();
            let substeps = (control_period / substep).round() as usize;
            let mut rows: Vec<SimulationRow> = Vec::with_capacity(actions.len());
            let mut looks = Looks::begin();
            for piece in actions.chunks((PIECE / substeps).max(1)) {
                let start =
                    rows.last().map_or_else(|| State::home(&robot), |row| row.state.clone());
                for row in simulate_from(&robot, &start, piece, precision, &options) {
                    let t = (rows.len() + 1) as f64 * control_period;
                    rows.push(SimulationRow { t, ..row });
                }
                looks.look()?;
            }
            Ok::<_, PyErr>(rows)
        })?;
        if let Some(index) = rows.iter().position(|row| !row.state.is_finite()) {
            return Err(runtime(format!(
                "the simulation blew up in step {index}: a number is not finite; a smaller substep may help"
            )));
        }
        let (n, n_arms) = (rows.len(), robot.n_arms);
        let dict = PyDict::new(py);
        let put = |name: &str, numbers: Vec<f64>, shape: &[usize]| {
            dict.set_item(name, array(py, numbers, shape)?)
        };
        put("t", rows.iter().map(|row| row.t).collect(), &[n])?;
        let of = |part: fn(&SimulationRow) -> &[f64]| {
            rows.iter().flat_map(part).copied().collect::<Vec<f64>>()
        };
        put("base_position", of(|row| &row.state.base_position), &[n, 3])?;
        put("base_quaternion", of(|row| &row.state.base_quaternion), &[n, 4])?;
        put("base_linear_velocity", of(|row| &row.state.base_linear_velocity), &[n, 3])?;
        put("base_angular_velocity", of(|row| &row.state.base_angular_velocity), &[n, 3])?;
        let joints = &robot.joints;
        let shape = [n, n_arms, joints.longest_arm()];
        put("joint_angles", by_arm(joints, &of(|row| &row.state.q)), &shape)?;
        put("joint_rates", by_arm(joints, &of(|row| &row.state.qd)), &shape)?;
        put("hands", of(|row| row.hands.as_flattened()), &[n, n_arms, 3])?;
        let contacts = rows.iter().map(|row| row.contacts).collect();
        dict.set_item("contacts", array::<u32>(py, contacts, &[n])?)?;
        Ok(dict)
    })
}

/// The sub-step must fit the control period a whole number of times.
fn check_steps(control_period: f64, substep: f64) -> PyResult<()> {
    if !(1e-4..=10.0).contains(&control_period) {
        return Err(value(format!(
            "control_period {control_period}: choose a time from 0.0001 to 10 s"
        )));
    }
    if !(1e-5..=control_period).contains(&substep) {
        return Err(value(format!(
            "substep {substep}: choose a time from 0.00001 to {control_period} s"
        )));
    }
    let substeps = control_period / substep;
    if (substeps - substeps.round()).abs() > 1e-6 * substeps {
        return Err(value(format!(
            "substep {substep}: does not divide the control period of {control_period} s; choose a whole fraction of it"
        )));
    }
    Ok(())
}
