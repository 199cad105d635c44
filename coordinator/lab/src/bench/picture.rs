//! The curves of growth as pictures.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use drawing::{Axis, Item, Layout, Panel, render};
use proto::ExitError;
use proto::config::Config;
use store::files;
use store::outputs::{Output, check_outside};

use super::growth::{Curve, NAMES, Series};

/// Size of a picture (px).
const SIZE: (u32, u32) = (640, 400);

/// Writes one file a curve into `dir`, which is made if it is not there.
pub(super) fn draw_all(dir: &Path, curves: &[Curve]) -> anyhow::Result<()> {
    std::fs::create_dir_all(dir)
        .with_context(|| format!("{}: cannot be created", dir.display()))?;
    let layout = Layout::columns(1).panel(SIZE.0, SIZE.1).alone();
    for curve in curves {
        let svg = render(&[panel(curve)], &layout)
            .with_context(|| format!("the curve {}", curve.name))?;
        files::replace_output(&path(dir, curve.name), svg.as_bytes())?;
    }
    Ok(())
}

/// Refuses a place where something else than such a picture is, or what `config` names.
pub(super) fn check_all(dir: &Path, force: bool, config: &Config) -> Result<(), ExitError> {
    // One that is still to be made holds nothing.
    if !dir.exists() {
        return if force { Ok(()) } else { check_outside("--pictures", dir) };
    }
    for name in NAMES {
        let path = path(dir, name);
        let read = ("--set robot.description", Path::new(&config.robot.description));
        Output { flag: "--pictures", path: &path, mark: b"<svg", force }.check(&[read])?;
    }
    Ok(())
}

/// Where the picture of a curve goes.
fn path(dir: &Path, name: &str) -> PathBuf {
    dir.join(format!("{name}.svg"))
}

/// A curve with its axes: logarithmic ones are labelled at powers of two, linear ones begin at 0.
fn panel(curve: &Curve) -> Panel {
    let axis = |name: &str, logarithmic: bool, read: fn(&(f64, f64)) -> f64| {
        let values = curve.series.iter().flat_map(|series| series.points.iter().map(read));
        if logarithmic { Axis::powers_of_two(name, values) } else { Axis::from_zero(name, values) }
    };
    let alone = curve.series.len() == 1;
    let items =
        curve.series.iter().enumerate().map(|(color, Series { name, points })| Item::Line {
            name: if alone { String::new() } else { words(name) },
            color,
            points: points.clone(),
            dots: true,
        });
    Panel {
        title: format!("Growth: {}", words(curve.name)),
        x: axis(curve.over, curve.logarithmic[0], |point| point.0),
        y: axis(curve.unit, curve.logarithmic[1], |point| point.1),
        items: items.collect(),
        links: Vec::new(),
    }
}

/// A key as a person writes it.
fn words(key: &str) -> String {
    key.replace('_', " ")
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
