//! Files of a crate import one way, so that each can be understood from those below it.

use std::fs;
use std::path::Path;

use tempfile::TempDir;
use tests::guide::repository;
use tests::imports::circles;

#[test]
fn no_two_files_of_a_crate_import_each_other_in_a_circle() {
    let text = fs::read_to_string(repository().join("Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = text.parse().expect("TOML");
    let members = manifest["workspace"]["members"].as_array().expect("members");
    let mut found = Vec::new();
    for member in members {
        let member = member.as_str().expect("a folder");
        let folder = repository().join(member);
        let roots = ["src/lib.rs", "src/main.rs", "lib.rs", "it/main.rs"];
        let roots: Vec<_> =
            roots.map(|root| folder.join(root)).into_iter().filter(|root| root.is_file()).collect();
        assert!(!roots.is_empty(), "{member} has no source");
        for root in roots {
            for circle in circles(&root).expect("sources") {
                found.push(format!("a circle in {member}:\n  {}", circle.join("\n  ")));
            }
        }
    }
    let cure = "what both need belongs into a file below both";
    assert!(found.is_empty(), "{cure}\n{}", found.join("\n"));
}

fn crate_of(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (path, text) in files {
        let path = folder.path().join(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, text).expect("written");
    }
    folder
}

fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    circles(&Path::join(crate_of(files).path(), "lib.rs")).expect("Rust")
}

#[test]
fn a_circle_is_found_through_names_that_are_passed_on() {
    let files = [
        ("lib.rs", "mod a; mod b; pub use a::A;"),
        ("a.rs", "use crate::b; pub struct A; fn f() { g!(b::inner::h(1)) }"),
        ("b/mod.rs", "pub mod inner;"),
        ("b/inner.rs", "pub fn h(x: u8) {} fn i(a: super::super::A) {}"),
    ];
    let circle = [
        "a.rs imports b/inner.rs by `b::inner::h`",
        "b/inner.rs imports a.rs by `super::super::A`",
    ];
    assert_eq!(circles_of(&files), [circle]);
    let through_all = [
        ("lib.rs", "mod a { mod b; pub struct A; fn f() { b::g() } }"),
        ("a/b.rs", "use super::*; pub fn g() {}"),
    ];
    assert_eq!(circles_of(&through_all).len(), 1);
}

#[test]
fn children_tests_and_other_crates_make_no_circle() {
    let files = [
        ("lib.rs", "mod a; pub struct Root; pub use a::f;"),
        (
            "a.rs",
            "use ::a::Other; pub fn f() { std::mem::take(x) } #[cfg(test)] mod tests { use crate::Root; }",
        ),
    ];
    assert_eq!(circles_of(&files), Vec::<Vec<String>>::new());
    let methods = [("lib.rs", "mod a; pub struct Root;"), ("a.rs", "impl crate::Root {}")];
    assert_eq!(circles_of(&methods), Vec::<Vec<String>>::new());
}
