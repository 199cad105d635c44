//! The robot in a row of moments: its base as a box, its arms as lines, its joints as dots.

use ::drawing::palette::{COLORS, Color, FAINT, INK};
use maud::{Markup, html};
use simulator::experiment::Skeleton;
use simulator::robot::Robot;

use crate::experiments::reassembly::{StageGoals, Staged};

/// Direction from which it is seen: turned from the x axis, and above the horizon (rad).
const AZIMUTH: f64 = 0.62;
const ELEVATION: f64 = 0.36;
/// Size of a moment's picture (px).
const WIDTH: f64 = 232.0;
const HEIGHT: f64 = 250.0;
/// Room above it for its title.
const TITLE: f64 = 26.0;
/// Moments that are drawn, as they are counted on the axes of figures; the last step follows.
const MOMENTS: [usize; 4] = [1, 8, 70, 78];

/// Colours of an arm that turns the base, and of those that reach, one after the other.
const TURNING: Color = COLORS[0];
const REACHING: [Color; 2] = [COLORS[1], COLORS[2]];

type Point = [f64; 3];

/// The robot in an episode of a stage, with the goals of its hands.
pub(super) fn sequence(robot: &Robot, stage: &Staged, goals: &StageGoals) -> Markup {
    let last = stage.poses.len();
    let mut moments: Vec<usize> = MOMENTS.into_iter().filter(|step| *step < last).collect();
    moments.push(last);
    let skeletons: Vec<Skeleton> =
        stage.poses.iter().map(|pose| Skeleton::of(robot, pose)).collect();
    let targets: Vec<Point> =
        goals.reaching.iter().map(|hand| [hand.goal[0], hand.goal[1], hand.goal[2]]).collect();
    let shown = moments.iter().flat_map(|step| points(&skeletons[step - 1]));
    let view = View::on(shown.chain(targets.iter().copied()));
    let width = WIDTH * moments.len() as f64;
    let label = format!("The robot in stage {}, at {} moments", stage.stage, moments.len());
    html! {
        svg viewBox=(format!("0 0 {width} {HEIGHT}")) width=(width) role="img" aria-label=(label)
            xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" {
            @for (index, step) in moments.iter().enumerate() {
                g transform=(format!("translate({} 0)", index as f64 * WIDTH)) {
                    text x="12" y="17" font-size="13" fill=(INK) { "step " (step) }
                    (moment(&view, &skeletons, *step - 1, stage, &targets))
                }
            }
        }
    }
}

/// All points of a robot.
fn points(skeleton: &Skeleton) -> Vec<Point> {
    skeleton.corners.iter().chain(skeleton.arms.iter().flatten()).copied().collect()
}

/// From which side, and how large.
struct View {
    scale: f64,
    /// Middle of what is seen, in metres on the picture.
    middle: (f64, f64),
}

/// Where a point is on a picture (m, right and up), and how near.
fn project([x, y, z]: Point) -> (f64, f64, f64) {
    let (sin_a, cos_a) = AZIMUTH.sin_cos();
    let (sin_e, cos_e) = ELEVATION.sin_cos();
    let towards = cos_a * x + sin_a * y;
    (cos_a * y - sin_a * x, cos_e * z - sin_e * towards, cos_e * towards + sin_e * z)
}

impl View {
    /// A view that all of `points` fit into.
    fn on(points: impl Iterator<Item = Point>) -> Self {
        let start = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let [left, right, low, high] = points.map(project).fold(start, |box_, (u, v, _)| {
            [box_[0].min(u), box_[1].max(u), box_[2].min(v), box_[3].max(v)]
        });
        let across = (WIDTH - 24.0) / (right - left).max(1e-9);
        let up = (HEIGHT - TITLE - 16.0) / (high - low).max(1e-9);
        Self { scale: across.min(up), middle: (0.5 * (left + right), 0.5 * (low + high)) }
    }

    /// Place on the picture (px).
    fn place(&self, point: Point) -> (f64, f64) {
        let (u, v, _) = project(point);
        let centre = (0.5 * WIDTH, TITLE + 0.5 * (HEIGHT - TITLE));
        (centre.0 + self.scale * (u - self.middle.0), centre.1 - self.scale * (v - self.middle.1))
    }

    fn path(&self, points: &[Point]) -> String {
        let places = points.iter().map(|point| {
            let (x, y) = self.place(*point);
            format!("{x:.1},{y:.1}")
        });
        places.collect::<Vec<_>>().join(" ")
    }
}

/// One picture; what is behind the base is drawn before it.
fn moment(
    view: &View,
    skeletons: &[Skeleton],
    index: usize,
    stage: &Staged,
    targets: &[Point],
) -> Markup {
    let skeleton = &skeletons[index];
    let reaches = |arm: usize| {
        let found = stage.reaching.iter().position(|(of, from)| *of == arm + 1 && *from <= index);
        found.map(|place| REACHING[place % REACHING.len()])
    };
    let nearness = |points: &[Point]| {
        points.iter().map(|point| project(*point).2).sum::<f64>() / points.len() as f64
    };
    let base = nearness(&skeleton.corners);
    let (near, far): (Vec<usize>, Vec<usize>) =
        (0..skeleton.arms.len()).partition(|arm| nearness(&skeleton.arms[*arm]) > base);
    let draw = |arm: usize| {
        let color = reaches(arm).unwrap_or(TURNING);
        let points = &skeleton.arms[arm];
        html! {
            polyline points=(view.path(points)) fill="none" stroke=(color) stroke-width="4"
                stroke-linejoin="round" stroke-linecap="round" {}
            @for (joint, point) in points.iter().enumerate().skip(1) {
                @let (x, y) = view.place(*point);
                @let hand = joint + 1 == points.len();
                circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r=(if hand { "4" } else { "2.6" })
                    fill=(if hand { color } else { INK }) {}
            }
        }
    };
    html! {
        @for arm in &far { (draw(*arm)) }
        (cube(view, skeleton))
        @for arm in &near { (draw(*arm)) }
        @for (place, (arm, from)) in stage.reaching.iter().enumerate() {
            @let color = REACHING[place % REACHING.len()];
            @let way: Vec<Point> = skeletons[..=index].iter().skip(*from)
                .filter_map(|skeleton| skeleton.arms[arm - 1].last().copied()).collect();
            @if way.len() > 1 {
                polyline points=(view.path(&way)) fill="none" stroke=(color) stroke-width="1.2"
                    stroke-dasharray="2 2" {}
            }
            @if let Some(target) = targets.get(place) {
                @let (x, y) = view.place(*target);
                path d=(format!("M{:.1} {y:.1}h14m-7 -7v14", x - 7.0)) stroke=(color) stroke-width="1.8" fill="none" {}
                circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r="5" stroke=(color) stroke-width="1.4" fill="none" {}
            }
        }
    }
}

/// The faces of the base that look this way.
fn cube(view: &View, skeleton: &Skeleton) -> Markup {
    // Corners around each face, by the bits of their indices.
    const FACES: [[usize; 4]; 6] =
        [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];
    let middle = |corners: &[usize]| {
        let sum: f64 = corners.iter().map(|corner| project(skeleton.corners[*corner]).2).sum();
        sum / corners.len() as f64
    };
    let centre = middle(&[0, 1, 2, 3, 4, 5, 6, 7]);
    let opacity = |face: usize| ["0.30", "0.18", "0.42"][face / 2];
    html! {
        @for (face, corners) in FACES.iter().enumerate() {
            @if middle(corners) > centre {
                polygon points=(view.path(&corners.map(|corner| skeleton.corners[corner])))
                    fill=(FAINT) fill-opacity=(opacity(face)) stroke=(INK) stroke-width="1.2"
                    stroke-linejoin="round" {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use ::drawing::palette::GRID;

    use super::*;

    #[test]
    fn the_style_sheet_knows_the_palette() {
        let style = include_str!("../document.css");
        for color in [INK, FAINT, GRID, COLORS[0], COLORS[1], COLORS[2]] {
            for property in ["fill", "stroke"] {
                assert!(style.contains(&format!("svg [{property}=\"{color}\"]")), "{color}");
            }
        }
    }

    #[test]
    fn up_is_up_and_what_is_near_is_near() {
        let (u, v, near) = project([0.0, 0.0, 1.0]);
        assert!(u.abs() < 1e-12 && v > 0.9 && near > 0.0);
        let (u, _, _) = project([0.0, 1.0, 0.0]);
        assert!(u > 0.5, "y points to the right");
        assert!(project([1.0, 0.0, 0.0]).2 > 0.5, "x points to whoever looks");
    }

    #[test]
    fn a_sequence_ends_with_the_last_step_and_stays_within() {
        let reports = super::super::reports::tests::reports();
        let robot = Robot::builtin("paper").expect("built in");
        let stages = &reports.reassembly.protocol.settings.stages;
        let text = sequence(&robot, &reports.reassembly.results[2], &stages[1]).into_string();
        assert!(text.contains("step 1<") && text.contains("step 70<") && text.contains("step 72<"));
        assert!(!text.contains("step 78") && !text.contains("NaN"));
        assert_eq!(text.matches("<polygon").count(), 4 * 3, "three faces of four cubes");
        let pairs = text.split(['"', ' ']).filter_map(|word| word.split_once(','));
        let numbers = |(x, y): (&str, &str)| Some((x.parse().ok()?, y.parse().ok()?));
        let places: Vec<(f64, f64)> = pairs.filter_map(numbers).collect();
        assert!(places.len() > 100, "{}", places.len());
        for (x, y) in places {
            assert!((0.0..=WIDTH).contains(&x) && (0.0..=HEIGHT).contains(&y), "{x} {y}");
        }
    }
}
