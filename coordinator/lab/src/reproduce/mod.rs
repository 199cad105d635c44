//! All of the paper's experiments, and a page that shows them.
//!
//! Each experiment is done unless its file is there already, and written whole. The page
//! is made from the `Reports`; nothing of it is kept elsewhere, so it can be made again from the files.

mod claims;
mod drawing;
mod episodes;
mod figures;
mod page;
mod place;
mod planned;
mod reports;
mod study;

use std::path::PathBuf;

use proto::{ExitCode, ExitError};
use serde::Serialize;
use store::files;

pub use self::claims::{Claim, Tally, table};
use self::episodes::Links;
use self::place::PAGE;
pub use self::place::{
    MARK, POLICIES, RUNS, check_place, curves_beside, default_policies, refused,
};
use self::planned::Planned;
pub use self::study::{Study, check_episodes};
pub use crate::experiments::reassembly::check_robot;
use crate::figures::recorded;

/// The page, and the paper's claims beside what was measured.
#[derive(Debug, Serialize)]
pub struct Reproduction {
    /// The page.
    pub report: PathBuf,
    /// The claims.
    pub claims: Vec<Claim>,
}

/// Does what is missing, draws, and says which claims hold.
pub fn reproduce(study: &Study) -> anyhow::Result<Reproduction> {
    let (curves, notes) = recorded::read_all(&study.curves)?;
    for note in &notes {
        output::note(note);
    }
    let planned = Planned::new(study)?;
    std::fs::create_dir_all(&study.out).map_err(|error| {
        let message = format!("{}: cannot be created: {error}", study.out.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })?;
    let robot = planned.robot().clone();
    let commands = planned.commands();
    let episodes = episodes::file(planned.policies())?;
    let reports = planned.finish()?;
    let claims = claims::claims(&reports);
    let links = if episodes.is_some() { Links::of(&reports)? } else { Links::default() };
    let html = page::page(&page::Content {
        reports: &reports,
        claims: &claims,
        commands: &commands,
        curves: &curves,
        robot: &robot,
        links: &links,
        quick: study.quick,
    })?;
    match episodes {
        Some(episodes) => files::replace(&study.out.join(episodes::FILE), episodes.as_bytes())?,
        None if study.controller.is_some() => {
            output::note(
                "note: the report has no episodes to watch: a controller does not play in the page",
            );
        }
        None => output::note(&format!(
            "note: the report has no episodes to watch: {}",
            service::page::MISSING
        )),
    }
    let report = study.out.join(PAGE);
    files::replace(&report, html.as_bytes())?;
    Ok(Reproduction { report, claims })
}

#[cfg(test)]
mod tests {
    use super::reports::Reports;
    use super::reports::tests::reports;
    use super::*;
    use crate::experiments::{
        Experiment as _, arm_failure, base_mass, disturbance, noise, precision, reassembly,
    };

    #[test]
    fn all_tables_fit() {
        let reports = reports();
        let Reports { precision, disturbance, arm_failure, base_mass, reassembly, noise } = reports;
        let columns = output::COLUMNS;
        for text in [
            precision::Study::table(columns, precision),
            disturbance::Study::table(columns, disturbance),
            arm_failure::Study::table(columns, arm_failure),
            base_mass::Study::table(columns, base_mass),
            reassembly::Study::table(columns, reassembly),
            noise::Study::table(columns, noise),
            claims::table(columns, &claims::claims(reports)),
        ] {
            for line in text.lines() {
                assert!(line.chars().count() <= columns, "{line}\nis too long in\n{text}");
            }
        }
    }
}
