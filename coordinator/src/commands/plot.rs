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
    files::replace_output(&args.out, picture.replacen('>', ground, 1).as_bytes())?;
    if args.json {
        return output::json(&families);
    }
    let rows = families.iter().map(|family| family.row(args.over));
    let table = output::table(Family::HEADER, rows);
    output::line(&format!("{table}\n\npicture  {}", args.out.display()))
}
