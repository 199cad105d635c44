//! Bodies that can touch, the pairs of them, and the capsules and balls by which most pairs are dismissed.

use nalgebra::Vector3;

use super::shape::{Bound, FixedBox, Rounded};
use crate::robot::{ArmBody, BaseBox, JOINTS_PER_ARM, Robot, Shape};
use crate::scalar::Real;

/// A moving link's shapes, the same for every arm, link frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingBody<S> {
    /// Its shapes.
    pub shapes: Vec<Rounded<S>>,
    /// Around all of them.
    pub bound: Bound<S>,
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
    /// Six, the same for every arm.
    pub links: Vec<MovingBody<S>>,
    /// What is fixed to the base: its boxes, then mount and pedestal of each arm.
    pub fixed: Vec<FixedBody<S>>,
    /// Which bodies can touch.
    pub pairs: Vec<Pair<S>>,
    /// `[j][l]`: no point of link l is farther than this from joint j's axis, in any pose (m); zero for l < j.
    pub levers: [[S; JOINTS_PER_ARM]; JOINTS_PER_ARM],
}

/// A ball (m).
type Ball = (Vector3<f64>, f64);

/// The distance from joint `joint`'s axis that no point of `link` exceeds in any pose: along the chain, each step as long as its shift.
fn lever(robot: &Robot, balls: &[Ball], joint: usize, link: usize) -> f64 {
    if link < joint {
        return 0.0;
    }
    let chain: f64 = robot.links[joint..link].iter().map(|l| l.shift.norm()).sum();
    let (centre, radius) = balls[link];
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
        let bounds: Vec<Bound<f64>> =
            robot.links.iter().map(|l| Bound::around(&l.shapes).unwrap_or(nothing)).collect();
        let balls: Vec<Ball> = bounds.iter().map(Bound::ball).collect();
        let links = robot.links.iter().zip(&bounds).map(|(link, bound)| MovingBody {
            shapes: link.shapes.iter().map(Rounded::new).collect(),
            bound: Bound::new(bound),
        });

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

        let shaped = |l: usize| !robot.links[l % JOINTS_PER_ARM].shapes.is_empty();
        let by_angle = |x: ArmBody, y: ArmBody| {
            robot.angle_contacts.iter().any(|c| c.pair == [x, y] || c.pair == [y, x])
        };
        let link_radius: Vec<f64> = balls.iter().map(|b| b.1).collect();
        let mut pairs = Vec::new();
        let mut pair = |a: usize, b: Partner| {
            let (other, shapes) = match b {
                Partner::Link(b) => (
                    link_radius[b % JOINTS_PER_ARM],
                    robot.links[b % JOINTS_PER_ARM].shapes.as_slice(),
                ),
                Partner::Fixed(b) => (fixed_radius[b], [].as_slice()),
            };
            let reach = S::splat(link_radius[a % JOINTS_PER_ARM] + other);
            let own = robot.links[a % JOINTS_PER_ARM].shapes.as_slice();
            let simple =
                matches!((own, shapes), ([Shape::Capsule { .. }], [Shape::Capsule { .. }]));
            let kind = match b {
                Partner::Fixed(b) if b < n_boxes => ContactKind::Base,
                Partner::Fixed(_) => ContactKind::Mount,
                Partner::Link(b) if b / JOINTS_PER_ARM == a / JOINTS_PER_ARM => ContactKind::Own,
                Partner::Link(_) => ContactKind::Arms,
            };
            pairs.push(Pair { a, b, kind, reach, simple });
        };
        let at = |arm: usize, l: usize| arm * JOINTS_PER_ARM + l;
        for arm in 0..robot.n_arms {
            for l in (0..JOINTS_PER_ARM).filter(|&l| shaped(l)) {
                // The base carries the first link and so never touches it.
                if l > 0 {
                    for b in 0..n_boxes {
                        pair(at(arm, l), Partner::Fixed(b));
                    }
                    for other in 0..robot.n_arms {
                        let own = other == arm;
                        if !(own && by_angle(ArmBody::Mount, ArmBody::Link(l))) {
                            pair(at(arm, l), Partner::Fixed(mount(other)));
                        }
                        let shapes = !robot.arms[other].pedestal_shapes.is_empty();
                        if shapes && !(own && by_angle(ArmBody::Pedestal, ArmBody::Link(l))) {
                            pair(at(arm, l), Partner::Fixed(mount(other) + 1));
                        }
                    }
                }
                for m in (l + 2..JOINTS_PER_ARM).filter(|&m| shaped(m)) {
                    if !by_angle(ArmBody::Link(l), ArmBody::Link(m)) {
                        pair(at(arm, m), Partner::Link(at(arm, l)));
                    }
                }
                for other in arm + 1..robot.n_arms {
                    for m in (0..JOINTS_PER_ARM).filter(|&m| shaped(m)) {
                        pair(at(arm, l), Partner::Link(at(other, m)));
                    }
                }
            }
        }
        let levers =
            std::array::from_fn(|j| std::array::from_fn(|l| S::splat(lever(robot, &balls, j, l))));
        Self { links: links.collect(), fixed, pairs, levers }
    }
}
