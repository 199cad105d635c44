//! What commands do to the robot, looked at closely.

use super::question::widen;
use crate::collision::clearance;
use crate::inverse_kinematics::base_pose;
use crate::model::Model;
use crate::robot::Robot;
use crate::scalar::{LaneFn, Real, dispatch};
use crate::simulate::{Precision, SimulationRow, simulate_from};
use crate::state::State;
use crate::step::StepOptions;
use crate::workspace::Workspace;

/// A motion and what it asks of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspection {
    /// State after each control step.
    pub rows: Vec<SimulationRow>,
    /// Smallest distance between two bodies that may touch, at the start and after each control step (m); negative where they overlap.
    pub clearance: Vec<f64>,
    /// Largest torque of each drive (N m), arm-major. A drive pulls most where its command changes.
    pub torques: Vec<f64>,
    /// Largest rate of each joint after a control step (rad/s), arm-major.
    pub rates: Vec<f64>,
    /// How far the base was from where it began, at most (m and rad).
    pub base: [f64; 2],
}

/// Plays `commands` (rad/s) from `start`.
pub fn inspect(
    robot: &Robot,
    options: &StepOptions,
    start: &State<f64>,
    commands: &[Vec<f32>],
) -> Inspection {
    let wide = widen(commands);
    let rows = simulate_from(robot, start, &wide, Precision::F32, options);
    let states: Vec<&State<f64>> =
        std::iter::once(start).chain(rows.iter().map(|row| &row.state)).collect();
    let clearance = dispatch(Clearances { robot, states: &states });
    let mut torques = vec![0.0_f64; robot.n_joints()];
    let mut rates = vec![0.0_f64; robot.n_joints()];
    for (state, command) in states.iter().zip(&wide) {
        for (joint, torque) in torques.iter_mut().enumerate() {
            *torque = torque.max(robot.torque(joint, command[joint], state.qd[joint]).abs());
        }
    }
    for row in &rows {
        for (most, rate) in rates.iter_mut().zip(&row.state.qd) {
            *most = most.max(rate.abs());
        }
    }
    let home = base_pose(start);
    let away = |state: &State<f64>| {
        let base = base_pose(state);
        let distance = (base.translation.vector - home.translation.vector).norm();
        [distance, base.rotation.angle_to(&home.rotation)]
    };
    let most = |[a, b]: [f64; 2], [x, y]: [f64; 2]| [a.max(x), b.max(y)];
    let base = states.iter().map(|state| away(state)).fold([0.0; 2], most);
    Inspection { rows, clearance, torques, rates, base }
}

struct Clearances<'a> {
    robot: &'a Robot,
    states: &'a [&'a State<f64>],
}

impl LaneFn for Clearances<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn call<S: Real>(self) -> Vec<f64> {
        let model = Model::<S>::new(self.robot);
        let mut workspace = Workspace::new(&model);
        let mut state = State::<S>::home(self.robot);
        let groups = self.states.chunks(S::LANES);
        groups
            .flat_map(|group| {
                for (lane, of) in group.iter().enumerate() {
                    state.set_lane(lane, of);
                }
                let least = clearance(&model, &mut workspace, &state);
                (0..group.len()).map(move |lane| least.lane(lane)).collect::<Vec<_>>()
            })
            .collect()
    }
}
