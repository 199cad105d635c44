//! Robots.

use std::path::PathBuf;

use numpy::PyArrayDyn;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use simulator::robot::mjcf::mjcf;
use simulator::robot::{self, MjcfOptions};

use crate::config::read_text;
use crate::errors::{guarded, value};
use crate::numbers::{array, by_arm};

/// A robot: a floating base with arms of two to seven joints.
///
/// `description` is the name of a robot that is built in ("paper", "release") or the path of a robot file. `ValueError` says what is wrong.
#[pyclass(frozen, module = "spaceoctopus")]
#[derive(Debug)]
pub(crate) struct Robot {
    pub(crate) inner: robot::Robot,
}

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (description = PathBuf::from("paper")))]
    fn new(description: PathBuf) -> PyResult<Self> {
        guarded(|| Ok(Self { inner: load(&description)? }))
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Arms.
    #[getter]
    fn n_arms(&self) -> usize {
        self.inner.n_arms
    }

    /// Joints, all arms.
    #[getter]
    fn n_joints(&self) -> usize {
        self.inner.n_joints()
    }

    /// Joints of each arm.
    #[getter]
    fn joints(&self) -> Vec<usize> {
        self.inner.joints.by_arm().collect()
    }

    /// Names of the arms.
    #[getter]
    fn arms(&self) -> Vec<&str> {
        self.inner.arms.iter().map(|arm| arm.name.as_str()).collect()
    }

    /// Joint angles at home (rad), `[arms, J]`, J those of the longest arm; zeros behind the joints of a shorter one.
    #[getter]
    fn home<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (joints, home) = (&self.inner.joints, self.inner.home_q());
        array(py, by_arm(joints, &home), &[joints.n_arms(), joints.longest_arm()])
    }

    /// Largest joint velocity commands (rad/s), `[arms, J]`, J those of the longest arm; zeros behind the joints of a shorter one.
    #[getter]
    fn max_rates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (joints, rates) = (&self.inner.joints, self.inner.max_rates());
        array(py, by_arm(joints, &rates), &[joints.n_arms(), joints.longest_arm()])
    }

    /// Mass of everything (kg).
    #[getter]
    fn total_mass(&self) -> f64 {
        self.inner.total_mass()
    }

    /// The robot that the text of a robot file describes.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        guarded(|| {
            let inner = robot::Robot::from_toml(text, "robot.toml".as_ref()).map_err(value)?;
            Ok(Self { inner })
        })
    }

    /// The description, as a robot file has it.
    fn to_toml(&self) -> String {
        self.inner.to_toml()
    }

    /// The robot as a MuJoCo model (XML).
    #[pyo3(signature = (*, contacts = true))]
    fn to_mjcf(&self, contacts: bool) -> String {
        mjcf(&self.inner, MjcfOptions { contacts })
    }

    /// For `pickle` and `copy`.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((py.get_type::<Self>().getattr("from_toml")?, (self.to_toml(),)))
    }

    fn __repr__(&self) -> String {
        format!("Robot({:?}, n_arms={})", self.inner.name, self.inner.n_arms)
    }
}

/// The robot of that name, or described by that file.
pub(crate) fn load(name: &std::path::Path) -> PyResult<robot::Robot> {
    if let Some(robot) = name.to_str().and_then(robot::Robot::builtin) {
        return Ok(robot);
    }
    let text = read_text(name).map_err(|error| {
        let builtin = robot::Robot::builtin_names().collect::<Vec<_>>().join(", ");
        value(format!(
            "robot {}: {error}; give a TOML file, or one of the built-in robots: {builtin}",
            name.display()
        ))
    })?;
    robot::Robot::from_toml(&text, name).map_err(value)
}

/// The robot that an argument names, or else `otherwise`.
pub(crate) fn of_argument(
    given: Option<&Bound<'_, PyAny>>,
    otherwise: &str,
) -> PyResult<robot::Robot> {
    let Some(given) = given else { return load(otherwise.as_ref()) };
    if let Ok(robot) = given.cast::<Robot>() {
        return Ok(robot.get().inner.clone());
    }
    let path: PathBuf = given.extract().map_err(|_| {
        PyTypeError::new_err("robot: expected a Robot, the name of one that is built in, or a path")
    })?;
    load(&path)
}

/// The robot that an argument names, or else the configuration does; refused where the task asks for more arms than it has.
pub(crate) fn of_config(
    given: Option<&Bound<'_, PyAny>>,
    config: &proto::config::Config,
) -> PyResult<robot::Robot> {
    let robot = of_argument(given, &config.robot.description)?;
    let checked = config.task.name.check_arms(&robot.name, robot.n_arms);
    checked.map_err(|refused| value(format!("{refused}; take another robot or another task")))?;
    Ok(robot)
}
