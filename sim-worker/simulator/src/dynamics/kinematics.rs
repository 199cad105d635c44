//! Steps between link frames, with the sparsity of Denavit–Hartenberg rows: a shift in the x-z plane, a twist about x (mostly a permutation), a turn
//! about z.
//!
//! **Why sparsity is constant.** A link's step is one straight piece of code for each shape of its
//! Denavit–Hartenberg row (`for_sparsity!`). A branch in its middle sends all the numbers that are carried along
//! through memory.

use crate::model::{ArmModel, LinkModel, Model, Sparsity, Twist};
use crate::scalar::Real;
use crate::spatial::{Vec3, Vec6, add, cross, cross_add, mat_t_vec, mat_vec, sub};
use crate::workspace::{LinkPose, Workspace};

/// Evaluates an expression with `$sparsity`, the [`Sparsity`] of a link, as a constant where it is one of the UR arms', and as a variable elsewhere.
///
/// A macro, because a closure is a function of its own that is compiled without the lane function's processor features.
macro_rules! for_sparsity {
    ($of:expr, $sparsity:ident => $value:expr) => {
        match $of {
            crate::model::Sparsity {
                twist: crate::model::Twist::None,
                has_a: true,
                has_d: false,
            } => {
                let $sparsity = crate::model::Sparsity {
                    twist: crate::model::Twist::None,
                    has_a: true,
                    has_d: false,
                };
                $value
            }
            crate::model::Sparsity {
                twist: crate::model::Twist::Quarter,
                has_a: false,
                has_d: true,
            } => {
                let $sparsity = crate::model::Sparsity {
                    twist: crate::model::Twist::Quarter,
                    has_a: false,
                    has_d: true,
                };
                $value
            }
            crate::model::Sparsity {
                twist: crate::model::Twist::MinusQuarter,
                has_a: false,
                has_d: true,
            } => {
                let $sparsity = crate::model::Sparsity {
                    twist: crate::model::Twist::MinusQuarter,
                    has_a: false,
                    has_d: true,
                };
                $value
            }
            $sparsity => $value,
        }
    };
}
pub(crate) use for_sparsity;

/// Rx(−α) v: from the axes before the twist to those behind it.
#[inline(always)]
pub(crate) fn untwist<S: Real>(link: &LinkModel<S>, sparsity: Sparsity, v: Vec3<S>) -> Vec3<S> {
    let [x, y, z] = v;
    match sparsity.twist {
        Twist::None => v,
        Twist::Quarter => [x, z, -y],
        Twist::MinusQuarter => [x, -z, y],
        Twist::General => {
            let (c, s) = link.twist_cos_sin;
            [x, c.mul_add(y, s * z), s.neg_mul_add(y, c * z)]
        }
    }
}

/// Rx(α) v: from the axes behind the twist to those before it.
#[inline(always)]
pub(crate) fn twist<S: Real>(link: &LinkModel<S>, sparsity: Sparsity, v: Vec3<S>) -> Vec3<S> {
    let [x, y, z] = v;
    match sparsity.twist {
        Twist::None => v,
        Twist::Quarter => [x, -z, y],
        Twist::MinusQuarter => [x, z, -y],
        Twist::General => {
            let (c, s) = link.twist_cos_sin;
            [x, s.neg_mul_add(z, c * y), s.mul_add(y, c * z)]
        }
    }
}

/// Rz(−q) v.
#[inline(always)]
pub(crate) fn unturn<S: Real>(sin: S, cos: S, v: Vec3<S>) -> Vec3<S> {
    [cos.mul_add(v[0], sin * v[1]), sin.neg_mul_add(v[0], cos * v[1]), v[2]]
}

/// Rz(q) v.
#[inline(always)]
pub(crate) fn turn<S: Real>(sin: S, cos: S, v: Vec3<S>) -> Vec3<S> {
    [sin.neg_mul_add(v[1], cos * v[0]), sin.mul_add(v[0], cos * v[1]), v[2]]
}

/// Motion at a link frame's origin, seen at the next link frame's origin in axes just before that joint's turn.
#[inline(always)]
pub(crate) fn motion_to_next<S: Real>(
    link: &LinkModel<S>,
    sparsity: Sparsity,
    v: Vec6<S>,
) -> Vec6<S> {
    let mut lin = v.lin;
    if sparsity.has_a {
        lin[1] = v.ang[2].mul_add(link.a, lin[1]);
        lin[2] = v.ang[1].neg_mul_add(link.a, lin[2]);
    }
    if sparsity.has_d {
        lin[0] = v.ang[1].mul_add(link.d, lin[0]);
        lin[1] = v.ang[0].neg_mul_add(link.d, lin[1]);
    }
    Vec6 { ang: untwist(link, sparsity, v.ang), lin: untwist(link, sparsity, lin) }
}

/// Force at the next link frame's origin, in axes just before that joint's turn, seen at this link frame's origin.
#[inline(always)]
pub(crate) fn force_from_next<S: Real>(
    link: &LinkModel<S>,
    sparsity: Sparsity,
    f: Vec6<S>,
) -> Vec6<S> {
    let mut ang = twist(link, sparsity, f.ang);
    let lin = twist(link, sparsity, f.lin);
    if sparsity.has_a {
        ang[1] = link.a.neg_mul_add(lin[2], ang[1]);
        ang[2] = link.a.mul_add(lin[1], ang[2]);
    }
    if sparsity.has_d {
        ang[0] = link.d.neg_mul_add(lin[1], ang[0]);
        ang[1] = link.d.mul_add(lin[0], ang[1]);
    }
    Vec6 { ang, lin }
}

/// Motion of the base, seen at an arm's frame 0.
#[inline(always)]
pub(crate) fn motion_to_arm<S: Real>(arm: &ArmModel<S>, v: Vec6<S>) -> Vec6<S> {
    let lin = cross_add(v.ang, arm.position, v.lin);
    Vec6 { ang: mat_t_vec(&arm.rotation, v.ang), lin: mat_t_vec(&arm.rotation, lin) }
}

/// Force at an arm's frame 0, seen at the base.
#[inline(always)]
pub(crate) fn force_to_base<S: Real>(arm: &ArmModel<S>, f: Vec6<S>) -> Vec6<S> {
    let lin = mat_vec(&arm.rotation, f.lin);
    Vec6 { ang: cross_add(arm.position, lin, mat_vec(&arm.rotation, f.ang)), lin }
}

/// First pass of the articulated-body algorithm [Featherstone 2008, Table 9.4], sines and velocities of all links: fills `sin`, `cos`, `v` of `ws.links`.
///
/// Shapes: `q`, `qd` `n_joints`. Reads `ws.base_v`.
#[inline(always)]
pub(crate) fn velocities<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, q: &[S], qd: &[S]) {
    for arm in 0..model.n_arms {
        let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
        let mut v = motion_to_arm(&model.arms[arm], ws.base_v);
        for j in 0..links.len() {
            if j > 0 {
                let before = &links[j - 1];
                v = for_sparsity!(before.sparsity, sparsity => motion_to_next(before, sparsity, v));
            }
            let (sin, cos) = q[first + j].sin_cos();
            v.ang = unturn(sin, cos, v.ang);
            v.lin = unturn(sin, cos, v.lin);
            // v_i = iX_λ v_λ + S q̇_i.
            v.ang[2] += qd[first + j];
            let link = &mut ws.links[first + j];
            link.sin = sin;
            link.cos = cos;
            link.v = v;
        }
    }
}

/// Poses of all link frames in the base frame: fills `ws.poses` from `sin` and `cos` of `ws.links`.
#[inline(always)]
pub(crate) fn poses<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for arm in 0..model.n_arms {
        poses_of_arm(model, ws, arm);
    }
}

/// [`poses`] of one arm's links.
#[inline(always)]
pub(crate) fn poses_of_arm<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, arm: usize) {
    let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
    let mut pose = LinkPose { r: model.arms[arm].rotation, o: model.arms[arm].position };
    for j in 0..links.len() {
        if j > 0 {
            let before = &links[j - 1];
            pose = for_sparsity!(before.sparsity, sparsity => next_pose(before, sparsity, pose));
        }
        let LinkScratchAngles { sin, cos } = angles(ws, first + j);
        for row in &mut pose.r {
            *row = unturn(sin, cos, *row);
        }
        ws.poses[first + j] = pose;
    }
}

struct LinkScratchAngles<S> {
    sin: S,
    cos: S,
}

#[inline(always)]
fn angles<S: Real>(ws: &Workspace<S>, i: usize) -> LinkScratchAngles<S> {
    LinkScratchAngles { sin: ws.links[i].sin, cos: ws.links[i].cos }
}

/// Pose of the next link frame before its joint's turn.
#[inline(always)]
fn next_pose<S: Real>(link: &LinkModel<S>, sparsity: Sparsity, pose: LinkPose<S>) -> LinkPose<S> {
    let LinkPose { mut r, mut o } = pose;
    for i in 0..3 {
        if sparsity.has_a {
            o[i] = link.a.mul_add(r[i][0], o[i]);
        }
        if sparsity.has_d {
            o[i] = link.d.mul_add(r[i][2], o[i]);
        }
        r[i] = untwist(link, sparsity, r[i]);
    }
    LinkPose { r, o }
}

/// Velocity of the material point at `p` (link frame) of a body that moves with `v`, link axes.
#[inline(always)]
pub(crate) fn point_velocity<S: Real>(v: Vec6<S>, p: Vec3<S>) -> Vec3<S> {
    add(v.lin, cross(v.ang, p))
}

/// Coordinates in a link frame of the base-frame point `p`.
#[inline(always)]
pub(crate) fn point_in_link<S: Real>(pose: &LinkPose<S>, p: Vec3<S>) -> Vec3<S> {
    mat_t_vec(&pose.r, sub(p, pose.o))
}
