//! Panels: coordinate systems, and what is drawn in them.

use proto::statistics::{mean, quantile};

use crate::axis::Axis;

/// A distribution in the form of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantiles {
    /// 10th percentile, where the lower whisker begins.
    pub p10: f64,
    /// 25th percentile, where the box begins.
    pub p25: f64,
    /// Median, the line across the box.
    pub p50: f64,
    /// 75th percentile, where the box ends.
    pub p75: f64,
    /// 90th percentile, where the upper whisker ends.
    pub p90: f64,
    /// Arithmetic mean, a dot.
    pub mean: f64,
}

impl Quantiles {
    /// Of `values`, interpolated between neighbours; none of nothing.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let [p10, p25, p50, p75, p90] =
            [0.1, 0.25, 0.5, 0.75, 0.9].map(|share| quantile(&values, share));
        (!values.is_empty()).then(|| Self { p10, p25, p50, p75, p90, mean: mean(&values) })
    }
}

/// Something drawn. `color` is a place in [`COLORS`](crate::palette::COLORS), which begin anew after the last; what has no
/// name is not in the legend.
#[derive(Debug, Clone)]
pub enum Item {
    /// From point to point.
    Line {
        /// What the legend says.
        name: String,
        /// Place in the palette.
        color: usize,
        /// Where it goes; what is not finite, or has no logarithm on an axis of such, is left out.
        points: Vec<(f64, f64)>,
        /// Whether each point is marked.
        dots: bool,
    },
    /// Between a lower and an upper line.
    Band {
        /// What the legend says.
        name: String,
        /// Place in the palette.
        color: usize,
        /// The lower line.
        low: Vec<(f64, f64)>,
        /// The upper line.
        high: Vec<(f64, f64)>,
    },
    /// Distributions at places on the horizontal axis.
    Boxes {
        /// What the legend says.
        name: String,
        /// Place in the palette.
        color: usize,
        /// Width of a box on the horizontal axis.
        width: f64,
        /// Where, and of what.
        boxes: Vec<(f64, Quantiles)>,
    },
    /// A horizontal line at a value that something is compared with.
    Threshold {
        /// What the legend says.
        name: String,
        /// The value.
        at: f64,
    },
    /// Steps in which something happens.
    Span {
        /// What the legend says.
        name: String,
        /// The first of them.
        from: f64,
        /// Where they end.
        to: f64,
    },
}

/// A line with a name.
pub fn line(name: impl Into<String>, color: usize, points: Vec<(f64, f64)>) -> Item {
    Item::Line { name: name.into(), color, points, dots: false }
}

impl Item {
    /// All values on the vertical axis that must be seen.
    fn heights(&self) -> Vec<f64> {
        match self {
            Self::Line { points, .. } => points.iter().map(|point| point.1).collect(),
            Self::Band { low, high, .. } => low.iter().chain(high).map(|point| point.1).collect(),
            Self::Boxes { boxes, .. } => {
                boxes.iter().flat_map(|(_, all)| [all.p10, all.p90, all.mean]).collect()
            }
            Self::Threshold { at, .. } => vec![*at],
            Self::Span { .. } => Vec::new(),
        }
    }
}

/// A part of what is drawn that leads elsewhere.
#[derive(Debug, Clone)]
pub struct Link {
    /// The address.
    pub to: String,
    /// What is there, in words.
    pub what: String,
    /// Where it is on the panel.
    pub at: Place,
}

/// Where a link is on a panel.
#[derive(Debug, Clone)]
pub enum Place {
    /// Everything between two values on the horizontal axis.
    Between(f64, f64),
    /// A line.
    Along(Vec<(f64, f64)>),
    /// A point.
    Point(f64, f64),
}

/// One coordinate system.
#[derive(Debug, Clone)]
pub struct Panel {
    /// What stands above it.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// What is drawn, the first at the back.
    pub items: Vec<Item>,
    /// What leads elsewhere, the first at the back.
    pub links: Vec<Link>,
}

impl Panel {
    /// With an even vertical axis, called `y`, for what is in it.
    pub fn linear(title: impl Into<String>, x: Axis, y: &str, items: Vec<Item>) -> Self {
        let y = Axis::around(y, items.iter().flat_map(Item::heights));
        Self { title: title.into(), x, y, items, links: Vec::new() }
    }

    /// With a logarithmic vertical axis, called `y`, for what is in it.
    pub fn log(title: impl Into<String>, x: Axis, y: &str, items: Vec<Item>) -> Self {
        let y = Axis::log(y, items.iter().flat_map(Item::heights));
        Self { title: title.into(), x, y, items, links: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_by_hand() {
        let quantiles = Quantiles::of((0..=10).map(f64::from).collect()).expect("not empty");
        assert_eq!((quantiles.p10, quantiles.p25, quantiles.p50), (1.0, 2.5, 5.0));
        assert_eq!((quantiles.p75, quantiles.p90, quantiles.mean), (7.5, 9.0, 5.0));
        assert_eq!(Quantiles::of(Vec::new()), None);
    }

    #[test]
    fn an_axis_has_room_for_everything_in_the_panel() {
        let boxes = vec![(0.0, Quantiles::of(vec![3.0, 700.0]).expect("not empty"))];
        let items = vec![
            line("", 0, vec![(0.0, 5.0), (1.0, f64::NAN)]),
            Item::Boxes { name: String::new(), color: 1, width: 0.3, boxes },
            Item::Threshold { name: String::new(), at: 900.0 },
        ];
        let panel = Panel::log("", Axis::linear("", 0.0, 1.0), "", items.clone());
        assert!(panel.y.low < 5.0 && panel.y.high > 900.0);
        // From 5 to 900, and a twentieth of that more on either side.
        let even = Panel::linear("", Axis::linear("", 0.0, 1.0), "", items);
        assert_eq!((even.y.low, even.y.high), (5.0 - 44.75, 900.0 + 44.75));
    }
}
