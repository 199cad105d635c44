//! Many environments in NumPy's arrays.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods as _};
use proto::layout::Dimensions;
use pyo3::prelude::*;
use simulator::rollout::World;
use simulator::stepping::{self, ARRAYS, Begin, GoalKind, Rows, StepError};

use crate::errors::{guarded, runtime, value};
use crate::numbers::{single, whole, whole_or_none, zeros};
use crate::robot::Robot;
use crate::threads::{Threads, available};
use crate::{config, robot};

/// Environments of a batch, at most.
const MOST_ENVS: usize = 1 << 20;

type Floats = Py<PyArrayDyn<f32>>;

/// Many environments that are stepped together, all agents at once.
///
/// Letters: N environments, A agents, O numbers that an agent sees, S numbers that critics see. U actions of an agent. Agent 2i moves the first
/// half of the joints of arm i, agent 2i + 1 the others. All arrays are float32 and stay the same objects: `reset` and `step` fill them in place, so copy what you
/// keep.
///
/// `config` is the name of a preset ("guided", "tuned", "paper", "release", "robust"), the path of a TOML file, or a `Config`; `task` and `set` are
/// as in `octopus train`; `robot` is a `Robot`, a name or a path. `threads` is how many work in a step, all processors by default; no
/// number depends on it. Episodes are `task.episode_steps` long, begin and end together, and are truncated at their end.
///
/// One thread at a time may call it. Two batches are independent, and nothing is left to processes that fork.
#[pyclass(frozen, module = "spaceoctopus")]
pub(crate) struct Batch {
    world: Arc<World>,
    n_envs: usize,
    threads: usize,
    open: Mutex<Open>,
    arrays: [Floats; ARRAYS],
    truncated: Py<PyArray1<bool>>,
}

/// What a step changes; nothing is left of it in a batch that was closed.
struct Open {
    batch: Option<stepping::Batch>,
    /// The next episodes', but for those of evaluations.
    next: Begin,
    /// First environment of the next episodes of an evaluation.
    evaluated: u32,
}

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (n_envs, config = None, *, task = None, set = Vec::new(), robot = None, threads = None))]
    fn new(
        py: Python<'_>,
        #[pyo3(from_py_with = whole)] n_envs: usize,
        config: Option<Bound<'_, PyAny>>,
        task: Option<&str>,
        set: Vec<String>,
        robot: Option<Bound<'_, PyAny>>,
        #[pyo3(from_py_with = whole_or_none)] threads: Option<usize>,
    ) -> PyResult<Self> {
        guarded(|| {
            if !(1..=MOST_ENVS).contains(&n_envs) {
                return Err(value(format!("n_envs is {n_envs}, expected 1 to {MOST_ENVS}")));
            }
            if threads == Some(0) {
                return Err(value("threads is 0, expected 1 or more, or None for all processors"));
            }
            let config = config::of_argument(config.as_ref(), task, &set)?;
            let robot = robot::of_config(robot.as_ref(), &config)?;
            let threads = threads.unwrap_or_else(available);
            let seed = config.run.seed;
            let world = Arc::new(World::new(&config, &robot));
            let sizes = &world.dimensions;
            let (n, arms) = (n_envs, sizes.n_arms);
            let array = |shape: &[usize]| zeros(py, shape).map(Bound::unbind);
            let arrays = [
                array(&[n, sizes.n_agents, sizes.observation])?,
                array(&[n, sizes.state])?,
                array(&[n, sizes.n_agents])?,
                array(&[n, arms])?,
                array(&[n, arms])?,
                array(&[n])?,
                array(&[n])?,
                array(&[n, arms, 6])?,
                array(&[n, 3])?,
                array(&[n, 13 + 2 * sizes.joints.n_joints()])?,
            ];
            let truncated = PyArray1::from_vec(py, vec![false; n]).unbind();
            let shared = Arc::clone(&world);
            let batch = py.detach(|| stepping::Batch::new(shared, n_envs, threads));
            let next = Begin { seed, iteration: 0, first: 0, goals: GoalKind::Training };
            let open = Mutex::new(Open { batch: Some(batch), next, evaluated: 0 });
            Ok(Self { world, n_envs, threads, open, arrays, truncated })
        })
    }

    /// Begins other episodes, and shows them.
    ///
    /// With a seed, those of iteration 0 of a run with this seed; without one, those of the next iteration (at first, of the
    /// configuration's seed). Environment n has the goals and the start of environment `first` + n of the run. `first` and `goals` stay what
    /// they were until others are asked for, with a seed, too.
    ///
    /// With `goals="evaluation"` goals are those of `octopus eval --seed SEED` and robots start at home: environment n plays episode `first` + n there. With a
    /// seed `first` is 0 unless it is given; without one and without `first` the episodes after those that were begun last are next.
    /// They have no other `iteration` than 0.
    ///
    /// `ValueError` if a value is out of range, `RuntimeError` if the batch is closed.
    #[pyo3(signature = (seed = None, *, iteration = None, first = None, goals = None))]
    fn reset(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole_or_none)] seed: Option<u64>,
        #[pyo3(from_py_with = whole_or_none)] iteration: Option<u32>,
        #[pyo3(from_py_with = whole_or_none)] first: Option<u32>,
        goals: Option<&str>,
    ) -> PyResult<()> {
        guarded(|| {
            let mut open = self.open()?;
            let Open { mut next, mut evaluated, .. } = *open;
            if let Some(seed) = seed {
                (next.seed, next.iteration, evaluated) = (seed, 0, 0);
            }
            next.goals = match goals {
                None => next.goals,
                Some("training") => GoalKind::Training,
                Some("evaluation") => GoalKind::Evaluation,
                Some(other) => {
                    return Err(value(format!(
                        "goals {other:?}: expected \"training\" or \"evaluation\""
                    )));
                }
            };
            let is_evaluation = next.goals == GoalKind::Evaluation;
            let begin = if is_evaluation {
                if let Some(other) = iteration.filter(|iteration| *iteration > 0) {
                    return Err(value(format!(
                        "iteration is {other}: goals of an evaluation are those of iteration 0"
                    )));
                }
                Begin { iteration: 0, first: first.unwrap_or(evaluated), ..next }
            } else {
                next.iteration = iteration.unwrap_or(next.iteration);
                next.first = first.unwrap_or(next.first);
                next
            };
            let batch = open.batch.as_mut().ok_or_else(closed)?;
            self.lend(py, batch, |batch, threads, rows| batch.reset(begin, threads, rows))?;
            // All numbers of 32 bits have had their turn after 2³² episodes.
            if is_evaluation {
                evaluated = begin.first.wrapping_add(self.n_envs as u32);
            } else {
                next.iteration = next.iteration.wrapping_add(1);
            }
            (open.next, open.evaluated) = (next, evaluated);
            self.truncated.bind(py).try_readwrite()?.as_slice_mut()?.fill(false);
            Ok(())
        })
    }

    /// Holds actions [N, A, U] for a control step (0.4 s by default), and shows what it led to.
    ///
    /// Actions are joint velocities before `task.action_scale` (0.8 in preset guided); what is beyond the joints' limits is clipped. Float32 in
    /// C order is taken as it is, other real numbers are converted.
    ///
    /// `ValueError` for another shape or a number that is not finite, `TypeError` for what is no number: then nothing has changed.
    /// `RuntimeError` if there is no episode that goes on, the batch is closed, or an environment has diverged. After that, and after a
    /// `KeyboardInterrupt`, it must be reset.
    fn step(&self, py: Python<'_>, actions: &Bound<'_, PyAny>) -> PyResult<()> {
        guarded(|| {
            let mut open = self.open()?;
            let batch = open.batch.as_mut().ok_or_else(closed)?;
            let shape =
                [self.n_envs, self.world.dimensions.n_agents, self.world.dimensions.n_actions];
            let actions = single(actions, "actions", &shape)?;
            let actions = actions.try_readonly()?;
            let actions = actions.as_slice()?;
            self.lend(py, batch, |batch, threads, rows| batch.step(actions, threads, rows))?;
            if batch.is_over() {
                self.truncated.bind(py).try_readwrite()?.as_slice_mut()?.fill(true);
            }
            Ok(())
        })
    }

    /// Gives the environments' memory back. Arrays stay as they are.
    fn close(&self) -> PyResult<()> {
        self.open()?.batch = None;
        Ok(())
    }

    /// Whether it was closed.
    #[getter]
    fn closed(&self) -> PyResult<bool> {
        Ok(self.open()?.batch.is_none())
    }

    /// Control steps since the start; `None` if no episode goes on.
    #[getter]
    fn steps(&self) -> PyResult<Option<usize>> {
        Ok(self.open()?.batch.as_ref().and_then(stepping::Batch::steps))
    }

    /// N: environments.
    #[getter]
    fn n_envs(&self) -> usize {
        self.n_envs
    }

    /// A: agents, two an arm.
    #[getter]
    fn n_agents(&self) -> usize {
        self.world.dimensions.n_agents
    }

    /// Joints that each agent moves: so many of its actions mean something.
    #[getter]
    fn joints_of_agents(&self) -> Vec<usize> {
        let Dimensions { joints, n_agents, .. } = self.world.dimensions;
        (0..n_agents).map(|agent| joints.of_agent(agent).len()).collect()
    }

    /// Control steps of an episode.
    #[getter]
    fn episode_steps(&self) -> usize {
        self.world.dimensions.n_steps
    }

    /// Threads that work in a step.
    #[getter]
    fn threads(&self) -> usize {
        self.threads
    }

    /// Limits of the actions (rad/s before scaling), `[A, U]`: what is beyond is clipped. U is 3 where arms have six joints, 4 where one has seven.
    #[getter]
    fn action_limit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let limits: Vec<f32> = self.world.task.action_limit.iter().map(|&x| x as f32).collect();
        let Dimensions { joints, n_agents, n_actions, .. } = self.world.dimensions;
        crate::numbers::array(
            py,
            crate::numbers::by_agent(&joints, &limits),
            &[n_agents, n_actions],
        )
    }

    /// What it is configured with.
    #[getter]
    fn config(&self) -> config::Config {
        config::Config { inner: self.world.config.clone() }
    }

    /// The robot.
    #[getter]
    fn robot(&self) -> Robot {
        Robot { inner: self.world.robot.clone() }
    }

    /// What agents see, [N, A, O].
    #[getter]
    fn observation(&self, py: Python<'_>) -> Floats {
        self.arrays[0].clone_ref(py)
    }

    /// What critics see, [N, S].
    #[getter]
    fn state(&self, py: Python<'_>) -> Floats {
        self.arrays[1].clone_ref(py)
    }

    /// Rewards of the last step, [N, A]; zero after a reset.
    #[getter]
    fn reward(&self, py: Python<'_>) -> Floats {
        self.arrays[2].clone_ref(py)
    }

    /// Norm of every hand's position error, [N, arms] (m).
    #[getter]
    fn position_error(&self, py: Python<'_>) -> Floats {
        self.arrays[3].clone_ref(py)
    }

    /// Norm of every hand's Euler-angle difference, [N, arms] (rad).
    #[getter]
    fn orientation_error(&self, py: Python<'_>) -> Floats {
        self.arrays[4].clone_ref(py)
    }

    /// Norm of the base's Euler-angle difference, [N] (rad).
    #[getter]
    fn base_error(&self, py: Python<'_>) -> Floats {
        self.arrays[5].clone_ref(py)
    }

    /// Touching pairs of bodies, [N].
    #[getter]
    fn touching_pairs(&self, py: Python<'_>) -> Floats {
        self.arrays[6].clone_ref(py)
    }

    /// Where hands shall go, [N, arms, 6]: position (m) and Euler angles x-y-z (rad), world.
    #[getter]
    fn hand_goal(&self, py: Python<'_>) -> Floats {
        self.arrays[7].clone_ref(py)
    }

    /// Where the base shall turn, [N, 3]: Euler angles x-y-z (rad), world.
    #[getter]
    fn base_goal(&self, py: Python<'_>) -> Floats {
        self.arrays[8].clone_ref(py)
    }

    /// Robots, [N, 13 + 2·joints]: base position (m), quaternion (w, x, y, z), linear velocity (m/s, world), angular velocity (rad/s,
    /// base axes), joint angles (rad), joint rates (rad/s), arm after arm.
    #[getter]
    fn robot_state(&self, py: Python<'_>) -> Floats {
        self.arrays[9].clone_ref(py)
    }

    /// Whether the episode was over with the last step, bool [N].
    #[getter]
    fn truncated(&self, py: Python<'_>) -> Py<PyArray1<bool>> {
        self.truncated.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        let World { config, robot, .. } = self.world.as_ref();
        let task = config.task.name.as_str();
        format!("Batch({}, task={task:?}, robot={:?})", self.n_envs, robot.name)
    }
}

impl Batch {
    /// What a step changes, unless somebody else is at it: another thread, or one of the process that this one was forked from.
    fn open(&self) -> PyResult<MutexGuard<'_, Open>> {
        match self.open.try_lock() {
            Ok(open) => Ok(open),
            // A panic leaves the batch unfinished, which it says itself.
            Err(TryLockError::Poisoned(open)) => Ok(open.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(runtime("the batch is being stepped by another thread"))
            }
        }
    }

    /// Lends all arrays to `work`, without Python's lock.
    fn lend(
        &self,
        py: Python<'_>,
        batch: &mut stepping::Batch,
        work: impl FnOnce(&mut stepping::Batch, &Threads, Rows<'_>) -> Result<(), StepError> + Send,
    ) -> PyResult<()> {
        let mut lent = Vec::with_capacity(self.arrays.len());
        for array in &self.arrays {
            lent.push(array.bind(py).try_readwrite()?);
        }
        let mut slices = Vec::with_capacity(ARRAYS);
        for array in &mut lent {
            slices.push(array.as_slice_mut()?);
        }
        let rows = Rows::of_arrays(slices.try_into().expect("one of each array"));
        let threads = Threads::new(self.threads);
        let result = py.detach(|| work(batch, &threads, rows));
        threads.interrupted()?;
        result.map_err(|error| match error {
            StepError::NotBegun
            | StepError::Over { .. }
            | StepError::Unfinished
            | StepError::Episode(_) => runtime(error),
            error => value(error),
        })
    }
}

fn closed() -> PyErr {
    runtime("the batch is closed")
}
