//! What is seen.

use crate::{Color, Overlay, Solid, Vector, View};

/// A solid with its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Its shape.
    pub solid: Solid,
    /// Colour of its surface.
    pub color: Color,
    /// What it is a part of: bodies of one part cast no shadows on each other.
    pub part: usize,
    /// Where it is a box: how far from its edges a line runs around each face (m).
    pub seam: Option<f64>,
}

/// Bodies and what is drawn over them, in even light before an even ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// What is behind everything (sRGB).
    pub ground: [u8; 3],
    /// The bodies.
    pub bodies: Vec<Body>,
    /// Lines and rings, drawn in this order.
    pub overlays: Vec<Overlay>,
    /// Towards the lamp, of length one.
    pub lamp: Vector,
}

impl Scene {
    /// An empty scene whose lamp stands to the left above whoever looks from `view`.
    pub fn new(ground: [u8; 3], view: View) -> Self {
        let [back, right, up] = view.axes();
        let lamp = (back * 0.62 - right * 0.5 + up * 0.8).normalize();
        Self { ground, bodies: Vec::new(), overlays: Vec::new(), lamp }
    }
}
