//! Panels put together into one picture. Legends stand above what is drawn, never on it.

use std::fmt::Write as _;

use anyhow::anyhow;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::Axis;
use crate::palette::{FAINT, GRID, GROUND, INK, nth};
use crate::panel::{Item, Link, Panel, Place};

/// Height of letters of a heading, the line below it, a panel's title, an axis's name, and everything else (px).
const HEADING: u32 = 24;
const BELOW: u32 = 14;
const TITLE: u32 = 17;
const NAME: u32 = 14;
const LABEL: u32 = 13;

/// Room for a heading with the line below it, for a panel's title, and for a line of its legend (px).
const HEADING_ROOM: u32 = 68;
const TITLE_ROOM: u32 = 24;
const LEGEND_ROOM: u32 = 19;
/// Room that a character of a label takes, and an axis's name with the gaps around it (px).
const CHARACTER: f64 = 6.3;
const NAME_ROOM: f64 = 30.0;

/// How panels are put together.
#[derive(Debug, Clone)]
pub struct Layout {
    columns: usize,
    panel: (u32, u32),
    heading: Option<(String, String)>,
    ground: bool,
}

impl Layout {
    /// So many panels side by side, 440 × 320 px each, and nothing behind them: for a page.
    pub fn columns(columns: usize) -> Self {
        Self { columns: columns.max(1), panel: (440, 320), heading: None, ground: false }
    }

    /// Panels side by side as many as there are, three at most.
    pub fn rows_of_three(panels: &[Panel]) -> Self {
        Self::columns(panels.len().clamp(1, 3))
    }

    /// With panels of another size (px).
    pub fn panel(self, width: u32, height: u32) -> Self {
        Self { panel: (width, height), ..self }
    }

    /// With a heading above all panels, and a line below it.
    pub fn heading(self, heading: impl Into<String>, below: impl Into<String>) -> Self {
        Self { heading: Some((heading.into(), below.into())), ..self }
    }

    /// On a white ground: a picture that stands alone may be shown on something dark.
    pub fn alone(self) -> Self {
        Self { ground: true, ..self }
    }
}

type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws panels, row after row; returns the SVG.
pub fn render(panels: &[Panel], layout: &Layout) -> anyhow::Result<String> {
    let rows = panels.len().div_ceil(layout.columns).max(1);
    let above = if layout.heading.is_some() { HEADING_ROOM } else { 0 };
    let (width, height) =
        (layout.panel.0 * layout.columns as u32, layout.panel.1 * rows as u32 + above);
    let mut svg = String::new();
    let links = draw_all(&mut svg, (width, height), panels, rows, layout)
        .map_err(|error| anyhow!("a picture cannot be drawn: {error}"))?;
    // Whoever reads a picture aloud says what its panels are about; a picture is as wide as there is room for.
    let body = svg.find('>').map_or("", |end| &svg[end + 1..]);
    let body = body.replacen("</svg>", &format!("{links}</svg>"), 1);
    let heading = layout.heading.iter().map(|(heading, _)| heading.as_str());
    let titles = heading.chain(panels.iter().map(|panel| panel.title.as_str()));
    let label = titles.collect::<Vec<_>>().join("; ");
    Ok(format!(
        "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" role=\"img\" aria-label=\"{}\" \
         xmlns=\"http://www.w3.org/2000/svg\">{body}",
        plain(&label)
    ))
}

/// Without what has a meaning in SVG.
fn plain(text: &str) -> String {
    text.replace('&', "and").replace(['<', '>', '"'], " ")
}

fn letters(height: u32, color: RGBColor) -> TextStyle<'static> {
    ("sans-serif", height).into_font().color(&color)
}

fn draw_all(
    svg: &mut String,
    size: (u32, u32),
    panels: &[Panel],
    rows: usize,
    layout: &Layout,
) -> Result<String, Failure> {
    let mut links = String::new();
    let mut root = SVGBackend::with_string(svg, size).into_drawing_area();
    if layout.ground {
        root.fill(&GROUND.rgb())?;
    }
    if let Some((heading, below)) = &layout.heading {
        let (above, rest) = root.split_vertically(HEADING_ROOM);
        above.draw(&Text::new(heading.as_str(), (14, 12), letters(HEADING, INK.rgb())))?;
        above.draw(&Text::new(below.as_str(), (14, 42), letters(BELOW, FAINT.rgb())))?;
        root = rest;
    }
    // Panels above one another begin at one place.
    let room = |column: usize| {
        let above = panels.iter().skip(column).step_by(layout.columns);
        above.map(|panel| label_room(&panel.y)).max().unwrap_or(0)
    };
    let areas = root.split_evenly((rows, layout.columns));
    for (index, (area, panel)) in areas.iter().zip(panels).enumerate() {
        links += &draw(area, panel, room(index % layout.columns))?;
    }
    root.present()?;
    Ok(links)
}

/// How a piece of a legend looks.
enum Sample {
    Line(RGBColor),
    Filled(RGBAColor),
    Dashes,
}

/// What a piece of the legend says, and how it looks; none of what has no name.
fn legend(item: &Item) -> Option<(&str, Sample)> {
    let (name, sample) = match item {
        Item::Line { name, color, .. } => (name, Sample::Line(nth(*color))),
        Item::Band { name, color, .. } => (name, Sample::Filled(nth(*color).mix(0.2))),
        Item::Boxes { name, color, .. } => (name, Sample::Filled(nth(*color).mix(0.45))),
        Item::Threshold { name, .. } => (name, Sample::Dashes),
        Item::Span { name, .. } => (name, Sample::Filled(FAINT.rgb().mix(0.25))),
    };
    (!name.is_empty()).then_some((name, sample))
}

/// Room for the labels of a vertical axis and its name (px).
fn label_room(axis: &Axis) -> u32 {
    let labels = axis.ticks().into_iter().map(|value| axis.label(value).chars().count());
    let longest = labels.max().unwrap_or(0);
    ((CHARACTER * longest as f64 + NAME_ROOM) as u32).max(58)
}

/// Draws a panel, with so much room for the labels of its vertical axis (px); returns its links, which nobody sees,
/// to be laid over all.
fn draw(area: &Area<'_>, panel: &Panel, label_room: u32) -> Result<String, Failure> {
    let area = area.margin(8, 6, 6, 20);
    let title = Text::new(panel.title.as_str(), (8, 2), letters(TITLE, INK.rgb()));
    area.draw(&title)?;
    let top = draw_legend(&area, panel)?;
    let mut chart = ChartBuilder::on(&area)
        .margin_top(top)
        .x_label_area_size(44)
        .y_label_area_size(label_room)
        .build_cartesian_2d(panel.x.clone(), panel.y.clone())?;
    let Panel { x, y, .. } = panel;
    // What happens at some time lies behind the grid.
    for item in &panel.items {
        if let Item::Span { from, to, .. } = item {
            let corners = [(x.clamp(*from), y.low), (x.clamp(*to), y.high)];
            chart.draw_series([Rectangle::new(corners, FAINT.rgb().mix(0.25).filled())])?;
        }
    }
    chart
        .configure_mesh()
        .bold_line_style(GRID.rgb())
        .light_line_style(TRANSPARENT)
        .axis_style(FAINT.rgb())
        .x_label_formatter(&|value| x.label(*value))
        .y_label_formatter(&|value| y.label(*value))
        .x_desc(x.name.as_str())
        .y_desc(y.name.as_str())
        .label_style(letters(LABEL, FAINT.rgb()))
        .axis_desc_style(letters(NAME, INK.rgb()))
        .draw()?;
    let place = |&(a, b): &(f64, f64)| (x.clamp(a), y.clamp(b));
    let drawable = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let there = |point: &&(f64, f64)| x.shows(point.0) && y.shows(point.1);
        points.iter().filter(there).map(place).collect()
    };
    for item in &panel.items {
        match item {
            Item::Line { color, points, dots, .. } => {
                let (color, points) = (nth(*color), drawable(points));
                if *dots {
                    let dots = points.iter().map(|&at| Circle::new(at, 3, color.filled()));
                    chart.draw_series(dots)?;
                }
                chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
            }
            Item::Band { color, low, high, .. } => {
                let mut outline = drawable(high);
                outline.extend(drawable(low).into_iter().rev());
                let band = Polygon::new(outline, nth(*color).mix(0.2).filled());
                chart.draw_series([band])?;
            }
            Item::Boxes { color, width, boxes, .. } => {
                let color = nth(*color);
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
                    chart.draw_series([Circle::new((*at, mean), 3, INK.rgb().filled())])?;
                }
            }
            Item::Threshold { at, .. } => {
                let at = y.clamp(*at);
                let ends = [(x.low, at), (x.high, at)];
                let dashes = DashedLineSeries::new(ends, 5, 4, INK.rgb().stroke_width(1));
                chart.draw_series(dashes)?;
            }
            Item::Span { .. } => {}
        }
    }
    let at = |point: (f64, f64)| chart.backend_coord(&point);
    let mut links = String::new();
    for Link { to, what, at: place } in &panel.links {
        let shape = match place {
            Place::Between(from, to) => {
                let ((left, top), (right, bottom)) =
                    (at((x.clamp(*from), y.high)), at((x.clamp(*to), y.low)));
                let (width, height) = (right - left, bottom - top);
                format!(
                    "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" fill=\"none\" pointer-events=\"all\"/>"
                )
            }
            Place::Along(points) => {
                let points = drawable(points).into_iter().map(at);
                let points: Vec<String> = points.map(|(x, y)| format!("{x},{y}")).collect();
                format!(
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"none\" stroke-width=\"9\" pointer-events=\"stroke\"/>",
                    points.join(" ")
                )
            }
            Place::Point(a, b) if x.shows(*a) && y.shows(*b) => {
                let (x, y) = at((x.clamp(*a), y.clamp(*b)));
                format!(
                    "<circle cx=\"{x}\" cy=\"{y}\" r=\"8\" fill=\"none\" pointer-events=\"all\"/>"
                )
            }
            Place::Point(..) => continue,
        };
        let what = plain(what);
        let to = to.replace('&', "&amp;").replace('"', "%22");
        let _ = writeln!(links, "<a href=\"{to}\"><title>{what}</title>{shape}</a>");
    }
    Ok(links)
}

/// The legend in lines under the title; returns where what is drawn may begin.
fn draw_legend(area: &Area<'_>, panel: &Panel) -> Result<u32, Failure> {
    let room = area.dim_in_pixel().0 as i32;
    let style = letters(LABEL, INK.rgb()).pos(Pos::new(HPos::Left, VPos::Center));
    let (mut left, mut line) = (8, 0_u32);
    let mut any = false;
    for (name, sample) in panel.items.iter().filter_map(legend) {
        let width = 30 + (CHARACTER * name.chars().count() as f64) as i32 + 12;
        if any && left + width > room {
            (left, line) = (8, line + 1);
        }
        let middle = (TITLE_ROOM + line * LEGEND_ROOM + LEGEND_ROOM / 2) as i32;
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
                    area.draw(&PathElement::new(ends, INK.rgb().stroke_width(1)))?;
                }
            }
        }
        area.draw(&Text::new(name, (left + 28, middle), style.clone()))?;
        left += width;
        any = true;
    }
    Ok(if any { TITLE_ROOM + (line + 1) * LEGEND_ROOM + 4 } else { TITLE_ROOM })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::panel::Quantiles;

    fn panel() -> Panel {
        let quantiles = Quantiles::of(vec![1.0, 2.0, 300.0]).expect("not empty");
        Panel {
            title: "a & b".to_owned(),
            x: Axis::linear("step", 0.0, 10.0),
            y: Axis::log("error (mm)", [1.0, 100.0]),
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
            links: Vec::new(),
        }
    }

    #[test]
    fn links_lie_over_what_they_are_of() {
        let link = |at| Link { to: "there#a".to_owned(), what: "a < b".to_owned(), at };
        let links = vec![
            link(Place::Between(0.0, 5.0)),
            link(Place::Along(vec![(0.0, 1.0), (10.0, 100.0)])),
            link(Place::Point(10.0, 100.0)),
            link(Place::Point(10.0, -1.0)),
        ];
        let svg = render(&[Panel { links, ..panel() }], &Layout::columns(1)).expect("drawn");
        assert_eq!(
            svg.matches("<a href=\"there#a\"><title>a   b</title>").count(),
            3,
            "no logarithm, no place"
        );
        let (_, line) = svg.split_once("<polyline points=\"").expect("a line");
        let (line, _) = line.split_once("\" fill=\"none\" stroke=\"none\"").expect("its end");
        let (x, y) = line.rsplit_once(' ').and_then(|(_, last)| last.split_once(',')).expect("two");
        assert!(svg.contains(&format!("<circle cx=\"{x}\" cy=\"{y}\" r=\"8\"")), "{line}: {svg}");
    }

    #[test]
    fn everything_is_drawn_within_its_panel() {
        let svg = render(&[panel(), panel()], &Layout::columns(2)).expect("drawn");
        assert!(svg.starts_with("<svg viewBox=\"0 0 880 320\"") && svg.ends_with("</svg>\n"));
        for word in ["line", "band", "boxes", "limit", "push", "error (mm)", "step"] {
            assert!(svg.contains(word), "{word}");
        }
        let words = svg.split(['"', ' ', ',', '\n']);
        let numbers = words.filter_map(|word| word.parse::<f64>().ok());
        assert!(numbers.into_iter().all(|x| (-20.0..=900.0).contains(&x)), "{svg}");
    }

    #[test]
    fn a_picture_alone_has_a_heading_and_a_ground() {
        let layout = Layout::columns(1).panel(600, 200).heading("Big", "small").alone();
        let svg = render(&[panel(), panel()], &layout).expect("drawn");
        assert!(svg.starts_with("<svg viewBox=\"0 0 600 468\""), "{}", &svg[..60]);
        assert!(svg.contains("aria-label=\"Big; a and b; a and b\""));
        assert!(svg.contains("\nBig\n") && svg.contains("\nsmall\n"));
        assert!(svg.contains(&GROUND.to_string()));
        let page = render(&[panel()], &Layout::columns(1)).expect("drawn");
        assert!(!page.contains(&GROUND.to_string()), "a page has a ground of its own");
    }
}
