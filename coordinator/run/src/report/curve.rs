//! `curve.svg`: the learning curve as a picture.
//!
//! Two panels over env-steps: the return, with the band that the agents span, and the errors after
//! an episode's last step on a logarithmic scale. Both are measured on the training episodes,
//! exploration noise included, so an evaluation ends lower.

use std::ops::Range;
use std::path::Path;

use anyhow::anyhow;
use plotters::chart::ChartContext;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use proto::config::TaskName;
use serde_json::Value;
use store::files;
use store::jsonl;

use super::row::Row;

const SIZE: (u32, u32) = (960, 720);
const X_LABELS: u32 = 44;
const Y_LABELS: u32 = 68;
const INK: RGBColor = RGBColor(38, 50, 56);
const FAINT: RGBColor = RGBColor(96, 112, 120);
const GRID: RGBColor = RGBColor(226, 231, 234);
const BLUE: RGBColor = RGBColor(31, 99, 168);
const ORANGE: RGBColor = RGBColor(214, 104, 24);
const TEAL: RGBColor = RGBColor(0, 128, 118);

/// More points than a picture has columns only make the file large; so many are averaged.
const MAX_POINTS: usize = 600;

/// One iteration on the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Env-steps trained on.
    pub env_steps: f64,
    /// Time since the run began (s).
    pub wall_s: f64,
    /// Mean return over agents.
    pub mean: f64,
    /// Smallest mean return of an agent.
    pub low: f64,
    /// Largest mean return of an agent.
    pub high: f64,
    /// Position error of hands (m).
    pub position: f64,
    /// Orientation error of hands (rad).
    pub orientation: f64,
    /// Attitude error of the base (rad).
    pub base: f64,
}

impl Row for Point {
    const NAMES: [&'static str; 8] = [
        "env_steps",
        "wall_s",
        "return_mean",
        "return_low",
        "return_high",
        "position",
        "orientation",
        "base",
    ];

    fn numbers(&self) -> [f64; 8] {
        let Self { env_steps, wall_s, mean, low, high, position, orientation, base } = *self;
        [env_steps, wall_s, mean, low, high, position, orientation, base]
    }

    fn from_numbers(numbers: [f64; 8]) -> Self {
        let [env_steps, wall_s, mean, low, high, position, orientation, base] = numbers;
        Self { env_steps, wall_s, mean, low, high, position, orientation, base }
    }
}

/// Reads the points of a `metrics.jsonl`; lines with a number that is not finite are left out.
pub fn read_points(path: &Path) -> anyhow::Result<Vec<Point>> {
    let point = |line: &Value| {
        let returns: Option<Vec<f64>> =
            line["returns"].as_array()?.iter().map(Value::as_f64).collect();
        let returns = returns?;
        Some(Point {
            env_steps: line["env_steps"].as_f64()?,
            wall_s: line["wall_s"].as_f64()?,
            mean: line["return_mean"].as_f64()?,
            low: returns.iter().copied().fold(f64::INFINITY, f64::min),
            high: returns.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            position: line["errors"]["position"].as_f64()?,
            orientation: line["errors"]["orientation"].as_f64()?,
            base: line["errors"]["base"].as_f64()?,
        })
    };
    Ok(jsonl::read(path)?.iter().filter_map(|(_, line)| point(line)).collect())
}

/// Draws `points` into the file `path`.
pub fn draw(path: &Path, points: &[Point], task: TaskName) -> anyhow::Result<()> {
    let mut svg = String::new();
    let points = thin_out(points, MAX_POINTS);
    render(&mut svg, &points, task)
        .map_err(|error| anyhow!("the learning curve cannot be drawn: {error}"))?;
    files::replace(path, svg.as_bytes())?;
    Ok(())
}

type Failure = Box<dyn std::error::Error>;

fn render(svg: &mut String, points: &[Point], task: TaskName) -> Result<(), Failure> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let steps = points.last().map_or(1.0, |point| point.env_steps);
    let title = match task {
        TaskName::Trajectory => "Learning curve: trajectory",
        TaskName::Reorientation => "Learning curve: reorientation",
    };
    root.draw(&Text::new(title, (76, 24), ("sans-serif", 24).into_font().color(&INK)))?;
    let subtitle = format!(
        "{} env-steps, {} iterations shown, exploration noise included",
        count(steps),
        points.len()
    );
    root.draw(&Text::new(subtitle, (76, 54), ("sans-serif", 14).into_font().color(&FAINT)))?;
    let panels = root.margin(80, 10, 8, 28).split_evenly((2, 1));
    draw_returns(&panels[0], points, steps)?;
    draw_errors(&panels[1], points, steps, task)?;
    root.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Chart<'a, 'b, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, Y>>;

fn draw_returns(area: &Area<'_>, points: &[Point], steps: f64) -> Result<(), Failure> {
    let low = points.iter().map(|point| point.low).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|point| point.high).fold(f64::NEG_INFINITY, f64::max);
    let margin = (0.06 * (high - low)).max(1e-3);
    let mut chart = ChartBuilder::on(area)
        .x_label_area_size(X_LABELS)
        .y_label_area_size(Y_LABELS)
        .build_cartesian_2d(0.0..steps, low - margin..high + margin)?;
    mesh(&mut chart, "", "return of an episode")?;
    let outline = points.iter().map(|point| (point.env_steps, point.high));
    let back = points.iter().rev().map(|point| (point.env_steps, point.low));
    let band = Polygon::new(outline.chain(back).collect::<Vec<_>>(), BLUE.mix(0.14).filled());
    chart
        .draw_series(std::iter::once(band))?
        .label("span of the agents")
        .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 20, y + 5)], BLUE.mix(0.14).filled()));
    let means = points.iter().map(|point| (point.env_steps, point.mean)).collect();
    curve(&mut chart, means, BLUE, "mean of the agents")?;
    legend(&mut chart, SeriesLabelPosition::LowerRight)
}

fn draw_errors(
    area: &Area<'_>,
    points: &[Point],
    steps: f64,
    task: TaskName,
) -> Result<(), Failure> {
    type Reading = fn(&Point) -> f64;
    let (description, readings): (&str, Vec<(Reading, RGBColor, &str)>) = match task {
        TaskName::Trajectory => (
            "error of the hands (mm, mrad)",
            vec![
                (|point| 1e3 * point.position, ORANGE, "position (mm)"),
                (|point| 1e3 * point.orientation, TEAL, "orientation (mrad)"),
            ],
        ),
        TaskName::Reorientation => {
            ("error of the base (mrad)", vec![(|point| 1e3 * point.base, TEAL, "attitude (mrad)")])
        }
    };
    // A logarithmic axis has no place for zero.
    let series = |read: Reading| -> Vec<(f64, f64)> {
        let all = points.iter().map(|point| (point.env_steps, read(point)));
        all.filter(|(_, value)| *value > 0.0).collect()
    };
    let values = || readings.iter().flat_map(|(read, ..)| series(*read)).map(|(_, value)| value);
    let axis = LogAxis {
        low: 0.85 * values().fold(f64::INFINITY, f64::min),
        high: 1.3 * values().fold(f64::NEG_INFINITY, f64::max),
    };
    if axis.low >= axis.high {
        return Ok(());
    }
    let mut chart = ChartBuilder::on(area)
        .x_label_area_size(X_LABELS)
        .y_label_area_size(Y_LABELS)
        .build_cartesian_2d(0.0..steps, axis)?;
    mesh(&mut chart, "env-steps", description)?;
    for (read, color, name) in readings {
        curve(&mut chart, series(read), color, name)?;
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

/// The axes, a light grid and their labels.
fn mesh<Y>(
    chart: &mut Chart<'_, '_, Y>,
    x_description: &str,
    y_description: &str,
) -> Result<(), Failure>
where
    Y: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT)
        .x_labels(9)
        .y_labels(7)
        .x_label_formatter(&|value| count(*value))
        .y_label_formatter(&|value| number(*value))
        .x_desc(x_description)
        .y_desc(y_description)
        .label_style(("sans-serif", 14).into_font().color(&FAINT))
        .axis_desc_style(("sans-serif", 15).into_font().color(&INK))
        .draw()?;
    Ok(())
}

fn curve<Y: Ranged<ValueType = f64>>(
    chart: &mut Chart<'_, '_, Y>,
    points: Vec<(f64, f64)>,
    color: RGBColor,
    name: &str,
) -> Result<(), Failure> {
    let style = color.stroke_width(2);
    chart
        .draw_series(LineSeries::new(points, style))?
        .label(name)
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
    Ok(())
}

fn legend<'a, Y: Ranged<ValueType = f64>>(
    chart: &mut Chart<'a, 'a, Y>,
    position: SeriesLabelPosition,
) -> Result<(), Failure> {
    chart
        .configure_series_labels()
        .position(position)
        .margin(12)
        .background_style(WHITE.mix(0.85))
        .label_font(("sans-serif", 14).into_font().color(&INK))
        .draw()?;
    Ok(())
}

/// A logarithmic axis with lines at 1, 2 and 5 of every decade.
#[derive(Debug, Clone, Copy)]
struct LogAxis {
    low: f64,
    high: f64,
}

impl Ranged for LogAxis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value / self.low).ln() / (self.high / self.low).ln();
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() {
            return Vec::new();
        }
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let within = |value: &f64| (self.low..=self.high).contains(value);
        decades
            .flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(decade)))
            .filter(within)
            .collect()
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

/// Means of neighbours, so that at most `most` remain.
pub fn thin_out(points: &[Point], most: usize) -> Vec<Point> {
    let group = points.len().div_ceil(most).max(1);
    let mean = |group: &[Point]| {
        let mut sums = [0.0; Point::NAMES.len()];
        for point in group {
            for (sum, number) in sums.iter_mut().zip(point.numbers()) {
                *sum += number;
            }
        }
        Point::from_numbers(sums.map(|sum| sum / group.len() as f64))
    };
    points.chunks(group).map(mean).collect()
}

/// A number of env-steps: `250 k`, `1.5 M`.
fn count(value: f64) -> String {
    match value {
        value if value >= 1e6 => format!("{} M", number(value / 1e6)),
        value if value >= 1e3 => format!("{} k", number(value / 1e3)),
        value => number(value),
    }
}

/// A number without a tail of zeros.
fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
