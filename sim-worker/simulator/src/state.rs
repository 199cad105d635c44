//! State of the robot: where it is and how it moves.

use crate::robot::Robot;
use crate::scalar::{Real, is_finite};

/// Generalised position and velocity of one robot, or of one robot per lane.
#[derive(Clone, Debug, PartialEq)]
pub struct State<S> {
    /// Origin of the base frame (the centre of the cube) in the world (m).
    pub base_position: [S; 3],
    /// Attitude of the base: unit quaternion (w, x, y, z), base to world.
    pub base_quaternion: [S; 4],
    /// Velocity of the base frame's origin, in world axes (m/s).
    pub base_linear_velocity: [S; 3],
    /// Angular velocity of the base, in base axes (rad/s).
    pub base_angular_velocity: [S; 3],
    /// Joint angles (rad), arm-major; length `n_joints`.
    pub q: Vec<S>,
    /// Joint rates (rad/s), arm-major; length `n_joints`.
    pub qd: Vec<S>,
}

impl<S> State<S> {
    /// All numbers in the order in which scripts, arrays and exported controllers have them: the base's position, quaternion, linear and angular
    /// velocity, joint angles, joint rates.
    #[inline(always)]
    pub fn parts(&self) -> [&[S]; 6] {
        let Self { base_position, base_quaternion, base_linear_velocity, .. } = self;
        let Self { base_angular_velocity, q, qd, .. } = self;
        [base_position, base_quaternion, base_linear_velocity, base_angular_velocity, q, qd]
    }

    /// [`State::parts`] to be written.
    pub fn parts_mut(&mut self) -> [&mut [S]; 6] {
        let Self { base_position, base_quaternion, base_linear_velocity, .. } = self;
        let Self { base_angular_velocity, q, qd, .. } = self;
        [base_position, base_quaternion, base_linear_velocity, base_angular_velocity, q, qd]
    }
}

impl<S: Real> State<S> {
    /// The robot at its home pose, at rest, in every lane.
    pub fn home(robot: &Robot) -> Self {
        let q: Vec<S> = robot.home_q().iter().map(|&x| S::splat(x)).collect();
        Self {
            base_position: robot.home_position.map(S::splat),
            base_quaternion: [1.0, 0.0, 0.0, 0.0].map(S::splat),
            base_linear_velocity: [S::zero(); 3],
            base_angular_velocity: [S::zero(); 3],
            qd: vec![S::zero(); q.len()],
            q,
        }
    }

    /// The state of lane `i`.
    pub fn lane(&self, i: usize) -> State<f64> {
        State {
            base_position: self.base_position.map(|x| x.lane(i)),
            base_quaternion: self.base_quaternion.map(|x| x.lane(i)),
            base_linear_velocity: self.base_linear_velocity.map(|x| x.lane(i)),
            base_angular_velocity: self.base_angular_velocity.map(|x| x.lane(i)),
            q: self.q.iter().map(|x| x.lane(i)).collect(),
            qd: self.qd.iter().map(|x| x.lane(i)).collect(),
        }
    }

    /// Replaces the state of lane `i`, rounded to the scalar's precision.
    ///
    /// # Panics
    /// If the number of joints differs.
    pub fn set_lane(&mut self, i: usize, state: &State<f64>) {
        fn put<S: Real>(to: &mut [S], from: &[f64], i: usize) {
            for (x, &y) in to.iter_mut().zip(from) {
                x.set_lane(i, y);
            }
        }
        assert_eq!(self.q.len(), state.q.len(), "joints of the two states");
        put(&mut self.base_position, &state.base_position, i);
        put(&mut self.base_quaternion, &state.base_quaternion, i);
        put(&mut self.base_linear_velocity, &state.base_linear_velocity, i);
        put(&mut self.base_angular_velocity, &state.base_angular_velocity, i);
        put(&mut self.q, &state.q, i);
        put(&mut self.qd, &state.qd, i);
    }

    /// Whether every number of every lane is finite.
    pub fn is_finite(&self) -> bool {
        self.parts().into_iter().flatten().all(|&x| is_finite(x))
    }
}
