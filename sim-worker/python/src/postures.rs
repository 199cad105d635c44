//! Goal postures for whoever runs a policy elsewhere.

use std::sync::Mutex;

use numpy::{PyArrayDyn, PyArrayMethods as _};
use pyo3::prelude::*;
use simulator::robot::Joints;
use simulator::rollout::World;
use simulator::task::{Errors, Goals, Readings};

use crate::config;
use crate::errors::{guarded, runtime, value};
use crate::numbers::{array, single};
use crate::robot;

/// Goal postures of one robot: joint angles that bring its hands to their goals, chosen when a goal is new, then followed.
///
/// `config` and `robot` are as for `Batch`; the configuration must have `task.posture.seen`. What `update` returns is what agents see of them,
/// and the input `postures` of an exported `controller.onnx`.
#[pyclass(frozen, module = "spaceoctopus")]
#[derive(Debug)]
pub(crate) struct Postures {
    joints: Joints,
    known: Mutex<(Errors<f32>, Readings<f32>)>,
}

#[pymethods]
impl Postures {
    #[new]
    #[pyo3(signature = (config = None, *, set = Vec::new(), robot = None))]
    fn new(
        config: Option<Bound<'_, PyAny>>,
        set: Vec<String>,
        robot: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        guarded(|| {
            let config = config::of_argument(config.as_ref(), None, &set)?;
            if !config.task.posture.seen {
                return Err(value(
                    "the configuration has no goal postures: set task.posture.seen=true",
                ));
            }
            let robot = robot::of_config(robot.as_ref(), &config)?;
            let World { task, robot, .. } = World::new(&config, &robot);
            let joints = robot.joints;
            let known = Mutex::new((Errors::of(&task, &robot), Readings::new(&joints)));
            Ok(Self { joints, known })
        })
    }

    /// Looks once a control step: the base's position [3] (m) and attitude [4] (unit quaternion, w first), joint angles [arms, J] (rad; J are the joints of the longest arm), goals of the
    /// hands [arms, 6] (m, and Euler angles x-y-z in rad; world). Returns [arms, 2 + J]: whether each posture brings the hand to its goal (1 or 0),
    /// whether it is free of stops (1 or 0), what is left to each joint (rad).
    ///
    /// `ValueError` for another shape, an attitude that is no unit quaternion, or a number beyond a million: then nothing has changed.
    fn update<'py>(
        &self,
        py: Python<'py>,
        base_position: Bound<'py, PyAny>,
        base_attitude: Bound<'py, PyAny>,
        joint_angles: Bound<'py, PyAny>,
        goals: Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        guarded(|| {
            let (n, room) = (self.joints.n_arms(), self.joints.longest_arm());
            let position = numbers(&base_position, "base_position", &[3])?;
            let attitude = numbers(&base_attitude, "base_attitude", &[4])?;
            let angles = numbers(&joint_angles, "joint_angles", &[n, room])?;
            let goals = numbers(&goals, "goals", &[n, 6])?;
            let square: f32 = attitude.iter().map(|x| x * x).sum();
            if !(0.999..=1.001).contains(&square) {
                return Err(value(format!(
                    "base_attitude has the length {}, expected 1",
                    square.sqrt()
                )));
            }
            let goals = Goals::fixed(goals.as_chunks().0.to_vec(), [0.0; 3]);
            let mut known = self
                .known
                .try_lock()
                .map_err(|_| runtime("another thread updates the postures"))?;
            let (errors, seen) = &mut *known;
            seen.base_position.copy_from_slice(&position);
            seen.base_quaternion.copy_from_slice(&attitude);
            for (arm, angles) in angles.chunks_exact(room).enumerate() {
                let joints = self.joints.of_arm(arm);
                seen.q[joints.clone()].copy_from_slice(&angles[..joints.len()]);
            }
            py.detach(|| errors.update(seen, &goals));
            let found = errors.postures().expect("the task tells them");
            let of_arm = |mut posture: Vec<f32>| {
                posture.resize(2 + room, 0.0);
                posture
            };
            let found: Vec<f32> = found.into_iter().flat_map(of_arm).collect();
            array(py, found, &[n, 2 + room])
        })
    }

    /// Forgets all goals, because another episode begins.
    fn forget(&self) -> PyResult<()> {
        let mut known =
            self.known.try_lock().map_err(|_| runtime("another thread updates the postures"))?;
        known.0.forget();
        Ok(())
    }
}

/// Largest number that is taken, as by an exported controller: squares of larger ones overflow, and what was computed from them stays.
const LARGEST: f32 = 1e6;

/// Numbers of this shape that are none beyond [`LARGEST`].
fn numbers(given: &Bound<'_, PyAny>, what: &str, shape: &[usize]) -> PyResult<Vec<f32>> {
    let numbers = single(given, what, shape)?.try_readonly()?.as_slice()?.to_vec();
    match numbers.iter().find(|x| !(-LARGEST..=LARGEST).contains(*x)) {
        Some(x) => {
            Err(value(format!("{what} has the number {x}, expected {} to {LARGEST}", -LARGEST)))
        }
        None => Ok(numbers),
    }
}
