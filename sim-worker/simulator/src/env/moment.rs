//! One environment at one moment, to be looked at by a person.

use std::collections::BTreeMap;

use crate::scalar::Real;
use crate::state::State;
use crate::task::Goals;

/// What an environment was like before a step that failed.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// State of the robot.
    pub state: State<f64>,
    /// Target of each hand: position (m), Euler angles (rad).
    pub hand_goals: Vec<[f64; 6]>,
    /// Target attitude of the base, Euler angles (rad).
    pub base_goal: [f64; 3],
    /// Joint velocity commands of the step (rad/s); if the policy failed, those of the step before for its agent and the ones after it.
    pub command: Vec<f64>,
}

impl Moment {
    /// The environment in `lane`.
    pub(super) fn of_lane<S: Real>(
        lane: usize,
        state: &State<S>,
        goals: &Goals<S>,
        command: &[S],
    ) -> Self {
        Self {
            state: state.lane(lane),
            hand_goals: goals.hands.iter().map(|goal| goal.map(|x| x.lane(lane))).collect(),
            base_goal: goals.base.map(|x| x.lane(lane)),
            command: command.iter().map(|x| x.lane(lane)).collect(),
        }
    }

    /// Everything by name, as it is sent and written down.
    pub fn arrays(&self) -> BTreeMap<String, Vec<f32>> {
        let State {
            base_position,
            base_quaternion,
            base_linear_velocity,
            base_angular_velocity,
            q,
            qd,
        } = &self.state;
        let hand_goals = self.hand_goals.as_flattened();
        let parts: [(&str, &[f64]); 9] = [
            ("base_position_m", base_position),
            ("base_quaternion_wxyz", base_quaternion),
            ("base_linear_velocity_m_s", base_linear_velocity),
            ("base_angular_velocity_rad_s", base_angular_velocity),
            ("joint_angles_rad", q),
            ("joint_rates_rad_s", qd),
            ("hand_goals_m_rad", hand_goals),
            ("base_goal_rad", &self.base_goal),
            ("command_rad_s", &self.command),
        ];
        let single = |values: &[f64]| values.iter().map(|&x| x as f32).collect();
        parts.into_iter().map(|(name, values)| (name.to_owned(), single(values))).collect()
    }
}
