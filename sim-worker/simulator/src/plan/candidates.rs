//! What is tried, in order.

use std::f64::consts::TAU;

use proto::rng::{Address, Purpose};

use super::question::Question;
use crate::inverse_kinematics::{Angles, base_pose, candidates, forward, padded, pose};
use crate::robot::{Joints, Robot};

/// Longest wait of an arm (control steps).
const LONGEST_WAIT: f64 = 12.0;

/// What one arm does.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Course {
    /// It does not move.
    Still,
    /// It goes to joint angles that are no goal of anybody.
    Posture(Angles),
    /// It goes to its pose.
    Goal {
        /// Control steps before it begins.
        wait: usize,
        /// Joint angles that it passes.
        via: Option<Angles>,
        /// The joint angles where it looks for the pose.
        way: Angles,
    },
}

/// One attempt: a course for each arm.
pub(super) type Candidate = Vec<Course>;

/// All candidates of a question.
pub(super) struct Candidates<'a> {
    question: &'a Question,
    joints: Joints,
    /// Where the joints are, by arm.
    now: Vec<Angles>,
    /// Joint angles for the pose of each asked arm, the best first.
    ways: Vec<Option<Vec<Angles>>>,
}

impl<'a> Candidates<'a> {
    pub(super) fn new(robot: &Robot, question: &'a Question) -> Self {
        let base = base_pose(&question.start);
        let ways =
            question.hands.iter().enumerate().map(|(arm, goal)| {
                Some(candidates(robot, arm, &(base.inverse() * pose((*goal)?))))
            });
        let of_arm = |arm: usize| padded(&question.start.q[robot.joints.of_arm(arm)]);
        let now = (0..robot.n_arms).map(of_arm).collect();
        Self { question, joints: robot.joints, now, ways: ways.collect() }
    }

    /// An asked arm for which inverse kinematics finds nothing.
    pub(super) fn arm_without_way(&self) -> Option<usize> {
        self.ways.iter().position(|ways| ways.as_ref().is_some_and(Vec::is_empty))
    }

    /// An asked arm whose best joint angles leave its hand too far from its pose with the base where it was at the start.
    pub(super) fn arm_out_of_reach(&self, robot: &Robot) -> Option<usize> {
        let Question { start, hands, within, .. } = self.question;
        let base = base_pose(start);
        self.ways.iter().enumerate().position(|(arm, ways)| {
            let (Some(ways), Some(goal)) = (ways, hands[arm]) else { return false };
            let target = base.inverse() * pose(goal);
            let hand = forward(robot, arm, &ways[0]).0;
            let off = (target.translation.vector - hand.translation.vector).norm();
            off > within.position || target.rotation.angle_to(&hand.rotation) > within.orientation
        })
    }

    /// Number of candidates that go straight: every way of every asked arm with the first way of the others.
    fn straight(&self) -> usize {
        self.ways.iter().flatten().map(|ways| ways.len() - 1).sum::<usize>() + 1
    }

    pub(super) fn get(&self, index: usize) -> Candidate {
        match index.checked_sub(self.straight()) {
            None => self.straight_candidate(index),
            Some(detour) => self.detour(detour as u32),
        }
    }

    fn straight_candidate(&self, index: usize) -> Candidate {
        let mut left = index;
        let each = self.ways.iter().map(|ways| {
            let Some(ways) = ways else { return Course::Still };
            // 0 is the first way of all arms; then one arm after the other takes its others.
            let others = ways.len() - 1;
            let way = if (1..=others).contains(&left) { left } else { 0 };
            left = if way > 0 { 0 } else { left.saturating_sub(others) };
            Course::Goal { wait: 0, via: None, way: ways[way] }
        });
        each.collect()
    }

    /// A candidate drawn by its index: the later, the wider it looks around.
    fn detour(&self, index: u32) -> Candidate {
        let seed = self.question.seed;
        let uniforms = |arm: usize, group: u32| {
            let index_ = arm as u32 * 8 + group;
            let address = Address {
                seed,
                purpose: Purpose::Detour,
                iteration: 0,
                env: index,
                step: 0,
                index: index_,
            };
            address.uniforms().map(f64::from)
        };
        let wide = 0.3 + 0.9 * (f64::from(index) / 256.0).min(1.0);
        // Offsets of an arm's joints, from two groups of numbers.
        let around = |middle: &Angles, arm: usize, group: u32, width: f64| -> Angles {
            let [a, b] = [uniforms(arm, group), uniforms(arm, group + 1)];
            let mut around = *middle;
            let n_joints = self.joints.of_arm(arm).len();
            for (angle, u) in around[..n_joints].iter_mut().zip(a.into_iter().chain(b)) {
                *angle += width * (2.0 * u - 1.0);
            }
            around
        };
        let each = self.ways.iter().zip(&self.now).enumerate().map(|(arm, (ways, now))| {
            let [which, kind, share, turn] = uniforms(arm, 0);
            let Some(ways) = ways else {
                // A third of the other arms rests; the motion of the rest moves the base.
                if kind < 0.34 {
                    return Course::Still;
                }
                return Course::Posture(around(now, arm, 2, wide * share));
            };
            // The first ways are the nearer ones.
            let mut way = ways[((which * which) * ways.len() as f64) as usize];
            if turn < 0.2 {
                // One joint goes the other way round, if that is not more than a turn from where it is.
                let n_joints = self.joints.of_arm(arm).len();
                let joint = (turn * 5.0 * n_joints as f64) as usize % n_joints;
                way[joint] -= TAU.copysign(way[joint] - now[joint]);
            }
            let middle = std::array::from_fn(|j| now[j] + share * (way[j] - now[j]));
            let via = (kind < 0.75).then(|| around(&middle, arm, 2, wide));
            let [late, wait, ..] = uniforms(arm, 4);
            let wait = if late < 0.5 { 0.0 } else { wait * LONGEST_WAIT };
            Course::Goal { wait: wait as usize, via, way }
        });
        each.collect()
    }
}
