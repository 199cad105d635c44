//! A controller that is not learned: the yardstick beside which policies stand.
//!
//! It knows the robot and solves for joint rates in every control step; a policy knows neither and only reacts. Both see the same readings, with the
//! same errors of the sensors, and their commands have the same limits.
//!
//! **The generalised Jacobian.** Nothing holds the base, so that an arm that moves pushes it away. Momentum is what it was, H v + B q̇ = p, with the
//! inertia H of the robot about its base, the momentum B of moving joints, and the base's velocity v. So v = H⁻¹ (p − B q̇), and a hand moves with
//! J_b v + J_m q̇ = (J_m − J_b H⁻¹ B) q̇ + J_b H⁻¹ p [Umetani and Yoshida 1989, "Resolved motion rate control of space manipulators with generalized
//! Jacobian matrix", IEEE Transactions on Robotics and Automation 5(3), eq. 15]. The matrix in front of q̇ is the generalised Jacobian; the last term is
//! the drift that a push has left. It is inverted by damped least squares [Nakamura and Hanafusa 1986; Wampler 1986].
//!
//! * `trajectory`: far from its goal an arm goes, joint by joint, to one of the sets of angles that bring its hand there,
//!   chosen when the goal is seen for the first time: the nearest that touches nothing. Near it all arms follow the generalised Jacobian. An arm that
//!   does not arrive tries its next set.
//! * `reorientation`: the rows of the base. Twenty-one directions of the joints are left over, which draw the arms back home.
//!
//! Arms that the controller does not move are taken to go on as they do.

mod branch;
mod least_squares;
mod momentum;
mod reaching;
mod turning;

use crate::inverse_kinematics::Angles;
use crate::model::Model;
use crate::robot::Robot;
use crate::rollout::World;
use crate::state::State;
use crate::task::{Aim, Goals};

/// Residual (m and rad, together) below which angles bring a hand to its goal.
const SOLVED: f64 = 1e-3;

/// Share of the way that is left which a control step shall take.
const GAIN: f64 = 0.7;

/// The controller of a task on a robot.
#[derive(Debug)]
pub struct JacobianController {
    robot: Robot,
    /// For what touches.
    model: Model<f64>,
    /// What each arm works for.
    aims: Vec<Aim>,
    /// Time of a control step (s).
    period: f64,
    /// Fastest joint rates (rad/s), arm-major: those that actions can command.
    limits: Vec<f64>,
}

/// What the controller keeps of an episode from one control step to the next.
#[derive(Debug, Clone, Default)]
pub(crate) struct Memory {
    /// By arm.
    branches: Vec<Option<Branch>>,
}

/// One of an arm's ways to its goal.
#[derive(Debug, Clone)]
struct Branch {
    /// The goal that it leads to.
    goal: [f64; 6],
    /// Angles at the goal, or those that come near it.
    angles: Angles,
    /// What is tried when it leads nowhere, the best last.
    others: Vec<Angles>,
    /// Control steps since it was chosen in which the hand was not at its goal.
    steps: usize,
}

impl JacobianController {
    /// The controller of the task of `world`, on its robot, within the limits of its actions.
    pub fn new(world: &World) -> Self {
        let scale = world.task.action_scale;
        Self {
            robot: world.robot.clone(),
            model: Model::new(&world.robot),
            aims: world.task.aims.clone(),
            period: world.config.env.control_period,
            limits: world.task.action_limit.iter().map(|limit| limit * scale).collect(),
        }
    }

    /// Joint rates (rad/s), arm-major, of the arms that it moves; zero of the others. `seen` is the robot as sensors show it.
    pub(crate) fn rates(
        &self,
        seen: &State<f64>,
        goals: &Goals<f64>,
        moves: &[bool],
        memory: &mut Memory,
    ) -> Vec<f64> {
        let aims = |wanted: Aim| -> Vec<bool> {
            moves.iter().zip(&self.aims).map(|(moves, aim)| *moves && *aim == wanted).collect()
        };
        let (reaching, turning) = (aims(Aim::Hand), aims(Aim::Base));
        let mut rates = vec![0.0; self.robot.n_joints()];
        if reaching.contains(&true) {
            rates = self.reach(seen, goals, &reaching, memory);
        }
        if turning.contains(&true) {
            let turned = self.turn(seen, goals.base, &turning);
            for (arm, turns) in turning.iter().enumerate() {
                let joints = self.robot.joints.of_arm(arm);
                if *turns {
                    rates[joints.clone()].copy_from_slice(&turned[joints]);
                }
            }
        }
        for (arm, _) in moves.iter().enumerate().filter(|(_, moves)| !**moves) {
            rates[self.robot.joints.of_arm(arm)].fill(0.0);
        }
        rates
    }

    /// Joints of the arms that it moves.
    fn joints(&self, moves: &[bool]) -> Vec<usize> {
        (0..self.robot.n_joints()).filter(|&joint| moves[self.robot.joints.arm_of(joint)]).collect()
    }
}

/// Slows all joints down in proportion until none is beyond its limit.
fn shorten(rates: &mut [f64], limits: &[f64]) {
    let parts = rates.iter().zip(limits).map(|(rate, limit)| rate.abs() / limit);
    let excess = parts.fold(1.0, f64::max);
    for rate in rates {
        *rate /= excess;
    }
}

#[cfg(test)]
mod tests;
