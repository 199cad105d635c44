//! The constants of a robot in the scalar and the layout of the hot path.

use std::ops::{Mul, Range};

use nalgebra::Matrix3;

use super::collision::{CollisionModel, ContactKind};
use crate::robot::{Arm, Joints, RigidBody, Robot, is_rotation};
use crate::scalar::Real;
use crate::spatial::{Mat3, Vec3};

/// Twist of a Denavit–Hartenberg row: right angles only permute coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Twist {
    /// 0°.
    None,
    /// +90°.
    Quarter,
    /// −90°.
    MinusQuarter,
    /// Any other angle.
    General,
}

impl Twist {
    /// The kind of a rotation about x.
    pub(crate) fn of(rotation: &Matrix3<f64>) -> Self {
        match (rotation[(1, 1)], rotation[(2, 1)]) {
            (1.0, 0.0) => Self::None,
            (0.0, 1.0) => Self::Quarter,
            (0.0, -1.0) => Self::MinusQuarter,
            _ => Self::General,
        }
    }
}

/// Which parts of a link's step to the next frame there are: the sparsity of its Denavit–Hartenberg row.
///
/// Functions of the hot path take it beside the link. Where `for_sparsity` of the dynamics makes it a constant, what is not there costs nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sparsity {
    /// The twist.
    pub twist: Twist,
    /// Whether the shift along x is other than zero.
    pub has_a: bool,
    /// Whether the shift along z is other than zero.
    pub has_d: bool,
}

/// Spatial inertia of a rigid body about its frame's origin [Featherstone 2008, eq. 2.63].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidInertia<S> {
    /// Mass (kg).
    pub mass: S,
    /// Mass times centre of mass (kg m).
    pub h: Vec3<S>,
    /// Inertia about the origin: xx, yy, zz, xy, xz, yz (kg m²).
    pub inertia: [S; 6],
}

impl<S: Real> RigidInertia<S> {
    fn new(body: &RigidBody) -> Self {
        let i = body.inertia_at_origin();
        Self {
            mass: S::splat(body.mass),
            h: (body.com * body.mass).map(S::splat).into(),
            inertia: [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|at| S::splat(i[at])),
        }
    }
}

impl<S: Real> Mul<S> for RigidInertia<S> {
    type Output = Self;

    /// A body so many times as heavy, of the same shape.
    #[inline(always)]
    fn mul(self, factor: S) -> Self {
        Self {
            mass: self.mass * factor,
            h: self.h.map(|h| h * factor),
            inertia: self.inertia.map(|i| i * factor),
        }
    }
}

/// What bodies of a robot weigh.
#[derive(Clone, Debug, PartialEq)]
pub struct Masses<S: Real> {
    /// The base with all that is welded to it, base frame.
    pub base: RigidInertia<S>,
    /// The links of all types of arms, one type after the other.
    pub links: Vec<RigidInertia<S>>,
}

impl<S: Real> Masses<S> {
    /// As `robot` is described.
    pub fn of(robot: &Robot) -> Self {
        let links = robot.types.iter().flat_map(|kind| &kind.links);
        Self {
            base: RigidInertia::new(&robot.base),
            links: links.map(|link| RigidInertia::new(&link.body)).collect(),
        }
    }

    /// Each body so many times as heavy, and with as many times the inertia: a factor for the base, then one for each link.
    #[inline(always)]
    #[must_use]
    pub fn times(mut self, factors: &[S]) -> Self {
        let bodies = std::iter::once(&mut self.base).chain(&mut self.links);
        for (body, &factor) in bodies.zip(factors) {
            *body = *body * factor;
        }
        self
    }
}

/// A moving link: its joint's servo, its inertia, and the step to the next link frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkModel<S> {
    /// Which parts its step has.
    pub sparsity: Sparsity,
    /// Cosine and sine of the twist.
    pub twist_cos_sin: (S, S),
    /// Shift along x (m).
    pub a: S,
    /// Shift along z (m).
    pub d: S,
    /// Inertia of the link.
    pub body: RigidInertia<S>,
    /// Inertia of the drive about the joint's axis (kg m²).
    pub armature: S,
    /// Torque for a rate that is missing (N m s/rad).
    pub gain: S,
    /// Fastest command (rad/s).
    pub max_rate: S,
    /// Largest torque (N m).
    pub max_torque: S,
}

/// A rotation by right angles: (R v)ᵢ = signᵢ · v at placeᵢ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignedPermutation<S> {
    /// Where each coordinate is taken from.
    pub place: [usize; 3],
    /// Its sign.
    pub sign: [S; 3],
}

/// An arm: the pose of its frame 0 in the base frame, and what it shares with the others of its type.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmModel<S> {
    /// Origin (m).
    pub position: Vec3<S>,
    /// Axes of frame 0 to base axes.
    pub rotation: Mat3<S>,
    /// The same rotation where it is one by right angles, as on every face of a cube.
    pub permutation: Option<SignedPermutation<S>>,
    /// Its links, of those of all types.
    pub links: Range<usize>,
    /// Its contacts by joint angle, of those of all types.
    pub angle_contacts: Range<usize>,
    /// Origin of the hand in the last link frame (m).
    pub tool_position: Vec3<S>,
    /// Axes of the hand to axes of the last link.
    pub tool_rotation: Mat3<S>,
}

/// A joint interval in which a pair touches (see [`AngleContact`](crate::robot::AngleContact)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleContactModel<S> {
    /// The joint of its arm, from 0.
    pub joint: usize,
    /// Middle of the interval (rad).
    pub centre: S,
    /// Half of the interval's length (rad).
    pub half: S,
    /// The half is shorter by this times |sin 2q| (rad).
    pub narrowing: S,
    /// The joint q of the narrowing, from 0.
    pub narrowing_joint: usize,
    /// Whether the ends of the interval push back.
    pub push: bool,
    /// What touches.
    pub kind: ContactKind,
}

/// A robot's constants in scalar `S`, shared by everything that simulates it; scratch memory is a
/// [`Workspace`](crate::workspace::Workspace).
#[derive(Clone, Debug, PartialEq)]
pub struct Model<S: Real> {
    /// Number of arms.
    pub n_arms: usize,
    /// Which joints are whose.
    pub joints: Joints,
    /// Inertia of the base with all that is welded to it, base frame.
    pub base: RigidInertia<S>,
    /// Of all types of arms, one type after the other; arms of one type share theirs.
    pub links: Vec<LinkModel<S>>,
    /// Where arms stand.
    pub arms: Vec<ArmModel<S>>,
    /// Pairs that touch by a joint's angle, of all types of arms.
    pub angle_contacts: Vec<AngleContactModel<S>>,
    /// What can touch.
    pub collision: CollisionModel<S>,
}

fn splat_matrix<S: Real>(m: &Matrix3<f64>) -> Mat3<S> {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| S::splat(m[(i, j)])))
}

fn signed_permutation<S: Real>(m: &Matrix3<f64>) -> Option<SignedPermutation<S>> {
    let mut p = SignedPermutation { place: [0; 3], sign: [S::zero(); 3] };
    for i in 0..3 {
        p.place[i] = (0..3).find(|&j| m[(i, j)].abs() == 1.0)?;
        p.sign[i] = S::splat(m[(i, p.place[i])]);
    }
    Some(p)
}

impl<S: Real> Model<S> {
    /// The constants of `robot`.
    pub fn new(robot: &Robot) -> Self {
        let links = robot.types.iter().flat_map(|kind| &kind.links).map(|link| {
            let t = &link.twist;
            LinkModel {
                sparsity: Sparsity {
                    twist: Twist::of(t),
                    has_a: link.shift.x != 0.0,
                    has_d: link.shift.z != 0.0,
                },
                twist_cos_sin: (S::splat(t[(1, 1)]), S::splat(t[(2, 1)])),
                a: S::splat(link.shift.x),
                d: S::splat(link.shift.z),
                body: RigidInertia::new(&link.body),
                armature: S::splat(link.armature),
                gain: S::splat(link.gain),
                max_rate: S::splat(link.max_rate),
                max_torque: S::splat(link.max_torque),
            }
        });
        let before = |arm: &Arm| &robot.types[..arm.arm_type];
        let arms = robot.arms.iter().map(|arm| {
            let kind = &robot.types[arm.arm_type];
            let links: usize = before(arm).iter().map(|kind| kind.links.len()).sum();
            let contacts: usize = before(arm).iter().map(|kind| kind.angle_contacts.len()).sum();
            assert!(is_rotation(&arm.rotation), "mount rotation {}", arm.rotation);
            ArmModel {
                position: arm.position.map(S::splat).into(),
                rotation: splat_matrix(&arm.rotation),
                permutation: signed_permutation(&arm.rotation),
                links: links..links + kind.links.len(),
                angle_contacts: contacts..contacts + kind.angle_contacts.len(),
                tool_position: kind.tool_position.map(S::splat).into(),
                tool_rotation: splat_matrix(&kind.tool_rotation),
            }
        });
        let angle_contacts = robot.types.iter().flat_map(|kind| &kind.angle_contacts);
        let angle_contacts = angle_contacts.map(|contact| AngleContactModel {
            joint: contact.joint,
            centre: S::splat(contact.centre),
            half: S::splat(contact.half),
            narrowing: S::splat(contact.narrowing),
            narrowing_joint: contact.narrowing_joint,
            push: contact.push,
            kind: ContactKind::told_by_angle(contact.pair),
        });
        Self {
            n_arms: robot.n_arms,
            joints: robot.joints,
            base: RigidInertia::new(&robot.base),
            links: links.collect(),
            arms: arms.collect(),
            angle_contacts: angle_contacts.collect(),
            collision: CollisionModel::new(robot),
        }
    }

    /// Gives all bodies these masses.
    #[inline(always)]
    pub fn weigh(&mut self, masses: &Masses<S>) {
        self.base = masses.base;
        for (link, body) in self.links.iter_mut().zip(&masses.links) {
            link.body = *body;
        }
    }

    /// Number of arms.
    pub fn n_arms(&self) -> usize {
        self.n_arms
    }

    /// Number of joints, all arms.
    pub fn n_joints(&self) -> usize {
        self.joints.n_joints()
    }

    /// The pairs of an arm that touch by a joint's angle.
    #[inline(always)]
    pub fn angle_contacts_of(&self, arm: usize) -> &[AngleContactModel<S>] {
        &self.angle_contacts[self.arms[arm].angle_contacts.clone()]
    }

    /// The links of an arm.
    #[inline(always)]
    pub fn links_of(&self, arm: usize) -> &[LinkModel<S>] {
        &self.links[self.arms[arm].links.clone()]
    }
}
