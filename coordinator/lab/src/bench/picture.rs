//! The curves of growth as pictures.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use plotters::prelude::*;
use store::files;

use super::figures::number;
use super::growth::{Curve, Series};

const SIZE: (u32, u32) = (640, 400);
const INK: RGBColor = RGBColor(38, 50, 56);
const FAINT: RGBColor = RGBColor(96, 112, 120);
const GRID: RGBColor = RGBColor(226, 231, 234);
const COLORS: [RGBColor; 2] = [RGBColor(31, 99, 168), RGBColor(214, 104, 24)];

/// Writes one file a curve into `dir`, which is made if it is not there.
pub(super) fn draw_all(dir: &Path, curves: &[Curve]) -> anyhow::Result<()> {
    std::fs::create_dir_all(dir)
        .with_context(|| format!("{}: cannot be created", dir.display()))?;
    for curve in curves {
        let mut svg = String::new();
        render(&mut svg, curve)
            .map_err(|error| anyhow!("the curve {} cannot be drawn: {error}", curve.name))?;
        files::replace_output(&path(dir, curve.name), svg.as_bytes())?;
    }
    Ok(())
}

/// Where the picture of a curve goes.
pub(super) fn path(dir: &Path, name: &str) -> PathBuf {
    dir.join(format!("{name}.svg"))
}

/// Logarithmic axes are labelled at powers of two; linear ones begin at 0.
fn render(svg: &mut String, curve: &Curve) -> Result<(), Box<dyn std::error::Error>> {
    let scales = curve.logarithmic.map(|logarithmic| if logarithmic { LOG } else { LINEAR });
    let place = |&(x, y): &(f64, f64)| ((scales[0].forth)(x), (scales[1].forth)(y));
    let places: Vec<_> = curve.series.iter().flat_map(|series| &series.points).map(place).collect();
    let range = |scale: &Scale, values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        let low = if scale.from_zero { 0.0 } else { low };
        (low, low + 1.06 * (high - low))
    };
    let (left, right) = range(&scales[0], &mut places.iter().map(|place| place.0));
    let (bottom, top) = range(&scales[1], &mut places.iter().map(|place| place.1));
    if !(left < right && bottom < top) {
        return Ok(());
    }
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(left..right, bottom..top)?;
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT)
        .x_labels(scales[0].labels(left, right))
        .y_labels(scales[1].labels(bottom, top))
        .x_label_formatter(&|x| number_of((scales[0].back)(*x)))
        .y_label_formatter(&|y| number_of((scales[1].back)(*y)))
        .x_desc(curve.over)
        .y_desc(curve.unit)
        .label_style(("sans-serif", 13).into_font().color(&FAINT))
        .axis_desc_style(("sans-serif", 14).into_font().color(&INK))
        .draw()?;
    for (Series { name, points }, color) in curve.series.iter().zip(COLORS) {
        let style = color.stroke_width(2);
        chart
            .draw_series(LineSeries::new(points.iter().map(place), style))?
            .label(name.replace('_', " "))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
        chart.draw_series(points.iter().map(|at| Circle::new(place(at), 3, color.filled())))?;
    }
    if curve.series.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.85))
            .label_font(("sans-serif", 13).into_font().color(&INK))
            .draw()?;
    }
    root.present()?;
    drop(chart);
    Ok(())
}

/// How an axis is spaced: from values to places on it and back, and whether it begins at 0.
struct Scale {
    forth: fn(f64) -> f64,
    back: fn(f64) -> f64,
    from_zero: bool,
}

impl Scale {
    /// How many labels there is room for, but no more than powers of two.
    fn labels(&self, low: f64, high: f64) -> usize {
        if self.from_zero { 9 } else { ((high - low) as usize + 1).min(9) }
    }
}

const LINEAR: Scale = Scale { forth: |value| value, back: |place| place, from_zero: true };
const LOG: Scale = Scale { forth: f64::log2, back: f64::exp2, from_zero: false };

/// A round number for an axis.
fn number_of(value: f64) -> String {
    match value {
        value if value >= 1e9 => format!("{} G", number(value / 1e9)),
        value if value >= 1e6 => format!("{} M", number(value / 1e6)),
        value if (value - value.round()).abs() < 1e-6 => {
            number(value).replace(".00", "").replace(".0", "")
        }
        value => number(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_becomes_a_picture_with_its_axes() {
        let series =
            Series { name: "rate", points: vec![(16.0, 10.0), (64.0, 15.0), (256.0, 14.0)] };
        let (over, unit) = ("arms", "env-steps/s");
        for logarithmic in [[true, false], [false, false], [true, true]] {
            let series = vec![series.clone()];
            let curve = Curve { name: "by_x", over, unit, logarithmic, series };
            let dir = tempfile::tempdir().expect("a directory");
            draw_all(dir.path(), &[curve]).expect("drawn");
            let text = std::fs::read_to_string(dir.path().join("by_x.svg")).expect("written");
            let label = if logarithmic[0] { "\n256\n" } else { "\n100\n" };
            for part in ["<svg", over, unit, "<polyline", label] {
                assert!(text.contains(part), "{part}");
            }
        }
    }
}
