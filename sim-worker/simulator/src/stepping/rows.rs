//! What environments show after a step, in the caller's memory.

use proto::layout::Dimensions;

use super::StepError;

/// What environments show: an array a quantity, row-major, a row an environment.
#[derive(Debug)]
pub struct Rows<'a> {
    /// `[N, A, O]`: what agents see.
    pub observation: &'a mut [f32],
    /// `[N, S]`: what critics see.
    pub state: &'a mut [f32],
    /// `[N, A]`: rewards of the step before, zero at the start.
    pub reward: &'a mut [f32],
    /// `[N, arms]`: norm of every hand's position error (m).
    pub position_error: &'a mut [f32],
    /// `[N, arms]`: norm of every hand's Euler-angle difference (rad).
    pub orientation_error: &'a mut [f32],
    /// `[N]`: norm of the base's Euler-angle difference (rad).
    pub base_error: &'a mut [f32],
    /// `[N]`: touching pairs of bodies.
    pub touching_pairs: &'a mut [f32],
    /// `[N, arms, 6]`: where hands shall go, position (m) and Euler angles (rad), world.
    pub hand_goal: &'a mut [f32],
    /// `[N, 3]`: where the base shall turn, Euler angles (rad).
    pub base_goal: &'a mut [f32],
    /// `[N, 13 + 2 J]`: base position (m), quaternion (w first), velocity (m/s, world), angular velocity (rad/s, body); joint angles (rad)
    /// and rates (rad/s), arm-major.
    pub robot: &'a mut [f32],
}

/// Numbers of a row of [`Rows::robot`].
pub(super) fn robot_width(dimensions: &Dimensions) -> usize {
    13 + 2 * dimensions.joints.n_joints()
}

impl<'a> Rows<'a> {
    /// Refuses arrays of another size than that of `n_envs` environments.
    pub(super) fn check(&self, n_envs: usize, dimensions: &Dimensions) -> Result<(), StepError> {
        let found = [
            &*self.observation,
            &*self.state,
            &*self.reward,
            &*self.position_error,
            &*self.orientation_error,
            &*self.base_error,
            &*self.touching_pairs,
            &*self.hand_goal,
            &*self.base_goal,
            &*self.robot,
        ];
        for (array, (what, width)) in
            found.iter().zip(NAMES.into_iter().zip(Self::widths(dimensions)))
        {
            let (found, expected) = (array.len(), n_envs * width);
            if found != expected {
                return Err(StepError::Length { what, found, expected });
            }
        }
        Ok(())
    }

    /// The rows of the first `n` environments, and those of the others; there are `of`.
    pub(super) fn split(self, n: usize, of: usize) -> (Self, Self) {
        let mut others = Vec::with_capacity(ARRAYS);
        let first = self.into_arrays().map(|array| {
            let width = array.len() / of;
            let (first, rest) = array.split_at_mut(n * width);
            others.push(rest);
            first
        });
        let others = others.try_into().expect("one of each array");
        (Self::of_arrays(first), Self::of_arrays(others))
    }

    fn into_arrays(self) -> [&'a mut [f32]; ARRAYS] {
        let Self {
            observation,
            state,
            reward,
            position_error,
            orientation_error,
            base_error,
            touching_pairs,
            hand_goal,
            base_goal,
            robot,
        } = self;
        [
            observation,
            state,
            reward,
            position_error,
            orientation_error,
            base_error,
            touching_pairs,
            hand_goal,
            base_goal,
            robot,
        ]
    }

    /// From arrays in the order of the fields.
    pub fn of_arrays(arrays: [&'a mut [f32]; ARRAYS]) -> Self {
        let [
            observation,
            state,
            reward,
            position_error,
            orientation_error,
            base_error,
            touching_pairs,
            hand_goal,
            base_goal,
            robot,
        ] = arrays;
        Self {
            observation,
            state,
            reward,
            position_error,
            orientation_error,
            base_error,
            touching_pairs,
            hand_goal,
            base_goal,
            robot,
        }
    }

    /// Numbers of a row of every array, in the order of the fields.
    pub fn widths(dimensions: &Dimensions) -> [usize; ARRAYS] {
        let Dimensions { n_agents, n_arms, observation, state, .. } = *dimensions;
        let robot = robot_width(dimensions);
        [n_agents * observation, state, n_agents, n_arms, n_arms, 1, 1, 6 * n_arms, 3, robot]
    }
}

/// Arrays of [`Rows`].
pub const ARRAYS: usize = 10;

/// Their names, in the order of the fields.
const NAMES: [&str; ARRAYS] = [
    "observation",
    "state",
    "reward",
    "position_error",
    "orientation_error",
    "base_error",
    "touching_pairs",
    "hand_goal",
    "base_goal",
    "robot",
];
