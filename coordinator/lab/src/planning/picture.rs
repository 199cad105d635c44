//! A plan as a picture: how the hands come nearer, how fast the joints turn, how near bodies come to each other.

use drawing::{Axis, Item, Layout, Panel, line, render};
use simulator::plan::{Miss, Question};
use simulator::robot::Robot;

use super::answer::Answer;

/// An SVG that stands alone. `period` is that of the control steps (s).
pub fn picture(
    robot: &Robot,
    question: &Question,
    answer: &Answer,
    period: f64,
) -> anyhow::Result<String> {
    let rows = &answer.inspection.rows;
    let end = period * rows.len() as f64;
    let time = || Axis::linear("time (s)", 0.0, end.max(period));
    let along = |values: Vec<f64>| -> Vec<(f64, f64)> {
        values.into_iter().enumerate().map(|(step, y)| (step as f64 * period, y)).collect()
    };
    let states = std::iter::once(&question.start).chain(rows.iter().map(|row| &row.state));
    let misses: Vec<Vec<Miss>> = states.map(|state| question.misses(robot, state)).collect();
    let errors = |of: fn(&Miss) -> f64, within: f64| -> Vec<Item> {
        let hands = misses[0].iter().enumerate().map(|(hand, &Miss { arm, .. })| {
            let values = misses.iter().map(|step| 1e3 * of(&step[hand])).collect();
            line(format!("hand {}", arm + 1), arm, along(values))
        });
        let wanted = Item::Threshold { name: "near enough".to_owned(), at: 1e3 * within };
        hands.chain([wanted]).collect()
    };
    let within = question.within;
    let fastest = (0..robot.n_arms).map(|arm| {
        let of_arm = |row: &simulator::simulate::SimulationRow| {
            let rates = row.state.qd[robot.joints.of_arm(arm)].iter();
            rates.map(|rate| rate.abs()).fold(0.0, f64::max)
        };
        let values = std::iter::once(0.0).chain(rows.iter().map(of_arm)).collect();
        line(format!("arm {}", arm + 1), arm, along(values))
    });
    let clearance: Vec<f64> = answer.inspection.clearance.iter().map(|gap| 1e3 * gap).collect();
    let gaps = Axis::from_zero("closest bodies (mm)", clearance.iter().copied());
    let panels = [
        Panel::log(
            "Position",
            time(),
            "position error (mm)",
            errors(|miss| miss.position, within.position),
        ),
        Panel::log(
            "Orientation",
            time(),
            "orientation error (mrad)",
            errors(|miss| miss.orientation, within.orientation),
        ),
        Panel::linear("Fastest joint", time(), "rate (rad/s)", fastest.collect()),
        Panel {
            title: "Distance between bodies".to_owned(),
            x: time(),
            y: gaps,
            items: vec![line(String::new(), 0, along(clearance))],
            links: Vec::new(),
        },
    ];
    render(&panels, &Layout::columns(2).alone())
}
