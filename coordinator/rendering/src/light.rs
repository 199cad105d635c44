//! How bodies look in the light: a lamp with soft shadows, a bright sky with a lighter ground below, and a gloss.
//!
//! Shadows and hidden sky are sums over bodies in closed form (see [`crate::solid`]), so that there is no noise: a still part of a film has still
//! pixels.

use crate::{Color, Scene, Vector};

/// Light of the lamp and of the sky, above and below.
const LAMP: Color = Color([1.0, 0.97, 0.91]);
const ABOVE: Color = Color([0.62, 0.67, 0.74]);
const BELOW: Color = Color([0.40, 0.38, 0.37]);
/// Share of the lamp's light that a shadow keeps, from all around.
const STRAY: f64 = 0.08;
/// How much of the hidden sky is dark; the rest is light that the hiding body gives back.
const DEPTH: f64 = 0.85;
/// Strength and sharpness of the gloss.
const GLOSS: f64 = 0.16;
const SHARPNESS: i32 = 48;
/// What surfaces seen edge-on keep of their light, which draws their outlines.
const EDGE: f64 = 0.72;
/// Width of a seam and of a box's lighter edges (m).
const SEAM: f64 = 0.006;
const BEVEL: f64 = 0.007;

/// Where a body is looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look {
    /// Index of the body.
    pub(crate) body: usize,
    /// The point (m) and the surface's normal.
    pub(crate) point: Vector,
    pub(crate) normal: Vector,
    /// Towards whoever looks, of length one.
    pub(crate) back: Vector,
    /// Size of a pixel there (m).
    pub(crate) pixel: f64,
}

/// The light that comes from a point of a body.
pub(crate) fn shade(scene: &Scene, look: &Look) -> Color {
    let body = &scene.bodies[look.body];
    let Look { point, normal, back, .. } = look;
    let (mut sky, mut light) = (1.0, 1.0);
    let facing = normal.dot(&scene.lamp);
    // A little above the surface, so that a body does not hide what lies on it.
    let above = point + normal * 1e-3;
    for other in scene.bodies.iter().filter(|other| other.part != body.part) {
        sky *= 1.0 - DEPTH * other.solid.hidden_sky(&above, normal).min(1.0);
        if facing > 0.0 && light > 0.0 {
            light *= other.solid.passing_light(&above, &scene.lamp);
        }
    }
    let lamp = facing.max(0.0) * (STRAY + (1.0 - STRAY) * light);
    let ambient = ABOVE.mixed(BELOW, f64::midpoint(1.0, -normal.z) as f32);
    let light_here = ambient.scaled(sky as f32).plus(LAMP.scaled(lamp as f32));
    let edge = EDGE + (1.0 - EDGE) * normal.dot(back).max(0.0).sqrt();
    let mut color = body.color;
    if let Some(inset) = body.seam {
        color = marked(scene, look, inset);
    }
    let half = (scene.lamp + back).normalize();
    let gloss = GLOSS * normal.dot(&half).max(0.0).powi(SHARPNESS) * light;
    color.lit(light_here).scaled(edge as f32).plus(LAMP.scaled(gloss as f32))
}

/// The colour of a box with a line around each face, and lighter edges.
fn marked(scene: &Scene, look: &Look, inset: f64) -> Color {
    let body = &scene.bodies[look.body];
    let crate::Solid::Box { centre, rotation, half } = &body.solid else { return body.color };
    let local = rotation.tr_mul(&(look.point - centre));
    let face = rotation.tr_mul(&look.normal).iamax();
    // Distance from the nearest edge of the face.
    let from_edge = (0..3)
        .filter(|i| *i != face)
        .map(|i| half[i] - local[i].abs())
        .fold(f64::INFINITY, f64::min);
    // Shares of a pixel: a line that is thinner than one is fainter instead.
    let share = |from: f64, to: f64| {
        let (low, high) = (from_edge - look.pixel / 2.0, from_edge + look.pixel / 2.0);
        ((high.min(to) - low.max(from)) / look.pixel).clamp(0.0, 1.0) as f32
    };
    let seam = share(inset - SEAM / 2.0, inset + SEAM / 2.0);
    let bevel = share(-1.0, BEVEL);
    let color = body.color.mixed(Color::BLACK, 0.45 * seam);
    color.mixed(Color([1.0; 3]), 0.22 * bevel)
}
