//! Where the robot touches itself.
//!
//! The simulator says how many pairs of bodies touch, by kind; a recording does not say which. So the nearest pairs of each kind are taken, and the
//! places between them. That holds for pairs that touch by a joint's angle, too, whose shapes keep a little apart.

use rendering::{Solid, Vector};
use simulator::model::ContactKind;

use super::bodies::{Kind, Part, Posed};

/// What is farther apart than this is not looked at (m).
const NEAR: f64 = 0.06;

/// Between two bodies: how far they are apart, negative if they overlap (m), and where that is.
#[derive(Debug, Clone, Copy)]
struct Gap {
    width: f64,
    place: Vector,
}

/// Where pairs touch, as many of each kind as `counts` says.
pub(super) fn places(posed: &Posed, counts: &[u32; ContactKind::COUNT]) -> Vec<Vector> {
    let mut found = Vec::new();
    for (kind, count) in ContactKind::ALL.into_iter().zip(counts) {
        if *count == 0 {
            continue;
        }
        let mut gaps: Vec<Gap> = Vec::new();
        for (index, one) in posed.parts.iter().enumerate() {
            for other in &posed.parts[..index] {
                if can_touch(one.kind, other.kind) == Some(kind) {
                    gaps.extend(between(one, other));
                }
            }
        }
        gaps.sort_by(|a, b| a.width.total_cmp(&b.width));
        found.extend(gaps.iter().take(*count as usize).map(|gap| gap.place));
    }
    found
}

/// The kind of contact that two bodies can have, as the simulator counts them.
fn can_touch(one: Kind, other: Kind) -> Option<ContactKind> {
    match (one, other) {
        (Kind::Link { link, .. }, Kind::Base) if link > 0 => Some(ContactKind::Base),
        (Kind::Link { link, .. }, Kind::Foot { .. }) if link > 0 => Some(ContactKind::Mount),
        (Kind::Link { arm: a, link: l, .. }, Kind::Link { arm: b, link: m, .. }) => {
            if a != b {
                Some(ContactKind::Arms)
            } else if l.abs_diff(m) > 1 {
                Some(ContactKind::Own)
            } else {
                None
            }
        }
        (Kind::Base | Kind::Foot { .. }, Kind::Link { .. }) => can_touch(other, one),
        _ => None,
    }
}

/// The narrowest gap between two bodies, unless they are far apart.
fn between(one: &Part, other: &Part) -> Option<Gap> {
    let pairs = one.solids.iter().flat_map(|a| other.solids.iter().map(move |b| (a, b)));
    pairs.filter_map(|(a, b)| gap(a, b)).min_by(|a, b| a.width.total_cmp(&b.width))
}

fn gap(a: &Solid, b: &Solid) -> Option<Gap> {
    match (a, b) {
        (Solid::Capsule { from, to, radius }, _) => along(from, to, *radius, b),
        (_, Solid::Capsule { from, to, radius }) => along(from, to, *radius, a),
        (Solid::Cylinder { from, to, radius }, _) => rim(from, to, *radius, b),
        (_, Solid::Cylinder { from, to, radius }) => rim(from, to, *radius, a),
        // Boxes are fixed to the base and never touch each other.
        (Solid::Box { .. }, Solid::Box { .. }) => None,
    }
}

/// Between a capsule and a convex body: the distance has one minimum along the segment, which is cut out from both sides.
fn along(from: &Vector, to: &Vector, radius: f64, body: &Solid) -> Option<Gap> {
    let at = |share: f64| from + (to - from) * share;
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..24 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if body.distance(&at(a)) < body.distance(&at(b)) { high = b } else { low = a }
    }
    let nearest = at(f64::midpoint(low, high));
    near(body, nearest, body.distance(&nearest), radius)
}

/// Between a cylinder and a convex body, by points on the edges of its ends.
fn rim(from: &Vector, to: &Vector, radius: f64, body: &Solid) -> Option<Gap> {
    let axis = (to - from).normalize();
    let aside = axis.cross(&if axis.x.abs() < 0.9 { Vector::x() } else { Vector::y() }).normalize();
    let across = axis.cross(&aside);
    let points = [from, to].into_iter().flat_map(|end| {
        (0..16).map(move |i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 16.0).sin_cos();
            end + (aside * cos + across * sin) * radius
        })
    });
    let nearest = points.min_by(|a, b| body.distance(a).total_cmp(&body.distance(b)))?;
    near(body, nearest, body.distance(&nearest), 0.0)
}

/// The gap between a body and the ball around a point.
fn near(body: &Solid, point: Vector, distance: f64, radius: f64) -> Option<Gap> {
    let width = distance - radius;
    if width > NEAR {
        return None;
    }
    // Downhill towards the body, as far as to the middle of the gap.
    let step = 1e-5;
    let slope = Vector::from([0, 1, 2].map(|i| {
        let mut beside = point;
        beside[i] += step;
        (body.distance(&beside) - distance) / step
    }));
    let down = slope.try_normalize(1e-6).unwrap_or_else(Vector::zeros);
    Some(Gap { width, place: point - down * (radius + width / 2.0) })
}

#[cfg(test)]
mod tests {
    use simulator::experiment::Pose;
    use simulator::robot::Robot;

    use super::*;

    fn ball(at: [f64; 3], radius: f64) -> Solid {
        Solid::sphere(Vector::from(at), radius)
    }

    #[test]
    fn gaps_are_as_wide_as_worked_by_hand() {
        // Balls of 0.1 and 0.2 whose centres are 0.32 apart: 0.02 between them, with its middle 0.11 from the first.
        let gap = gap(&ball([0.0; 3], 0.1), &ball([0.32, 0.0, 0.0], 0.2)).expect("near");
        assert!((gap.width - 0.02).abs() < 1e-9 && (gap.place.x - 0.11).abs() < 1e-4, "{gap:?}");
        let tube = Solid::Capsule {
            from: Vector::new(-1.0, 0.0, 0.15),
            to: Vector::new(1.0, 0.0, 0.15),
            radius: 0.1,
        };
        let gap = super::gap(&ball([0.3, 0.0, 0.0], 0.1), &tube).expect("overlap");
        assert!((gap.width + 0.05).abs() < 1e-6, "{gap:?}");
        assert!((gap.place - Vector::new(0.3, 0.0, 0.075)).norm() < 1e-3, "{gap:?}");
        assert!(super::gap(&ball([0.0, 9.0, 0.0], 0.1), &tube).is_none(), "far away");
    }

    #[test]
    fn as_many_places_as_pairs_touch_and_on_the_robot() {
        let robot = Robot::builtin("paper").expect("built in");
        // Forearm and upper arm folded onto each other.
        let mut joints: Vec<f32> = robot.home_q().iter().map(|q| *q as f32).collect();
        joints[2] = 3.0;
        let pose =
            Pose { base_position: [0.0, 0.0, 4.0], base_quaternion: [1.0, 0.0, 0.0, 0.0], joints };
        let posed = Posed::new(&robot, &pose);
        assert!(places(&posed, &[0; 4]).is_empty());
        let found = places(&posed, &[0, 0, 2, 0]);
        assert_eq!(found.len(), 2);
        for place in found {
            let of_arm = |part: &&Part| matches!(part.kind, Kind::Link { arm: 0, .. });
            let solids = posed.parts.iter().filter(of_arm).flat_map(|part| &part.solids);
            let nearest = solids.map(|solid| solid.distance(&place)).fold(1.0, f64::min);
            assert!(nearest < NEAR, "{place:?} {nearest}");
        }
    }
}
