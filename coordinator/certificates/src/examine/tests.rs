use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::time::Duration;

use tempfile::TempDir;

use super::*;
use crate::issue::{Wanted, issue};

/// A directory with these hosts, as of `now`.
fn made(hosts: &[&str], now: SystemTime) -> (TempDir, CertificateDir) {
    let outer = tempfile::tempdir().expect("a directory");
    let dir = CertificateDir::new(outer.path().join("certificates"));
    let hosts = hosts.iter().map(|host| (*host).to_owned()).collect();
    let wanted = Wanted { hosts, days: 30, ..Wanted::default() };
    issue(&dir, &wanted, now).expect("made");
    (outer, dir)
}

fn told(dir: &CertificateDir, name: &str, now: SystemTime) -> (ExitCode, String) {
    let error = check(dir, name, now).expect_err("something is wrong");
    (error.code, error.message)
}

#[test]
fn what_is_wrong_with_a_pair_is_said() {
    let now = SystemTime::now();
    let (_outer, dir) = made(&["a", "b"], now);
    let (_outer, other) = made(&["a"], now);
    let day = Duration::from_hours(24);
    let (code, text) = told(&dir, "a", now + 31 * day);
    assert_eq!(code, ExitCode::Environment);
    assert!(text.contains("a.pem: has expired, on 2"), "{text}");
    let (code, text) = told(&dir, "a", now - 2 * day);
    assert_eq!(code, ExitCode::Environment);
    assert!(text.contains("is not valid before") && text.contains("clocks"), "{text}");
    let (code, text) = told(&dir, "c", now);
    assert_eq!(code, ExitCode::BadInput);
    assert!(text.contains("c.pem: cannot be read"), "{text}");
    // Of another authority, which has no say here.
    fs::copy(other.certificate(AUTHORITY), dir.certificate(AUTHORITY)).expect("writable");
    let (code, text) = told(&dir, "a", now);
    assert_eq!(code, ExitCode::Environment);
    assert!(text.contains("is of another authority than"), "{text}");
}

#[test]
fn a_pair_under_another_name_or_with_another_key_is_none() {
    let now = SystemTime::now();
    let (_outer, dir) = made(&["a", "b"], now);
    fs::rename(dir.certificate("b"), dir.certificate("c")).expect("there");
    let (code, text) = told(&dir, "c", now);
    assert_eq!(code, ExitCode::BadInput);
    assert!(text.contains("is the certificate of \"b\", not of c"), "{text}");
    fs::rename(dir.key("b"), dir.key("a")).expect("there");
    let (code, text) = told(&dir, "a", now);
    assert_eq!(code, ExitCode::BadInput);
    assert!(text.contains("a.key: is not the key of"), "{text}");
}

#[test]
fn a_key_that_others_may_read_is_refused_and_none_is_quoted() {
    let now = SystemTime::now();
    let (_outer, dir) = made(&["a"], now);
    fs::set_permissions(dir.key("a"), Permissions::from_mode(0o644)).expect("own");
    let (code, text) = told(&dir, "a", now);
    assert_eq!(code, ExitCode::Environment);
    assert!(text.contains("chmod 600"), "{text}");
    fs::set_permissions(dir.key("a"), Permissions::from_mode(0o600)).expect("own");
    let secret = fs::read_to_string(dir.key("a")).expect("readable").replace("-----BEGIN", "-----");
    fs::write(dir.key("a"), &secret).expect("writable");
    let (code, text) = told(&dir, "a", now);
    assert_eq!(code, ExitCode::BadInput);
    assert!(text.ends_with("is no private key"), "{text}");
    fs::write(dir.certificate("a"), secret).expect("writable");
    let (_, text) = told(&dir, "a", now);
    assert!(text.contains("is no certificate"), "{text}");
}

#[test]
fn a_machine_is_the_only_host_of_which_it_has_a_key_or_the_one_that_is_named() {
    let now = SystemTime::now();
    let (_outer, dir) = made(&["a", "b"], now);
    assert_eq!(own_host(&dir, Some("b")).expect("named"), "b");
    let error = own_host(&dir, None).expect_err("two");
    assert_eq!(error.code, ExitCode::Usage);
    assert!(error.message.contains("--name says which: a, b"), "{error}");
    fs::remove_file(dir.key("b")).expect("there");
    assert_eq!(own_host(&dir, None).expect("one"), "a");
    fs::remove_file(dir.key("a")).expect("there");
    assert_eq!(own_host(&dir, None).expect_err("none").code, ExitCode::BadInput);
    assert_eq!(hosts(&dir).expect("readable"), ["a", "b"]);
}
