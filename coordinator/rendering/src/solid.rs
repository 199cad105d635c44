//! Convex bodies: where rays meet them, and how they stand in the light of others.

use nalgebra::Matrix3;

use crate::Vector;

/// A convex body in the world.
#[derive(Debug, Clone, PartialEq)]
pub enum Solid {
    /// All points within `radius` of a segment; a sphere if its ends are one point.
    Capsule {
        /// One end of the segment (m).
        from: Vector,
        /// The other end (m).
        to: Vector,
        /// Radius (m).
        radius: f64,
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Middle of one end (m).
        from: Vector,
        /// Middle of the other end (m).
        to: Vector,
        /// Radius (m).
        radius: f64,
    },
    /// A box.
    Box {
        /// Its middle (m).
        centre: Vector,
        /// Its axes to the world's.
        rotation: Matrix3<f64>,
        /// Half of its edges (m).
        half: Vector,
    },
}

/// Where a ray enters a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    /// Distance along the ray (m).
    pub(crate) t: f64,
    /// Outward, of length one.
    pub(crate) normal: Vector,
}

/// How wide the lamp is: what is this much nearer to a ray of light than to the surface that the ray comes from keeps light away.
const LAMP: f64 = 0.16;

/// Distance from a surface within which shadows begin softly (m).
const SOFT: f64 = 0.03;

impl Solid {
    /// A ball.
    pub fn sphere(centre: Vector, radius: f64) -> Self {
        Self::Capsule { from: centre, to: centre, radius }
    }

    /// Balls that hold the body between them: their convex hull does.
    pub fn balls(&self) -> Vec<(Vector, f64)> {
        match self {
            Self::Capsule { from, to, radius } | Self::Cylinder { from, to, radius } => {
                vec![(*from, *radius), (*to, *radius)]
            }
            Self::Box { centre, rotation, half } => (0..8)
                .map(|corner| {
                    let signs = [0, 1, 2].map(|bit| f64::from(2 * (corner >> bit & 1) - 1));
                    (centre + rotation * Vector::from(signs).component_mul(half), 0.0)
                })
                .collect(),
        }
    }

    /// Distance from the body, negative within (m). Outside of a cylinder's or a box's edges it is exact; within it is that of the nearest face.
    pub fn distance(&self, point: &Vector) -> f64 {
        match self {
            Self::Capsule { from, to, radius } => {
                (point - nearest_on_segment(point, from, to)).norm() - radius
            }
            Self::Cylinder { from, to, radius } => {
                let axis = to - from;
                let length = axis.norm();
                let axis = axis / length;
                let out = point - from;
                let along = axis.dot(&out);
                let beside = (out - axis * along).norm() - radius;
                rounded_corner(beside, (along - length / 2.0).abs() - length / 2.0)
            }
            Self::Box { centre, rotation, half } => {
                let beyond = rotation.tr_mul(&(point - centre)).abs() - half;
                let outside = beyond.sup(&Vector::zeros()).norm();
                outside + beyond.max().min(0.0)
            }
        }
    }

    /// Where a ray from `origin` in `direction` (of length one) enters the body.
    pub(crate) fn enter(&self, origin: &Vector, direction: &Vector) -> Option<Hit> {
        match self {
            Self::Capsule { from, to, radius } => {
                enter_capsule(origin, direction, from, to, *radius)
            }
            Self::Cylinder { from, to, radius } => {
                enter_cylinder(origin, direction, from, to, *radius)
            }
            Self::Box { centre, rotation, half } => {
                let (o, d) = (rotation.tr_mul(&(origin - centre)), rotation.tr_mul(direction));
                let hit = enter_box(&o, &d, half)?;
                Some(Hit { normal: rotation * hit.normal, ..hit })
            }
        }
    }

    /// Share of the sky above a surface at `point` with outward `normal` that the body hides, weighed by how steeply the light would come.
    ///
    /// A capsule counts as the ball around its nearest point, for which the share is cos θ (r/d)²; a box by how large it looks around its
    /// nearest point. Neither is exact, both are smooth.
    pub(crate) fn hidden_sky(&self, point: &Vector, normal: &Vector) -> f64 {
        match self {
            Self::Capsule { .. } | Self::Cylinder { .. } => {
                let (from, to, radius) = self.as_capsule();
                let way = nearest_on_segment(point, &from, &to) - point;
                let distance = way.norm().max(1e-6);
                let near = (radius / distance.max(radius)).powi(2);
                (normal.dot(&way) / distance).max(0.0) * near
            }
            Self::Box { centre, rotation, half } => {
                let local = rotation.tr_mul(&(point - centre));
                let nearest = local.zip_map(half, |x, half| x.clamp(-half, half));
                let way = rotation * (nearest - local);
                let distance = way.norm();
                if distance < 1e-9 {
                    return 0.0;
                }
                let size = half.norm() / 2.0;
                let near = size * size / (size * size + distance * distance);
                f64::midpoint(1.0, normal.dot(&way) / distance).max(0.0) * near
            }
        }
    }

    /// Share of a lamp's light from `towards` (of length one) that reaches `point` past the body: 1 if it is not in the way, with a soft edge.
    pub(crate) fn passing_light(&self, point: &Vector, towards: &Vector) -> f64 {
        let (gap, along) = match self {
            Self::Capsule { .. } | Self::Cylinder { .. } => {
                let (from, to, radius) = self.as_capsule();
                let (ba, oa) = (to - from, point - from);
                let (baba, bard, oaba, oard) =
                    (ba.norm_squared(), ba.dot(towards), oa.dot(&ba), oa.dot(towards));
                let sine = baba - bard * bard;
                let free =
                    if sine > 1e-9 * baba { (bard * oaba - oard * baba) / sine } else { -oard };
                let h =
                    if baba > 0.0 { ((oaba + free * bard) / baba).clamp(0.0, 1.0) } else { 0.0 };
                let along = (h * bard - oard).max(0.0);
                ((oa + towards * along - ba * h).norm() - radius, along)
            }
            Self::Box { centre, rotation, half } => {
                let (o, d) = (rotation.tr_mul(&(point - centre)), rotation.tr_mul(towards));
                let reach = |along: f64| {
                    let at = o + d * along;
                    (at, at.zip_map(half, |x, half| x.clamp(-half, half)))
                };
                // To the foot of the box's nearest point, and again from there.
                let mut along = (-o.dot(&d)).max(0.0);
                for _ in 0..4 {
                    along = (reach(along).1 - o).dot(&d).max(0.0);
                }
                let gap = match slab(&o, &d, half) {
                    // A ray that only cuts an edge is as good as beside it.
                    Some((enter, leave, _)) if leave > 0.0 => -(leave - enter.max(0.0)) / 2.0,
                    _ => {
                        let (at, nearest) = reach(along);
                        (at - nearest).norm()
                    }
                };
                (gap, along)
            }
        };
        let light = (0.5 + gap / (LAMP * (along + SOFT))).clamp(0.0, 1.0);
        // Where the body lies behind the surface, it is in nobody's light.
        let light = light * light * (3.0 - 2.0 * light);
        let before = (along / SOFT).min(1.0);
        1.0 - before * (1.0 - light)
    }

    /// Itself, or a capsule of about its size.
    fn as_capsule(&self) -> (Vector, Vector, f64) {
        match self {
            Self::Cylinder { from, to, radius } => {
                let half = (to - from).norm() / 2.0;
                let middle = (from + to) / 2.0;
                // A ball of about its volume, drawn out if it is long.
                let ball = (0.75 * radius * radius * 2.0 * half).cbrt().min(*radius);
                let reach = (half - ball).max(0.0) / half.max(1e-9);
                (middle + (from - middle) * reach, middle + (to - middle) * reach, ball)
            }
            Self::Capsule { from, to, radius } => (*from, *to, *radius),
            Self::Box { centre, half, .. } => (*centre, *centre, half.norm()),
        }
    }
}

/// The point of a segment that is nearest.
pub(crate) fn nearest_on_segment(point: &Vector, from: &Vector, to: &Vector) -> Vector {
    let way = to - from;
    let length = way.norm_squared();
    let share =
        if length > 0.0 { (way.dot(&(point - from)) / length).clamp(0.0, 1.0) } else { 0.0 };
    from + way * share
}

/// Distance from a corner, of the distances from the two faces that meet in it.
fn rounded_corner(a: f64, b: f64) -> f64 {
    a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0)
}

/// A ball is met nearest to its centre's foot on the ray.
fn enter_ball(origin: &Vector, direction: &Vector, centre: &Vector, radius: f64) -> Option<f64> {
    let way = origin - centre;
    let b = direction.dot(&way);
    // The distance between centre and ray, by their difference: squares of long ways would drown it.
    let aside = way - direction * b;
    let h = radius * radius - aside.norm_squared();
    (h > 0.0).then(|| -b - h.sqrt())
}

/// A tube that a ray enters, the ends left out: the distance, and how far along the axis (0 to 1).
fn enter_tube(
    origin: &Vector,
    direction: &Vector,
    from: &Vector,
    to: &Vector,
    radius: f64,
) -> Option<(f64, f64)> {
    let ba = to - from;
    let oa = origin - from;
    let baba = ba.norm_squared();
    let (bard, baoa) = (ba.dot(direction), ba.dot(&oa));
    let (rdoa, oaoa) = (direction.dot(&oa), oa.norm_squared());
    let a = baba - bard * bard;
    if a <= 1e-12 * baba {
        return None;
    }
    let b = baba * rdoa - baoa * bard;
    let c = baba * oaoa - baoa * baoa - radius * radius * baba;
    let h = b * b - a * c;
    if h < 0.0 {
        return None;
    }
    let t = (-b - h.sqrt()) / a;
    Some((t, (baoa + t * bard) / baba))
}

fn enter_capsule(
    origin: &Vector,
    direction: &Vector,
    from: &Vector,
    to: &Vector,
    radius: f64,
) -> Option<Hit> {
    let tube = enter_tube(origin, direction, from, to, radius);
    let t = match tube {
        Some((t, along)) if (0.0..=1.0).contains(&along) => Some(t),
        // Past an end: the ball around it.
        Some((_, along)) => {
            enter_ball(origin, direction, if along < 0.0 { from } else { to }, radius)
        }
        // Along the axis, or past all of it.
        None if (to - from).norm_squared() * (1.0 - 1e-9) <= (to - from).dot(direction).powi(2) => {
            let ends = [from, to].map(|end| enter_ball(origin, direction, end, radius));
            ends.into_iter().flatten().reduce(f64::min)
        }
        None => None,
    }?;
    let at = origin + direction * t;
    let normal = (at - nearest_on_segment(&at, from, to)) / radius;
    (t > 0.0).then_some(Hit { t, normal })
}

fn enter_cylinder(
    origin: &Vector,
    direction: &Vector,
    from: &Vector,
    to: &Vector,
    radius: f64,
) -> Option<Hit> {
    let axis = (to - from).normalize();
    if let Some((t, along)) = enter_tube(origin, direction, from, to, radius)
        && (0.0..=1.0).contains(&along)
        && t > 0.0
    {
        let at = origin + direction * t;
        return Some(Hit { t, normal: (at - (from + (to - from) * along)) / radius });
    }
    // The end that looks this way.
    let slope = axis.dot(direction);
    let (end, normal) = if slope > 0.0 { (from, -axis) } else { (to, axis) };
    if slope.abs() < 1e-12 {
        return None;
    }
    let t = axis.dot(&(end - origin)) / slope;
    let out = origin + direction * t - end;
    (t > 0.0 && out.norm_squared() <= radius * radius).then_some(Hit { t, normal })
}

/// In the box's own axes.
fn enter_box(origin: &Vector, direction: &Vector, half: &Vector) -> Option<Hit> {
    let (enter, _, face) = slab(origin, direction, half)?;
    let mut normal = Vector::zeros();
    normal[face] = -direction[face].signum();
    (enter > 0.0).then_some(Hit { t: enter, normal })
}

/// Where a line enters and leaves a box, in the box's own axes, and the axis of the face that it enters by.
fn slab(origin: &Vector, direction: &Vector, half: &Vector) -> Option<(f64, f64, usize)> {
    let (mut enter, mut leave, mut face) = (f64::NEG_INFINITY, f64::INFINITY, 0);
    for i in 0..3 {
        if direction[i].abs() < 1e-12 {
            if origin[i].abs() > half[i] {
                return None;
            }
            continue;
        }
        let middle = -origin[i] / direction[i];
        let reach = half[i] / direction[i].abs();
        if middle - reach > enter {
            (enter, face) = (middle - reach, i);
        }
        leave = leave.min(middle + reach);
    }
    (enter <= leave).then_some((enter, leave, face))
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    /// One of each kind, about the size of a hand, near the origin.
    fn solids() -> Vec<Solid> {
        let tilt = *Rotation3::from_euler_angles(0.3, -0.8, 1.2).matrix();
        let (from, to) = (Vector::new(-0.2, 0.1, 0.0), Vector::new(0.3, 0.2, 0.25));
        vec![
            Solid::Capsule { from, to, radius: 0.1 },
            Solid::Cylinder { from, to, radius: 0.15 },
            Solid::Box { centre: from, rotation: tilt, half: Vector::new(0.1, 0.2, 0.3) },
            Solid::sphere(to, 0.2),
        ]
    }

    /// Directions on a spiral around the globe.
    fn directions() -> impl Iterator<Item = Vector> {
        (0..200).map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 200.0;
            let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
            Vector::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + Vector::z() * z
        })
    }

    /// A ray enters where a march along the distances does, and the normal is the distance's gradient.
    #[test]
    fn rays_enter_where_the_distance_is_zero() {
        let mut hits = 0;
        for solid in solids() {
            for (from, to) in directions().zip(directions().skip(7)) {
                let origin = from * 2.0;
                let direction = (to * 0.25 - origin).normalize();
                let mut marched = 0.0;
                for _ in 0..300 {
                    marched += solid.distance(&(origin + direction * marched));
                }
                let hit = solid.enter(&origin, &direction);
                assert_eq!(hit.is_some(), marched < 4.0, "{solid:?} {origin:?} {direction:?}");
                let Some(hit) = hit else { continue };
                hits += 1;
                assert!((hit.t - marched).abs() < 1e-4, "{solid:?}: {} {marched}", hit.t);
                let at = origin + direction * hit.t;
                let step = 1e-6;
                let rise = solid.distance(&(at + hit.normal * step)) - solid.distance(&at);
                assert!((rise / step - 1.0).abs() < 1e-3, "{solid:?} {rise}");
                assert!((hit.normal.norm() - 1.0).abs() < 1e-9);
            }
        }
        assert!(hits > 200, "{hits}");
    }

    #[test]
    fn rays_along_an_axis_meet_the_end() {
        let (from, to) = (Vector::zeros(), Vector::z());
        let origin = Vector::new(0.05, 0.0, 5.0);
        for (solid, wanted) in [
            (Solid::Capsule { from, to, radius: 0.1 }, 4.0 - (0.01f64 - 0.0025).sqrt()),
            (Solid::Cylinder { from, to, radius: 0.1 }, 4.0),
            (Solid::sphere(to, 0.1), 4.0 - (0.01f64 - 0.0025).sqrt()),
        ] {
            let hit = solid.enter(&origin, &-Vector::z()).expect("met");
            assert!((hit.t - wanted).abs() < 1e-9, "{solid:?} {}", hit.t);
            assert_eq!(solid.enter(&origin, &Vector::z()), None, "behind");
            assert_eq!(solid.enter(&(origin + Vector::x()), &-Vector::z()), None, "beside");
        }
    }

    #[test]
    fn balls_hold_the_body() {
        for solid in solids() {
            let balls = solid.balls();
            for direction in directions() {
                let Some(hit) = solid.enter(&(direction * 3.0), &-direction) else { continue };
                let at = direction * (3.0 - hit.t);
                let reach = |way: &Vector| {
                    balls.iter().map(|(c, r)| c.dot(way) + r).fold(f64::NEG_INFINITY, f64::max)
                };
                assert!(at.dot(&hit.normal) <= reach(&hit.normal) + 1e-9, "{solid:?}");
            }
        }
    }

    #[test]
    fn light_comes_from_where_nothing_is_and_no_sky_from_below() {
        for solid in solids() {
            let (below, beside) = (Vector::new(0.0, 0.12, -2.0), Vector::new(3.0, 0.0, -2.0));
            assert!(solid.passing_light(&beside, &Vector::z()) > 0.99, "{solid:?}");
            assert!(solid.passing_light(&below, &-Vector::z()) > 0.99, "{solid:?}");
            assert!(solid.hidden_sky(&below, &-Vector::z()) < 1e-2, "{solid:?}");
            for direction in directions() {
                let (sky, light) =
                    (solid.hidden_sky(&below, &direction), solid.passing_light(&below, &direction));
                assert!((0.0..=1.0).contains(&sky) && (0.0..=1.0).contains(&light));
            }
        }
        let ball = Solid::sphere(Vector::z(), 0.5);
        assert!(ball.passing_light(&Vector::zeros(), &Vector::z()) < 0.01, "in the middle of it");
        // A ball of radius r at distance d straight above hides (r/d)² of the light.
        assert!((ball.hidden_sky(&Vector::zeros(), &Vector::z()) - 0.25).abs() < 1e-12);
    }
}
