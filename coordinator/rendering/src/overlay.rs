//! Flat lines and rings that are drawn over bodies.

use crate::{Camera, Color, Vector};

/// Least width of what is drawn (px): thinner lines would only be fainter.
const THINNEST: f64 = 1.25;

/// Something flat, of even colour, drawn after the bodies and hidden by those before it.
#[derive(Debug, Clone, PartialEq)]
pub enum Overlay {
    /// A line through points, each with how much it covers (0 to 1).
    Path {
        /// The points (m) and their cover.
        points: Vec<(Vector, f32)>,
        /// Width (m); it looks smaller far away.
        width: f64,
        /// Its colour.
        color: Color,
        /// Share of the cover that is left where a body is before it.
        behind: f32,
    },
    /// A circle that always looks this way; with no radius a dot.
    Ring {
        /// Its middle (m).
        centre: Vector,
        /// Radius (m).
        radius: f64,
        /// Width of the line (m).
        width: f64,
        /// Its colour.
        color: Color,
        /// How much it covers (0 to 1).
        cover: f32,
        /// Share of the cover that is left where a body is before it.
        behind: f32,
    },
}

/// What a pixel gets of something flat.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Touch {
    /// Share that is covered.
    pub(crate) cover: f32,
    /// How far it is in front of the camera (m).
    pub(crate) depth: f64,
}

/// A segment on the picture.
#[derive(Debug, Clone, Copy)]
struct Segment {
    ends: [[f64; 2]; 2],
    depths: [f64; 2],
    covers: [f32; 2],
    /// Half of its width (px).
    reach: f64,
}

/// An overlay on a picture, ready to be asked.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    segments: Vec<Segment>,
    ring: Option<f64>,
    pub(crate) color: Color,
    pub(crate) behind: f32,
}

impl Placed {
    pub(crate) fn new(overlay: &Overlay, camera: &Camera) -> Self {
        match overlay {
            Overlay::Path { points, width, color, behind } => {
                let places: Vec<_> = points.iter().map(|(at, _)| camera.project(at)).collect();
                let pairs = places.windows(2).zip(points.windows(2));
                let segments = pairs.map(|(places, points)| {
                    let depths = [places[0].1, places[1].1];
                    let wide = width * camera.scale(f64::midpoint(depths[0], depths[1]));
                    Segment {
                        ends: [places[0].0, places[1].0],
                        depths,
                        covers: [points[0].1, points[1].1],
                        reach: wide.max(THINNEST) / 2.0,
                    }
                });
                Self { segments: segments.collect(), ring: None, color: *color, behind: *behind }
            }
            Overlay::Ring { centre, radius, width, color, cover, behind } => {
                let (place, depth) = camera.project(centre);
                let wide = (width * camera.scale(depth)).max(THINNEST);
                let segment = Segment {
                    ends: [place; 2],
                    depths: [depth; 2],
                    covers: [*cover; 2],
                    reach: wide / 2.0,
                };
                let ring = Some(radius * camera.scale(depth));
                Self { segments: vec![segment], ring, color: *color, behind: *behind }
            }
        }
    }

    /// What of it may touch the pixels from `low` to `high`; nothing if nothing does.
    pub(crate) fn within(&self, low: [f64; 2], high: [f64; 2]) -> Option<Self> {
        let out = self.ring.unwrap_or(0.0) + 1.0;
        let near = |segment: &&Segment| {
            let reach = segment.reach + out;
            (0..2).all(|i| {
                let [a, b] = segment.ends.map(|end| end[i]);
                a.min(b) - reach <= high[i] && a.max(b) + reach >= low[i]
            })
        };
        let segments: Vec<Segment> = self.segments.iter().filter(near).copied().collect();
        (!segments.is_empty()).then_some(Self { segments, ..*self })
    }

    /// What the pixel around `at` gets; of several segments the one that covers most.
    pub(crate) fn touch(&self, at: [f64; 2]) -> Option<Touch> {
        let mut most: Option<Touch> = None;
        for segment in &self.segments {
            let [from, to] = segment.ends;
            let way = [to[0] - from[0], to[1] - from[1]];
            let out = [at[0] - from[0], at[1] - from[1]];
            let length = way[0] * way[0] + way[1] * way[1];
            let dot = way[0] * out[0] + way[1] * out[1];
            let share = if length > 0.0 { (dot / length).clamp(0.0, 1.0) } else { 0.0 };
            let aside = (out[0] - share * way[0]).hypot(out[1] - share * way[1]);
            let aside = self.ring.map_or(aside, |radius| (aside - radius).abs());
            // A pixel's share of a band with a straight edge.
            let inside = (segment.reach - aside + 0.5).clamp(0.0, 1.0) as f32;
            let [a, b] = segment.covers;
            let cover = inside * (a + share as f32 * (b - a));
            if cover > most.map_or(0.0, |touch| touch.cover) {
                let depth = segment.depths[0] + share * (segment.depths[1] - segment.depths[0]);
                most = Some(Touch { cover, depth });
            }
        }
        most
    }
}
