//! From where a scene is seen.

use nalgebra::Rotation3;

use crate::Vector;

/// Tangent of half the angle that a picture's shorter side spans: that of a long lens, which leaves distant and near things nearly of one size.
const HALF_ANGLE: f64 = 0.18;

/// Side from which something is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Turn about the vertical, from the x axis towards the y axis (rad).
    pub azimuth: f64,
    /// Height above the horizon (rad), less than a quarter turn.
    pub elevation: f64,
}

impl View {
    /// Towards whoever looks, to the right, and up; world axes, of length one.
    pub fn axes(self) -> [Vector; 3] {
        let turn = Rotation3::from_axis_angle(&Vector::z_axis(), self.azimuth)
            * Rotation3::from_axis_angle(&Vector::y_axis(), -self.elevation);
        [turn * Vector::x(), turn * Vector::y(), turn * Vector::z()]
    }
}

/// A pinhole and the picture behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Where it stands (m, world).
    pub(crate) eye: Vector,
    /// Back towards whoever looks, to the right, and up.
    pub(crate) axes: [Vector; 3],
    /// Size of a thing of one metre at a distance of one metre (px).
    pub(crate) focal: f64,
    /// Columns and rows.
    pub(crate) size: [usize; 2],
    /// Where the middle of the lens points (px).
    pub(crate) centre: [f64; 2],
}

impl Camera {
    /// A camera on whose picture of `size` pixels all `balls` (centre and radius, m) have their place with `margin` pixels around them, as large as can be.
    /// Seen from another side the same balls are as near; what is seen may leave the picture then.
    ///
    /// # Panics
    /// If there is no ball, or no place within the margin.
    pub fn fit(view: View, size: [usize; 2], margin: f64, balls: &[(Vector, f64)]) -> Self {
        let [width, height] = size.map(|side| side as f64);
        assert!(2.0 * margin < width.min(height), "{size:?} with a margin of {margin}");
        let low = balls.iter().map(|(at, r)| at.add_scalar(-r)).reduce(|a, b| a.inf(&b));
        let high = balls.iter().map(|(at, r)| at.add_scalar(*r)).reduce(|a, b| a.sup(&b));
        let middle = low.zip(high).map(|(low, high)| (low + high) / 2.0).expect("balls to look at");
        let around =
            balls.iter().map(|(at, radius)| (at - middle).norm() + radius).fold(1e-3, f64::max);
        let axes = view.axes();
        let eye = middle + axes[0] * (around / HALF_ANGLE);
        let mut camera = Self { eye, axes, focal: 1.0, size, centre: [0.0; 2] };
        // How far the balls reach on a picture whose focal length is one pixel.
        let (mut from, mut to) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for (at, radius) in balls {
            let (place, depth) = camera.project(at);
            let reach = camera.reach(*radius, depth);
            for i in 0..2 {
                from[i] = from[i].min(place[i] - reach);
                to[i] = to[i].max(place[i] + reach);
            }
        }
        let room = [width - 2.0 * margin, height - 2.0 * margin];
        camera.focal = (0..2).map(|i| room[i] / (to[i] - from[i])).fold(f64::INFINITY, f64::min);
        let middle = [0, 1].map(|i| camera.focal * (from[i] + to[i]) / 2.0);
        camera.centre = [width / 2.0 - middle[0], height / 2.0 - middle[1]];
        camera
    }

    /// The same camera, moved around `pivot` to another side.
    pub fn turned(&self, pivot: &Vector, view: View) -> Self {
        let axes = view.axes();
        let away = self.axes.map(|axis| axis.dot(&(self.eye - pivot)));
        let eye = pivot + axes[0] * away[0] + axes[1] * away[1] + axes[2] * away[2];
        Self { eye, axes, ..self.clone() }
    }

    /// The same camera with a longer lens, the middle of the picture where it is.
    pub fn zoomed(&self, factor: f64) -> Self {
        let middle = self.size.map(|side| side as f64 / 2.0);
        let centre = [0, 1].map(|i| middle[i] + factor * (self.centre[i] - middle[i]));
        Self { focal: factor * self.focal, centre, ..self.clone() }
    }

    /// Where a point is on the picture (px, from the upper left corner), and how far in front of the camera (m).
    pub fn project(&self, point: &Vector) -> ([f64; 2], f64) {
        let [back, right, up] = self.axes.map(|axis| axis.dot(&(point - self.eye)));
        let depth = -back;
        let scale = self.focal / depth;
        ([self.centre[0] + scale * right, self.centre[1] - scale * up], depth)
    }

    /// Direction of the ray through a place on the picture, of length one.
    pub(crate) fn ray(&self, [x, y]: [f64; 2]) -> Vector {
        let (right, up) = ((x - self.centre[0]) / self.focal, (self.centre[1] - y) / self.focal);
        (self.axes[1] * right + self.axes[2] * up - self.axes[0]).normalize()
    }

    /// How far the outline of a ball at a depth reaches from where its centre is seen, at most (px).
    pub(crate) fn reach(&self, radius: f64, depth: f64) -> f64 {
        // Off the middle of the picture outlines are stretched; a long lens has little of that.
        1.1 * self.focal * radius / (depth * depth - radius * radius).max(1e-9).sqrt()
    }

    /// Size of a thing of one metre at a depth (px).
    pub fn scale(&self, depth: f64) -> f64 {
        self.focal / depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: View = View { azimuth: 0.6, elevation: 0.4 };

    #[test]
    fn up_is_up_and_x_comes_nearer() {
        let [back, right, up] = View { azimuth: 0.0, elevation: 0.0 }.axes();
        assert!((back - Vector::x()).norm() < 1e-12);
        assert!((right - Vector::y()).norm() < 1e-12);
        assert!((up - Vector::z()).norm() < 1e-12);
        let [back, _, up] = VIEW.axes();
        assert!(back.z > 0.0 && up.z > 0.0, "seen from above");
    }

    #[test]
    fn what_is_fitted_is_on_the_picture_and_fills_it() {
        let balls = [
            (Vector::new(0.0, 1.5, 4.0), 0.2),
            (Vector::new(0.0, -1.5, 4.0), 0.2),
            (Vector::new(0.3, 0.0, 4.5), 0.5),
        ];
        for size in [[400, 300], [300, 400]] {
            let camera = Camera::fit(VIEW, size, 10.0, &balls);
            let (mut from, mut to) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for (at, radius) in &balls {
                let (place, depth) = camera.project(at);
                for i in 0..2 {
                    from[i] = from[i].min(place[i] - camera.reach(*radius, depth));
                    to[i] = to[i].max(place[i] + camera.reach(*radius, depth));
                }
            }
            let gaps = [0, 1].map(|i| (from[i], size[i] as f64 - to[i]));
            assert!(gaps.iter().all(|(a, b)| *a > 9.99 && *b > 9.99), "{gaps:?}");
            assert!(gaps.iter().any(|(a, b)| *a < 10.01 && *b < 10.01), "{gaps:?}");
        }
    }

    #[test]
    fn a_ray_goes_through_the_point_that_is_seen_there() {
        let ball = Vector::new(0.2, -0.4, 3.0);
        let camera = Camera::fit(VIEW, [200, 100], 4.0, &[(ball, 1.0)]);
        let camera = camera.turned(&ball, View { azimuth: 2.0, elevation: -0.3 }).zoomed(1.5);
        for point in [ball, ball + Vector::new(0.3, 0.5, -0.2)] {
            let (place, depth) = camera.project(&point);
            let ray = camera.ray(place);
            let along = (point - camera.eye).dot(&ray);
            assert!((camera.eye + ray * along - point).norm() < 1e-9);
            assert!((-ray.dot(&camera.axes[0]) * along - depth).abs() < 1e-9);
        }
        let (place, _) = camera.project(&ball);
        assert!((place[0] - 100.0).abs() < 1.0 && (place[1] - 50.0).abs() < 1.0, "{place:?}");
    }
}
