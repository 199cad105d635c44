//! `octopus doctor`: can this machine train?

use std::path::Path;

use clap::Args;
use proto::config::{Config, Layers, Preset};
use proto::layout::Dimensions;
use proto::{ExitCode, ExitError};
use run::preflight::{self, Check, Verdict};
use run::supervisor::Programs;
use store::provenance;

use crate::clean;

const DOCTOR_EXAMPLES: &str = "\
Examples:
  octopus doctor
  octopus doctor --json | jq '.[] | select(.verdict != \"good\")'

Exits with 4 if anything stands in the way of a training.";

/// Options of `octopus doctor`.
#[derive(Debug, Clone, Copy, Args)]
#[command(after_help = DOCTOR_EXAMPLES)]
pub struct DoctorArgs {
    /// Print the checks as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Workers that the checks reckon with.
const WORKERS: usize = 2;

/// Checks the machine; fails if a run would.
pub fn run(args: DoctorArgs) -> anyhow::Result<()> {
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let programs = Programs::find();
    let learner = programs.as_ref().ok().map(|programs| programs.learner.clone());
    let config = Layers::new(Preset::DEFAULT, None).resolve()?;
    let libtorch = match programs {
        Ok(programs) => preflight::libtorch(&programs.learner),
        Err(error) => {
            let found = error.message.split(';').next().unwrap_or_default();
            Check::failure("programs", found, "`make build` builds all three")
        }
    };
    let checks = [
        preflight::processors(WORKERS.min(processors), 1, &[]),
        preflight::memory(),
        shared_memory(&config)?,
        preflight::descriptors(WORKERS, &[]),
        preflight::memory_maps(WORKERS),
        libtorch,
        preflight::gpu(learner.as_deref(), Path::new("/proc/driver/nvidia")),
        preflight::arithmetic(&config, &provenance::vector_extensions()),
        leftovers(),
    ];
    if args.json {
        output::json(&checks)?;
    } else {
        let columns = output::columns();
        let rows = checks.iter().map(|check| {
            let verdict = match check.verdict {
                Verdict::Good => "good",
                Verdict::Warning => "warning",
                Verdict::Failure => "FAILS",
            };
            let wrap = |indent, text: &str| output::wrap_within(columns, indent, indent, text);
            let cure = check.cure.as_ref().map(|cure| format!("\n{:20}-> {}", "", wrap(23, cure)));
            let found = wrap(26, &check.found);
            format!("{verdict:8}{:18}{found}{}", check.name, cure.unwrap_or_default())
        });
        output::line(&rows.collect::<Vec<_>>().join("\n"))?;
    }
    let failures = checks.iter().filter(|check| check.verdict == Verdict::Failure).count();
    if failures > 0 {
        let message = format!("{failures} of {} checks fail; each names its cure", checks.len());
        return Err(ExitError::new(ExitCode::Environment, message).into());
    }
    Ok(())
}

/// Whether the default run fits.
fn shared_memory(config: &Config) -> anyhow::Result<Check> {
    let robot = run::robots::load_robot(&config.robot.description)?;
    Ok(preflight::shared_memory(config, &Dimensions::new(config, robot.joints), 0, &[]))
}

/// What killed runs left behind.
fn leftovers() -> Check {
    const NAME: &str = "leftovers";
    match clean::leftovers() {
        Ok(found) if found.is_empty() => Check::good(NAME, "none"),
        Ok(found) => Check::warning(
            NAME,
            format!(
                "{} left shared memory behind",
                output::counted(found.len() as u64, "killed run")
            ),
            "`octopus clean`",
        ),
        Err(error) => {
            Check::warning(NAME, format!("cannot be looked for: {error}"), "check /dev/shm")
        }
    }
}
