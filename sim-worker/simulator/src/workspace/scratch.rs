//! Scratch memory of the dynamics, named.

use super::contact_set::ContactSet;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{Mat3, Vec3, Vec6};

/// What the three passes of the articulated-body algorithm keep of a link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinkScratch<S> {
    /// Sine and cosine of the joint angle.
    pub(crate) sin: S,
    pub(crate) cos: S,
    /// Velocity of the link, link frame.
    pub(crate) v: Vec6<S>,
    /// Force on the link from outside (contacts), link frame at its origin; holds nothing where `forced` is not set.
    pub(crate) f_ext: Vec6<S>,
    /// I_A S: the articulated inertia's column of the joint.
    pub(crate) u_col: Vec6<S>,
    /// 1 / (Sᵀ I_A S + armature).
    pub(crate) d_inv: S,
    /// τ − Sᵀ p_A.
    pub(crate) u: S,
    /// Torque of the servo and of the contacts that the joint's angle tells (N m).
    pub(crate) tau: S,
}

/// Pose of a link frame in the base frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinkPose<S> {
    /// Link axes to base axes.
    pub(crate) r: Mat3<S>,
    /// Origin (m).
    pub(crate) o: Vec3<S>,
}

/// Scratch memory for one robot (or one robot per lane). Holds nothing from one call to the next that matters.
#[derive(Clone, Debug)]
pub struct Workspace<S: Real> {
    /// One a joint, arm-major.
    pub(crate) links: Vec<LinkScratch<S>>,
    /// One a joint, arm-major; filled where contacts or hands need them.
    pub(crate) poses: Vec<LinkPose<S>>,
    /// Whether each link feels an outside force in some lane.
    pub(crate) forced: Vec<bool>,
    /// Outside force on the base, base frame.
    pub(crate) base_f_ext: Vec6<S>,
    /// Velocity of the base, base frame.
    pub(crate) base_v: Vec6<S>,
    /// Wrench of a disturbance on the whole robot at the last evaluation: world axes, about the base's position at the period's start.
    pub(crate) outside: Vec6<S>,
    /// Flat states of the integrator, see `step::flat_state`: at the substep's start, at the stage, the stage's derivative, their weighted sum.
    pub(crate) y0: Vec<S>,
    pub(crate) y: Vec<S>,
    pub(crate) k: Vec<S>,
    pub(crate) sum: Vec<S>,
    pub(crate) contacts: ContactSet<S>,
}

impl<S: Real> Workspace<S> {
    /// Scratch memory for `model`.
    pub fn new(model: &Model<S>) -> Self {
        let n = model.n_joints();
        let zero = S::zero();
        let link = LinkScratch {
            sin: zero,
            cos: zero,
            v: Vec6::zero(),
            f_ext: Vec6::zero(),
            u_col: Vec6::zero(),
            d_inv: zero,
            u: zero,
            tau: zero,
        };
        let pose = LinkPose { r: [[zero; 3]; 3], o: [zero; 3] };
        let flat = vec![zero; 13 + 2 * n];
        Self {
            links: vec![link; n],
            poses: vec![pose; n],
            forced: vec![false; n],
            base_f_ext: Vec6::zero(),
            base_v: Vec6::zero(),
            outside: Vec6::zero(),
            y0: flat.clone(),
            y: flat.clone(),
            k: flat.clone(),
            sum: flat,
            contacts: ContactSet::new(model),
        }
    }

    /// Takes all outside forces off base and links.
    #[inline(always)]
    pub(crate) fn take_off_outside_forces(&mut self) {
        self.base_f_ext = Vec6::zero();
        self.forced.fill(false);
    }
}
