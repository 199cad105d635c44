//! `octopus certificates`: by what the machines of a run know each other.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::SystemTime;

use certificates::examine::{self, Certificate};
use certificates::issue::{Wanted, issue};
use clap::Args;
use proto::certificates::{AUTHORITY, CertificateDir, LEARNER};
use proto::{ExitCode, ExitError};
use serde::Serialize;

use crate::values::whole;

const CERTIFICATES_EXAMPLES: &str = "\
Examples:
  octopus certificates certs --learner 192.168.1.2 --host lab-2 --host lab-3
  octopus certificates certs --host lab-4
  octopus certificates certs

On the machine of the learner DIR is what --certificates names. A host needs three files of it: \
authority.pem, NAME.pem and NAME.key. authority.key signs all others: whoever has it can let anybody \
join, so that it belongs on no other machine, and may lie elsewhere while nothing is made. Who may \
join a run are the hosts whose .pem files are in its directory, also while it goes on.

Nothing is overwritten: a pair is made anew when its two files are removed, and the authority when the \
directory is. Certificates are dated a day earlier, because clocks differ; when they have expired, \
machines cannot connect any more.";

/// Options of `octopus certificates`.
#[derive(Debug, Clone, Args)]
#[command(after_help = CERTIFICATES_EXAMPLES)]
pub struct CertificatesArgs {
    /// The directory, which is made if it is not there.
    pub dir: PathBuf,
    /// A machine that may join under this name; may be given again.
    #[arg(long = "host", value_name = "NAME", allow_negative_numbers = true)]
    pub hosts: Vec<String>,
    /// A name or an address under which hosts reach the learner's machine, beside its host name and
    /// localhost; may be given again.
    #[arg(long, value_name = "ADDRESS", allow_negative_numbers = true)]
    pub learner: Vec<String>,
    /// How long certificates are valid; an authority is for ten years or longer.
    #[arg(long, value_name = "N", allow_hyphen_values = true, default_value_t = 365, value_parser = whole::<u32>(1, 36_500))]
    pub days: u32,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A certificate as it is shown.
#[derive(Debug, Serialize)]
struct Shown {
    /// `authority`, `learner` or the name of a host.
    certificate: String,
    #[serde(flatten)]
    said: Certificate,
    /// Whether it has just been made.
    new: bool,
}

/// Makes what is wanted and shows all that is there.
pub fn run(args: &CertificatesArgs) -> anyhow::Result<()> {
    // A link that leads nowhere is there, too.
    if args.dir.symlink_metadata().is_ok() && !args.dir.is_dir() {
        let message = format!("{}: is no directory; name another one", args.dir.display());
        return Err(ExitError::new(ExitCode::RunDirectory, message).into());
    }
    let dir = CertificateDir::new(&args.dir);
    let CertificatesArgs { hosts, learner, days, .. } = args.clone();
    let made = issue(&dir, &Wanted { hosts, learner, days }, SystemTime::now())?;
    let made: BTreeSet<_> = made.into_iter().collect();
    let shown = examine::list(&dir)?.into_iter().enumerate().map(|(index, said)| {
        let certificate = match index {
            0 => AUTHORITY.to_owned(),
            _ => said.name.clone(),
        };
        Shown { new: made.contains(&certificate), certificate, said }
    });
    let shown: Vec<_> = shown.collect();
    if args.json {
        return output::json(&shown);
    }
    let rows = shown.iter().map(|Shown { certificate, said, new }| {
        let of = match certificate.as_str() {
            AUTHORITY => "all others".to_owned(),
            LEARNER => said.addresses.join(" "),
            _ => "a host".to_owned(),
        };
        let new = if *new { "new" } else { "" };
        [certificate.clone(), of, said.until(), new.to_owned()]
    });
    output::line(&output::table(["certificate", "of", "valid until", ""], rows))
}

/// The directory of certificates that an encrypted link needs.
pub(crate) fn wanted(dir: Option<&PathBuf>, endpoint: &str) -> Result<CertificateDir, ExitError> {
    dir.map(CertificateDir::new).ok_or_else(|| {
        let message = format!(
            "{endpoint}: both ends of an encrypted link show certificates: --certificates DIR, which \
             `octopus certificates DIR --host NAME` makes"
        );
        ExitError::new(ExitCode::Usage, message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_no_directory_of_certificates() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let dir = file.path().to_owned();
        let args =
            CertificatesArgs { dir, hosts: Vec::new(), learner: Vec::new(), days: 1, json: false };
        let error = run(&args).expect_err("a file").downcast::<ExitError>().expect("ours");
        assert_eq!(error.code, ExitCode::RunDirectory);
        assert!(error.message.contains("is no directory"), "{error}");
    }
}
