//! `curve.svg`: the learning curve as a picture.
//!
//! Two panels over env-steps: the return, with the band that the agents span, and the errors after
//! an episode's last step on a logarithmic scale. Both are measured on the training episodes,
//! exploration noise included, so an evaluation ends lower.

use std::path::Path;

use drawing::{Axis, Item, Layout, Panel, line, render};
use output::{counted, grouped};
use proto::config::TaskName;
use store::files;

use super::points::{Point, thin_out};

/// Size of a panel (px).
const PANEL: (u32, u32) = (960, 340);
/// More points than a picture has columns only make the file large; so many are averaged.
const MAX_POINTS: usize = 600;

/// Draws `points` into the file `path`.
pub fn draw(path: &Path, points: &[Point], task: TaskName) -> anyhow::Result<()> {
    let steps = points.last().map_or(1.0, |point| point.env_steps);
    let iterations = counted(points.len() as u64, "iteration");
    let points = thin_out(points, MAX_POINTS);
    let x = Axis::linear("env-steps", 0.0, steps);
    let below =
        format!("{} env-steps, {iterations}, exploration noise included", grouped(steps as u64));
    let layout = Layout::columns(1)
        .panel(PANEL.0, PANEL.1)
        .heading(format!("Learning curve: {}", task.as_str()), below)
        .alone();
    let panels = [returns(&points, x.clone()), errors(&points, x, task)];
    files::replace(path, render(&panels, &layout)?.as_bytes())?;
    Ok(())
}

/// A number of each iteration over its env-steps.
fn series(points: &[Point], read: impl Fn(&Point) -> f64) -> Vec<(f64, f64)> {
    points.iter().map(|point| (point.env_steps, read(point))).collect()
}

fn returns(points: &[Point], x: Axis) -> Panel {
    let band = Item::Band {
        name: "span of the agents".to_owned(),
        color: 0,
        low: series(points, |point| point.low),
        high: series(points, |point| point.high),
    };
    let mean = line("mean of the agents", 0, series(points, |point| point.mean));
    Panel::linear("Return of an episode", x, "return", vec![band, mean])
}

fn errors(points: &[Point], x: Axis, task: TaskName) -> Panel {
    let milli = |read: fn(&Point) -> f64| series(points, |point| 1e3 * read(point));
    let (mut items, mut color) = (Vec::new(), 2);
    if task.reaches() {
        items.push(line("position (mm)", 1, milli(|point| point.position)));
        items.push(line("orientation (mrad)", color, milli(|point| point.orientation)));
        color += 1;
    }
    if task.turns() {
        items.push(line("attitude (mrad)", color, milli(|point| point.base)));
    }
    let title = match (task.reaches(), task.turns()) {
        (true, true) => "Errors of hands and base after the last step",
        (true, false) => "Errors of the hands after the last step",
        (false, _) => "Error of the base after the last step",
    };
    let y = if task.reaches() { "error (mm, mrad)" } else { "error (mrad)" };
    Panel::log(title, x, y, items)
}
