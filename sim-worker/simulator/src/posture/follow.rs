//! Postures follow their goals; where one does not bring its hand there, another way is looked for.
//!
//! Few lanes of an arm look for one, and looking takes six times as long as following. So lanes of all arms look side by side.

use super::arm::{Following, Place, Posture, Pursuit};
use super::chain::put_lane;
use super::search::{Question, STOPPED};
use crate::robot::MAX_ARMS;
use crate::scalar::{LANES, Mask, Real};

/// Has all arms follow their goals, but in the lanes of `rests`, an entry an arm.
#[inline(always)]
pub(super) fn follow<S: Real>(
    arms: &mut [Posture<S>],
    goals: &[[S; 6]],
    place: &Place<'_, S>,
    rests: &[S::Mask],
    following: Following,
) {
    let mut pursuits = Pursuits([None; MAX_ARMS]);
    let mut looks = false;
    for (index, arm) in arms.iter_mut().enumerate() {
        let pursuit = arm.go_after(&goals[index], (place, rests[index]), (index, following));
        looks |= pursuit.bad.any();
        pursuits.0[index] = Some(pursuit);
    }
    if looks {
        look(arms, &mut pursuits);
    }
    for (index, arm) in arms.iter_mut().enumerate() {
        arm.settle(pursuits.of(index), following);
    }
}

/// What the robot's arms are after, an entry an arm; none behind its last.
struct Pursuits<S: Real>([Option<Pursuit<S>>; MAX_ARMS]);

impl<S: Real> Pursuits<S> {
    #[inline(always)]
    fn of(&mut self, arm: usize) -> &mut Pursuit<S> {
        self.0[arm].as_mut().expect("every arm of the robot goes after its goal")
    }
}

/// Looks for another way in all lanes that need one; arms of one type together.
#[inline(always)]
fn look<S: Real>(arms: &mut [Posture<S>], pursuits: &mut Pursuits<S>) {
    for first in 0..arms.len() {
        let mut is_first = true;
        for earlier in &arms[..first] {
            is_first &= !earlier.chain.is_of_same_type(&arms[first].chain);
        }
        if !is_first {
            continue;
        }
        let mut seats = [Seat { arm: 0, lane: 0 }; LANES];
        let mut taken = 0;
        for arm in first..arms.len() {
            let bad = pursuits.of(arm).bad;
            if !bad.any() || !arms[arm].chain.is_of_same_type(&arms[first].chain) {
                continue;
            }
            for lane in 0..S::LANES {
                if !bad.lane(lane) {
                    continue;
                }
                seats[taken] = Seat { arm, lane };
                taken += 1;
                if taken == S::LANES {
                    look_together(arms, pursuits, &seats[..taken]);
                    taken = 0;
                }
            }
        }
        if taken > 0 {
            look_together(arms, pursuits, &seats[..taken]);
        }
    }
}

/// A lane of an arm.
#[derive(Clone, Copy)]
struct Seat {
    arm: usize,
    lane: usize,
}

/// [`look`] for as many lanes as there are at most.
#[inline(always)]
fn look_together<S: Real>(arms: &mut [Posture<S>], pursuits: &mut Pursuits<S>, seats: &[Seat]) {
    // Lanes that nobody takes keep what the first arm has there.
    let first = seats[0].arm;
    let mut chain = arms[first].chain.clone();
    let Pursuit { mut target, mut stands, .. } = *pursuits.of(first);
    let mut tried = arms[first].tried;
    for (to, &Seat { arm, lane }) in seats.iter().enumerate() {
        let (posture, pursuit) = (&arms[arm], pursuits.of(arm));
        chain.put_lane(to, &posture.chain, lane);
        target.put_lane(to, &pursuit.target, lane);
        put_lane(&mut stands, to, &pursuit.stands, lane);
        tried.set_lane(to, posture.tried.lane(lane));
    }
    let question = Question { chain: &chain, target: &target, stands: &stands };
    let other = question.later(tried);
    let cost = question.cost(&other);
    for (from, &Seat { arm, lane }) in seats.iter().enumerate() {
        if cost.lane(from) < STOPPED {
            put_lane(&mut arms[arm].angles, lane, &other, from);
            pursuits.of(arm).cost.set_lane(lane, cost.lane(from));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::readings;
    use crate::posture::chain::Chain;
    use crate::robot::Robot;
    use crate::scalar::{LaneFn, dispatch};
    use crate::state::State;
    use crate::task::HandReading;

    /// Situations of the robot, one a lane.
    const SITUATIONS: usize = 48;

    /// Two arms of six joints and two of seven.
    fn robot() -> Robot {
        let text = include_str!("../../robots/seven-joints.toml");
        Robot::from_toml(text, std::path::Path::new("seven-joints.toml")).expect("valid")
    }

    /// Goals of all hands, farther than a few steps lead, but in half of the situations one hand is at its own.
    fn goals(robot: &Robot, situation: usize) -> Vec<[f64; 6]> {
        let mut there = State::<f64>::home(robot);
        for (joint, q) in there.q.iter_mut().enumerate() {
            if situation % 8 != 1 + robot.joints.arm_of(joint) {
                *q += 0.9 * (1.7 * joint as f64 + 0.9 * situation as f64).sin();
            }
        }
        let hands = readings(robot, &there).hands;
        let pose = |hand: &HandReading<f64>| {
            let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
            [x, y, z, a, b, c]
        };
        hands.iter().map(pose).collect()
    }

    /// Arms at home, which have tried so many starts each, their goals, and the lanes that rest; the first lane is situation `first`.
    #[inline(always)]
    fn begun<S: Real>(robot: &Robot, first: usize) -> (Vec<Posture<S>>, Vec<[S; 6]>, S::Mask) {
        let mut arms: Vec<_> = Chain::<S>::of(robot).into_iter().map(Posture::new).collect();
        let mut slots = vec![[S::zero(); 6]; arms.len()];
        let mut rests = S::Mask::splat(false);
        for lane in 0..S::LANES {
            let situation = first + lane;
            for (index, goal) in goals(robot, situation).into_iter().enumerate() {
                for (slot, x) in slots[index].iter_mut().zip(goal) {
                    slot.set_lane(lane, x);
                }
                arms[index].tried.set_lane(lane, ((11 * index + situation) % 30) as f64);
            }
            rests.set_lane(lane, situation % 7 == 5);
        }
        (arms, slots, rests)
    }

    /// All that following changes in a lane of a posture.
    fn bits<S: Real>(arm: &Posture<S>, lane: usize) -> Vec<u64> {
        let all = arm.angles.iter().chain([&arm.tried, &arm.good, &arm.free]).chain(arm.left());
        all.map(|x| x.lane(lane).to_bits()).collect()
    }

    /// Number of lanes, and the bits of each arm in each situation.
    struct Together;
    impl LaneFn for Together {
        type Output = (usize, Vec<Vec<Vec<u64>>>);
        #[inline(always)]
        fn call<S: Real>(self) -> Self::Output {
            let robot = robot();
            let state = State::<S>::home(&robot);
            let place = Place::of(&state, robot.joints);
            let mut out = Vec::new();
            for first in (0..SITUATIONS).step_by(S::LANES) {
                let (mut arms, goals, rests) = begun::<S>(&robot, first);
                follow(&mut arms, &goals, &place, &[rests; MAX_ARMS], Following::CLOSE);
                for lane in 0..S::LANES {
                    out.push(arms.iter().map(|arm| bits(arm, lane)).collect());
                }
            }
            (S::LANES, out)
        }
    }

    /// [`follow`] for one arm in one lane, which looks for another way alone; says whether it looks, and whether it finds one.
    fn follow_alone(
        arm: &mut Posture<f32>,
        goal: &[f32; 6],
        (place, rests): (&Place<'_, f32>, bool),
        index: usize,
    ) -> (bool, bool) {
        let mut pursuit = arm.go_after(goal, (place, rests), (index, Following::CLOSE));
        let mut finds = false;
        if pursuit.bad {
            let Pursuit { target, stands, .. } = &pursuit;
            let question = Question { chain: &arm.chain, target, stands };
            let other = question.later(arm.tried);
            let cost = question.cost(&other);
            finds = f64::from(cost) < STOPPED;
            if finds {
                arm.angles = other;
                pursuit.cost = cost;
            }
        }
        arm.settle(&pursuit, Following::CLOSE);
        (pursuit.bad, finds)
    }

    #[test]
    fn arms_that_look_together_find_what_each_finds_alone() {
        let (n_lanes, together) = dispatch(Together);
        let robot = robot();
        let state = State::<f32>::home(&robot);
        let place = Place::of(&state, robot.joints);
        let mut looks_of_type = vec![vec![0; SITUATIONS.div_ceil(n_lanes)]; robot.types.len()];
        let mut found = vec![0; robot.arms.len()];
        for (situation, together) in together.iter().enumerate() {
            let (mut arms, goals, rests) = begun::<f32>(&robot, situation);
            for (index, arm) in arms.iter_mut().enumerate() {
                let (looks, finds) = follow_alone(arm, &goals[index], (&place, rests), index);
                looks_of_type[robot.arms[index].arm_type][situation / n_lanes] +=
                    usize::from(looks);
                found[index] += usize::from(finds);
                assert_eq!(together[index], bits(arm, 0), "{situation}, arm {index}");
            }
        }
        for looks in looks_of_type {
            assert!(looks.iter().any(|&looks| looks > n_lanes), "too few look: {looks:?}");
        }
        assert!(found.iter().all(|&found| found > 3), "too few find another way: {found:?}");
    }
}
