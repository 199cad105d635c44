//! `octopus plot`: learning curves of runs side by side.

use std::path::{Path, PathBuf};

use clap::Args;
use lab::figures::families::{Family, Over, families};
use lab::figures::learning::learning_alone;
use lab::figures::recorded;
use proto::ExitError;
use store::files;
use store::outputs::{self, Output};

use crate::names::{Named, Names};

const EXAMPLES: &str = "\
Examples:
  octopus plot runs/trajectory-20260101-120000
  octopus plot runs/mappo-1 runs/mappo-2 runs/ppo-1 runs/ppo-2
  octopus plot runs/* --over time --out curves.svg
  octopus plot runs/* --save curves.json

The return of training episodes, exploration included, and the errors that evaluations on \
held-out goals found in the last steps of an episode, with a panel for each. Runs that differ in \
their seeds alone are one curve: their mean within its 95 % bootstrap interval, which of three \
runs is all that they span. The table says where curves end, and where the errors are first as \
good as the paper's, in the median over the runs: by its own measure, the minimum over time, and \
in the last steps. A run that is still going on can be drawn, too.";

/// Options of `octopus plot`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct PlotArgs {
    /// Run directories, and files made by --save.
    #[arg(value_name = "RUN_DIR|CURVES", required = true, num_args = 1..)]
    pub runs: Vec<PathBuf>,
    /// What learning is drawn against.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Over::EnvSteps))]
    pub over: Named<Over>,
    /// Where the picture goes; another picture that is there is replaced.
    #[arg(long, value_name = "FILE.svg", default_value = "learning-curves.svg")]
    pub out: PathBuf,
    /// Keep the curves in one small file, too, which can be given in the place of the runs.
    #[arg(long, value_name = "FILE")]
    pub save: Option<PathBuf>,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
    /// Print the curves as JSON.
    #[arg(long)]
    pub json: bool,
}

impl Names for Over {
    const ALL: &'static [Named<Self>] = &[Named(Self::EnvSteps), Named(Self::Time)];

    fn name(self) -> &'static str {
        match self {
            Self::EnvSteps => "env-steps",
            Self::Time => "time",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::EnvSteps => "Env-steps trained on",
            Self::Time => "Wall-clock time",
        }
    }
}

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
    outputs::check_ending("--out", out, "svg")?;
    let Some(save) = save else { return Ok(()) };
    Output { flag: "--save", path: save, mark: b"{\"curves\":", force: *force }.check(&inputs)?;
    outputs::check_distinct(&[("--out", out), ("--save", save)])
}
