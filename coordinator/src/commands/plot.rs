//! `octopus plot`: learning curves of runs side by side.

use crate::cli::plot::PlotArgs;
use crate::figures::families::{Family, families};
use crate::figures::learning::learning;
use crate::figures::recorded;
use crate::{files, output};

/// Draws.
pub fn run(args: &PlotArgs) -> anyhow::Result<()> {
    let mut curves = Vec::new();
    for path in &args.runs {
        curves.extend(recorded::read(path)?);
    }
    if let Some(path) = &args.save {
        recorded::write(path, &curves)?;
    }
    let families = families(&curves, args.over);
    let picture = learning(&families, args.over)?;
    // A picture by itself has a ground of its own; what it is drawn on may be dark.
    let ground = r##"><rect width="100%" height="100%" fill="#FFFFFF"/>"##;
    files::replace(&args.out, picture.replacen('>', ground, 1).as_bytes())?;
    if args.json {
        return output::json(&families);
    }
    let last = |values: &[[f64; 3]]| {
        values.last().map_or_else(String::new, |[low, mean, high]| {
            format!("{mean:.1} ({low:.1} to {high:.1})")
        })
    };
    let row = |family: &Family| {
        [
            family.name(),
            family.task.as_str().to_owned(),
            family.runs.len().to_string(),
            last(&family.returns),
            last(&family.position),
            last(&family.orientation),
            last(&family.base),
        ]
    };
    let header =
        ["curve", "task", "runs", "return", "position (mm)", "orientation (mrad)", "base (mrad)"];
    let table = output::table(header, families.iter().map(row));
    output::line(&format!("{table}\n\npicture  {}", args.out.display()))
}
