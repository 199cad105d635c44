//! Which hosts may join: all, or those whose certificates lie in a directory.

use process::certificates::hosts;
use proto::certificates::CertificateDir;
use proto::{ExitCode, ExitError};

use crate::arguments::HubArguments;
use crate::network::End;

/// See the module.
pub(super) struct Admission {
    certificates: Option<CertificateDir>,
    /// Names of the hosts that may join, if not all may.
    pub(super) names: Vec<String>,
}

impl Admission {
    /// Reads who may join.
    pub(super) fn read(arguments: &HubArguments) -> Result<Self, ExitError> {
        let certificates = arguments.certificates.as_ref().map(CertificateDir::new);
        let names = certificates.as_ref().map(|dir| (dir, hosts(dir.path())));
        let names = match names {
            None => Vec::new(),
            Some((_, Ok(names))) => names,
            Some((dir, Err(error))) => {
                let message = format!("{}: cannot be read: {error}", dir.path().display());
                return Err(ExitError::new(ExitCode::Environment, message));
            }
        };
        Ok(Self { certificates, names })
    }

    /// This end of the network.
    pub(super) fn end<'a>(&'a self, endpoint: &'a str) -> End<'a> {
        let certificates = self.certificates.as_ref().map(|dir| (dir, self.names.as_slice()));
        End::Listen(endpoint, certificates)
    }

    /// Whether others may join than before. While the directory cannot be read, those of before may.
    pub(super) fn has_changed(&mut self) -> bool {
        let Some(dir) = &self.certificates else { return false };
        match hosts(dir.path()) {
            Ok(names) if names != self.names => {
                self.names = names;
                true
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_may_join_is_who_has_a_certificate_there() {
        let dir = std::env::temp_dir().join(format!("octopus-admission-{}", std::process::id()));
        std::fs::create_dir(&dir).expect("a directory");
        let put = |name: &str| std::fs::write(dir.join(name), "").expect("writable");
        for name in ["authority.pem", "learner.pem", "learner.key", "lab-2.pem"] {
            put(name);
        }
        let certificates = Some(CertificateDir::new(&dir));
        let mut admission = Admission { certificates, names: Vec::new() };
        assert!(admission.has_changed() && !admission.has_changed());
        assert_eq!(admission.names, ["lab-2"]);
        put("lab-1.pem");
        assert!(admission.has_changed());
        assert_eq!(admission.names, ["lab-1", "lab-2"]);
        std::fs::remove_dir_all(&dir).expect("removable");
        assert!(!admission.has_changed(), "those of before may go on");
    }
}
