//! Learning curves: a panel for the return and for each error of each task.

use drawing::{Axis, Item, Layout, Panel, line, render};
use proto::config::TaskName;

use super::families::{Errors, Family, Over};
use crate::statistics::ErrorOf;

/// A quantity `[low, mean, high]` along a curve.
type Read = fn(&Errors) -> &[[f64; 3]];

/// Return in training and errors on held-out goals of families over `over`: their mean, and its interval. As many panels side
/// by side as a page has room for.
pub fn learning(families: &[Family], over: Over) -> anyhow::Result<String> {
    let panels = panels(families, over);
    render(&panels, &Layout::rows_of_three(&panels))
}

/// The same as a picture that stands alone.
pub fn learning_alone(families: &[Family], over: Over) -> anyhow::Result<String> {
    let panels = panels(families, over);
    render(&panels, &Layout::rows_of_three(&panels).alone())
}

fn panels(families: &[Family], over: Over) -> Vec<Panel> {
    let mut panels = Vec::new();
    for &task in TaskName::ALL {
        let families: Vec<&Family> = families.iter().filter(|family| family.task == task).collect();
        let ends = families.iter().filter_map(|family| family.along.last());
        let Some(most) = ends.copied().reduce(f64::max) else { continue };
        let x = Axis::linear(over.axis(), 0.0, most);
        let mut name = task.as_str().to_owned();
        name[..1].make_ascii_uppercase();
        let returns = items(&families, |family| (&family.along, &family.returns));
        let title = format!("{name}: return in training");
        panels.push(Panel::linear(title, x.clone(), "return, mean of the agents", returns));
        for error in ErrorOf::of(task) {
            let (axis, read): (_, Read) = match error {
                ErrorOf::Position => ("position error (mm)", |errors| &errors.position),
                ErrorOf::Orientation => ("orientation error (mrad)", |errors| &errors.orientation),
                ErrorOf::Base => ("attitude error (mrad)", |errors| &errors.base),
            };
            let mut items =
                items(&families, |family| (&family.held_out.along, read(&family.held_out)));
            if items.is_empty() {
                continue;
            }
            items
                .push(Item::Threshold { name: "the paper's".to_owned(), at: 1e3 * error.papers() });
            let title = format!("{name}: {error}, held-out goals");
            panels.push(Panel::log(title, x.clone(), axis, items));
        }
    }
    panels
}

/// Lines with their bands, of all families that have been measured.
fn items<'a>(
    families: &[&'a Family],
    read: impl Fn(&'a Family) -> (&'a [f64], &'a [[f64; 3]]),
) -> Vec<Item> {
    let of_family = |(color, family): (usize, &&'a Family)| {
        let (along, values) = read(family);
        let at = |place: usize| -> Vec<(f64, f64)> {
            along.iter().copied().zip(values.iter().map(|values| values[place])).collect()
        };
        let band = Item::Band { name: String::new(), color, low: at(0), high: at(2) };
        let items = [band, line(family.name.clone(), color, at(1))];
        (!along.is_empty()).then_some(items)
    };
    families.iter().enumerate().filter_map(of_family).flatten().collect()
}
