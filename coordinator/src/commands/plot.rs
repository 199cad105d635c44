//! `octopus plot`: learning curves of runs side by side.

use std::path::Path;

use lab::figures::families::{Family, families};
use lab::figures::learning::learning_alone;
use lab::figures::recorded;
use proto::{ExitCode, ExitError};
use store::files;
use store::outputs::{Output, is_same_place};

use crate::cli::plot::PlotArgs;

/// Draws.
pub fn run(args: &PlotArgs) -> anyhow::Result<()> {
    check_outputs(args)?;
    let (curves, notes) = recorded::read_all(&args.runs)?;
    for note in &notes {
        output::note(note);
    }
    if let Some(path) = &args.save {
        recorded::write(path, &curves)?;
    }
    let families = families(&curves, args.over.0);
    let picture = learning_alone(&families, args.over.0)?;
    files::replace_output(&args.out, picture.as_bytes())?;
    if args.json {
        return output::json(&families);
    }
    let rows = families.iter().map(|family| family.row(args.over.0));
    let table = output::table(Family::HEADER, rows);
    output::line(&format!("{table}\n\npicture  {}", args.out.display()))
}

/// Refuses places that are taken.
fn check_outputs(args: &PlotArgs) -> Result<(), ExitError> {
    let inputs: Vec<(&'static str, &Path)> =
        args.runs.iter().map(|run| ("RUN_DIR|CURVES", run.as_path())).collect();
    let PlotArgs { out, save, force, .. } = args;
    Output { flag: "--out", path: out, mark: b"<svg", force: *force }.check(&inputs)?;
    let Some(save) = save else { return Ok(()) };
    Output { flag: "--save", path: save, mark: b"{\"curves\":", force: *force }.check(&inputs)?;
    if is_same_place(out, save) {
        let message = format!("--save {}: is what --out names, too", save.display());
        return Err(ExitError::new(ExitCode::Usage, message));
    }
    Ok(())
}
