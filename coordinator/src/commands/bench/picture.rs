//! The curves of growth as pictures.

use std::path::Path;

use anyhow::{Context as _, anyhow};
use plotters::prelude::*;

use super::figures::number;
use super::growth::{Curve, Series};
use crate::files;

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
        files::replace_output(&dir.join(format!("{}.svg", curve.name)), svg.as_bytes())?;
    }
    Ok(())
}

/// Abscissas are spaced by their logarithm, and labelled at the powers of two.
fn render(svg: &mut String, curve: &Curve) -> Result<(), Box<dyn std::error::Error>> {
    let points = || curve.series.iter().flat_map(|series| &series.points);
    let (mut low, mut high, mut top) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
    for (x, y) in points() {
        (low, high, top) = (low.min(x.log2()), high.max(x.log2()), top.max(*y));
    }
    if low >= high || top <= 0.0 {
        return Ok(());
    }
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(low..high, 0.0..1.08 * top)?;
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT)
        .x_labels((high - low).round() as usize + 1)
        .y_labels(6)
        .x_label_formatter(&|x| number_of(x.exp2()))
        .y_label_formatter(&|y| number_of(*y))
        .x_desc(curve.over)
        .y_desc(curve.unit)
        .label_style(("sans-serif", 13).into_font().color(&FAINT))
        .axis_desc_style(("sans-serif", 14).into_font().color(&INK))
        .draw()?;
    for (Series { name, points }, color) in curve.series.iter().zip(COLORS) {
        let place = || points.iter().map(|(x, y)| (x.log2(), *y));
        let style = color.stroke_width(2);
        chart
            .draw_series(LineSeries::new(place(), style))?
            .label(name.replace('_', " "))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
        chart.draw_series(place().map(|at| Circle::new(at, 3, color.filled())))?;
    }
    if curve.series.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.85))
            .label_font(("sans-serif", 13).into_font().color(&INK))
            .draw()?;
    }
    root.present()?;
    drop(chart);
    Ok(())
}

/// A round number for an axis.
fn number_of(value: f64) -> String {
    match value {
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
        let curve = Curve { name: "by_x", over: "arms", unit: "env-steps/s", series: vec![series] };
        let dir = tempfile::tempdir().expect("a directory");
        draw_all(dir.path(), &[curve]).expect("drawn");
        let text = std::fs::read_to_string(dir.path().join("by_x.svg")).expect("written");
        for part in ["<svg", "arms", "env-steps/s", "<polyline"] {
            assert!(text.contains(part), "{part}");
        }
    }
}
