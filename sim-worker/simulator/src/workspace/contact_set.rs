//! The contacts of a substep, and what tells when a pair must be looked at again.

use crate::model::{Bound, Model};
use crate::robot::MAX_JOINTS_PER_ARM;
use crate::scalar::{Mask, Real};
use crate::spatial::Vec3;

/// Natural frequency of contacts (rad/s), lower where the integrator's substep asks for it.
const FREQUENCY: f64 = 260.0;

/// Damping ratio of contacts.
const DAMPING_RATIO: f64 = 0.5;

/// A point at which two bodies push each other, for the length of a substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact<S: Real> {
    pub(crate) pair: usize,
    /// Lanes in which it may push within the substep.
    pub(crate) lanes: S::Mask,
    /// Surface points, fixed to the bodies: A's in its link frame, B's in its link frame or the base frame (m).
    pub(crate) on_a: Vec3<S>,
    pub(crate) on_b: Vec3<S>,
    /// From B to A, fixed to the base.
    pub(crate) normal: Vec3<S>,
    /// Mass the joints show along the normal (kg).
    pub(crate) mass: S,
    /// Acceleration that torques alone would give the gap at the start of the substep, as far as it closes it and is held against (m/s²).
    pub(crate) hold: S,
    /// A's point in the base frame (m), and the force (N), at the last look.
    pub(crate) point: Vec3<S>,
    pub(crate) force: S,
    /// Acceleration that the gap shall have at least (m/s²).
    pub(crate) drive: S,
    /// Where its row of `couplings` begins.
    pub(crate) others: usize,
    /// What a unit force along the normal leaves at the joints of A's arm, and of B's where that is another (see `collision::push::arm_response`).
    pub(crate) at_a: Response<S>,
    pub(crate) at_b: Response<S>,
}

/// How long joints take to follow a new command, all but for a small part (s).
const SETTLING: f64 = 0.06;

/// Speed (m/s) and rate (rad/s) that nothing exceeds, whatever acts on it.
const FASTEST: f64 = 1e3;

/// How long the motion at hand says something about speeds (s).
pub(crate) const OUTLOOK: f64 = 0.1;

/// A force carried up an arm: u at each joint, zero behind the arm's last.
pub(crate) type Response<S> = [S; MAX_JOINTS_PER_ARM];

/// Contacts of a substep, and what tells when a pair must be looked at again.
#[derive(Clone, Debug)]
pub(crate) struct ContactSet<S: Real> {
    pub(crate) contacts: Vec<Contact<S>>,
    /// Off the diagonal of W (1/kg), contact by contact: which other contact, and how much a unit of its force accelerates the gap.
    pub(crate) couplings: Vec<(usize, S)>,
    /// ω² (1/s²) and 2 ζ ω (1/s) of contacts.
    pub(crate) stiffness: S,
    pub(crate) damping: S,
    /// Bounding capsules of the links, base frame, and their middles (m).
    pub(crate) bounds: Vec<Bound<S>>,
    pub(crate) middles: Vec<Vec3<S>>,
    /// Torques at the joints without the contacts (N m), see `collision::push::take_off_forces`.
    pub(crate) free: Vec<S>,
    /// Rate that no joint is expected to exceed in the period (rad/s).
    pub(crate) rates: Vec<S>,
    /// Speed against the base that no point of a link is expected to exceed in the period, whatever the pose (m/s).
    pub(crate) speeds: Vec<S>,
    /// Speed that none is expected to exceed for [`OUTLOOK`] (m/s): from the motion at hand, or `speeds` while joints still follow a new command.
    pub(crate) speeds_ahead: Vec<S>,
    /// When `speeds_ahead` is looked at again, since the period's start (s).
    pub(crate) next_look: f64,
    /// When each pair may come into reach, since the period's start (s).
    pub(crate) wake: Vec<S>,
    /// Pairs with an alarm before `next_scan`, in ascending order; when all are looked through again, since the period's start (s).
    pub(crate) due: Vec<usize>,
    pub(crate) next_scan: f64,
    /// By arm: whether some contact of the substep involves it.
    pub(crate) touched: Vec<bool>,
}

impl<S: Real> ContactSet<S> {
    /// Room for all pairs of `model`.
    pub(crate) fn new(model: &Model<S>) -> Self {
        let (n_pairs, n) = (model.collision.pairs.len(), model.n_joints());
        let zero = S::zero();
        Self {
            contacts: Vec::with_capacity(n_pairs),
            couplings: Vec::with_capacity(n_pairs),
            stiffness: zero,
            damping: zero,
            bounds: vec![Bound { from: [zero; 3], to: [zero; 3], radius: zero }; n],
            middles: vec![[zero; 3]; n],
            free: vec![zero; n],
            rates: vec![zero; n],
            speeds: vec![zero; n],
            speeds_ahead: vec![zero; n],
            next_look: 0.0,
            wake: vec![zero; n_pairs],
            due: Vec::with_capacity(n_pairs),
            next_scan: 0.0,
            touched: vec![false; model.n_arms()],
        }
    }

    /// Begins a control period: sets the stiffness of contacts, softer where only frequencies up to `stable` (rad/s) are, and bounds speeds by rates and commands
    /// (rad/s).
    #[inline(always)]
    pub(crate) fn begin_period(&mut self, model: &Model<S>, stable: f64, qd: &[S], command: &[S]) {
        for i in 0..self.rates.len() {
            // A quarter more than asked for, because other joints and contacts drag.
            let rate = qd[i].abs().max(command[i].abs());
            self.rates[i] = rate.mul_add(S::splat(1.25), S::splat(0.1));
        }
        for i in 0..self.speeds.len() {
            let first = model.joints.of_arm(model.joints.arm_of(i)).start;
            let levers = &model.collision.link(i).levers;
            let mut speed = S::zero();
            for (&rate, lever) in self.rates[first..=i].iter().zip(levers) {
                speed = lever.mul_add(rate, speed);
            }
            self.speeds[i] = speed;
            self.speeds_ahead[i] = speed;
        }
        self.next_look = SETTLING;
        self.next_scan = 0.0;
        self.contacts.clear();
        self.wake.fill(S::zero());
        let frequency = FREQUENCY.min(stable);
        self.stiffness = S::splat(frequency * frequency);
        self.damping = S::splat(2.0 * DAMPING_RATIO * frequency);
    }

    /// Lists the pairs with an alarm before the next scan.
    #[inline(always)]
    pub(crate) fn list_due(&mut self) {
        self.due.clear();
        let next_scan = S::splat(self.next_scan);
        for (pair, wake) in self.wake.iter().enumerate() {
            if wake.lt(next_scan).any() {
                self.due.push(pair);
            }
        }
    }

    /// Takes off the list what has no alarm before the next scan any more.
    #[inline(always)]
    pub(crate) fn keep_due(&mut self) {
        let next_scan = S::splat(self.next_scan);
        let mut kept = 0;
        for i in 0..self.due.len() {
            let pair = self.due[i];
            if self.wake[pair].lt(next_scan).any() {
                self.due[kept] = pair;
                kept += 1;
            }
        }
        self.due.truncate(kept);
    }

    /// ω² (1/s²) and 2 ζ ω (1/s) of contacts.
    #[inline(always)]
    pub(crate) fn rates(&self) -> (S, S) {
        (self.stiffness, self.damping)
    }

    /// Has every pair looked at in the next substep: commands and motion bound speeds no longer where something acts from outside.
    #[inline(always)]
    pub(crate) fn wake_all(&mut self) {
        self.rates.fill(S::splat(FASTEST));
        self.speeds.fill(S::splat(FASTEST));
        self.wake.fill(S::zero());
        self.next_look = 0.0;
        self.next_scan = 0.0;
    }

    /// Whether the last narrow phase found a contact in some lane.
    #[inline(always)]
    pub(crate) fn any(&self) -> bool {
        !self.contacts.is_empty()
    }

    /// Whether some contact is one of this arm.
    #[inline(always)]
    pub(crate) fn touches_arm(&self, arm: usize) -> bool {
        self.touched[arm]
    }
}
