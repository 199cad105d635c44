//! From a scene to pixels.
//!
//! A picture is made tile by tile, each with the few bodies that can be seen in it. Of a pixel sixteen places are looked at, for whose body is
//! nearest there; every body that is found is shaded once, and has as much of the pixel as places. So edges are smooth, and surfaces, which are
//! smooth by themselves, cost no more than they must.

use crate::light::{Look, shade};
use crate::overlay::Placed;
use crate::{Camera, Color, Image, Scene, Vector};

/// Side of a tile (px).
const TILE: usize = 8;

/// Places of a pixel that are looked at.
const SAMPLES: usize = 16;

/// Flat things this far behind a surface are still before it (m).
const BEFORE: f64 = 2e-3;

/// What is nearest at a place of a pixel.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// Index of the body, if there is one.
    body: Option<usize>,
    depth: f64,
}

/// The places: evenly spread over both axes (Hammersley's points), so that nearly level and nearly upright edges are smooth, too.
fn places() -> [[f64; 2]; SAMPLES] {
    std::array::from_fn(|i| {
        let reversed = (i as u8).reverse_bits() >> 4;
        [(i as f64 + 0.5) / 16.0, (f64::from(reversed) + 0.5) / 16.0]
    })
}

/// What a camera sees of a scene.
pub fn render(scene: &Scene, camera: &Camera) -> Image {
    let [width, height] = camera.size;
    let mut image = Image::filled(width, height, scene.ground);
    let bounds: Vec<[[f64; 2]; 2]> =
        scene.bodies.iter().map(|body| bounds(&body.solid.balls(), camera)).collect();
    let overlays: Vec<Placed> =
        scene.overlays.iter().map(|overlay| Placed::new(overlay, camera)).collect();
    let places = places();
    for top in (0..height).step_by(TILE) {
        for left in (0..width).step_by(TILE) {
            let low = [left as f64, top as f64];
            let high = [low[0] + TILE as f64, low[1] + TILE as f64];
            let seen = |bounds: &[[f64; 2]; 2]| {
                (0..2).all(|i| bounds[0][i] <= high[i] && bounds[1][i] >= low[i])
            };
            let bodies: Vec<usize> = (0..bounds.len()).filter(|i| seen(&bounds[*i])).collect();
            let overlays: Vec<Placed> =
                overlays.iter().filter_map(|overlay| overlay.within(low, high)).collect();
            if bodies.is_empty() && overlays.is_empty() {
                continue;
            }
            let tile = Tile { scene, camera, bodies, overlays, places: &places };
            for y in top..height.min(top + TILE) {
                for x in left..width.min(left + TILE) {
                    if let Some(color) = tile.pixel(x, y) {
                        image.pixels[y * width + x] = color.to_srgb();
                    }
                }
            }
        }
    }
    image
}

/// Corners of a rectangle on the picture that holds what lies between balls.
fn bounds(balls: &[(Vector, f64)], camera: &Camera) -> [[f64; 2]; 2] {
    let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for (at, radius) in balls {
        let (place, depth) = camera.project(at);
        let reach = camera.reach(*radius, depth);
        for i in 0..2 {
            bounds[0][i] = bounds[0][i].min(place[i] - reach);
            bounds[1][i] = bounds[1][i].max(place[i] + reach);
        }
    }
    bounds
}

struct Tile<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    /// What can be seen in it.
    bodies: Vec<usize>,
    overlays: Vec<Placed>,
    places: &'a [[f64; 2]; SAMPLES],
}

impl Tile<'_> {
    /// A pixel's colour; nothing if it is the ground's.
    fn pixel(&self, x: usize, y: usize) -> Option<Color> {
        let ground = Color::srgb(self.scene.ground);
        let corner = [x as f64, y as f64];
        let mut samples = [Sample { body: None, depth: f64::INFINITY }; SAMPLES];
        if !self.bodies.is_empty() {
            for (sample, place) in samples.iter_mut().zip(self.places) {
                let ray = self.camera.ray([corner[0] + place[0], corner[1] + place[1]]);
                let slope = -ray.dot(&self.camera.axes[0]);
                for &body in &self.bodies {
                    let hit = self.scene.bodies[body].solid.enter(&self.camera.eye, &ray);
                    if let Some(hit) = hit
                        && hit.t * slope < sample.depth
                    {
                        *sample = Sample { body: Some(body), depth: hit.t * slope };
                    }
                }
            }
        }
        let mut color = Color::BLACK;
        let mut bare = SAMPLES;
        let mut done = [None; SAMPLES];
        for i in 0..SAMPLES {
            let Some(body) = samples[i].body else { continue };
            if done[..i].contains(&Some(body)) {
                continue;
            }
            done[i] = Some(body);
            let mine = || (0..SAMPLES).filter(|&j| samples[j].body == Some(body));
            let count = mine().count();
            bare -= count;
            let share = count as f32 / SAMPLES as f32;
            color = color.plus(self.shaded(body, corner, mine()).scaled(share));
        }
        color = color.plus(ground.scaled(bare as f32 / SAMPLES as f32));
        let mut touched = bare < SAMPLES;
        for overlay in &self.overlays {
            let Some(touch) = overlay.touch([corner[0] + 0.5, corner[1] + 0.5]) else { continue };
            let before = samples.iter().filter(|s| touch.depth < s.depth + BEFORE).count();
            let before = before as f32 / SAMPLES as f32;
            let cover = touch.cover * (before + overlay.behind * (1.0 - before));
            color = color.mixed(overlay.color, cover);
            touched |= cover > 0.0;
        }
        touched.then_some(color)
    }

    /// Of a body in the middle of the places of a pixel that are its own. They lie in a cone, as the body is convex, and so does their middle.
    fn shaded(&self, body: usize, corner: [f64; 2], own: impl Iterator<Item = usize>) -> Color {
        let (mut middle, mut count, mut first) = ([0.0; 2], 0.0, None);
        for place in own.map(|i| self.places[i]) {
            middle = [middle[0] + place[0], middle[1] + place[1]];
            count += 1.0;
            first = first.or(Some(place));
        }
        let middle = middle.map(|sum| sum / count);
        let solid = &self.scene.bodies[body].solid;
        let hit = [Some(middle), first].into_iter().flatten().find_map(|place| {
            let ray = self.camera.ray([corner[0] + place[0], corner[1] + place[1]]);
            Some((ray, solid.enter(&self.camera.eye, &ray)?))
        });
        let Some((ray, hit)) = hit else { return Color::BLACK };
        let look = Look {
            body,
            point: self.camera.eye + ray * hit.t,
            normal: hit.normal,
            back: -ray,
            pixel: hit.t / self.camera.focal / hit.normal.dot(&-ray).max(0.05),
        };
        shade(self.scene, &look)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::{Body, Overlay, Solid, View};

    const GROUND: [u8; 3] = [240, 242, 244];
    const VIEW: View = View { azimuth: 0.5, elevation: 0.4 };

    fn body(solid: Solid, color: [u8; 3]) -> Body {
        Body { solid, color: Color::srgb(color), part: 0, seam: None }
    }

    fn scene(bodies: Vec<Body>) -> (Scene, Camera) {
        let balls: Vec<_> = bodies.iter().flat_map(|body| body.solid.balls()).collect();
        let scene = Scene { bodies, ..Scene::new(GROUND, VIEW) };
        (scene, Camera::fit(VIEW, [120, 90], 8.0, &balls))
    }

    fn at(image: &Image, camera: &Camera, point: &Vector) -> [u8; 3] {
        let (place, _) = camera.project(point);
        image.pixel(place[0] as usize, place[1] as usize)
    }

    #[test]
    fn a_ball_covers_its_disc_and_nothing_else() {
        let (scene, camera) = scene(vec![body(Solid::sphere(Vector::z(), 0.5), [200, 30, 30])]);
        let image = render(&scene, &camera);
        let [red, green, _] = at(&image, &camera, &Vector::z());
        assert!(red > 100 && green < red / 2, "{red} {green}");
        let (centre, depth) = camera.project(&Vector::z());
        // The outline of a ball: focal · r / √(d² − r²).
        let radius = camera.focal * 0.5 / (depth * depth - 0.25).sqrt();
        for y in 0..90 {
            for x in 0..120 {
                let out = (x as f64 + 0.5 - centre[0]).hypot(y as f64 + 0.5 - centre[1]);
                let is_ground = image.pixel(x, y) == GROUND;
                if out > radius + 1.5 {
                    assert!(is_ground, "{x} {y}");
                }
                if out < radius - 1.5 {
                    assert!(!is_ground, "{x} {y}");
                }
            }
        }
    }

    /// Sums over all pixels are areas: the edge's pixels hold shares of both sides.
    #[test]
    fn edges_are_smooth() {
        let black = body(Solid::sphere(Vector::zeros(), 0.5), [0, 0, 0]);
        let (scene, camera) = scene(vec![black]);
        let image = render(&scene, &camera);
        let levels: std::collections::BTreeSet<u8> = image.pixels.iter().map(|p| p[1]).collect();
        assert!(levels.len() > 16, "{levels:?}");
    }

    #[test]
    fn the_near_one_is_seen_and_what_stands_in_the_shadow_is_darker() {
        let [back, ..] = VIEW.axes();
        let near = body(Solid::sphere(back, 0.3), [30, 200, 30]);
        let far = body(Solid::sphere(Vector::zeros(), 0.3), [200, 30, 30]);
        let (both, camera) = scene(vec![far.clone(), near]);
        let [red, green, _] = at(&render(&both, &camera), &camera, &Vector::zeros());
        assert!(green > red, "{red} {green}");

        let mut lit = Scene { bodies: vec![far.clone()], ..Scene::new(GROUND, VIEW) };
        let bright = at(&render(&lit, &camera), &camera, &Vector::zeros())[0];
        let shade = Solid::sphere(lit.lamp * 0.8, 0.2);
        lit.bodies.push(Body { part: 1, ..body(shade, [0; 3]) });
        let dark = at(&render(&lit, &camera), &camera, &(lit.lamp * 0.29))[0];
        let before = at(
            &render(&Scene { bodies: vec![far], ..Scene::new(GROUND, VIEW) }, &camera),
            &camera,
            &(lit.lamp * 0.29),
        )[0];
        assert!(f32::from(dark) < 0.7 * f32::from(before), "{dark} {before} {bright}");
    }

    #[test]
    fn a_line_is_hidden_by_what_is_before_it() {
        let [back, right, _] = VIEW.axes();
        let wall = Solid::Box {
            centre: Vector::zeros(),
            rotation: Matrix3::identity(),
            half: Vector::new(0.3, 0.3, 0.3),
        };
        let (mut scene, camera) = scene(vec![body(wall, [0, 0, 200])]);
        let camera = camera.zoomed(0.2);
        let line = |offset: f64, behind: f32| Overlay::Path {
            points: vec![(back * offset - right, 1.0), (back * offset + right, 1.0)],
            width: 0.08,
            color: Color::srgb([255, 0, 0]),
            behind,
        };
        for (offset, behind, seen) in [(2.0, 0.0, true), (-2.0, 0.0, false), (-2.0, 1.0, true)] {
            scene.overlays = vec![line(offset, behind)];
            let image = render(&scene, &camera);
            let [red, _, blue] = at(&image, &camera, &(back * offset));
            assert_eq!(red > 240 && blue < 80, seen, "{offset} {behind}: {red} {blue}");
            let outside = at(&image, &camera, &(back * offset + right * 0.8));
            // At its edge a pixel is not of the line alone.
            let [red, green, blue] = outside;
            assert!(red > 240 && green < 80 && blue < 80, "{offset} {behind}: {outside:?}");
        }
    }

    #[test]
    fn the_same_scene_gives_the_same_pixels() {
        let (scene, camera) = scene(vec![body(Solid::sphere(Vector::x(), 0.2), [9, 99, 199])]);
        assert_eq!(render(&scene, &camera), render(&scene, &camera));
    }
}
