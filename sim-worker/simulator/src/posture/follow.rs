//! Postures follow their goals; where one does not bring its hand there, another way is looked for.
//!
//! Few lanes of an arm look for one, and looking takes six times as long as following. So lanes of all arms look side by side.

use super::arm::{Place, Posture, Pursuit};
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
) {
    let mut pursuits = Pursuits([None; MAX_ARMS]);
    let mut looks = false;
    for (index, arm) in arms.iter_mut().enumerate() {
        let pursuit = arm.go_after(&goals[index], (place, rests[index]), index);
        looks |= pursuit.bad.any();
        pursuits.0[index] = Some(pursuit);
    }
    if looks {
        look(arms, &mut pursuits);
    }
    for (index, arm) in arms.iter_mut().enumerate() {
        arm.settle(pursuits.of(index));
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
