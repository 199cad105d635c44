//! Panels of lines, bands and boxes, side by side, as SVG for a page.
//!
//! Nothing is filled behind a picture, and all colours are of one small set, so that the page's style sheet can replace them where it is
//! dark (see `reproduce/style.css`). Legends stand above what is drawn, never on it.

use std::ops::Range;

use anyhow::anyhow;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use proto::statistics::{mean, quantile};

/// Size of a panel (px).
const PANEL: (u32, u32) = (440, 320);
const INK: RGBColor = RGBColor(38, 50, 56);
const FAINT: RGBColor = RGBColor(96, 112, 120);
const GRID: RGBColor = RGBColor(226, 231, 234);
/// Okabe and Ito's colours, which all eyes tell apart.
pub(crate) const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// Height of a panel's title and of a line of its legend, and the room that a character takes (px).
const TITLE: u32 = 24;
const LEGEND: u32 = 19;
const CHARACTER: f64 = 6.7;

/// An axis.
#[derive(Debug, Clone)]
pub(crate) struct Axis {
    /// What it shows, with its unit.
    pub(crate) name: String,
    pub(crate) scale: Scale,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// How an axis is divided.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Scale {
    Linear,
    Log,
    /// A name at 0, 1, 2, …
    Names(Vec<String>),
}

impl Axis {
    /// From `low` to `high`, evenly.
    pub(crate) fn linear(name: &str, low: f64, high: f64) -> Self {
        let high = if high > low { high } else { low + 1.0 };
        Self { name: name.to_owned(), scale: Scale::Linear, low, high }
    }

    /// Names side by side.
    pub(crate) fn names(name: &str, names: Vec<String>) -> Self {
        let high = names.len() as f64 - 0.5;
        Self { name: name.to_owned(), scale: Scale::Names(names), low: -0.5, high }
    }

    /// Logarithmic, with room for all of `values` that are above zero, and at least for a factor of ten.
    pub(crate) fn log(name: &str, values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values
            .filter(|value| value.is_finite() && *value > 0.0)
            .fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
        let (low, high) = if low <= high { (0.8 * low, 1.25 * high) } else { (0.1, 1.0) };
        let middle = (low * high).sqrt();
        let reach = (high / middle).max(10_f64.sqrt());
        Self { name: name.to_owned(), scale: Scale::Log, low: middle / reach, high: middle * reach }
    }

    /// The nearest value that is on the axis.
    fn clamp(&self, value: f64) -> f64 {
        value.clamp(self.low, self.high)
    }

    fn label(&self, value: f64) -> String {
        match &self.scale {
            Scale::Names(names) => names.get(value.round() as usize).cloned().unwrap_or_default(),
            Scale::Linear | Scale::Log => number(value),
        }
    }
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = match self.scale {
            Scale::Log => (value / self.low).ln() / (self.high / self.low).ln(),
            Scale::Linear | Scale::Names(_) => (value - self.low) / (self.high - self.low),
        };
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() {
            return Vec::new();
        }
        match &self.scale {
            Scale::Names(names) => (0..names.len()).map(|index| index as f64).collect(),
            Scale::Linear => {
                let rough = (self.high - self.low) / 6.0;
                let decade = 10_f64.powf(rough.log10().floor());
                let steps = [1.0, 2.0, 2.5, 5.0, 10.0].map(|digit| digit * decade);
                let step = steps.into_iter().find(|step| *step >= rough).unwrap_or(rough);
                let first = (self.low / step).ceil() as i64;
                let last = (self.high / step + 1e-9).floor() as i64;
                (first..=last).map(|index| index as f64 * step).collect()
            }
            Scale::Log => {
                let digits: &[f64] =
                    if self.high / self.low > 300.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
                let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
                decades
                    .flat_map(|decade| digits.iter().map(move |digit| digit * 10_f64.powi(decade)))
                    .filter(|value| (self.low..=self.high).contains(value))
                    .collect()
            }
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

/// A distribution in the form of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Quantiles {
    pub(crate) p10: f64,
    pub(crate) p25: f64,
    pub(crate) p50: f64,
    pub(crate) p75: f64,
    pub(crate) p90: f64,
    pub(crate) mean: f64,
}

impl Quantiles {
    /// Of `values`, interpolated between neighbours; none of nothing.
    pub(crate) fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let [p10, p25, p50, p75, p90] =
            [0.1, 0.25, 0.5, 0.75, 0.9].map(|share| quantile(&values, share));
        (!values.is_empty()).then(|| Self { p10, p25, p50, p75, p90, mean: mean(&values) })
    }
}

/// Something drawn, with its place in [`COLORS`].
#[derive(Debug, Clone)]
pub(crate) enum Item {
    Line {
        name: String,
        color: usize,
        points: Vec<(f64, f64)>,
        dots: bool,
    },
    /// Between a lower and an upper line.
    Band {
        name: String,
        color: usize,
        low: Vec<(f64, f64)>,
        high: Vec<(f64, f64)>,
    },
    /// At places on the horizontal axis, `width` wide.
    Boxes {
        name: String,
        color: usize,
        width: f64,
        boxes: Vec<(f64, Quantiles)>,
    },
    /// A horizontal line at a value that something is compared with.
    Threshold {
        name: String,
        at: f64,
    },
    /// Steps in which something happens.
    Span {
        name: String,
        from: f64,
        to: f64,
    },
}

/// A line with a name.
pub(crate) fn line(name: impl Into<String>, color: usize, points: Vec<(f64, f64)>) -> Item {
    Item::Line { name: name.into(), color: color % COLORS.len(), points, dots: false }
}

/// One coordinate system.
#[derive(Debug, Clone)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) items: Vec<Item>,
}

impl Panel {
    /// With a logarithmic axis for what is in it.
    pub(crate) fn log(title: impl Into<String>, x: Axis, y: &str, items: Vec<Item>) -> Self {
        let values = items.iter().flat_map(|item| match item {
            Item::Line { points, .. } => points.iter().map(|point| point.1).collect(),
            Item::Band { low, high, .. } => {
                low.iter().chain(high).map(|point| point.1).collect::<Vec<_>>()
            }
            Item::Threshold { at, .. } => vec![*at],
            Item::Boxes { .. } | Item::Span { .. } => Vec::new(),
        });
        let y = Axis::log(y, values);
        Self { title: title.into(), x, y, items }
    }
}

type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws panels in `columns`.
pub(crate) fn render(panels: &[Panel], columns: usize) -> anyhow::Result<String> {
    let rows = panels.len().div_ceil(columns);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let mut svg = String::new();
    draw_all(&mut svg, size, panels, (rows, columns))
        .map_err(|error| anyhow!("a figure cannot be drawn: {error}"))?;
    // Whoever reads a picture aloud says what its first panel is about; a picture is as wide as there is room for.
    let body = svg.find('>').map_or("", |end| &svg[end + 1..]);
    let title = panels.iter().map(|panel| panel.title.as_str()).collect::<Vec<_>>().join("; ");
    Ok(format!(
        "<svg viewBox=\"0 0 {} {}\" width=\"{}\" role=\"img\" aria-label=\"{}\" \
         xmlns=\"http://www.w3.org/2000/svg\">{body}",
        size.0,
        size.1,
        size.0,
        title.replace('&', "and").replace(['<', '>', '"'], " ")
    ))
}

fn draw_all(
    svg: &mut String,
    size: (u32, u32),
    panels: &[Panel],
    grid: (usize, usize),
) -> Result<(), Failure> {
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    for (area, panel) in root.split_evenly(grid).iter().zip(panels) {
        draw(area, panel)?;
    }
    root.present()?;
    Ok(())
}

/// A piece of a legend: its name, and how it looks.
enum Sample {
    Line(RGBColor),
    Filled(RGBAColor),
    Dashes,
}

impl Item {
    fn legend(&self) -> Option<(&str, Sample)> {
        let (name, sample) = match self {
            Self::Line { name, color, .. } => (name, Sample::Line(COLORS[*color])),
            Self::Band { name, color, .. } => (name, Sample::Filled(COLORS[*color].mix(0.2))),
            Self::Boxes { name, color, .. } => (name, Sample::Filled(COLORS[*color].mix(0.45))),
            Self::Threshold { name, .. } => (name, Sample::Dashes),
            Self::Span { name, .. } => (name, Sample::Filled(FAINT.mix(0.25))),
        };
        (!name.is_empty()).then_some((name, sample))
    }
}

fn draw(area: &Area<'_>, panel: &Panel) -> Result<(), Failure> {
    let area = area.margin(4, 6, 2, 14);
    area.draw(&Text::new(panel.title.clone(), (8, 2), ("sans-serif", 16).into_font().color(&INK)))?;
    let top = draw_legend(&area, panel)?;
    let mut chart = ChartBuilder::on(&area)
        .margin_top(top)
        .x_label_area_size(42)
        .y_label_area_size(58)
        .build_cartesian_2d(panel.x.clone(), panel.y.clone())?;
    let Panel { x, y, .. } = panel;
    // What happens at some time lies behind the grid.
    for item in &panel.items {
        if let Item::Span { from, to, .. } = item {
            let corners = [(x.clamp(*from), y.low), (x.clamp(*to), y.high)];
            chart.draw_series([Rectangle::new(corners, FAINT.mix(0.25).filled())])?;
        }
    }
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT)
        .x_labels(24)
        .y_labels(24)
        .x_label_formatter(&|value| x.label(*value))
        .y_label_formatter(&|value| y.label(*value))
        .x_desc(x.name.as_str())
        .y_desc(y.name.as_str())
        .label_style(("sans-serif", 12).into_font().color(&FAINT))
        .axis_desc_style(("sans-serif", 13).into_font().color(&INK))
        .draw()?;
    let place = |&(a, b): &(f64, f64)| (x.clamp(a), y.clamp(b));
    let drawable = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let there =
            |point: &&(f64, f64)| point.1.is_finite() && (y.scale != Scale::Log || point.1 > 0.0);
        points.iter().filter(there).map(place).collect()
    };
    for item in &panel.items {
        match item {
            Item::Line { color, points, dots, .. } => {
                let (color, points) = (COLORS[*color], drawable(points));
                if *dots {
                    let dots = points.iter().map(|&at| Circle::new(at, 3, color.filled()));
                    chart.draw_series(dots)?;
                }
                chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
            }
            Item::Band { color, low, high, .. } => {
                let mut outline = drawable(high);
                outline.extend(drawable(low).into_iter().rev());
                let band = Polygon::new(outline, COLORS[*color].mix(0.2).filled());
                chart.draw_series([band])?;
            }
            Item::Boxes { color, width, boxes, .. } => {
                let color = COLORS[*color];
                for (at, quantiles) in boxes {
                    let [p10, p25, p50, p75, p90, mean] = [
                        quantiles.p10,
                        quantiles.p25,
                        quantiles.p50,
                        quantiles.p75,
                        quantiles.p90,
                        quantiles.mean,
                    ]
                    .map(|value| y.clamp(value));
                    let (left, right) = (at - 0.5 * width, at + 0.5 * width);
                    let line = |from, to, width| {
                        PathElement::new(vec![from, to], color.stroke_width(width))
                    };
                    chart.draw_series([
                        Rectangle::new([(left, p25), (right, p75)], color.mix(0.35).filled()),
                        Rectangle::new([(left, p25), (right, p75)], color.stroke_width(1)),
                    ])?;
                    chart.draw_series([
                        line((*at, p10), (*at, p25), 1),
                        line((*at, p75), (*at, p90), 1),
                        line((left, p50), (right, p50), 3),
                    ])?;
                    chart.draw_series([Circle::new((*at, mean), 3, INK.filled())])?;
                }
            }
            Item::Threshold { at, .. } => {
                let at = y.clamp(*at);
                let ends = [(x.low, at), (x.high, at)];
                let dashes = DashedLineSeries::new(ends, 5, 4, INK.stroke_width(1));
                chart.draw_series(dashes)?;
            }
            Item::Span { .. } => {}
        }
    }
    Ok(())
}

/// The legend in lines under the title; returns where what is drawn may begin.
fn draw_legend(area: &Area<'_>, panel: &Panel) -> Result<u32, Failure> {
    let room = area.dim_in_pixel().0 as i32;
    let style = ("sans-serif", 12).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
    let (mut left, mut line) = (8, 0_u32);
    let mut any = false;
    for (name, sample) in panel.items.iter().filter_map(Item::legend) {
        let width = 30 + (CHARACTER * name.chars().count() as f64) as i32 + 12;
        if any && left + width > room {
            (left, line) = (8, line + 1);
        }
        let middle = (TITLE + line * LEGEND + LEGEND / 2) as i32;
        let (from, to) = ((left, middle), (left + 22, middle));
        match sample {
            Sample::Line(color) => {
                area.draw(&PathElement::new(vec![from, to], color.stroke_width(3)))?;
            }
            Sample::Filled(color) => {
                let corners = [(from.0, middle - 5), (to.0, middle + 5)];
                area.draw(&Rectangle::new(corners, color.filled()))?;
            }
            Sample::Dashes => {
                for start in [0, 8, 16] {
                    let ends = vec![(left + start, middle), (left + start + 5, middle)];
                    area.draw(&PathElement::new(ends, INK.stroke_width(1)))?;
                }
            }
        }
        area.draw(&Text::new(name.to_owned(), (left + 28, middle), style.clone()))?;
        left += width;
        any = true;
    }
    Ok(if any { TITLE + (line + 1) * LEGEND + 4 } else { TITLE })
}

/// A number without a tail of zeros: `250 k`, `0.05`, `20`.
fn number(value: f64) -> String {
    let of = |value: f64, unit: &str| {
        let text = if value.abs() < 0.1 { format!("{value:.3}") } else { format!("{value:.2}") };
        let text = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.')
        } else {
            &text
        };
        format!("{}{unit}", if text == "-0" { "0" } else { text })
    };
    match value {
        value if value >= 1e6 => of(value / 1e6, " M"),
        value if value >= 1e4 => of(value / 1e3, " k"),
        value => of(value, ""),
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
    fn axes_have_round_labels_and_room() {
        struct Bold;
        impl KeyPointHint for Bold {
            fn max_num_points(&self) -> usize {
                24
            }
            fn weight(&self) -> plotters::coord::ranged1d::KeyPointWeight {
                plotters::coord::ranged1d::KeyPointWeight::Bold
            }
        }
        assert_eq!(Axis::linear("", 0.0, 200.0).key_points(Bold), [0.0, 50.0, 100.0, 150.0, 200.0]);
        let log = Axis::log("", [4.0, 0.0, f64::NAN, 30.0].into_iter());
        assert!(log.low < 4.0 && log.high > 30.0);
        assert_eq!(log.key_points(Bold), [5.0, 10.0, 20.0]);
        // One value alone has a decade of room.
        let one = Axis::log("", [1.0].into_iter());
        assert!((one.high / one.low - 10.0).abs() < 1e-9);
        let names = Axis::names("", vec!["a".to_owned(), "b".to_owned()]);
        assert_eq!((names.low, names.high, names.label(1.0)), (-0.5, 1.5, "b".to_owned()));
        let texts = [250_000.0, 0.05, 20.0, -0.001, 1.5e6, 0.8].map(number);
        assert_eq!(texts, ["250 k", "0.05", "20", "-0.001", "1.5 M", "0.8"]);
    }

    #[test]
    fn everything_is_drawn_within_its_panel() {
        let quantiles = Quantiles::of(vec![1.0, 2.0, 300.0]).expect("not empty");
        let panel = Panel {
            title: "a & b".to_owned(),
            x: Axis::linear("step", 0.0, 10.0),
            y: Axis::log("error (mm)", [1.0, 100.0].into_iter()),
            items: vec![
                Item::Line {
                    name: "line".to_owned(),
                    color: 0,
                    points: vec![(0.0, 1e9), (5.0, 0.0), (10.0, f64::NAN), (12.0, 3.0)],
                    dots: true,
                },
                Item::Band {
                    name: "band".to_owned(),
                    color: 1,
                    low: vec![(0.0, 1.0), (10.0, 2.0)],
                    high: vec![(0.0, 3.0), (10.0, 4.0)],
                },
                Item::Boxes {
                    name: "boxes".to_owned(),
                    color: 2,
                    width: 0.5,
                    boxes: vec![(2.0, quantiles)],
                },
                Item::Threshold { name: "limit".to_owned(), at: 25.0 },
                Item::Span { name: "push".to_owned(), from: 4.0, to: 5.0 },
            ],
        };
        let svg = render(&[panel.clone(), panel], 2).expect("drawn");
        assert!(svg.starts_with("<svg viewBox=\"0 0 880 320\"") && svg.ends_with("</svg>\n"));
        for word in ["line", "band", "boxes", "limit", "push", "error (mm)", "step"] {
            assert!(svg.contains(word), "{word}");
        }
        let words = svg.split(['"', ' ', ',', '\n']);
        let numbers = words.filter_map(|word| word.parse::<f64>().ok());
        assert!(numbers.into_iter().all(|x| (-20.0..=900.0).contains(&x)), "{svg}");
    }
}
