//! Open-loop simulation: a table of joint rate commands in, a table of states out.

use crate::collision::count_contacts;
use crate::dynamics::{Hand, hands};
use crate::model::Model;
use crate::robot::Robot;
use crate::scalar::{LaneFn, Real, dispatch};
use crate::state::State;
use crate::step::{StepOptions, step};
use crate::workspace::Workspace;

/// Scalar a simulation runs in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Double precision, the reference.
    F64,
    /// Single precision on lanes, exactly as training runs it.
    F32,
}

/// State after a control step.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationRow {
    /// Time since the start (s).
    pub t: f64,
    /// State of the robot.
    pub state: State<f64>,
    /// Positions of the hands in the world (m).
    pub hands: Vec<[f64; 3]>,
    /// Number of touching pairs.
    pub contacts: u32,
}

/// Runs the robot from home through `actions`, one row of joint rate commands (rad/s, arm-major, `n_joints`) a control step.
///
/// # Panics
/// If a row has another length than `n_joints`.
pub fn simulate(
    robot: &Robot,
    actions: &[Vec<f64>],
    precision: Precision,
    options: &StepOptions,
) -> Vec<SimulationRow> {
    simulate_from(robot, &State::home(robot), actions, precision, options)
}

/// [`simulate`] from another state than home; it is rounded to the precision first.
///
/// # Panics
/// If a row has another length than `n_joints`, or the state another number of joints.
pub fn simulate_from(
    robot: &Robot,
    start: &State<f64>,
    actions: &[Vec<f64>],
    precision: Precision,
    options: &StepOptions,
) -> Vec<SimulationRow> {
    let run = OpenLoop { robot, start, actions, options };
    match precision {
        Precision::F64 => run.call::<f64>(),
        Precision::F32 => dispatch(run),
    }
}

struct OpenLoop<'a> {
    robot: &'a Robot,
    start: &'a State<f64>,
    actions: &'a [Vec<f64>],
    options: &'a StepOptions,
}

impl LaneFn for OpenLoop<'_> {
    type Output = Vec<SimulationRow>;

    #[inline(always)]
    fn call<S: Real>(self) -> Vec<SimulationRow> {
        let Self { robot, start, actions, options } = self;
        let model = Model::<S>::new(robot);
        let mut ws = Workspace::new(&model);
        let mut state = State::<S>::home(robot);
        for lane in 0..S::LANES {
            state.set_lane(lane, start);
        }
        let mut command = vec![S::zero(); robot.n_joints()];
        let mut hand = vec![Hand::default(); robot.n_arms];
        let mut rows = Vec::with_capacity(actions.len());
        for (i, action) in actions.iter().enumerate() {
            assert_eq!(action.len(), robot.n_joints(), "commands in row {i}");
            for (c, &a) in command.iter_mut().zip(action) {
                *c = S::splat(a);
            }
            step(&model, &mut ws, &mut state, &command, options);
            hands(&model, &mut ws, &state, &mut hand);
            rows.push(SimulationRow {
                t: (i + 1) as f64 * options.control_period,
                state: state.lane(0),
                hands: hand.iter().map(|h| h.position.map(|x| x.lane(0))).collect(),
                contacts: count_contacts(&model, &mut ws, &state).lane(0) as u32,
            });
        }
        rows
    }
}
