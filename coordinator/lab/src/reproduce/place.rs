//! Where everything of a reproduction is: what it takes, and the directory that it fills.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use proto::{ExitCode, ExitError};
use store::{outputs, regular_files};

use super::episodes;
use super::page::GENERATOR;
use crate::experiments::Name;

/// The page's name in the directory.
pub(super) const PAGE: &str = "report.html";
/// The name of the learning curves beside policies, as `octopus plot --save` writes them.
const CURVES: &str = "curves.json";

/// Where runs land in the directory of everything.
pub const RUNS: &str = "runs";
/// Where the best policies do.
pub const POLICIES: &str = "policies";
/// The file beside them that says that they are.
pub const MARK: &str = ".octopus-reproduce";

/// Refuses a directory that something else was made in, or a page that is none of ours.
pub fn check_place(out: &Path, force: bool) -> Result<(), ExitError> {
    let mark = format!("content=\"{GENERATOR}\"");
    check_page(&out.join(PAGE), |text| text.contains(&mark))?;
    check_page(&out.join(episodes::FILE), episodes::is_ours)?;
    outputs::check_directory("--out", out, is_ours, Some(force))
}

/// The learning curves that lie beside policies, if there are any.
pub fn curves_beside(policies: &Path) -> Option<PathBuf> {
    Some(policies.join(CURVES)).filter(|curves| curves.is_file())
}

/// The policies that come with the program: below the working directory, or above the program.
pub fn default_policies() -> Result<PathBuf, ExitError> {
    const PLACE: &str = "deploy/policies";
    let program = std::env::current_exe().unwrap_or_default();
    let mut places = std::iter::once(Path::new("")).chain(program.ancestors().skip(1));
    let found = places.find_map(|place| Some(place.join(PLACE)).filter(|place| place.is_dir()));
    found.ok_or_else(|| {
        let message = format!(
            "no policies: name a directory that holds `trajectory` and `reorientation` with \
             --policies DIR; there is no {PLACE} here or above the program. `octopus train \
             trajectory --run-dir DIR/trajectory` and `octopus train reorientation --run-dir \
             DIR/reorientation` make one"
        );
        ExitError::new(ExitCode::Usage, message)
    })
}

/// Whether a file or directory of this name in the directory is made here.
fn is_ours(name: &str) -> bool {
    let made = [PAGE, episodes::FILE, RUNS, POLICIES, MARK].contains(&name);
    made || Name::ALL.iter().any(|experiment| name == format!("{experiment}.json"))
}

/// Refuses to write over a page that is none of ours.
fn check_page(path: &Path, is_ours: impl Fn(&str) -> bool) -> Result<(), ExitError> {
    match regular_files::read(path, regular_files::RECORD) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Ok(there) if is_ours(&String::from_utf8_lossy(&there)) => Ok(()),
        Ok(_) => Err(refused(path, "is there already and was not made by this command")),
        Err(error) => Err(refused(path, &format!("cannot be read: {error}"))),
    }
}

/// An error about something that stands in the way.
pub fn refused(path: &Path, what: &str) -> ExitError {
    let message = format!("{}: {what}; name another --out, or move it away", path.display());
    ExitError::new(ExitCode::RunDirectory, message)
}
