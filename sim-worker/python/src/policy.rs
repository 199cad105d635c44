//! Policies: they act, and play episodes.

use std::ffi::CString;
use std::path::PathBuf;

use numpy::{PyArrayDyn, PyArrayMethods as _, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyRuntimeWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulator::evaluate::Evaluation;
use simulator::experiment::{FixedGoals, MOST_RECORDED, Player, Recording, Trial, play};
use simulator::policy;
use simulator::rollout::World;
use simulator::stepping::act;
use simulator::task::Aim;

use crate::errors::{guarded, runtime, value};
use crate::numbers::{array, by_arm, double, has_shape, single_of_any_shape, whole, zeros};
use crate::robot::Robot;
use crate::threads::{Threads, available};
use crate::{checkpoint, config, robot};

/// Most control steps of an episode, and most episodes of an evaluation: those of the command line.
const MOST_STEPS: usize = 100_000;
const MOST_EPISODES: usize = 1_000_000;

/// A trained policy with the world that it acts in.
#[pyclass(frozen, module = "spaceoctopus")]
pub(crate) struct Policy {
    world: World,
    actors: policy::Policy,
    /// Directory of the checkpoint.
    #[pyo3(get)]
    path: PathBuf,
    /// Iterations that it was trained on.
    #[pyo3(get)]
    iteration: u64,
    /// Env-steps that it was trained on.
    #[pyo3(get)]
    env_steps: u64,
}

#[pymethods]
impl Policy {
    /// The policy of a checkpoint: its directory, a run (its newest), RUN:best, RUN:ITERATION, RUN:NAME or RUN:TAG.
    ///
    /// `robot` puts it on another robot with as many arms. Files are held against the manifest's hashes. `ValueError` says what is wrong. The
    /// newest of a run is that of `octopus eval`: its own, and whole; a `RuntimeWarning` names damaged ones that are newer.
    #[staticmethod]
    #[pyo3(signature = (path, *, robot = None))]
    fn load(py: Python<'_>, path: PathBuf, robot: Option<Bound<'_, PyAny>>) -> PyResult<Self> {
        guarded(|| {
            let robot = robot.map(|robot| robot::of_argument(Some(&robot), "")).transpose()?;
            let loaded = py.detach(|| {
                let (found, passed_over) = checkpoint::load(&path)?;
                let shown = found.dir.display();
                let robot = robot.unwrap_or_else(|| found.robot.clone());
                if robot.joints != found.robot.joints {
                    return Err(format!(
                        "{shown}: the policy moves {}, the robot `{}` has {}",
                        found.robot.joints, robot.name, robot.joints
                    ));
                }
                let world = World::new(&found.config, &robot);
                let actors = world.policy(&found.parameters);
                let actors = actors.map_err(|error| format!("{shown}: {error}"))?;
                let checkpoint::Checkpoint { dir, iteration, env_steps, .. } = found;
                Ok((Self { world, actors, path: dir, iteration, env_steps }, passed_over))
            });
            let (policy, passed_over) = loaded.map_err(value)?;
            for error in passed_over {
                let message = format!("a damaged checkpoint is passed over: {error}");
                let category = py.get_type::<PyRuntimeWarning>();
                PyErr::warn(py, &category, &CString::new(message)?, 1)?;
            }
            Ok(policy)
        })
    }

    /// Mean actions for observations [N, A, O], as [N, A, U], or for [A, O], as [A, U]; float32, before clipping and scaling.
    ///
    /// The observations are a batch's of the policy's own configuration (`policy.config`). `ValueError` for another shape or numbers that
    /// are not finite.
    fn act<'py>(
        &self,
        py: Python<'py>,
        observation: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        guarded(|| {
            let sizes = &self.world.dimensions;
            let observation = single_of_any_shape(observation, "observation")?;
            let leading = match observation.shape() {
                [n, _, _] => Some(*n),
                _ => None,
            };
            let seen = [sizes.n_agents, sizes.observation];
            let done = [sizes.n_agents, sizes.n_actions];
            let shape =
                |n: Option<usize>, rest: [usize; 2]| n.into_iter().chain(rest).collect::<Vec<_>>();
            has_shape(&observation, "observation", &shape(leading, seen))?;
            let observation = observation.try_readonly()?;
            let observation = observation.as_slice()?;
            let actions = zeros(py, &shape(leading, done))?;
            let mut lent = actions.try_readwrite()?;
            let slots = lent.as_slice_mut()?;
            let threads = Threads::new(available());
            let result = py.detach(|| {
                let seen = (leading.unwrap_or(1), observation);
                act(&self.world, &self.actors, seen, &threads, slots)
            });
            threads.interrupted()?;
            result.map_err(value)?;
            drop(lent);
            Ok(actions)
        })
    }

    /// Plays held-out episodes with mean actions, as `octopus eval` does; the figures are those of its `--json`.
    ///
    /// Returns {"steps": …, "episodes": [{"hands": [{"position": {"min", "last", "tail"} (m), "orientation": … (rad)}], "base": … (rad),
    /// "contact_steps", "contact_pairs", "contact_steps_by_kind", "end"}]}.
    #[pyo3(signature = (episodes = 30, steps = 200, *, seed = 0))]
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole)] episodes: usize,
        #[pyo3(from_py_with = whole)] steps: usize,
        #[pyo3(from_py_with = whole)] seed: u64,
    ) -> PyResult<Bound<'py, PyAny>> {
        guarded(|| {
            within("episodes", episodes, MOST_EPISODES)?;
            within("steps", steps, MOST_STEPS)?;
            within("episodes times steps", episodes * steps, MOST_RECORDED)?;
            let trial = Trial::new(Player::new(&self.world, &self.actors), seed, episodes, steps);
            let recording = played(py, &trial)?;
            let text =
                py.detach(|| serde_json::to_string(&Evaluation::of_task(&self.world, &recording)));
            py.import("json")?.call_method1("loads", (text.map_err(runtime)?,))
        })
    }

    /// Plays one held-out episode with mean actions; returns arrays by name, a row a control step, after it.
    ///
    /// "hand_error" [T, arms, 6] (goal − actual: m and Euler angles in rad, world), "base_error" [T, 3] (rad), "base_position" [T, 3] (m),
    /// "base_quaternion" [T, 4] (w first), "base_angular_velocity" [T, 3] (rad/s, base axes), "joint_angles" [T, arms, J] (rad), "contacts"
    /// [T, 4] (touching pairs: arm and base, arm and mount, arm and itself, two arms).
    ///
    /// `hand_goal` [arms, 6] (m and Euler angles in rad, world) and `base_goal` [3] (rad) replace the episode's; where all of a goal is NaN, it stays. `ValueError`
    /// for a goal of what the policy does not move to a goal.
    #[pyo3(signature = (episode = 0, steps = 200, *, seed = 0, hand_goal = None, base_goal = None))]
    fn play<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole)] episode: u32,
        #[pyo3(from_py_with = whole)] steps: usize,
        #[pyo3(from_py_with = whole)] seed: u64,
        hand_goal: Option<Bound<'py, PyAny>>,
        base_goal: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        guarded(|| {
            within("steps", steps, MOST_STEPS)?;
            let mut trial = Trial::new(Player::new(&self.world, &self.actors), seed, 1, steps);
            trial.goals.env = episode;
            trial.fixed = fixed(&self.world, hand_goal.as_ref(), base_goal.as_ref())?;
            recorded(py, &played(py, &trial)?)
        })
    }

    /// What it was trained with.
    #[getter]
    fn config(&self) -> config::Config {
        config::Config { inner: self.world.config.clone() }
    }

    /// The robot.
    #[getter]
    fn robot(&self) -> Robot {
        Robot { inner: self.world.robot.clone() }
    }

    /// The task that it learned.
    #[getter]
    fn task(&self) -> &'static str {
        self.world.task.name.as_str()
    }

    /// A: agents, two an arm.
    #[getter]
    fn n_agents(&self) -> usize {
        self.world.dimensions.n_agents
    }

    fn __repr__(&self) -> String {
        let (path, task) = (self.path.display(), self.task());
        format!("Policy({path}, task={task:?}, iteration={})", self.iteration)
    }
}

fn within(what: &str, found: usize, most: usize) -> PyResult<()> {
    if (1..=most).contains(&found) {
        return Ok(());
    }
    Err(value(format!("{what} is {found}, expected 1 to {most}")))
}

/// Plays a trial on all processors.
fn played(py: Python<'_>, trial: &Trial<'_>) -> PyResult<Recording> {
    let threads = Threads::new(available());
    let result = py.detach(|| play(trial, &threads, &|| {}));
    threads.interrupted()?;
    result.map_err(runtime)
}

/// Goals that are given; a row of NaN stands for one that is drawn. Refused, as by `octopus film`, are those that the policy does not move to.
fn fixed(
    world: &World,
    hands: Option<&Bound<'_, PyAny>>,
    base: Option<&Bound<'_, PyAny>>,
) -> PyResult<FixedGoals> {
    let task = world.task.name;
    let meant = |is_meant: bool, what: &str| {
        let refused =
            || value(format!("{what} has no meaning here: the policy learned `{}`", task.as_str()));
        if is_meant { Ok(()) } else { Err(refused()) }
    };
    let mut fixed = FixedGoals::default();
    if let Some(given) = hands {
        let goals = double(given, "hand_goal")?;
        has_shape(&goals, "hand_goal", &[world.dimensions.n_arms, 6])?;
        let numbers = goals.try_readonly()?.as_slice()?.to_vec();
        for (arm, pose) in numbers.as_chunks::<6>().0.iter().enumerate() {
            fixed.hands.push(if pose.iter().all(|x| x.is_nan()) {
                None
            } else {
                let what = format!("hand_goal[{arm}]");
                sensible(&what, pose)?;
                meant(task.reaches() && world.task.aims[arm] == Aim::Hand, &what)?;
                Some(*pose)
            });
        }
    }
    if let Some(given) = base {
        let goal = double(given, "base_goal")?;
        has_shape(&goal, "base_goal", &[3])?;
        let numbers = goal.try_readonly()?.as_slice()?.to_vec();
        let attitude = <[f64; 3]>::try_from(numbers.as_slice()).expect("three numbers");
        if !attitude.iter().all(|x| x.is_nan()) {
            sensible("base_goal", &attitude)?;
            meant(task.turns(), "base_goal")?;
            fixed.base = Some(attitude);
        }
    }
    Ok(fixed)
}

/// Refuses goals that are a mistake, as `octopus eval --goals` does (m, rad).
fn sensible(what: &str, numbers: &[f64]) -> PyResult<()> {
    match numbers.iter().find(|x| !(-1000.0..=1000.0).contains(*x)) {
        None => Ok(()),
        Some(found) => Err(value(format!("{what} holds {found}, expected -1000 to 1000"))),
    }
}

/// A recording of one episode as arrays by name.
fn recorded<'py>(py: Python<'py>, recording: &Recording) -> PyResult<Bound<'py, PyDict>> {
    let (n_arms, steps) = (recording.n_arms(), recording.steps());
    let dict = PyDict::new(py);
    let put = |name: &str, numbers: Vec<f32>, shape: &[usize]| {
        dict.set_item(name, array(py, numbers, shape)?)
    };
    let each = || 0..steps;
    let hands =
        each().flat_map(|step| (0..n_arms).flat_map(move |arm| recording.hand(0, step, arm)));
    put("hand_error", hands.collect(), &[steps, n_arms, 6])?;
    put("base_error", each().flat_map(|step| recording.base(0, step)).collect(), &[steps, 3])?;
    let rates = each().flat_map(|step| recording.base_rate(0, step)).collect();
    put("base_angular_velocity", rates, &[steps, 3])?;
    let poses: Vec<_> = each().map(|step| recording.pose(0, step)).collect();
    let positions = poses.iter().flat_map(|pose| pose.base_position).collect();
    put("base_position", positions, &[steps, 3])?;
    let quaternions = poses.iter().flat_map(|pose| pose.base_quaternion).collect();
    put("base_quaternion", quaternions, &[steps, 4])?;
    let joints: Vec<f32> = poses.into_iter().flat_map(|pose| pose.joints).collect();
    let of_robot = recording.joints();
    let shape = [steps, n_arms, of_robot.longest_arm()];
    put("joint_angles", by_arm(of_robot, &joints), &shape)?;
    let contacts: Vec<u32> = each().flat_map(|step| recording.contacts(0, step)).collect();
    let kinds = contacts.len() / steps;
    dict.set_item("contacts", array(py, contacts, &[steps, kinds])?)?;
    Ok(dict)
}
