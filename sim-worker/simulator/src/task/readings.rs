//! What tasks read from a simulated robot, and the errors that follow.

use super::{Goals, Task};
use crate::posture::{Guidance, Pace, Posture, Postures};
use crate::robot::Joints;
use crate::robot::Robot;
use crate::scalar::{Kernel, Real};
use crate::spatial::{
    euler_xyz_to_rotation, mat_t_vec, quaternion_to_rotation, rotation_difference,
};

/// A hand's pose and velocity in the world.
#[derive(Debug, Clone, Copy)]
pub struct HandReading<S> {
    /// Position (m).
    pub position: [S; 3],
    /// Euler angles (rad).
    pub euler: [S; 3],
    /// Linear velocity of the tool frame's origin (m/s).
    pub linear: [S; 3],
    /// Angular velocity, expressed in the world (rad/s).
    pub angular: [S; 3],
}

impl<S: Real> Default for HandReading<S> {
    fn default() -> Self {
        let zero = [S::zero(); 3];
        Self { position: zero, euler: zero, linear: zero, angular: zero }
    }
}

/// Everything that observations, critic states and rewards are made of.
#[derive(Debug, Clone)]
pub struct Readings<S> {
    /// Base position, world (m).
    pub base_position: [S; 3],
    /// Base attitude, unit quaternion (w, x, y, z).
    pub base_quaternion: [S; 4],
    /// Base attitude, Euler angles (rad).
    pub base_euler: [S; 3],
    /// Base linear velocity, world (m/s).
    pub base_linear: [S; 3],
    /// Base angular velocity, body (rad/s).
    pub base_angular: [S; 3],
    /// Joint angles, arm-major (rad).
    pub q: Vec<S>,
    /// Joint rates, arm-major (rad/s).
    pub qd: Vec<S>,
    /// One entry an arm.
    pub hands: Vec<HandReading<S>>,
    /// Last action of every joint, arm-major: clipped, before scaling. Zero at the start.
    pub last_action: Vec<S>,
}

impl<S: Real> Readings<S> {
    /// Zeros for a robot with these joints.
    pub fn new(of_robot: &Joints) -> Self {
        let joints = vec![S::zero(); of_robot.n_joints()];
        let zero = [S::zero(); 3];
        Self {
            base_position: zero,
            base_quaternion: [S::one(), S::zero(), S::zero(), S::zero()],
            base_euler: zero,
            base_linear: zero,
            base_angular: zero,
            q: joints.clone(),
            qd: joints.clone(),
            hands: vec![HandReading::default(); of_robot.n_arms()],
            last_action: joints,
        }
    }
}

/// Widths of the squashed position errors (m): tanh(e / width).
pub const POSITION_WIDTHS: [f64; 2] = [0.05, 0.015];
/// Widths of the squashed attitude errors (rad): tanh(e / width).
pub const ATTITUDE_WIDTHS: [f64; 2] = [0.08, 0.025];

/// Share of the way to its goal posture that an arm is taken to cover in a control step where nothing is added to actions.
pub const UNGUIDED: f64 = 0.7;

/// Task errors of one lane group, goal − actual: as they are paid, and as agents see them.
///
/// The tasks' measures and rewards are in the world's axes and Euler angles, as the paper has them.
/// Agents see errors in the **axes of the base**, attitudes as rotations (see
/// [`rotation_difference`]): where the base is and how it is turned makes no difference to what an
/// arm has to do, nor, without gravity, to how it moves, and so an agent does not have to learn it.
#[derive(Debug, Clone)]
pub struct Errors<S: Real> {
    /// Position (m, world) and Euler angles (rad) of each hand.
    pub hands: Vec<[S; 6]>,
    /// Attitude of the base (rad).
    pub base: [S; 3],
    /// Position (m) and rotation (rad) of each hand, in the base's axes.
    pub seen_hands: Vec<[S; 6]>,
    /// Rotation of the base, in its axes (rad).
    pub seen_base: [S; 3],
    /// `seen_hands` squashed: position at both widths, then rotation at both widths.
    pub squashed_hands: Vec<[S; 12]>,
    /// `seen_base` squashed at both widths.
    pub squashed_base: [S; 6],
    /// How the goal of each hand moves, if goals do: linear (m/s) and angular (rad/s), in the base's axes.
    pub seen_motion: Vec<[S; 6]>,
    /// ‖position error‖ of each hand (m).
    pub position_norm: Vec<S>,
    /// ‖Euler-angle difference‖ of each hand (rad).
    pub orientation_norm: Vec<S>,
    /// ‖Euler-angle difference‖ of the base (rad).
    pub base_norm: S,
    /// What is left to go to the goal postures, where a task tells them.
    pub(crate) postures: Option<Postures<S>>,
}

impl<S: Real> Errors<S> {
    /// Zeros for `n_arms` arms.
    pub fn new(n_arms: usize) -> Self {
        Self {
            hands: vec![[S::zero(); 6]; n_arms],
            base: [S::zero(); 3],
            seen_hands: vec![[S::zero(); 6]; n_arms],
            seen_base: [S::zero(); 3],
            squashed_hands: vec![[S::zero(); 12]; n_arms],
            squashed_base: [S::zero(); 6],
            seen_motion: vec![[S::zero(); 6]; n_arms],
            position_norm: vec![S::zero(); n_arms],
            orientation_norm: vec![S::zero(); n_arms],
            base_norm: S::zero(),
            postures: None,
        }
    }

    /// Those that `task` tells.
    pub fn of(task: &Task, robot: &Robot) -> Self {
        let mut errors = Self::new(robot.n_arms);
        errors.tell(task, robot);
        errors
    }

    /// Goal postures of the hands as agents see them, an arm each, where a task tells them: whether they bring the hand to its goal (1 or 0),
    /// whether they are free of stops (1 or 0), what is left to each joint (rad).
    pub fn postures(&self) -> Option<Vec<Vec<S>>> {
        let of_arm = |arm: &Posture<S>| [&[arm.good, arm.free], arm.left()].concat();
        self.postures.as_ref().map(|postures| postures.arms.iter().map(of_arm).collect())
    }

    /// The clipped actions, one a joint, where agents of `task` say so much: it adds the way to the goal postures, if it has any.
    pub fn acted(&self, task: &Task, said: &[S]) -> Vec<S> {
        let limits: Vec<S> = task.action_limit.iter().map(|limit| S::splat(*limit)).collect();
        let mut guidance = Guidance::none(limits.len());
        if let Some(postures) = &self.postures {
            guidance.look(&postures.arms, task, task.action_scale, &limits);
        }
        let clipped = |(joint, said): (usize, &S)| {
            guidance.act(joint, *said).clamp(-limits[joint], limits[joint])
        };
        said.iter().enumerate().map(clipped).collect()
    }

    /// Has the goal postures that `task` tells, if it does, be known instead of others; says whether these were not known before.
    pub(crate) fn tell(&mut self, task: &Task, robot: &Robot) -> bool {
        if !task.knows_postures() {
            return false;
        }
        let proto::config::Posture { gain, trust, .. } = task.posture;
        let limit = |limit: &f64| S::splat(limit * task.action_scale);
        let pace = Pace {
            gain: if gain > 0.0 { gain } else { UNGUIDED },
            period: task.control_period,
            limits: task.action_limit.iter().map(limit).collect(),
        };
        if self.postures.as_ref().is_some_and(|postures| postures.are(&pace, trust)) {
            return false;
        }
        self.postures = Some(Postures::new(robot, pace, trust));
        true
    }

    /// Forgets where the base was, because nobody looked at it for a while.
    pub(crate) fn forget_base(&mut self) {
        if let Some(postures) = &mut self.postures {
            postures.forget_base();
        }
    }

    /// Has hands without a way to their goals rest.
    pub(crate) fn give_rest(&mut self) {
        if let Some(postures) = &mut self.postures {
            postures.give_rest();
        }
    }

    /// Which arms go to their goal postures from now on, an entry an arm.
    pub(crate) fn activate(&mut self, active: impl Iterator<Item = bool>) {
        if let Some(postures) = &mut self.postures {
            postures.activate(active);
        }
    }

    /// Forgets what it knows of goals, because another episode begins.
    pub fn forget(&mut self) {
        if let Some(postures) = &mut self.postures {
            postures.forget();
        }
    }

    /// Takes the errors of `readings` against `goals`.
    #[inline(always)]
    pub fn update(&mut self, readings: &Readings<S>, goals: &Goals<S>) {
        S::compiled(Update { errors: self, readings, goals });
    }

    #[inline(always)]
    fn take(&mut self, readings: &Readings<S>, goals: &Goals<S>) {
        let base = quaternion_to_rotation(&readings.base_quaternion);
        for arm in 0..self.hands.len() {
            let (hand, goal) = (&readings.hands[arm], &goals.hands[arm]);
            let e = &mut self.hands[arm];
            for i in 0..3 {
                e[i] = goal[i] - hand.position[i];
                e[3 + i] = goal[3 + i] - hand.euler[i];
            }
            let e = *e;
            self.position_norm[arm] = norm([e[0], e[1], e[2]]);
            self.orientation_norm[arm] = norm([e[3], e[4], e[5]]);

            let target = euler_xyz_to_rotation([goal[3], goal[4], goal[5]]);
            let turned = rotation_difference(&target, &euler_xyz_to_rotation(hand.euler));
            let seen = &mut self.seen_hands[arm];
            seen[..3].copy_from_slice(&mat_t_vec(&base, [e[0], e[1], e[2]]));
            seen[3..].copy_from_slice(&mat_t_vec(&base, turned));
            let seen = *seen;
            let squashed = &mut self.squashed_hands[arm];
            for i in 0..3 {
                for (scale, (p, a)) in POSITION_WIDTHS.iter().zip(ATTITUDE_WIDTHS).enumerate() {
                    squashed[3 * scale + i] = (seen[i] * S::splat(1.0 / p)).tanh();
                    squashed[6 + 3 * scale + i] = (seen[3 + i] * S::splat(1.0 / a)).tanh();
                }
            }
        }
        if let Some(body) = &goals.body {
            for (arm, seen) in self.seen_motion.iter_mut().enumerate() {
                let [linear, angular] = body.rates(arm);
                seen[..3].copy_from_slice(&mat_t_vec(&base, linear));
                seen[3..].copy_from_slice(&mat_t_vec(&base, angular));
            }
        }
        let turned = rotation_difference(&euler_xyz_to_rotation(goals.base), &base);
        self.seen_base = mat_t_vec(&base, turned);
        for i in 0..3 {
            self.base[i] = goals.base[i] - readings.base_euler[i];
            for (scale, a) in ATTITUDE_WIDTHS.iter().enumerate() {
                self.squashed_base[3 * scale + i] = (self.seen_base[i] * S::splat(1.0 / a)).tanh();
            }
        }
        self.base_norm = norm(self.base);
        if let Some(postures) = &mut self.postures {
            let base = (readings.base_position, readings.base_quaternion);
            postures.update(base, &readings.q, &goals.hands);
        }
    }
}

struct Update<'a, S: Real> {
    errors: &'a mut Errors<S>,
    readings: &'a Readings<S>,
    goals: &'a Goals<S>,
}

impl<S: Real> Kernel<S> for Update<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.errors.take(self.readings, self.goals);
    }
}

#[inline(always)]
fn norm<S: Real>([x, y, z]: [S; 3]) -> S {
    x.mul_add(x, y.mul_add(y, z * z)).sqrt()
}
