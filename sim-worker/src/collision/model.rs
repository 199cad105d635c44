//! Bodies that can touch, the pairs of them, and the spheres by which most pairs are dismissed.

use nalgebra::Vector3;

use super::shape::{FixedBox, Rounded, bounding_sphere};
use crate::robot::{ArmBody, BaseBox, JOINTS_PER_ARM, Robot};
use crate::scalar::Real;
use crate::spatial::Vec3;

/// A moving link's shapes, the same for every arm, link frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MovingBody<S> {
    pub(crate) shapes: Vec<Rounded<S>>,
    pub(crate) centre: Vec3<S>,
    pub(crate) radius: S,
}

/// What is fixed to the base, base frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FixedBody<S> {
    /// A box.
    Box(FixedBox<S>),
    /// Rounded shapes.
    Rounded(Vec<Rounded<S>>),
}

/// The second body of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Partner {
    /// Link, index over all arms.
    Link(usize),
    /// Index of a fixed body.
    Fixed(usize),
}

/// Two bodies that can touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair<S> {
    /// Link, index over all arms.
    pub(crate) a: usize,
    pub(crate) b: Partner,
    /// Sum of the bounding radii (m); of A alone where B is a box.
    pub(crate) reach: S,
}

/// Pairs that are far apart together.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PairGroup<S> {
    /// A sphere about link A's centre and one about B's hold all the pairs; none where each pair is looked at.
    pub(crate) bound: Option<GroupBound<S>>,
    pub(crate) pairs: std::ops::Range<usize>,
}

/// Spheres about the bounding centres of two bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GroupBound<S> {
    pub(crate) a: usize,
    pub(crate) b: Partner,
    /// Sum of the radii (m).
    pub(crate) reach: S,
}

/// Everything collisions need of a robot.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CollisionModel<S> {
    /// Six, the same for every arm.
    pub(crate) links: Vec<MovingBody<S>>,
    pub(crate) fixed: Vec<FixedBody<S>>,
    /// Bounding centre of each fixed body.
    pub(crate) fixed_centres: Vec<Vec3<S>>,
    pub(crate) pairs: Vec<Pair<S>>,
    pub(crate) groups: Vec<PairGroup<S>>,
}

/// A ball (m).
type Ball = (Vector3<f64>, f64);

/// Builds the list of pairs.
struct Builder<S> {
    pairs: Vec<Pair<S>>,
    groups: Vec<PairGroup<S>>,
    link_radius: Vec<f64>,
    /// None for boxes, whose distance is exact.
    fixed_radius: Vec<Option<f64>>,
}

impl<S: Real> Builder<S> {
    fn group(&mut self, bound: Option<(usize, Partner, f64)>, pairs: &[(usize, Partner)]) {
        let start = self.pairs.len();
        for &(a, b) in pairs {
            let other = match b {
                Partner::Link(b) => self.link_radius[b % JOINTS_PER_ARM],
                Partner::Fixed(b) => self.fixed_radius[b].unwrap_or(0.0),
            };
            let reach = S::splat(self.link_radius[a % JOINTS_PER_ARM] + other);
            self.pairs.push(Pair { a, b, reach });
        }
        if start < self.pairs.len() {
            let bound = bound.map(|(a, b, reach)| GroupBound { a, b, reach: S::splat(reach) });
            self.groups.push(PairGroup { bound, pairs: start..self.pairs.len() });
        }
    }
}

/// Parts of an arm that stay together: the link whose centre stands for the part, and its links.
const PARTS: [(usize, std::ops::Range<usize>); 2] = [(1, 0..2), (2, 2..JOINTS_PER_ARM)];

/// The radius about the centre of link `anchor` that holds `links` in every pose.
fn part_radius(robot: &Robot, balls: &[Ball], anchor: usize, links: std::ops::Range<usize>) -> f64 {
    links
        .map(|l| {
            let (centre, radius) = balls[l];
            // Along the chain: joint by joint, each step no longer than its shift.
            let path = match l.cmp(&anchor) {
                std::cmp::Ordering::Equal => return (centre - balls[anchor].0).norm() + radius,
                std::cmp::Ordering::Greater => {
                    let first = (robot.links[anchor].shift - balls[anchor].0).norm();
                    let rest = (anchor + 1..l).map(|k| robot.links[k].shift.norm()).sum::<f64>();
                    first + rest + centre.norm()
                }
                std::cmp::Ordering::Less => {
                    let first = balls[anchor].0.norm();
                    let rest = (l + 1..anchor).map(|k| robot.links[k].shift.norm()).sum::<f64>();
                    first + rest + (robot.links[l].shift - centre).norm()
                }
            };
            path + radius
        })
        .fold(0.0, f64::max)
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
        let balls: Vec<Ball> = robot
            .links
            .iter()
            .map(|l| bounding_sphere(&l.shapes).unwrap_or((Vector3::zeros(), 0.0)))
            .collect();
        let links = robot.links.iter().zip(&balls).map(|(link, (centre, radius))| MovingBody {
            shapes: link.shapes.iter().map(Rounded::new).collect(),
            centre: (*centre).map(S::splat).into(),
            radius: S::splat(*radius),
        });

        // Fixed bodies: the base's boxes, then mount and pedestal of each arm.
        let (mut fixed, mut centres, mut fixed_radius) = (Vec::new(), Vec::new(), Vec::new());
        let n_boxes = robot.boxes.len();
        for b in &robot.boxes {
            fixed.push(fixed_box(b));
            centres.push(b.centre);
            fixed_radius.push(None);
        }
        let mut root_radius = Vec::new();
        for arm in &robot.arms {
            fixed.push(fixed_box(&arm.mount));
            centres.push(arm.mount.centre);
            fixed_radius.push(None);
            let ball = bounding_sphere(&arm.pedestal_shapes).unwrap_or((arm.position, 0.0));
            fixed.push(FixedBody::Rounded(arm.pedestal_shapes.iter().map(Rounded::new).collect()));
            centres.push(ball.0);
            fixed_radius.push(Some(ball.1));
            let about_mount = (ball.0 - arm.mount.centre).norm() + ball.1;
            root_radius.push(about_mount.max(arm.mount.half.norm()));
        }
        let mount = |arm: usize| n_boxes + 2 * arm;

        let shaped = |l: usize| !robot.links[l % JOINTS_PER_ARM].shapes.is_empty();
        let by_angle = |x: ArmBody, y: ArmBody| {
            robot.stops.iter().any(|s| s.pair == [x, y] || s.pair == [y, x])
        };
        let link_radius: Vec<f64> = balls.iter().map(|b| b.1).collect();
        let parts: Vec<f64> = PARTS
            .iter()
            .map(|(anchor, l)| part_radius(robot, &balls, *anchor, l.clone()))
            .collect();
        let mut builder =
            Builder { pairs: Vec::new(), groups: Vec::new(), link_radius, fixed_radius };
        for arm in 0..robot.n_arms {
            let at = |l: usize| arm * JOINTS_PER_ARM + l;
            // An arm with the base's boxes, with its own mount and pedestal, with itself.
            let mut own = Vec::new();
            for l in (1..JOINTS_PER_ARM).filter(|&l| shaped(l)) {
                own.extend((0..n_boxes).map(|b| (at(l), Partner::Fixed(b))));
                if !by_angle(ArmBody::Mount, ArmBody::Link(l)) {
                    own.push((at(l), Partner::Fixed(mount(arm))));
                }
                let has_pedestal = !robot.arms[arm].pedestal_shapes.is_empty();
                if has_pedestal && !by_angle(ArmBody::Pedestal, ArmBody::Link(l)) {
                    own.push((at(l), Partner::Fixed(mount(arm) + 1)));
                }
                for m in l + 2..JOINTS_PER_ARM {
                    if shaped(m) && !by_angle(ArmBody::Link(l), ArmBody::Link(m)) {
                        own.push((at(l), Partner::Link(at(m))));
                    }
                }
            }
            for m in (2..JOINTS_PER_ARM).filter(|&m| shaped(0) && shaped(m)) {
                if !by_angle(ArmBody::Link(0), ArmBody::Link(m)) {
                    own.push((at(m), Partner::Link(at(0))));
                }
            }
            builder.group(None, &own);
            // With the mounts and pedestals of the others, and with the others.
            for other in (0..robot.n_arms).filter(|&o| o != arm) {
                for ((anchor, links), radius) in PARTS.iter().zip(&parts) {
                    let mut pairs = Vec::new();
                    for l in links.clone().filter(|&l| l > 0 && shaped(l)) {
                        pairs.push((at(l), Partner::Fixed(mount(other))));
                        if !robot.arms[other].pedestal_shapes.is_empty() {
                            pairs.push((at(l), Partner::Fixed(mount(other) + 1)));
                        }
                    }
                    let reach = radius + root_radius[other];
                    let bound = (at(*anchor), Partner::Fixed(mount(other)), reach);
                    builder.group(Some(bound), &pairs);
                    if other < arm {
                        continue;
                    }
                    for ((other_anchor, other_links), other_radius) in PARTS.iter().zip(&parts) {
                        let mut pairs = Vec::new();
                        for l in links.clone().filter(|&l| shaped(l)) {
                            for m in other_links.clone().filter(|&m| shaped(m)) {
                                pairs.push((at(l), Partner::Link(other * JOINTS_PER_ARM + m)));
                            }
                        }
                        let partner = Partner::Link(other * JOINTS_PER_ARM + other_anchor);
                        let bound = (at(*anchor), partner, radius + other_radius);
                        builder.group(Some(bound), &pairs);
                    }
                }
            }
        }
        Self {
            links: links.collect(),
            fixed,
            fixed_centres: centres.iter().map(|c| c.map(S::splat).into()).collect(),
            pairs: builder.pairs,
            groups: builder.groups,
        }
    }
}
