//! Makes certificates. What is there is never overwritten.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::time::{Duration, SystemTime};

use proto::certificates::{AUTHORITY, CertificateDir, LEARNER, check_host_name};
use proto::{ExitCode, ExitError};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PublicKeyData as _, SanType,
};

use crate::examine;

/// What is to be made, beside the authority where there is none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Names of hosts.
    pub hosts: Vec<String>,
    /// Names and addresses of the learner's machine, beside its host name and those of the loopback interface.
    pub learner: Vec<String>,
    /// How long certificates are valid (days).
    pub days: u32,
}

const DAY: Duration = Duration::from_hours(24);
/// Certificates are dated so much earlier: clocks of two machines may be hours apart.
const EARLIER: Duration = DAY;
/// Days for which an authority is valid at least: whoever adds a host next year should not have to visit all machines.
const AUTHORITY_DAYS: u32 = 3650;

/// Makes what is wanted in `dir`, as of `now`, and says what was made. An authority and the learner's certificate are made
/// where there are none.
///
/// # Errors
/// If a name or address cannot be ([`ExitCode::Usage`]), a certificate is there already or the authority's key is not
/// ([`ExitCode::RunDirectory`]), what is there is none ([`ExitCode::BadInput`]), or files cannot be written
/// ([`ExitCode::Failure`]).
pub fn issue(
    dir: &CertificateDir,
    wanted: &Wanted,
    now: SystemTime,
) -> Result<Vec<String>, ExitError> {
    check_names(&wanted.hosts)?;
    let addresses = wanted.learner.iter().map(|address| {
        let wrong = || {
            let message = format!("{address}: wants a name or an address, without a port");
            ExitError::new(ExitCode::Usage, message)
        };
        alternative(address).ok_or_else(wrong)
    });
    let addresses = addresses.collect::<Result<Vec<_>, _>>()?;
    let is_there = |name: &str| dir.certificate(name).exists() || dir.key(name).exists();
    let begins = !is_there(AUTHORITY);
    let with_learner = !is_there(LEARNER) || !addresses.is_empty();
    let learner = with_learner.then_some(LEARNER);
    let names = learner.into_iter().chain(wanted.hosts.iter().map(String::as_str));
    if let Some(name) = names.clone().find(|name| is_there(name)) {
        let message = format!(
            "{}: is there already, and nothing is overwritten; when both it and {} are removed, \
             others can be made",
            dir.certificate(name).display(),
            dir.key(name).display(),
        );
        return Err(ExitError::new(ExitCode::RunDirectory, message));
    }
    let mut made: Vec<String> = Vec::new();
    let (issuer, until) = if begins {
        made.push(AUTHORITY.to_owned());
        new_authority(dir, wanted.days, now)?
    } else {
        authority(dir)?
    };
    for name in names {
        let mut params = parameters(name, now, wanted.days, until)?;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = if name == LEARNER {
            params.subject_alt_names = own_names();
            params.subject_alt_names.extend(addresses.clone());
            vec![ExtendedKeyUsagePurpose::ServerAuth]
        } else {
            vec![ExtendedKeyUsagePurpose::ClientAuth]
        };
        let key = KeyPair::generate().map_err(|error| unmade(&error))?;
        let certificate = params.signed_by(&key, &issuer).map_err(|error| unmade(&error))?;
        put(dir, name, &key, &certificate.pem())?;
        made.push(name.to_owned());
    }
    Ok(made)
}

fn check_names(hosts: &[String]) -> Result<(), ExitError> {
    for (index, name) in hosts.iter().enumerate() {
        check_host_name(name).map_err(|why| ExitError::new(ExitCode::Usage, why))?;
        if hosts[..index].contains(name) {
            let message = format!("{name}: is named twice");
            return Err(ExitError::new(ExitCode::Usage, message));
        }
    }
    Ok(())
}

/// A name or address as certificates have it.
fn alternative(text: &str) -> Option<SanType> {
    if let Ok(address) = text.parse::<IpAddr>() {
        return Some(SanType::IpAddress(address));
    }
    let label = |label: &str| {
        let known = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
        !label.is_empty() && label.len() < 64 && label.bytes().all(known) && !label.starts_with('-')
    };
    // Digits and dots alone are an address that is none.
    let is_name = text.len() < 254 && text.split('.').all(label);
    let has_letter = text.bytes().any(|byte| byte.is_ascii_alphabetic());
    (is_name && has_letter).then(|| text.try_into().ok().map(SanType::DnsName)).flatten()
}

/// What the machine at hand calls itself.
fn own_names() -> Vec<SanType> {
    let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let mut names: Vec<_> = ["localhost", &host].into_iter().filter_map(alternative).collect();
    names.dedup();
    names.push(SanType::IpAddress(Ipv4Addr::LOCALHOST.into()));
    names.push(SanType::IpAddress(Ipv6Addr::LOCALHOST.into()));
    names
}

/// What all certificates have: a name, and dates no later than `until`.
fn parameters(
    name: &str,
    now: SystemTime,
    days: u32,
    until: SystemTime,
) -> Result<CertificateParams, ExitError> {
    let mut params = CertificateParams::new(Vec::new()).map_err(|error| unmade(&error))?;
    params.distinguished_name.push(DnType::CommonName, name);
    params.not_before = (now - EARLIER).into();
    params.not_after = (now + DAY * days).min(until).into();
    params.use_authority_key_identifier_extension = true;
    Ok(params)
}

/// Makes an authority. Until when it is valid is the other thing.
fn new_authority(
    dir: &CertificateDir,
    days: u32,
    now: SystemTime,
) -> Result<(Issuer<'static, KeyPair>, SystemTime), ExitError> {
    let days = days.max(AUTHORITY_DAYS);
    let until = now + DAY * days;
    let key = KeyPair::generate().map_err(|error| unmade(&error))?;
    // No two authorities have one name: who looks for the signer of a certificate looks by name.
    let last = key.der_bytes().iter().rev().take(6);
    let mark = last.fold(0_u64, |mark, byte| (mark << 8) | u64::from(*byte));
    let mut params = parameters(&format!("SpaceOctopus authority {mark:012x}"), now, days, until)?;
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let certificate = params.self_signed(&key).map_err(|error| unmade(&error))?;
    let path = dir.path();
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
        .map_err(|error| unwritten(path, &error))?;
    put(dir, AUTHORITY, &key, &certificate.pem())?;
    Ok((Issuer::new(params, key), until))
}

/// The authority that is there, and until when it is valid.
fn authority(dir: &CertificateDir) -> Result<(Issuer<'static, KeyPair>, SystemTime), ExitError> {
    let (path, key) = (dir.certificate(AUTHORITY), dir.key(AUTHORITY));
    if !key.exists() {
        let message = format!(
            "{}: is not there; certificates are made where the key of the authority is",
            key.display()
        );
        return Err(ExitError::new(ExitCode::RunDirectory, message));
    }
    let certificate = examine::read(dir, AUTHORITY)?;
    let wrong = |path: &Path, error: &dyn std::fmt::Display| {
        ExitError::new(ExitCode::BadInput, format!("{}: cannot be used: {error}", path.display()))
    };
    let text = process::input::read_text(&key).map_err(|error| wrong(&key, &error))?;
    let pair = KeyPair::from_pem(&text).map_err(|error| wrong(&key, &error))?;
    let text = process::input::read_text(&path).map_err(|error| wrong(&path, &error))?;
    let issuer = Issuer::from_ca_cert_pem(&text, pair).map_err(|error| wrong(&path, &error))?;
    let seconds = u64::try_from(certificate.not_after).unwrap_or(0);
    Ok((issuer, SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)))
}

/// Writes a pair. The key comes first, so that no certificate is without one.
fn put(dir: &CertificateDir, name: &str, key: &KeyPair, pem: &str) -> Result<(), ExitError> {
    let (path, of_key) = (dir.certificate(name), dir.key(name));
    write_new(&of_key, 0o600, &key.serialize_pem())?;
    write_new(&path, 0o644, pem).inspect_err(|_| {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&of_key);
    })
}

fn write_new(path: &Path, mode: u32, text: &str) -> Result<(), ExitError> {
    let written = OpenOptions::new().write(true).create_new(true).mode(mode).open(path).and_then(
        |mut file: File| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        },
    );
    written.map_err(|error| unwritten(path, &error))
}

fn unwritten(path: &Path, error: &std::io::Error) -> ExitError {
    ExitError::new(ExitCode::Failure, format!("{}: cannot be written: {error}", path.display()))
}

fn unmade(error: &rcgen::Error) -> ExitError {
    ExitError::new(ExitCode::Failure, format!("a certificate cannot be made: {error}"))
}

#[cfg(test)]
mod tests;
