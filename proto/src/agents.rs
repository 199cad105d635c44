//! How the joints of a robot are divided among arms and agents.
//!
//! Each arm has two agents: the first moves the half of its joints that stands at the base (the shoulder), the second the others (the wrist). Where the
//! number is odd, the shoulder has one more.

#![expect(
    clippy::inline_always,
    reason = "asked in the innermost loops, which are compiled for the processor's vectors"
)]

use std::fmt;
use std::ops::Range;

/// Agents of one arm: shoulder joints, wrist joints.
pub const AGENTS_PER_ARM: usize = 2;

/// Most arms of a robot.
pub const MAX_ARMS: usize = 8;

/// Fewest joints of an arm: one an agent.
pub const MIN_JOINTS_PER_ARM: usize = AGENTS_PER_ARM;

/// Most joints of an arm.
pub const MAX_JOINTS_PER_ARM: usize = 7;

/// Most joints that one agent moves.
pub const MAX_JOINTS_PER_AGENT: usize = MAX_JOINTS_PER_ARM.div_ceil(AGENTS_PER_ARM);

/// Which joints are whose. Joints are counted arm-major, from the base to the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Joints {
    n_arms: u8,
    /// By arm: its first joint; behind the last arm: the number of joints.
    first: [u8; MAX_ARMS + 1],
    /// By joint: its arm.
    arm: [u8; MAX_ARMS * MAX_JOINTS_PER_ARM],
}

impl Joints {
    /// Of a robot whose arms have so many joints each.
    ///
    /// # Panics
    ///
    /// With no arm or more than [`MAX_ARMS`], or where an arm has fewer than [`MIN_JOINTS_PER_ARM`] or more than [`MAX_JOINTS_PER_ARM`] joints: where numbers
    /// come from outside, [`Joints::are_possible`] tells before.
    pub fn new(joints: &[usize]) -> Self {
        assert!(Self::are_possible(joints), "arms of {joints:?} joints");
        let mut new = Self {
            n_arms: joints.len() as u8,
            first: [0; MAX_ARMS + 1],
            arm: [0; MAX_ARMS * MAX_JOINTS_PER_ARM],
        };
        let mut at = 0;
        for (arm, &n) in joints.iter().enumerate() {
            new.arm[at..at + n].fill(arm as u8);
            at += n;
            new.first[arm + 1..].fill(at as u8);
        }
        new
    }

    /// The same, of numbers that come from outside: nothing if no robot has such arms.
    pub fn of_outside(joints: &[usize]) -> Option<Self> {
        Self::are_possible(joints).then(|| Self::new(joints))
    }

    /// Of a robot with `n_arms` arms of six joints, as UR arms are.
    pub fn of_sixes(n_arms: usize) -> Self {
        Self::new(&[6; MAX_ARMS][..n_arms])
    }

    /// Whether a robot may have arms of so many joints.
    pub fn are_possible(joints: &[usize]) -> bool {
        let fit = |n: &usize| (MIN_JOINTS_PER_ARM..=MAX_JOINTS_PER_ARM).contains(n);
        (1..=MAX_ARMS).contains(&joints.len()) && joints.iter().all(fit)
    }

    /// Number of arms.
    #[inline(always)]
    pub fn n_arms(&self) -> usize {
        usize::from(self.n_arms)
    }

    /// Number of agents.
    #[inline(always)]
    pub fn n_agents(&self) -> usize {
        self.n_arms() * AGENTS_PER_ARM
    }

    /// Number of joints, all arms.
    #[inline(always)]
    pub fn n_joints(&self) -> usize {
        usize::from(self.first[self.n_arms()])
    }

    /// The joints of an arm.
    #[inline(always)]
    pub fn of_arm(&self, arm: usize) -> Range<usize> {
        usize::from(self.first[arm])..usize::from(self.first[arm + 1])
    }

    /// The joints that an agent moves.
    #[inline(always)]
    pub fn of_agent(&self, agent: usize) -> Range<usize> {
        let Range { start, end } = self.of_arm(agent / AGENTS_PER_ARM);
        let middle = start + (end - start).div_ceil(AGENTS_PER_ARM);
        if agent.is_multiple_of(AGENTS_PER_ARM) { start..middle } else { middle..end }
    }

    /// The arm that a joint belongs to.
    #[inline(always)]
    pub fn arm_of(&self, joint: usize) -> usize {
        usize::from(self.arm[joint])
    }

    /// The agent that moves a joint.
    pub fn agent_of(&self, joint: usize) -> usize {
        let shoulder = self.arm_of(joint) * AGENTS_PER_ARM;
        shoulder + usize::from(!self.of_agent(shoulder).contains(&joint))
    }

    /// Which joint of its arm a joint is, from 0.
    #[inline(always)]
    pub fn within_arm(&self, joint: usize) -> usize {
        joint - usize::from(self.first[self.arm_of(joint)])
    }

    /// Joints of the longest arm: what arms see of their own has room for so many.
    pub fn longest_arm(&self) -> usize {
        (0..self.n_arms()).map(|arm| self.of_arm(arm).len()).max().unwrap_or(0)
    }

    /// U: joints of the agent that moves most. Every agent has so many actions; those beyond its own joints move nothing.
    pub fn per_agent(&self) -> usize {
        self.longest_arm().div_ceil(AGENTS_PER_ARM)
    }

    /// Whether every agent moves as many joints as any other.
    pub fn are_even(&self) -> bool {
        (0..self.n_agents()).all(|agent| self.of_agent(agent).len() == self.per_agent())
    }

    /// Joints of each arm.
    pub fn by_arm(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.n_arms()).map(|arm| self.of_arm(arm).len())
    }
}

/// `4 arms of 6 joints`, `arms of 6, 6, 7, 7 joints`.
impl fmt::Display for Joints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.of_arm(0).len();
        match self.n_arms() {
            1 => write!(f, "1 arm of {n} joints"),
            arms if self.by_arm().all(|other| other == n) => write!(f, "{arms} arms of {n} joints"),
            _ => {
                let each: Vec<String> = self.by_arm().map(|n| n.to_string()).collect();
                write!(f, "arms of {} joints", each.join(", "))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_joint_is_of_one_arm_and_one_agent() {
        for arms in [&[6, 6, 6, 6][..], &[7, 6], &[2, 3, 4, 5, 6, 7], &[7; MAX_ARMS]] {
            let joints = Joints::new(arms);
            assert_eq!(joints.by_arm().collect::<Vec<_>>(), arms);
            let mut seen = 0;
            for agent in 0..joints.n_agents() {
                for joint in joints.of_agent(agent) {
                    assert_eq!(joint, seen);
                    assert_eq!(joints.agent_of(joint), agent);
                    assert_eq!(joints.arm_of(joint), agent / AGENTS_PER_ARM);
                    let arm = joints.of_arm(agent / AGENTS_PER_ARM);
                    assert_eq!(joints.within_arm(joint), joint - arm.start);
                    seen += 1;
                }
                assert!(joints.of_agent(agent).len() <= joints.per_agent());
            }
            assert_eq!(seen, joints.n_joints());
        }
        let words = |arms: &[usize]| Joints::new(arms).to_string();
        assert_eq!(words(&[6, 6]), "2 arms of 6 joints");
        assert_eq!(words(&[7, 6]), "arms of 7, 6 joints");
        assert_eq!(words(&[7]), "1 arm of 7 joints");
        assert!(Joints::of_sixes(4).are_even() && !Joints::new(&[7]).are_even());
        assert_eq!(Joints::new(&[5]).of_agent(0), 0..3);
        assert!(!Joints::are_possible(&[8]) && !Joints::are_possible(&[1]));
        assert!(!Joints::are_possible(&[]) && !Joints::are_possible(&[6; 9]));
    }
}
