//! Bodies that can touch, the pairs of them, and the capsules and balls by which most pairs are dismissed.

use nalgebra::Vector3;

use super::shape::{Bound, FixedBox, Rounded};
use crate::robot::{ArmBody, ArmType, BaseBox, MAX_JOINTS_PER_ARM, Robot, Shape};
use crate::scalar::Real;

/// A moving link's shapes, the same for every arm of a type, link frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingBody<S> {
    /// Its shapes.
    pub shapes: Vec<Rounded<S>>,
    /// Around all of them.
    pub bound: Bound<S>,
    /// `[j]`: no point of the link is farther than this from joint j's axis, in any pose (m); zero for joints behind it.
    pub levers: [S; MAX_JOINTS_PER_ARM],
}

/// What is fixed to the base, base frame.
#[derive(Clone, Debug, PartialEq)]
pub enum FixedBody<S> {
    /// A box.
    Box(FixedBox<S>),
    /// Rounded shapes, and a capsule around all of them.
    Rounded(Vec<Rounded<S>>, Bound<S>),
}

/// The second body of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Partner {
    /// Link, index over all arms.
    Link(usize),
    /// Index of a fixed body.
    Fixed(usize),
}

/// What touches what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContactKind {
    /// A moving link and a box of the base.
    Base,
    /// A moving link and a mount or pedestal, its own arm's or another's.
    Mount,
    /// Two moving links of one arm.
    Own,
    /// Moving links of two arms.
    Arms,
}

impl ContactKind {
    /// Number of kinds.
    pub const COUNT: usize = 4;
    /// All of them, each at its own index.
    pub const ALL: [Self; Self::COUNT] = [Self::Base, Self::Mount, Self::Own, Self::Arms];

    /// The kind of a pair that is told by joint angle.
    pub(crate) fn told_by_angle(pair: [ArmBody; 2]) -> Self {
        if pair.iter().all(|body| matches!(body, ArmBody::Link(_))) {
            Self::Own
        } else {
            Self::Mount
        }
    }
}

/// Two bodies that can touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair<S> {
    /// Link, index over all arms.
    pub a: usize,
    /// What it may touch.
    pub b: Partner,
    /// What touches what.
    pub kind: ContactKind,
    /// Sum of the radii of the balls around the bounding capsules (m).
    pub reach: S,
    /// Whether A and B are one capsule each, so that their bounds are as good as they are.
    pub simple: bool,
}

/// Everything collisions need of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct CollisionModel<S> {
    /// Of all types of arms, one type after the other; arms of one type share theirs.
    pub links: Vec<MovingBody<S>>,
    /// By joint of the robot: the link behind it, of `links`.
    pub link_of: Vec<usize>,
    /// What is fixed to the base: its boxes, then mount and pedestal of each arm.
    pub fixed: Vec<FixedBody<S>>,
    /// Which bodies can touch.
    pub pairs: Vec<Pair<S>>,
}

/// A ball (m).
type Ball = (Vector3<f64>, f64);

/// The distance from joint `joint`'s axis that no point of `link` exceeds in any pose: along the chain, each step as long as its shift.
fn lever(kind: &ArmType, (centre, radius): Ball, joint: usize, link: usize) -> f64 {
    if link < joint {
        return 0.0;
    }
    let chain: f64 = kind.links[joint..link].iter().map(|l| l.shift.norm()).sum();
    chain + centre.norm() + radius
}

fn fixed_box<S: Real>(b: &BaseBox) -> FixedBody<S> {
    FixedBody::Box(FixedBox {
        centre: b.centre.map(S::splat).into(),
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| S::splat(b.rotation[(i, j)]))),
        half: b.half.map(S::splat).into(),
    })
}

impl<S: Real> CollisionModel<S> {
    /// Bodies and pairs of `robot`.
    ///
    /// Not pairs: bodies without shapes; bodies fixed to each other; a link with the link or the base that carries it; pairs told by joint angle.
    pub(crate) fn new(robot: &Robot) -> Self {
        let nothing = Bound { from: [0.0; 3], to: [0.0; 3], radius: 0.0 };
        let mut links = Vec::new();
        let mut first_of_type = Vec::new();
        for kind in &robot.types {
            first_of_type.push(links.len());
            for (l, link) in kind.links.iter().enumerate() {
                let bound = Bound::around(&link.shapes).unwrap_or(nothing);
                let lever = |joint| S::splat(lever(kind, bound.ball(), joint, l));
                links.push(MovingBody {
                    shapes: link.shapes.iter().map(Rounded::new).collect(),
                    bound: Bound::new(&bound),
                    levers: std::array::from_fn(lever),
                });
            }
        }
        let joints = robot.joints;
        let link_of = (0..joints.n_joints()).map(|joint| {
            first_of_type[robot.arms[joints.arm_of(joint)].arm_type] + joints.within_arm(joint)
        });
        let ball_radius =
            |joint: usize| Bound::around(&robot.link(joint).shapes).unwrap_or(nothing).ball().1;

        // Fixed bodies: the base's boxes, then mount and pedestal of each arm.
        let (mut fixed, mut fixed_radius) = (Vec::new(), Vec::new());
        let n_boxes = robot.boxes.len();
        for b in &robot.boxes {
            fixed.push(fixed_box(b));
            fixed_radius.push(0.0);
        }
        for arm in &robot.arms {
            fixed.push(fixed_box(&arm.mount));
            fixed_radius.push(0.0);
            let bound = Bound::around(&arm.pedestal_shapes).unwrap_or(nothing);
            let shapes = arm.pedestal_shapes.iter().map(Rounded::new).collect();
            fixed.push(FixedBody::Rounded(shapes, Bound::new(&bound)));
            fixed_radius.push(bound.ball().1);
        }
        let mount = |arm: usize| n_boxes + 2 * arm;

        let shaped = |joint: &usize| !robot.link(*joint).shapes.is_empty();
        let by_angle = |arm: usize, x: ArmBody, y: ArmBody| {
            robot.type_of(arm).angle_contacts.iter().any(|c| c.pair == [x, y] || c.pair == [y, x])
        };
        let mut pairs = Vec::new();
        let mut pair = |a: usize, b: Partner| {
            let (other, shapes) = match b {
                Partner::Link(b) => (ball_radius(b), robot.link(b).shapes.as_slice()),
                Partner::Fixed(b) => (fixed_radius[b], [].as_slice()),
            };
            let reach = S::splat(ball_radius(a) + other);
            let own = robot.link(a).shapes.as_slice();
            let simple =
                matches!((own, shapes), ([Shape::Capsule { .. }], [Shape::Capsule { .. }]));
            let kind = match b {
                Partner::Fixed(b) if b < n_boxes => ContactKind::Base,
                Partner::Fixed(_) => ContactKind::Mount,
                Partner::Link(b) if joints.arm_of(b) == joints.arm_of(a) => ContactKind::Own,
                Partner::Link(_) => ContactKind::Arms,
            };
            pairs.push(Pair { a, b, kind, reach, simple });
        };
        for arm in 0..robot.n_arms {
            let of_arm = joints.of_arm(arm);
            let body = |joint: usize| ArmBody::Link(joints.within_arm(joint));
            for l in of_arm.clone().filter(shaped) {
                // The base carries the first link and so never touches it.
                if l > of_arm.start {
                    for b in 0..n_boxes {
                        pair(l, Partner::Fixed(b));
                    }
                    for other in 0..robot.n_arms {
                        let own = other == arm;
                        if !(own && by_angle(arm, ArmBody::Mount, body(l))) {
                            pair(l, Partner::Fixed(mount(other)));
                        }
                        let shapes = !robot.arms[other].pedestal_shapes.is_empty();
                        if shapes && !(own && by_angle(arm, ArmBody::Pedestal, body(l))) {
                            pair(l, Partner::Fixed(mount(other) + 1));
                        }
                    }
                }
                for m in (l + 2..of_arm.end).filter(shaped) {
                    if !by_angle(arm, body(l), body(m)) {
                        pair(m, Partner::Link(l));
                    }
                }
                for other in arm + 1..robot.n_arms {
                    for m in joints.of_arm(other).filter(shaped) {
                        pair(l, Partner::Link(m));
                    }
                }
            }
        }
        Self { links, link_of: link_of.collect(), fixed, pairs }
    }

    /// The link behind a joint of the robot.
    #[inline(always)]
    pub(crate) fn link(&self, joint: usize) -> &MovingBody<S> {
        &self.links[self.link_of[joint]]
    }
}
