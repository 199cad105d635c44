//! Bringing hands to poses.

use nalgebra::{DMatrix, DVector, Isometry3, Vector3};

use super::least_squares::damped;
use super::momentum::BaseMotion;
use super::{Branch, GAIN, JacobianController, Memory, SOLVED, shorten};
use crate::inverse_kinematics::{Angles, approach, base_pose, forward, padded, pose, residual};
use crate::state::State;
use crate::task::Goals;

/// An arm whose joints are all nearer than this to the branch's angles (rad) follows the generalised Jacobian.
const NEAR: f64 = 0.6;
/// Damping in parts of the square of the error (m and rad, together): it falls with it [Chan and Lawrence 1988, "General inverse kinematics with the
/// error damped pseudoinverse"];
const DAMPING: f64 = 1e-2;
/// and what remains of it at the goal.
const LEAST_DAMPING: f64 = 1e-8;
/// A hand is at its goal when it is nearer than this (m and rad, together).
const ARRIVED: f64 = 0.01;
/// Control steps after which an arm whose hand has not arrived tries its next branch: half a turn at 0.8 rad/s takes ten.
const PATIENCE: usize = 15;
/// Iterations of the inverse kinematics in a control step: the base has moved the goal a little.
const ITERATIONS: usize = 4;

/// Rows of a hand in the Jacobian: linear and angular.
const ROWS: usize = 6;

/// An arm on its way.
struct Reaching {
    arm: usize,
    goal: Isometry3<f64>,
    /// Rates towards the branch's angles (rad/s).
    to_branch: Angles,
    near: bool,
}

impl JacobianController {
    pub(super) fn reach(
        &self,
        now: &State<f64>,
        goals: &Goals<f64>,
        moves: &[bool],
        memory: &mut Memory,
    ) -> Vec<f64> {
        let base = base_pose(now);
        memory.branches.resize(moves.len(), None);
        let mut rates = now.qd.clone();
        let mut near = Vec::new();
        for arm in (0..moves.len()).filter(|arm| moves[*arm]) {
            let reaching = self.look(now, &base, (arm, goals.hands[arm]), memory);
            let joints = self.robot.joints.of_arm(arm);
            let mut towards = reaching.to_branch;
            let towards = &mut towards[..joints.len()];
            shorten(towards, &self.limits[joints.clone()]);
            rates[joints].copy_from_slice(towards);
            if reaching.near {
                near.push(reaching);
            }
        }
        if let Some(motion) = BaseMotion::of(&self.robot, now).filter(|_| !near.is_empty()) {
            self.follow(now, &base, &motion, &near, &mut rates);
        }
        rates
    }

    /// What arm and goal ask for; chooses a branch where there is none for this goal.
    fn look(
        &self,
        now: &State<f64>,
        base: &Isometry3<f64>,
        (arm, goal): (usize, [f64; 6]),
        memory: &mut Memory,
    ) -> Reaching {
        let stands = padded(&now.q[self.robot.joints.of_arm(arm)]);
        let pose = pose(goal);
        let target = base.inverse() * pose;
        let slot = &mut memory.branches[arm];
        let branch = match slot {
            // A goal that moves has its branch chosen anew in every step, from where the arm stands. Those of `capture` were reached less often, and with more
            // contacts, by branches that were kept while the goal moved a little.
            Some(branch) if branch.goal == goal => branch,
            _ => {
                let mut others = self.branches(now, arm, &target);
                let angles = others.pop().unwrap_or(stands);
                slot.insert(Branch { goal, angles, others, steps: 0 })
            }
        };
        let (hand, _) = forward(&self.robot, arm, &stands);
        if residual(&target, &hand).norm() < ARRIVED {
            branch.steps = 0;
        } else {
            branch.steps += 1;
        }
        if branch.steps > PATIENCE
            && let Some(other) = branch.others.pop()
        {
            (branch.angles, branch.steps) = (other, 0);
        }
        let (way, miss) = approach(&self.robot, arm, &target, branch.angles, ITERATIONS);
        // Angles that only come near would wander: the arm stays at those that it has.
        if miss < SOLVED {
            branch.angles = way;
        }
        let way = branch.angles;
        let left: Angles = std::array::from_fn(|j| way[j] - stands[j]);
        Reaching {
            arm,
            goal: pose,
            to_branch: left.map(|angle| GAIN / self.period * angle),
            near: miss < SOLVED && left.iter().all(|angle| angle.abs() < NEAR),
        }
    }

    /// Replaces the rates of arms near their goals by those that the generalised Jacobian gives, the other arms moving as `rates` says.
    fn follow(
        &self,
        now: &State<f64>,
        base: &Isometry3<f64>,
        motion: &BaseMotion,
        near: &[Reaching],
        rates: &mut [f64],
    ) {
        let r = *base.rotation.to_rotation_matrix().matrix();
        let of_arm = |reaching: &Reaching| self.robot.joints.of_arm(reaching.arm);
        let joints: Vec<usize> = near.iter().flat_map(of_arm).collect();
        let (n, n_rows) = (joints.len(), near.len() * ROWS);
        let others: Vec<usize> = (0..rates.len()).filter(|joint| !joints.contains(joint)).collect();
        // How the base moves by itself and by the arms that do not follow.
        let mut carried = motion.drift;
        for &joint in &others {
            carried += motion.by_joints.column(joint) * rates[joint];
        }
        let mut jacobian = DMatrix::zeros(n_rows, n);
        let [mut wanted, mut damping] = [(); 2].map(|()| DVector::zeros(n_rows));
        let mut preferred = DVector::zeros(n);
        let mut first = 0;
        for (row, reaching) in near.iter().enumerate() {
            let Reaching { arm, goal, to_branch, .. } = reaching;
            let own_joints = of_arm(reaching);
            let q = padded(&now.q[own_joints.clone()]);
            let (hand, own) = forward(&self.robot, *arm, &q);
            // By the base: v + ω × r, and ω, which it has in its own axes.
            let lever = (r * hand.translation.vector).cross_matrix();
            let by_base = |linear: Vector3<f64>, angular: Vector3<f64>| {
                let angular = r * angular;
                (linear - lever * angular, angular)
            };
            let at = row * ROWS;
            let mut add = |column: usize, (linear, angular): (Vector3<f64>, Vector3<f64>)| {
                let mut of_hand = jacobian.fixed_view_mut::<6, 1>(at, column);
                for i in 0..3 {
                    of_hand[i] += linear[i];
                    of_hand[3 + i] += angular[i];
                }
            };
            for (column, &joint) in joints.iter().enumerate() {
                let v = motion.by_joints.column(joint);
                add(column, by_base(v.fixed_rows::<3>(0).into(), v.fixed_rows::<3>(3).into()));
            }
            for j in 0..own_joints.len() {
                let [linear, angular] = [0, 3].map(|i| r * own.fixed_view::<3, 1>(i, j));
                add(first + j, (linear, angular));
            }
            let there = base * hand;
            let linear = goal.translation.vector - there.translation.vector;
            let angular = (goal.rotation * there.rotation.inverse()).scaled_axis();
            let drift =
                by_base(carried.fixed_rows::<3>(0).into(), carried.fixed_rows::<3>(3).into());
            let gain = GAIN / self.period;
            // Each arm for itself: one that is far from its goal leaves the others as they are.
            let square = DAMPING * (linear.norm_squared() + angular.norm_squared());
            damping.rows_mut(at, ROWS).fill(square + LEAST_DAMPING);
            for i in 0..3 {
                wanted[at + i] = gain * linear[i] - drift.0[i];
                wanted[at + 3 + i] = gain * angular[i] - drift.1[i];
            }
            for j in 0..own_joints.len() {
                preferred[first + j] = to_branch[j];
            }
            first += own_joints.len();
        }
        let found = damped(&jacobian, &wanted, &preferred, &damping);
        let mut found: Vec<f64> = found.iter().copied().collect();
        let limits: Vec<f64> = joints.iter().map(|joint| self.limits[*joint]).collect();
        let (mut of_arms, mut their_limits) = (found.as_mut_slice(), limits.as_slice());
        for reaching in near {
            let n_joints = of_arm(reaching).len();
            let (rates, rest) = of_arms.split_at_mut(n_joints);
            let (limits, rest_of_limits) = their_limits.split_at(n_joints);
            shorten(rates, limits);
            (of_arms, their_limits) = (rest, rest_of_limits);
        }
        for (joint, rate) in joints.iter().zip(found) {
            rates[*joint] = rate;
        }
    }
}
