use std::os::unix::fs::PermissionsExt as _;

use tempfile::TempDir;

use super::*;

/// A directory that is not there yet.
fn place() -> (TempDir, CertificateDir) {
    let outer = tempfile::tempdir().expect("a directory");
    let dir = CertificateDir::new(outer.path().join("certificates"));
    (outer, dir)
}

fn wanted(hosts: &[&str], learner: &[&str]) -> Wanted {
    let owned = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect();
    Wanted { hosts: owned(hosts), learner: owned(learner), days: 30 }
}

#[test]
fn a_directory_has_an_authority_a_learner_and_hosts_and_keys_are_secret() {
    let (_outer, dir) = place();
    let now = SystemTime::now();
    let made = issue(&dir, &wanted(&["b", "a"], &["10.0.0.7", "learner.example"]), now);
    assert_eq!(made.expect("made"), ["authority", "learner", "b", "a"]);
    let mode = |path: &Path| std::fs::metadata(path).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode(dir.path()), 0o700);
    for name in ["authority", "learner", "a", "b"] {
        assert_eq!(mode(&dir.key(name)), 0o600, "{name}");
    }
    let learner = examine::check(&dir, LEARNER, now).expect("valid");
    for address in ["localhost", "127.0.0.1", "::1", "10.0.0.7", "learner.example"] {
        assert!(learner.addresses.iter().any(|other| other == address), "{learner:?}");
    }
    assert!(examine::check(&dir, "a", now).expect("valid").addresses.is_empty());
    let names: Vec<_> = examine::list(&dir).expect("all").into_iter().map(|it| it.name).collect();
    assert!(names[0].starts_with("SpaceOctopus authority "), "{names:?}");
    assert_eq!(names[1..], ["learner", "a", "b"]);
}

#[test]
fn hosts_are_added_and_nothing_is_overwritten() {
    let (_outer, dir) = place();
    let now = SystemTime::now();
    issue(&dir, &wanted(&["a"], &[]), now).expect("made");
    let before = ["authority", "learner", "a"].map(|name| std::fs::read(dir.certificate(name)));
    assert_eq!(issue(&dir, &wanted(&["b"], &[]), now).expect("made"), ["b"]);
    examine::check(&dir, "b", now).expect("of the same authority");
    assert_eq!(issue(&dir, &wanted(&[], &[]), now).expect("nothing to do"), Vec::<String>::new());
    for again in [wanted(&["c", "a"], &[]), wanted(&["c"], &["10.0.0.1"])] {
        let error = issue(&dir, &again, now).expect_err("there");
        assert_eq!(error.code, ExitCode::RunDirectory);
        assert!(error.message.contains("nothing is overwritten"), "{error}");
        assert!(!dir.certificate("c").exists(), "all or nothing");
    }
    let after = ["authority", "learner", "a"].map(|name| std::fs::read(dir.certificate(name)));
    assert_eq!(before.map(Result::unwrap), after.map(Result::unwrap));
    // Where the key of the authority is not, nothing can be signed.
    std::fs::remove_file(dir.key(AUTHORITY)).expect("there");
    let error = issue(&dir, &wanted(&["d"], &[]), now).expect_err("no key");
    assert!(error.message.contains("where the key of the authority is"), "{error}");
}

#[test]
fn names_and_addresses_that_cannot_be_are_refused_before_anything_is_made() {
    let (_outer, dir) = place();
    let wrong = [
        wanted(&["learner"], &[]),
        wanted(&["a/b"], &[]),
        wanted(&["a", "a"], &[]),
        wanted(&[], &["10.0.0.1:7447"]),
        wanted(&[], &["10.0.0"]),
        wanted(&[], &["a b"]),
        wanted(&[], &[""]),
    ];
    for wanted in wrong {
        let error = issue(&dir, &wanted, SystemTime::now()).expect_err("wrong");
        assert_eq!(error.code, ExitCode::Usage, "{wanted:?}: {error}");
    }
    assert!(!dir.path().exists());
}

#[test]
fn no_certificate_outlives_its_authority_and_all_are_dated_a_day_earlier() {
    let (_outer, dir) = place();
    let now = SystemTime::now();
    issue(&dir, &Wanted { days: 5000, ..wanted(&["a"], &[]) }, now).expect("made");
    let of = |name: &str| examine::read(&dir, name).expect("readable");
    assert_eq!(of("a").not_after - of("a").not_before, 5001 * 86_400);
    issue(&dir, &Wanted { days: 9000, ..wanted(&["b"], &[]) }, now).expect("made");
    assert_eq!(of("b").not_after, of(AUTHORITY).not_after);
    // Two clocks an hour apart.
    examine::check(&dir, "a", now - Duration::from_hours(1)).expect("valid already");
}

#[test]
fn a_directory_that_cannot_be_written_is_named() {
    let (outer, _) = place();
    let file = outer.path().join("file");
    std::fs::write(&file, "").expect("writable");
    let dir = CertificateDir::new(file.join("below"));
    let error = issue(&dir, &wanted(&[], &[]), SystemTime::now()).expect_err("no directory");
    assert_eq!(error.code, ExitCode::Failure);
    assert!(error.message.contains("cannot be written"), "{error}");
}
