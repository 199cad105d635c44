//! Goals in lanes: where the hands and the base of each environment shall be, and how that moves.
//!
//! Which goals a task has is said in [`proto::tasks`].

pub use proto::tasks::GoalAddress;
use proto::tasks::{EpisodeGoals, GoalRanges, HomeArm};

use super::Task;
use super::tumbling::Tumbling;
use crate::scalar::Real;

/// Goals of the environments of one lane group.
#[derive(Debug, Clone)]
pub struct Goals<S> {
    /// Target of each hand: position in the world (m), Euler angles (rad).
    pub hands: Vec<[S; 6]>,
    /// Target attitude of the base, Euler angles (rad).
    pub base: [S; 3],
    /// The body that carries the hands' goals, if they move.
    pub(crate) body: Option<Tumbling<S>>,
}

impl<S: Real> Goals<S> {
    /// Goals that lie at home, for which errors are distances from home.
    pub fn at_home(ranges: &GoalRanges) -> Self {
        let hand = |arm: &HomeArm| {
            let [[x, y, z], [a, b, c]] = [arm.position, arm.euler];
            [x, y, z, a, b, c].map(S::splat)
        };
        Self {
            hands: ranges.home.arms.iter().map(hand).collect(),
            base: ranges.home.base_euler.map(S::splat),
            body: None,
        }
    }

    /// Goals that stay: of hands, position in the world (m) and Euler angles (rad), and of the base, Euler angles (rad).
    pub fn fixed(hands: Vec<[S; 6]>, base: [S; 3]) -> Self {
        Self { hands, base, body: None }
    }

    /// Draws the goals of one environment into `lane`. What `task` has no goals for stays as it is.
    ///
    /// Where they move, [`Goals::attach`] must follow when all lanes are drawn.
    pub fn draw(&mut self, task: &Task, address: GoalAddress, lane: usize) {
        let EpisodeGoals { hands, base, body } = task.name.definition().goals(&task.goals, address);
        for (slots, pose) in self.hands.iter_mut().zip(&hands) {
            for (slot, &value) in slots.iter_mut().zip(pose.iter().flatten()) {
                slot.set_lane(lane, value);
            }
        }
        for (slot, &value) in self.base.iter_mut().zip(base.iter().flatten()) {
            slot.set_lane(lane, value);
        }
        let n_arms = self.hands.len();
        match body {
            Some(body) => {
                self.body.get_or_insert_with(|| Tumbling::new(n_arms)).set_lane(lane, &body);
            }
            // Of two tasks the later one has its goals, and what carries them, each lane for itself.
            None if !hands.is_empty() => {
                if let Some(body) = &mut self.body {
                    body.rest_lane(lane);
                }
                self.body.take_if(|body| body.rests());
            }
            None => {}
        }
    }

    /// Has the body, if there is one, carry the hands' goals from where they are.
    pub fn attach(&mut self) {
        for arm in 0..self.hands.len() {
            self.attach_hand(arm);
        }
    }

    /// Has the body, if there is one, carry the goal of `arm` from where it is.
    pub fn attach_hand(&mut self, arm: usize) {
        if let Some(body) = &mut self.body {
            body.attach(arm, &self.hands[arm]);
        }
    }

    /// How fast the goal of each hand moves, if they do: linear (m/s) and angular (rad/s), world.
    pub fn hand_velocities(&self) -> Option<Vec<[S; 6]>> {
        let of_arm = |body: &Tumbling<S>, arm| {
            let [[x, y, z], [a, b, c]] = body.rates(arm);
            [x, y, z, a, b, c]
        };
        let body = self.body.as_ref()?;
        Some((0..self.hands.len()).map(|arm| of_arm(body, arm)).collect())
    }

    /// Moves what moves by `time` (s).
    #[inline(always)]
    pub fn advance(&mut self, time: f64) {
        if let Some(body) = &mut self.body {
            body.advance(time);
            for (arm, hand) in self.hands.iter_mut().enumerate() {
                *hand = body.carried(arm);
            }
        }
    }
}
