//! Reads certificates, and says what is wrong with them.

use std::net::IpAddr;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::SystemTime;

use proto::certificates::{AUTHORITY, CertificateDir, LEARNER};
use proto::{ExitCode, ExitError};
use rcgen::{KeyPair, PublicKeyData as _};
use serde::Serialize;
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::{FromDer as _, X509Certificate};

use crate::times::{date, seconds};

/// What a certificate says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Certificate {
    /// Whose it is.
    pub name: String,
    /// Addresses and names of a machine at which it is reached.
    pub addresses: Vec<String>,
    /// When it begins to be valid (s since 1970).
    pub not_before: i64,
    /// When it ends to be (s since 1970).
    pub not_after: i64,
}

impl Certificate {
    /// Until when it is valid, for a person.
    pub fn until(&self) -> String {
        date(self.not_after)
    }
}

/// All certificates of a directory: the authority's, the learner's and those of hosts, as far as they are there.
pub fn list(dir: &CertificateDir) -> Result<Vec<Certificate>, ExitError> {
    let hosts = hosts(dir)?;
    let names = [AUTHORITY, LEARNER].into_iter().chain(hosts.iter().map(String::as_str));
    names.filter(|name| dir.certificate(name).exists()).map(|name| read(dir, name)).collect()
}

/// What the certificate of `name` says.
///
/// # Errors
/// If it cannot be read or is none ([`ExitCode::BadInput`]).
pub fn read(dir: &CertificateDir, name: &str) -> Result<Certificate, ExitError> {
    let path = dir.certificate(name);
    let der = der(&path)?;
    let certificate = parse(&path, &der)?;
    let own = certificate.subject().iter_common_name().next();
    let addresses = certificate.subject_alternative_name().ok().flatten();
    let addresses = addresses.map(|extension| &extension.value.general_names);
    let validity = certificate.validity();
    Ok(Certificate {
        name: own.and_then(|name| name.as_str().ok()).unwrap_or_default().to_owned(),
        addresses: addresses.into_iter().flatten().filter_map(address).collect(),
        not_before: validity.not_before.timestamp(),
        not_after: validity.not_after.timestamp(),
    })
}

/// Whether this machine can show the certificate of `name` as of `now`: it is its, is signed by the directory's authority,
/// has its key, and is valid.
///
/// # Errors
/// If a file is missing or not what it should be ([`ExitCode::BadInput`]), or what it says does not do
/// ([`ExitCode::Environment`]).
pub fn check(dir: &CertificateDir, name: &str, now: SystemTime) -> Result<Certificate, ExitError> {
    let (path, key) = (dir.certificate(name), dir.key(name));
    let said = read(dir, name)?;
    let wrong = |code: ExitCode, what: String| {
        Err(ExitError::new(code, format!("{}: {what}", path.display())))
    };
    if said.name != name {
        let what = format!("is the certificate of {:?}, not of {name}", said.name);
        return wrong(ExitCode::BadInput, what);
    }
    let (own, signer) = (der(&path)?, dir.certificate(AUTHORITY));
    let authority = der(&signer)?;
    let (own, authority) = (parse(&path, &own)?, parse(&signer, &authority)?);
    check_key(&key, &path, &own)?;
    if own.verify_signature(Some(authority.public_key())).is_err() {
        let what = format!("is of another authority than {}", signer.display());
        return wrong(ExitCode::Environment, what);
    }
    let now = seconds(now);
    if now > said.not_after {
        let what = format!(
            "has expired, on {}; `octopus certificates` makes another where the authority is, when \
             it and its key are removed there",
            said.until()
        );
        return wrong(ExitCode::Environment, what);
    }
    if now < said.not_before {
        let what = format!(
            "is not valid before {}; compare the clocks of both machines",
            date(said.not_before)
        );
        return wrong(ExitCode::Environment, what);
    }
    Ok(said)
}

/// Names of the hosts whose certificates are in the directory.
pub fn hosts(dir: &CertificateDir) -> Result<Vec<String>, ExitError> {
    process::certificates::hosts(dir.path()).map_err(|error| {
        let message = format!("{}: cannot be read: {error}", dir.path().display());
        ExitError::new(ExitCode::BadInput, message)
    })
}

/// As which host this machine joins: the one that is named, or the only one of which there is a key.
///
/// # Errors
/// If there is no such ([`ExitCode::BadInput`]) or more than one ([`ExitCode::Usage`]).
pub fn own_host(dir: &CertificateDir, named: Option<&str>) -> Result<String, ExitError> {
    if let Some(name) = named {
        return Ok(name.to_owned());
    }
    let mut hosts = hosts(dir)?;
    hosts.retain(|name| dir.key(name).exists());
    let shown = dir.path().display();
    if hosts.len() > 1 {
        let message =
            format!("{shown}: has keys of several hosts; --name says which: {}", hosts.join(", "));
        return Err(ExitError::new(ExitCode::Usage, message));
    }
    hosts.pop().ok_or_else(|| {
        let message = format!(
            "{shown}: has no certificate of a host with its key; they are made by `octopus \
             certificates DIR --host NAME`, and belong here together with authority.pem"
        );
        ExitError::new(ExitCode::BadInput, message)
    })
}

/// A key is for its owner's eyes alone, and belongs to its certificate.
fn check_key(path: &Path, of: &Path, certificate: &X509Certificate<'_>) -> Result<(), ExitError> {
    let shown = path.display();
    let wrong = |code: ExitCode, what: &str| ExitError::new(code, format!("{shown}: {what}"));
    let text = process::input::read_text(path)
        .map_err(|error| wrong(ExitCode::BadInput, &format!("cannot be read: {error}")))?;
    let (mode, owner) = std::fs::metadata(path).map_or((0, 0), |found| (found.mode(), found.uid()));
    // A key of root may be lent to a group: so secrets come to who is not root in a cluster.
    let others = if owner == 0 { 0o037 } else { 0o077 };
    if mode & others != 0 {
        let what = format!("others may read this key: chmod 600 {shown}");
        return Err(wrong(ExitCode::Environment, &what));
    }
    // What is wrong with a key is nothing to be quoted.
    let key =
        KeyPair::from_pem(&text).map_err(|_| wrong(ExitCode::BadInput, "is no private key"))?;
    if key.der_bytes() != &*certificate.public_key().subject_public_key.data {
        let what = format!("is not the key of {}", of.display());
        return Err(wrong(ExitCode::BadInput, &what));
    }
    Ok(())
}

/// The first certificate in a file.
fn der(path: &Path) -> Result<Vec<u8>, ExitError> {
    let wrong =
        |what: String| ExitError::new(ExitCode::BadInput, format!("{}: {what}", path.display()));
    let text = process::input::read_text(path)
        .map_err(|error| wrong(format!("cannot be read: {error}")))?;
    let (_, pem) = x509_parser::pem::parse_x509_pem(text.as_bytes())
        .map_err(|error| wrong(format!("is no certificate: {error}")))?;
    if pem.label != "CERTIFICATE" {
        return Err(wrong(format!("is no certificate but a {}", pem.label.to_lowercase())));
    }
    Ok(pem.contents)
}

fn parse<'a>(path: &Path, der: &'a [u8]) -> Result<X509Certificate<'a>, ExitError> {
    X509Certificate::from_der(der).map(|(_, certificate)| certificate).map_err(|error| {
        let message = format!("{}: is no certificate: {error}", path.display());
        ExitError::new(ExitCode::BadInput, message)
    })
}

fn address(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => match bytes.len() {
            4 => <[u8; 4]>::try_from(*bytes).ok().map(|bytes| IpAddr::from(bytes).to_string()),
            _ => <[u8; 16]>::try_from(*bytes).ok().map(|bytes| IpAddr::from(bytes).to_string()),
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests;
