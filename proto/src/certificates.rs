//! By what gateways of several machines know each other: files of a directory of certificates, and names of hosts.
//!
//! `octopus certificates` makes such a directory. A machine of its own holds of it what it needs: the learner's machine
//! `authority.pem`, its own pair, and the certificates of the hosts that may join; a host `authority.pem` and its pair.

use std::path::{Path, PathBuf};

/// Who signs all others.
pub const AUTHORITY: &str = "authority";
/// The machine of the learner.
pub const LEARNER: &str = "learner";
/// Longest name of a host (bytes). Certificates have room for 64, the list of hosts for fewer.
pub const NAME_LEN: usize = 40;

/// A directory of certificates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CertificateDir(PathBuf);

impl CertificateDir {
    /// The one at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The certificate of `name`.
    pub fn certificate(&self, name: &str) -> PathBuf {
        self.0.join(format!("{name}.pem"))
    }

    /// The private key that belongs to it.
    pub fn key(&self, name: &str) -> PathBuf {
        self.0.join(format!("{name}.key"))
    }
}

/// The host whose certificate a file of this name is.
pub fn host_of(file: &str) -> Option<&str> {
    let name = file.strip_suffix(".pem")?;
    check_host_name(name).is_ok().then_some(name)
}

/// Refuses what no host can be called in a certificate: it is part of a file name and of keys in the network.
pub fn check_host_name(name: &str) -> Result<(), String> {
    if [AUTHORITY, LEARNER].contains(&name) {
        return Err(format!("{name}: no host may be called so"));
    }
    let known = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let begins = name.bytes().next().is_some_and(|byte| byte.is_ascii_alphanumeric());
    if begins && name.len() <= NAME_LEN && name.bytes().all(known) {
        return Ok(());
    }
    Err(format!(
        "{name}: wants a name of letters, digits, `-`, `_` and `.` that begins with a letter or digit, of at \
         most {NAME_LEN}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_hosts_are_names_of_files_and_none_is_taken() {
        for name in ["lab-2", "a", "node.example.org", "7_x", &"n".repeat(NAME_LEN)] {
            assert_eq!(check_host_name(name), Ok(()));
            assert_eq!(host_of(&format!("{name}.pem")), Some(name));
        }
        let long = "n".repeat(NAME_LEN + 1);
        for name in ["", ".hidden", "-x", "a/b", "a*", "a b", "ü", "learner", "authority", &long] {
            assert!(check_host_name(name).is_err_and(|why| why.starts_with(name)), "{name}");
            assert_eq!(host_of(&format!("{name}.pem")), None, "{name}");
        }
        assert_eq!((host_of("lab-2.key"), host_of("lab-2")), (None, None));
    }

    #[test]
    fn a_pair_lies_side_by_side() {
        let dir = CertificateDir::new("c");
        assert_eq!(dir.certificate(LEARNER), Path::new("c/learner.pem"));
        assert_eq!(dir.key("lab-2"), Path::new("c/lab-2.key"));
    }
}
