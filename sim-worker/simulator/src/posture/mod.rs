//! Goal postures: the joint angles that bring each hand to its goal, as a task tells them to its agents.
//!
//! A pose can be reached in up to eight ways, and near the borders between them an actor that sees the pose alone averages. A goal posture
//! is one way: chosen when the goal is seen for the first time, then kept, while steps of damped least squares in every control step let it follow
//! the goal, where that moves, and the base, which carries goals away from the arm or to it. Where the posture does not bring the hand to its goal, or stops a joint, another
//! way is looked for in every control step, and now and then for all arms together, also where arms touch.

mod arm;
mod chain;
mod follow;
mod foresight;
mod guidance;
mod kinematic_rollout;
mod search;

use std::sync::Arc;

use self::arm::{Following, Place, equal};
pub(crate) use self::arm::{Pace, Posture};
use self::chain::Chain;
use self::follow::follow;
use self::foresight::{Foresight, Trials};
pub(crate) use self::guidance::Guidance;
use crate::collision::touching;
use crate::model::Model;
use crate::robot::{MAX_ARMS, Robot};
use crate::scalar::{Kernel, Mask, Real, registers_are_whole};
use crate::spatial::{Vec3, quaternion_normalised};
use crate::workspace::Workspace;

/// A pose of the base that is not known: nothing is the same as what is not a number.
const UNKNOWN: [f64; 7] = [f64::NAN; 7];

/// Control steps after which all arms choose anew, if some arm has no way to its goal or touches something.
const REVIEW: f64 = 10.0;
/// Reviews of the same goals: after the last one an arm without a way looks for one by itself alone.
const REVIEWS: f64 = 16.0;

/// The goal postures of one lane group.
#[derive(Debug, Clone)]
pub(crate) struct Postures<S: Real> {
    pub(crate) arms: Vec<Posture<S>>,
    /// Which arms go to their postures; false behind the last one.
    active: [bool; MAX_ARMS],
    /// Whether a hand without a way comes as near to its goal as it can; else it rests.
    persistent: bool,
    model: Arc<Model<S>>,
    workspace: Workspace<S>,
    pace: Pace<S>,
    /// Where sets of ways are tried.
    trials: Width<S>,
    /// Where the base was read to be when they last followed it: who looks twice sees the same.
    base: [S; 7],
    /// Where it is taken to be.
    believed: [S; 7],
    /// Weight of a newly read pose of the base in where it is taken to be, in single precision as elsewhere.
    trust: f64,
    /// Control steps since a goal was new.
    age: S,
}

/// In how many lanes sets of ways are tried: as many as there are environments, or as fill a register. The choice is the same.
#[derive(Debug, Clone)]
enum Width<S: Real> {
    Lanes(Arc<Trials<S>>),
    Register(Arc<Trials<S::Register>>),
}

impl<S: Real> Postures<S> {
    /// None yet.
    pub(crate) fn new(robot: &Robot, pace: Pace<S>, trust: f64) -> Self {
        let trials = if S::LANES < S::Register::LANES && registers_are_whole() {
            Width::Register(Arc::new(Trials::new(robot, &pace)))
        } else {
            Width::Lanes(Arc::new(Trials::new(robot, &pace)))
        };
        let arms = Chain::of(robot).into_iter().map(Posture::new);
        let model = Model::new(robot);
        Self {
            arms: arms.collect(),
            active: std::array::from_fn(|arm| arm < robot.n_arms),
            persistent: true,
            workspace: Workspace::new(&model),
            model: Arc::new(model),
            pace,
            trials,
            base: UNKNOWN.map(S::splat),
            believed: UNKNOWN.map(S::splat),
            trust: f64::from(trust as f32),
            age: S::zero(),
        }
    }

    /// Whether they go at this pace, and trust so much.
    pub(crate) fn are(&self, pace: &Pace<S>, trust: f64) -> bool {
        self.pace == *pace && self.trust == f64::from(trust as f32)
    }

    /// Has hands without a way rest, while they do not stand in the way of others. Otherwise they come nearer to their goals in small steps, each of which moves the base a
    /// little, until the goal comes into reach. That disturbs those who learn.
    pub(crate) fn give_rest(&mut self) {
        self.persistent = false;
    }

    /// Which arms go to their postures from now on. The others are taken to stay where they are, and nobody chooses anew for their sake.
    pub(crate) fn activate(&mut self, active: impl Iterator<Item = bool>) {
        for (slot, active) in self.active.iter_mut().zip(active) {
            *slot = active;
        }
    }

    /// Forgets all goals, because another episode begins.
    pub(crate) fn forget(&mut self) {
        for arm in &mut self.arms {
            arm.forget();
        }
        self.forget_base();
    }

    /// Forgets where the base was, because it was not looked at for a while.
    pub(crate) fn forget_base(&mut self) {
        self.base = UNKNOWN.map(S::splat);
        self.believed = self.base;
    }

    /// How they follow their goals.
    fn following(&self) -> Following {
        if self.trust >= 1.0 { Following::CLOSE } else { Following::STEADY }
    }

    /// Takes in where the base is read to be, but in lanes where it `rests`; says where it is taken to be.
    ///
    /// Sensors err anew in every control step, and goals are seen from the base: a posture that cannot follow what trembles is given up for another one.
    #[inline(always)]
    fn believe(
        &mut self,
        (position, quaternion): (Vec3<S>, [S; 4]),
        rests: S::Mask,
    ) -> (Vec3<S>, [S; 4]) {
        if self.trust >= 1.0 {
            return (position, quaternion);
        }
        let was = self.believed;
        let known = was[0].le(was[0]);
        // An attitude has two quaternions.
        let [q0, q1, q2, q3] = quaternion;
        let along = was[6].mul_add(q3, was[5].mul_add(q2, was[4].mul_add(q1, was[3] * q0)));
        let other = along.lt(S::zero());
        let [q0, q1, q2, q3] = [q0, q1, q2, q3].map(|part| S::select(other, -part, part));
        let [x, y, z] = position;
        let read = [x, y, z, q0, q1, q2, q3];
        let weight = S::splat(self.trust);
        let mut now = read;
        for (now, was) in now.iter_mut().zip(was) {
            *now = S::select(known, weight.mul_add(*now - was, was), *now);
        }
        let [x, y, z, q0, q1, q2, q3] = now;
        let [q0, q1, q2, q3] = quaternion_normalised(&[q0, q1, q2, q3]);
        for (believed, now) in self.believed.iter_mut().zip([x, y, z, q0, q1, q2, q3]) {
            *believed = S::select(rests, *believed, now);
        }
        let [x, y, z, q0, q1, q2, q3] = self.believed;
        ([x, y, z], [q0, q1, q2, q3])
    }

    /// Counts a control step, but in lanes where the base `rests`, and from zero where a goal is `new`; says in which lanes all active arms choose anew.
    ///
    /// The base that other ways leave elsewhere may bring a goal back into reach. And arms that were led astray may have come to rest at each other.
    #[inline(always)]
    fn review(&mut self, new: S::Mask, rests: S::Mask, place: &Place<'_, S>) -> S::Mask {
        let older = S::select(rests, self.age, self.age + S::one());
        self.age = S::select(new, S::zero(), older);
        let reviews = (self.age / S::splat(REVIEW)).floor();
        let due = (self.age - reviews * S::splat(REVIEW)).lt(S::splat(0.5));
        let due = due & !new & !rests & reviews.le(S::splat(REVIEWS));
        if !due.any() {
            return due;
        }
        let touching = touching(&self.model, &mut self.workspace, &place.at_rest());
        let mut bad = S::Mask::splat(false);
        for (index, arm) in self.arms.iter().enumerate() {
            let is_bad = arm.good.lt(S::one()) | S::zero().lt(touching.by_arm[index]);
            bad = bad | (is_bad & S::Mask::splat(self.active[index]));
        }
        due & bad
    }

    /// Looks for postures of new goals of the hands (m, rad; world), and has the others follow the base, which is at `position` (m) with the
    /// attitude `quaternion`; `q` are the joint angles (rad).
    #[inline(always)]
    pub(crate) fn update(
        &mut self,
        (position, quaternion): (Vec3<S>, [S; 4]),
        q: &[S],
        goals: &[[S; 6]],
    ) {
        S::compiled(Update { postures: self, base: (position, quaternion), q, goals });
    }
}

/// The arguments of [`Postures::update`].
struct Update<'a, S: Real> {
    postures: &'a mut Postures<S>,
    base: (Vec3<S>, [S; 4]),
    q: &'a [S],
    goals: &'a [[S; 6]],
}

impl<S: Real> Kernel<S> for Update<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { postures, base: (position, quaternion), q, goals } = self;
        let ([x, y, z], [q0, q1, q2, q3]) = (position, quaternion);
        let now = [x, y, z, q0, q1, q2, q3];
        let rests = equal(&now, &postures.base);
        postures.base = now;
        let (position, quaternion) = postures.believe((position, quaternion), rests);
        let place = Place { position, quaternion, q, joints: postures.model.joints };
        let mut open = [S::Mask::splat(false); MAX_ARMS];
        let mut still = open;
        let (mut new, mut asked) = (S::Mask::splat(false), S::Mask::splat(false));
        for (index, (arm, goal)) in postures.arms.iter_mut().zip(goals).enumerate() {
            let (is_new, rests) = arm.begin(goal, &place, index);
            open[index] = is_new & S::Mask::splat(postures.active[index]);
            still[index] = rests;
            new = new | is_new;
            asked = asked | open[index];
        }
        let reviewed = postures.review(new, rests, &place);
        let following = postures.following();
        if (asked | reviewed).any() {
            let Postures { arms, active, persistent, trials, age, .. } = &mut *postures;
            for (open, active) in open.iter_mut().zip(*active) {
                *open = *open | (reviewed & S::Mask::splat(active));
            }
            let before = *age / S::splat(REVIEW);
            let foresight = Foresight {
                goals,
                place: &place,
                open: &open[..arms.len()],
                active: *active,
                following,
                persistent: *persistent,
                before,
                to_the_end: false,
            };
            match trials {
                Width::Lanes(trials) => foresight.choose(arms, trials),
                Width::Register(trials) => foresight.choose(arms, trials),
            }
        }
        for still in &mut still {
            *still = *still & rests;
        }
        follow(&mut postures.arms, goals, &place, &still, following);
    }
}

#[cfg(test)]
mod tests;
