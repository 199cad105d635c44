//! Learning curves: a panel for the return and for each error of each task.

use proto::config::TaskName;

use super::families::{Family, Over};
use super::panels::{Axis, COLORS, Item, Panel, line, render};

/// A quantity `[low, mean, high]` along a curve.
type Read = fn(&Family) -> &[[f64; 3]];

/// Return and errors of families over `over`: their mean, and what their seeds span.
pub(crate) fn learning(families: &[Family], over: Over) -> anyhow::Result<String> {
    let mut panels = Vec::new();
    for task in [TaskName::Trajectory, TaskName::Reorientation] {
        let families: Vec<&Family> = families.iter().filter(|family| family.task == task).collect();
        let ends = families.iter().filter_map(|family| family.along.last());
        let Some(most) = ends.copied().reduce(f64::max) else { continue };
        let x = Axis::linear(over.axis(), 0.0, most);
        let (name, errors): (_, &[(&str, &str, Read)]) = match task {
            TaskName::Trajectory => (
                "Trajectory",
                &[
                    ("position", "position error (mm)", |family| &family.position),
                    ("orientation", "orientation error (mrad)", |family| &family.orientation),
                ],
            ),
            TaskName::Reorientation => {
                ("Reorientation", &[("base", "attitude error (mrad)", |family| &family.base)])
            }
        };
        let returns = items(&families, |family| &family.returns);
        let (low, high) = span(&families, |family| &family.returns);
        let margin = 0.05 * (high - low);
        panels.push(Panel {
            title: format!("{name}: return"),
            x: x.clone(),
            y: Axis::linear("return, mean of the agents", low - margin, high + margin),
            items: returns,
        });
        for (error, axis, read) in errors {
            let title = format!("{name}: {error}");
            panels.push(Panel::log(title, x.clone(), axis, items(&families, *read)));
        }
    }
    let columns = panels.len().clamp(1, 3);
    render(&panels, columns)
}

fn items(families: &[&Family], read: Read) -> Vec<Item> {
    let of_family = |(color, family): (usize, &&Family)| {
        let at = |place: usize| -> Vec<(f64, f64)> {
            let values = read(family).iter().map(|values| values[place]);
            family.along.iter().copied().zip(values).collect()
        };
        let color = color % COLORS.len();
        let band = Item::Band { name: String::new(), color, low: at(0), high: at(2) };
        [band, line(family.name(), color, at(1))]
    };
    families.iter().enumerate().flat_map(of_family).collect()
}

fn span(families: &[&Family], read: Read) -> (f64, f64) {
    let values = families.iter().flat_map(|family| read(family)).flatten();
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(*value), high.max(*value))
    })
}
