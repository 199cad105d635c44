//! What free flight cannot change: momentum, and the straight path of the centre of mass.
//!
//! No Runge–Kutta method keeps the angular momentum of a tree of bodies, and one-sided forces and torque limits cost it orders of accuracy. So the
//! end of a control period is projected back onto its invariants [Hairer, Lubich & Wanner 2006, §IV.4]: the base takes the position and velocities
//! that the joints, as integrated, leave it. Contacts and servos act between parts of the robot and so change none of it. What acts from outside does, by
//! its impulse (`Invariants::struck`).
//!
//! [Hairer, Lubich & Wanner 2006] Geometric Numerical Integration, Springer.

use super::articulated::ArticulatedInertia;
use super::kinematics::{for_sparsity, force_from_next, force_to_base, turn, velocities};
use crate::model::{Model, RigidInertia};
use crate::scalar::{Kernel, Real};
use crate::spatial::{
    Mat3, Vec3, Vec6, add, cross, cross_add, mat_t_vec, mat_vec, quaternion_to_rotation, scale, sub,
};
use crate::workspace::Workspace;

/// Base coordinates of a moment: where it is, seen from a fixed point, and how it moves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BaseMotion<S> {
    /// Position of the base's origin from the fixed point, world axes (m).
    pub(crate) position: Vec3<S>,
    /// Attitude (w, x, y, z).
    pub(crate) quaternion: [S; 4],
    /// Velocity of the origin, world axes (m/s).
    pub(crate) linear: Vec3<S>,
    /// Angular velocity, base axes (rad/s).
    pub(crate) angular: Vec3<S>,
}

/// Momentum and centre of mass of the robot at a moment, and its inertia with the joints locked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Invariants<S> {
    /// Linear momentum, world axes (kg m/s).
    linear: Vec3<S>,
    /// Angular momentum about the fixed point, world axes (kg m²/s).
    angular: Vec3<S>,
    /// Centre of mass from the fixed point, world axes (m).
    com: Vec3<S>,
    /// Inertia about the base's origin, base axes.
    locked: ArticulatedInertia<S>,
    r_wb: Mat3<S>,
}

/// Invariants at a moment. Fills `ws.base_v` and of every link `sin`, `cos`, `v`.
pub(crate) fn invariants<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    base: &BaseMotion<S>,
    q: &[S],
    qd: &[S],
) -> Invariants<S> {
    S::compiled(Look { model, ws, base, q, qd })
}

/// The arguments of [`invariants`].
struct Look<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    base: &'a BaseMotion<S>,
    q: &'a [S],
    qd: &'a [S],
}

impl<S: Real> Kernel<S> for Look<'_, S> {
    type Output = Invariants<S>;

    #[inline(always)]
    fn run(self) -> Invariants<S> {
        let Self { model, ws, base, q, qd } = self;
        let r_wb = quaternion_to_rotation(&base.quaternion);
        ws.base_v = Vec6 { ang: base.angular, lin: mat_t_vec(&r_wb, base.linear) };
        velocities(model, ws, q, qd);
        let mut locked = ArticulatedInertia::zero();
        locked.add_body(&model.base);
        let mut total = momentum(&model.base, ws.base_v);
        for arm in 0..model.n_arms {
            let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
            let mut inertia = ArticulatedInertia::zero();
            let mut h = Vec6::zero();
            let mut j = links.len();
            while j > 0 {
                j -= 1;
                let body = &links[j];
                if j + 1 < links.len() {
                    (inertia, h) = for_sparsity!(body.sparsity, sparsity => (
                        inertia.moved_to_previous(body, sparsity),
                        force_from_next(body, sparsity, h)
                    ));
                }
                let link = &ws.links[first + j];
                inertia.add_body(&body.body);
                let own = momentum(&body.body, link.v);
                inertia = inertia.turned(link.sin, link.cos);
                h.ang = turn(link.sin, link.cos, add(h.ang, own.ang));
                h.lin = turn(link.sin, link.cos, add(h.lin, own.lin));
            }
            locked.add(&inertia.moved_to_base(&model.arms[arm]));
            let h = force_to_base(&model.arms[arm], h);
            total.ang = add(total.ang, h.ang);
            total.lin = add(total.lin, h.lin);
        }
        let linear = mat_vec(&r_wb, total.lin);
        // The block of a rigid body is [m c]×.
        let per_mass = locked.c[0].recip();
        let com = scale(per_mass, [locked.b[2][1], locked.b[0][2], locked.b[1][0]]);
        Invariants {
            linear,
            angular: cross_add(base.position, linear, mat_vec(&r_wb, total.ang)),
            com: add(base.position, mat_vec(&r_wb, com)),
            locked,
            r_wb,
        }
    }
}

/// I v of a rigid body.
#[inline(always)]
fn momentum<S: Real>(body: &RigidInertia<S>, v: Vec6<S>) -> Vec6<S> {
    let [xx, yy, zz, xy, xz, yz] = body.inertia;
    let rotor = mat_vec(&[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], v.ang);
    Vec6 {
        ang: cross_add(body.h, v.lin, rotor),
        lin: cross_add(v.ang, body.h, scale(body.mass, v.lin)),
    }
}

impl<S: Real> Invariants<S> {
    /// Centre of mass from the fixed point, world axes (m).
    #[cfg(test)]
    pub(crate) fn centre_of_mass(&self) -> Vec3<S> {
        self.com
    }

    /// Velocity of the centre of mass, world axes (m/s).
    pub(crate) fn velocity(&self) -> Vec3<S> {
        scale(self.locked.c[0].recip(), self.linear)
    }

    /// Velocity that the base, which has none, takes so that nothing of this momentum is left: at its origin, its axes, if the fixed point is there.
    #[inline(always)]
    pub(crate) fn recoil(&self) -> Vec6<S> {
        let [ang, lin] =
            [self.angular, self.linear].map(|p| mat_t_vec(&self.r_wb, sub([S::zero(); 3], p)));
        self.locked.solve(Vec6 { ang, lin })
    }

    /// What they are after a time (s) in which a constant force and some moment have acted from outside, with this impulse: world axes, about the fixed point
    /// (N m s, N s).
    ///
    /// The centre of mass is set back by what [`Invariants::restore`] lets it travel too far: under a constant force it gains ½ F t² / m, not F t² / m.
    #[inline(always)]
    pub(crate) fn struck(&mut self, impulse: Vec6<S>, time: S) {
        self.linear = add(self.linear, impulse.lin);
        self.angular = add(self.angular, impulse.ang);
        let late = scale(S::splat(-0.5) * time * self.locked.c[0].recip(), impulse.lin);
        self.com = add(self.com, late);
    }

    /// Moves and accelerates `base`, which has the invariants `now`, so that it has these again, `time` (s) later.
    #[inline(always)]
    pub(crate) fn restore(&self, now: &Self, base: &mut BaseMotion<S>, time: S) {
        // The centre of mass goes straight on.
        let travelled = scale(time * self.locked.c[0].recip(), self.linear);
        let shift = sub(add(self.com, travelled), now.com);
        base.position = add(base.position, shift);
        // What momentum is missing, about the base's origin there.
        let force = sub(self.linear, now.linear);
        let moment = sub(sub(self.angular, now.angular), cross(shift, now.linear));
        let moment = sub(moment, cross(base.position, force));
        let change = now
            .locked
            .solve(Vec6 { ang: mat_t_vec(&now.r_wb, moment), lin: mat_t_vec(&now.r_wb, force) });
        base.angular = add(base.angular, change.ang);
        base.linear = add(base.linear, mat_vec(&now.r_wb, change.lin));
    }
}
