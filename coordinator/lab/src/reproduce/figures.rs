//! The paper's figures from our numbers.

use drawing::{Axis, Item, Layout, Panel, Place, Quantiles, line, render};
use proto::config::TaskName;

use super::claims::{MASS_SHARE, MASS_THRESHOLD};
use super::episodes::Links;
use super::reports::Reports;
use crate::experiments::base_mass::in_mrad;
use crate::experiments::disturbance::{Disturbance, Disturbed};
use crate::experiments::noise::{Point, Quantity};
use crate::experiments::report::{ErrorOfMany, Figure, Goals};
use crate::statistics::ErrorOf;

const STEP: &str = "control step";

/// An error's axis label.
fn label(error: ErrorOf) -> &'static str {
    match error {
        ErrorOf::Position => "position error (mm)",
        ErrorOf::Orientation => "orientation error (mrad)",
        ErrorOf::Base => "attitude error (mrad)",
    }
}

/// Numbers over steps, which are counted from 1, in thousandths.
fn over_steps(values: impl IntoIterator<Item = f32>) -> Vec<(f64, f64)> {
    let values = values.into_iter().enumerate();
    values.map(|(step, value)| ((step + 1) as f64, 1e3 * f64::from(value))).collect()
}

fn threshold(name: &str, at: f64) -> Item {
    Item::Threshold { name: name.to_owned(), at }
}

fn norm([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

/// A panel over the steps of an episode with a logarithmic axis for what is in it.
fn course(title: impl Into<String>, name: &str, steps: usize, items: Vec<Item>) -> Panel {
    Panel::log(title, Axis::linear(STEP, 0.0, steps as f64), name, items)
}

/// The panel, of which every place leads to one trial.
fn over_all(panel: Panel, trial: &str, links: &Links) -> Panel {
    let all = Place::Between(panel.x.low, panel.x.high);
    Panel { links: links.at(trial, all).into_iter().collect(), ..panel }
}

/// The panel, of which every line leads to a trial of its own; they were drawn in this order.
fn along_lines(panel: Panel, trials: &[String], links: &Links) -> Panel {
    let lines = panel.items.iter().filter_map(|item| match item {
        Item::Line { points, .. } => Some(points.clone()),
        _ => None,
    });
    let along = lines.zip(trials);
    let along = along.filter_map(|(points, trial)| links.at(trial, Place::Along(points))).collect();
    Panel { links: along, ..panel }
}

/// Boxes of every agent's error: by the paper's measure and by ours.
pub(super) fn precision(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let mut panels = Vec::new();
    for result in &reports.precision.results {
        let episodes = &result.summary.episodes;
        let task = result.summary.task;
        let n_hands = episodes.first().map_or(0, |episode| episode.hands.len());
        let n_arms = if task.reaches() { n_hands } else { 0 };
        for error in ErrorOf::of(task) {
            let claim = 1e3 * error.papers();
            let course = |episode: usize, arm: usize| match error {
                ErrorOf::Position => episodes[episode].hands[arm].position,
                ErrorOf::Orientation => episodes[episode].hands[arm].orientation,
                ErrorOf::Base => episodes[episode].base,
            };
            let boxes = |tail: bool, shift: f64| -> Vec<(f64, Quantiles)> {
                let of_arm = |arm: usize| {
                    let courses = (0..episodes.len()).map(|episode| course(episode, arm));
                    let values = courses.map(|course| if tail { course.tail } else { course.min });
                    let values = values.map(|value| 1e3 * f64::from(value)).collect();
                    Some((arm as f64 + shift, Quantiles::of(values)?))
                };
                (0..n_arms.max(1)).filter_map(of_arm).collect()
            };
            let (min, tail) = (boxes(false, -0.19), boxes(true, 0.19));
            let (title, x) = match error {
                ErrorOf::Position => ("Shoulders: position of the hands", "agent"),
                ErrorOf::Orientation => ("Wrists: orientation of the hands", "agent"),
                ErrorOf::Base => ("All agents: attitude of the base", ""),
            };
            let names = match error {
                ErrorOf::Base => vec!["base".to_owned()],
                ErrorOf::Position => (0..n_arms).map(|arm| (2 * arm).to_string()).collect(),
                ErrorOf::Orientation => (0..n_arms).map(|arm| (2 * arm + 1).to_string()).collect(),
            };
            let width = 0.34;
            let items = vec![
                Item::Boxes { name: "minimum".to_owned(), color: 0, width, boxes: min },
                Item::Boxes { name: "last 20 steps".to_owned(), color: 1, width, boxes: tail },
                threshold("the paper's claim", claim),
            ];
            let boxes = (0..names.len()).map(|index| index as f64);
            let at = |index| Place::Between(index - 0.5, index + 0.5);
            let watch = boxes.filter_map(|index| links.at(&result.trial(), at(index))).collect();
            let panel = Panel::log(title, Axis::names(x, names), label(error), items);
            panels.push(Panel { links: watch, ..panel });
        }
    }
    render(&panels, &Layout::rows_of_three(&panels))
}

/// Median errors over time.
pub(super) fn courses(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let mut panels = Vec::new();
    let steps = reports.precision.protocol.steps;
    for result in &reports.precision.results {
        for error in ErrorOf::of(result.summary.task) {
            let title = match error {
                ErrorOf::Position => "Position of the hands",
                ErrorOf::Orientation => "Orientation of the hands",
                ErrorOf::Base => "Attitude of the base",
            };
            let errors: Vec<&ErrorOfMany> =
                result.errors.iter().filter(|other| other.error == error).collect();
            let items = errors.iter().enumerate().flat_map(|(index, error)| {
                let (median, p90) = match error.arm {
                    Some(arm) => (format!("arm {arm}"), String::new()),
                    None => ("median".to_owned(), "90 % of the episodes below".to_owned()),
                };
                let tenth = (errors.len() == 1)
                    .then(|| line(p90, 1, over_steps(error.course.p90.iter().copied())));
                let middle = over_steps(error.course.p50.iter().copied());
                [Some(line(median, index, middle)), tenth].into_iter().flatten()
            });
            let panel = course(title, label(error), steps, items.collect());
            panels.push(over_all(panel, &result.trial(), links));
        }
    }
    render(&panels, &Layout::rows_of_three(&panels))
}

/// The disturbed steps, marked.
fn disturbed(result: &Disturbed) -> Item {
    // What step k leads to stands at k + 1.
    let [from, to] = result.steps.map(|step| step as f64);
    Item::Span { name: "disturbed".to_owned(), from, to }
}

/// One episode with the authors' goals and overwritten actions, each axis; none on a robot of other arms than theirs.
pub(super) fn disturbed_axes(reports: &Reports, links: &Links) -> anyhow::Result<Option<String>> {
    let report = &reports.disturbance;
    let mut panels = Vec::new();
    for result in report.results.iter().filter(|r| r.disturbance == Disturbance::Override) {
        let Some(figure) = &result.figure else { continue };
        for error in &result.errors {
            let axes: &[[f32; 3]] = match (error.error, figure.hands.first()) {
                (ErrorOf::Position, Some(hand)) => &hand.position_m,
                (ErrorOf::Orientation, Some(hand)) => &hand.orientation_rad,
                _ => &figure.base_rad,
            };
            let (title, names) = match error.error {
                ErrorOf::Position => (format!("Hand {}, position", arm(figure)), ["x", "y", "z"]),
                ErrorOf::Orientation => {
                    (format!("Hand {}, orientation", arm(figure)), ["about x", "y", "z"])
                }
                ErrorOf::Base => ("Base, attitude".to_owned(), ["about x", "y", "z"]),
            };
            let bound = 1e3 * f64::from(error.threshold);
            let from = result.steps[0];
            let after = axes.iter().skip(from.saturating_sub(10)).flatten();
            let peak = after.fold(0.0_f32, |peak, value| peak.max(value.abs()));
            // From home to the goal is far; what the disturbance does is what shall be seen.
            let reach = (1.15e3 * f64::from(peak)).max(2.0 * bound);
            let mut items = vec![disturbed(result)];
            items.extend(names.iter().enumerate().map(|(axis, name)| {
                line(*name, axis, over_steps(axes.iter().map(|error| error[axis])))
            }));
            items.push(threshold("claim", bound));
            items.push(threshold("", -bound));
            let panel = Panel {
                title: format!("{title}: {}", result.what),
                x: Axis::linear(STEP, 0.0, report.protocol.steps as f64),
                y: Axis::linear(label(error.error), -reach, reach),
                items,
                links: Vec::new(),
            };
            panels.push(over_all(panel, &result.trial(Goals::Theirs), links));
        }
    }
    if panels.is_empty() {
        return Ok(None);
    }
    render(&panels, &Layout::rows_of_three(&panels)).map(Some)
}

fn arm(figure: &Figure) -> usize {
    figure.hands.first().map_or(0, |hand| hand.arm)
}

/// Medians of the worst axis over held-out goals, every disturbance.
pub(super) fn disturbed_courses(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let report = &reports.disturbance;
    let mut panels = Vec::new();
    for task in [TaskName::Trajectory, TaskName::Reorientation] {
        let results: Vec<&Disturbed> =
            report.results.iter().filter(|result| result.task == task).collect();
        let Some(first) = results.first() else { continue };
        for (index, error) in first.errors.iter().enumerate() {
            let mut items = Vec::new();
            items.extend(results.last().map(|result| disturbed(result)));
            items.extend(results.iter().enumerate().map(|(color, result)| {
                let median = result.errors[index].course.p50.iter().copied();
                line(result.disturbance.to_string(), color, over_steps(median))
            }));
            items.push(threshold("claim", 1e3 * f64::from(error.threshold)));
            let title = match error.error {
                ErrorOf::Base => "Reorientation, worst axis".to_owned(),
                of => format!("Trajectory, {of}, worst axis"),
            };
            let panel = course(title, label(error.error), report.protocol.steps, items);
            let trials: Vec<String> =
                results.iter().map(|result| result.trial(Goals::HeldOut)).collect();
            panels.push(along_lines(panel, &trials, links));
        }
    }
    render(&panels, &Layout::rows_of_three(&panels))
}

/// Courses of turning the base with a failed arm: the authors' goal, and medians.
pub(super) fn arm_failure(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let report = &reports.arm_failure;
    let panel = |title: &str, goals: Goals, points: &dyn Fn(usize) -> Vec<(f64, f64)>| {
        let results = report.results.iter().enumerate();
        let mut items: Vec<Item> =
            results.map(|(index, result)| line(result.name(), index, points(index))).collect();
        items.push(threshold("claim", 30.0));
        let panel = course(title, label(ErrorOf::Base), report.protocol.steps, items);
        let trials: Vec<String> = report.results.iter().map(|result| result.trial(goals)).collect();
        along_lines(panel, &trials, links)
    };
    let theirs = |index: usize| {
        let figure: &Figure = &report.results[index].figure;
        over_steps(figure.base_rad.iter().map(|error| norm(*error)))
    };
    let median = |index: usize| over_steps(report.results[index].error.course.p50.iter().copied());
    let tenth = |index: usize| over_steps(report.results[index].error.course.p90.iter().copied());
    let panels = [
        panel("The authors' goal", Goals::Theirs, &theirs),
        panel("Held-out goals, median", Goals::HeldOut, &median),
        panel("Held-out goals, 90 % below", Goals::HeldOut, &tenth),
    ];
    render(&panels, &Layout::columns(3))
}

/// Success against mass, and the error.
pub(super) fn base_mass(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let report = &reports.base_mass;
    let masses = report.results.iter().map(|result| result.mass);
    let heaviest = masses.clone().fold(0.0, f64::max);
    let x = Axis::linear("mass of the cube (kg)", 0.0, 1.04 * heaviest);
    let dotted = |name: String, color: usize, points: Vec<(f64, f64)>| Item::Line {
        name,
        color,
        points,
        dots: true,
    };
    let thresholds = report.protocol.settings.thresholds_rad.iter().enumerate();
    let mut success: Vec<Item> = thresholds
        .map(|(index, threshold)| {
            let points = report.results.iter().map(|r| (r.mass, 100.0 * r.success[index]));
            dotted(format!("{} mrad", in_mrad(*threshold)), index, points.collect())
        })
        .collect();
    success.push(threshold("claim", 100.0 * MASS_SHARE));
    let of = |read: fn(&ErrorOfMany) -> f64| -> Vec<(f64, f64)> {
        report.results.iter().map(|result| (result.mass, 1e3 * read(&result.error))).collect()
    };
    let errors = vec![
        dotted("mean".to_owned(), 0, of(|error| error.tail.mean)),
        dotted("median".to_owned(), 1, of(|error| error.tail.p50)),
        dotted("90 % below".to_owned(), 2, of(|error| error.tail.p90)),
        threshold("50 mrad", 1e3 * MASS_THRESHOLD),
    ];
    let course = course("Error in the last 20 steps", label(ErrorOf::Base), 1, errors);
    // A strip around each mass.
    let mut edges: Vec<f64> = vec![x.low];
    edges.extend(report.results.windows(2).map(|pair| 0.5 * (pair[0].mass + pair[1].mass)));
    edges.push(x.high);
    let strips = report.results.iter().zip(edges.windows(2));
    let watch: Vec<_> = strips
        .filter_map(|(result, edge)| links.at(&result.trial(), Place::Between(edge[0], edge[1])))
        .collect();
    let panels = [
        Panel {
            title: "Success by threshold".to_owned(),
            x: x.clone(),
            y: Axis::linear("episodes that end within (%)", 0.0, 104.0),
            items: success,
            links: watch.clone(),
        },
        Panel { x, links: watch, ..course },
    ];
    render(&panels, &Layout::columns(2))
}

/// Courses of both stages with the authors' goals.
pub(super) fn reassembly(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let report = &reports.reassembly;
    let mut panels = Vec::new();
    for stage in report.results.iter().filter(|stage| stage.goals == Goals::Theirs) {
        let second = stage.reaching.iter().filter(|(_, from)| *from > 0).map(|(arm, from)| {
            let from = *from as f64;
            Item::Span { name: format!("arm {arm} joins"), from, to: from + 1.0 }
        });
        let second: Vec<Item> = second.collect();
        for (error, claim) in
            [(ErrorOf::Position, 40.0), (ErrorOf::Orientation, 45.0), (ErrorOf::Base, 35.0)]
        {
            let mut items = second.clone();
            let hands = stage.figure.hands.iter();
            let lines: Vec<(String, Vec<(f64, f64)>)> = match error {
                ErrorOf::Position => hands
                    .map(|hand| {
                        let errors = hand.position_m.iter().map(|error| norm(*error));
                        (format!("arm {}", hand.arm), over_steps(errors))
                    })
                    .collect(),
                ErrorOf::Orientation => hands
                    .map(|hand| {
                        let errors = hand.orientation_rad.iter().map(|error| norm(*error));
                        (format!("arm {}", hand.arm), over_steps(errors))
                    })
                    .collect(),
                ErrorOf::Base => {
                    let errors = stage.figure.base_rad.iter().map(|error| norm(*error));
                    vec![("base".to_owned(), over_steps(errors))]
                }
            };
            let lines = lines.into_iter().enumerate();
            items.extend(lines.map(|(color, (name, points))| line(name, color, points)));
            items.push(threshold("claim", claim));
            let title = format!("{}: {error}", capital(&stage.stage.to_string()));
            let panel = course(title, label(error), report.protocol.steps, items);
            panels.push(over_all(panel, &stage.trial(), links));
        }
    }
    render(&panels, &Layout::columns(3))
}

fn capital(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// What is made worse: as a title, and as the words of its axis.
const WORSE: [(Quantity, &str, &str); 4] = [
    (Quantity::Sensors, "Sensors", "standard deviation (mm, mrad, mm/s, mrad/s)"),
    (Quantity::JointTorque, "Disturbing torques", "standard deviation (N m)"),
    (Quantity::Delay, "Delay of the commands", "control steps"),
    (Quantity::ArmMass, "Mass of the arms", "multiple"),
];

/// The strengths of a quantity, in their order.
fn strengths_of(points: &[Point], quantity: Quantity) -> Vec<f64> {
    let mut strengths: Vec<f64> = Vec::new();
    for point in points.iter().filter(|point| point.quantity == quantity) {
        if !strengths.contains(&point.strength) {
            strengths.push(point.strength);
        }
    }
    strengths
}

/// An error (mm, mrad) over the places of the strengths.
fn over_strengths<'a>(
    points: impl Iterator<Item = &'a Point>,
    strengths: &[f64],
    of: ErrorOf,
) -> Vec<(f64, f64)> {
    let at = |point: &Point| {
        let error = point.errors.iter().find(|error| error.error == of)?;
        let at = strengths.iter().position(|strength| *strength == point.strength)?;
        Some((at as f64, 1e3 * error.tail.mean))
    };
    points.filter_map(at).collect()
}

/// Errors against what is made worse, of the policies beside others; none where there are no others.
pub(super) fn noise_beside(reports: &Reports) -> anyhow::Result<Option<String>> {
    let points = &reports.noise.results;
    let mut who: Vec<Option<&str>> = vec![None];
    for by in points.iter().map(|point| point.by.as_deref()) {
        if !who.contains(&by) {
            who.push(by);
        }
    }
    if who.len() == 1 {
        return Ok(None);
    }
    let mut panels = Vec::new();
    for (quantity, title, x) in WORSE {
        let strengths = strengths_of(points, quantity);
        for of in [ErrorOf::Position, ErrorOf::Orientation, ErrorOf::Base] {
            let series = |by: Option<&str>| {
                let of_both =
                    |point: &&Point| point.quantity == quantity && point.by.as_deref() == by;
                over_strengths(points.iter().filter(of_both), &strengths, of)
            };
            let lines = who.iter().enumerate().map(|(color, by)| Item::Line {
                name: by.unwrap_or("policies").to_owned(),
                color,
                points: series(*by),
                dots: true,
            });
            let lines = lines
                .filter(|line| matches!(line, Item::Line { points, .. } if !points.is_empty()));
            let items: Vec<Item> = lines.collect();
            if items.is_empty() {
                continue;
            }
            let panel = course(title, label(of), 1, items);
            let names = strengths.iter().map(ToString::to_string).collect();
            panels.push(Panel { x: Axis::names(x, names), ..panel });
        }
    }
    render(&panels, &Layout::columns(3)).map(Some)
}

/// Errors against what is made worse.
pub(super) fn noise(reports: &Reports, links: &Links) -> anyhow::Result<String> {
    let points = &reports.noise.results;
    let mut panels = Vec::new();
    for (quantity, title, x) in WORSE {
        let strengths = strengths_of(points, quantity);
        let own = |point: &&Point| point.quantity == quantity && point.by.is_none();
        let series = |of: ErrorOf| over_strengths(points.iter().filter(own), &strengths, of);
        let items: Vec<Item> = [
            (ErrorOf::Position, "position of hands (mm)"),
            (ErrorOf::Orientation, "orientation (mrad)"),
            (ErrorOf::Base, "base (mrad)"),
        ]
        .into_iter()
        .enumerate()
        .map(|(color, (of, name))| Item::Line {
            name: name.to_owned(),
            color,
            points: series(of),
            dots: true,
        })
        .collect();
        let watch = points.iter().filter(own).flat_map(|point| {
            let at = strengths.iter().position(|strength| *strength == point.strength);
            let errors = point.errors.iter().map(|error| 1e3 * error.tail.mean);
            errors
                .filter_map(move |error| links.at(&point.trial(), Place::Point(at? as f64, error)))
        });
        let watch: Vec<_> = watch.collect();
        let names = strengths.iter().map(ToString::to_string).collect();
        let panel = course(title, "error, last 20 steps (mm, mrad)", 1, items);
        panels.push(Panel { x: Axis::names(x, names), links: watch, ..panel });
    }
    render(&panels, &Layout::columns(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_an_untrained_robot() {
        let reports = super::super::reports::tests::reports();
        let links = &Links::of(reports).expect("links");
        let axes = disturbed_axes(reports, links).expect("drawn").expect("a robot of four arms");
        for (figure, words) in [
            (precision(reports, links), &["position error (mm)", "last 20 steps", "agent"][..]),
            (courses(reports, links), &["control step", "arm 4", "median"]),
            (Ok(axes), &["disturbed", "about x", "lift of arm 2"]),
            (disturbed_courses(reports, links), &["push and pull", "worst axis"]),
            (arm_failure(reports, links), &["arm 4 limp", "The authors"]),
            (base_mass(reports, links), &["mass of the cube (kg)", "50 mrad", "episodes that end"]),
            (reassembly(reports, links), &["arm 3 joins", "Dual: base"]),
            (noise(reports, links), &["Mass of the arms", "standard deviation (N m)"]),
        ] {
            let figure = figure.expect("drawn");
            assert!(!figure.contains("NaN") && !figure.contains("inf"), "{figure}");
            for word in words {
                assert!(figure.contains(word), "{word}");
            }
            assert!(figure.contains("<a href=\"episodes.html#play="), "it leads to episodes");
        }
        // Others than the policies are not in the file of episodes.
        let beside = noise_beside(reports).expect("drawn").expect("a controller beside");
        for word in ["policies", "jacobian", "Delay of the commands"] {
            assert!(beside.contains(word), "{word}");
        }
        assert!(!beside.contains("NaN") && !beside.contains("<a href"), "{beside}");
    }
}
