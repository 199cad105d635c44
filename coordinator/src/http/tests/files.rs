//! Downloads: whole files, ranges, conditions, archives.

use axum::http::StatusCode;

use super::Bench;
use crate::checkpoint::{Manifest, Name, STATE};

fn state(bench: &Bench) -> Vec<u8> {
    std::fs::read(bench.store.dir(&Name::of_iteration(1)).join(STATE)).expect("readable")
}

const PATH: &str = "/v1/checkpoints/latest/files/state.safetensors";

#[tokio::test]
async fn every_listed_file_comes_with_its_hash_as_tag() {
    let bench = Bench::new(&[1]);
    let dir = bench.store.dir(&Name::of_iteration(1));
    let manifest = Manifest::read(&dir).expect("readable");
    assert!(manifest.files.len() >= 4);
    for (file, entry) in &manifest.files {
        let answer = bench.ask(&format!("GET /v1/checkpoints/latest/files/{file}")).await;
        assert_eq!(answer.status, StatusCode::OK, "{file}");
        assert_eq!(answer.header("etag"), format!("\"{}\"", entry.blake3));
        assert_eq!(answer.header("content-length"), entry.len.to_string());
        assert_eq!(answer.header("accept-ranges"), "bytes");
        assert!(answer.body == std::fs::read(dir.join(file)).expect("readable"), "{file}");
        assert_eq!(blake3::hash(&answer.body).to_hex().as_str(), entry.blake3, "{file}");
    }
    let answer = bench.ask("GET /v1/checkpoints/latest/files/manifest.json").await;
    assert_eq!(answer.header("content-type"), "application/json");
    assert!(answer.body == std::fs::read(dir.join("manifest.json")).expect("readable"));
}

#[tokio::test]
async fn ranges_are_the_files_bytes() {
    let bench = Bench::new(&[1]);
    let state = state(&bench);
    let len = state.len();
    for (range, part) in [
        ("bytes=0-0".to_owned(), 0..1),
        ("bytes=100-1099".to_owned(), 100..1100),
        (format!("bytes={}-", len - 7), len - 7..len),
        ("bytes=-9".to_owned(), len - 9..len),
        (format!("bytes=0-{len}"), 0..len),
        // Over the border of a piece.
        ("bytes=262100-262200".to_owned(), 262_100..262_201),
    ] {
        let answer = bench.send(&format!("GET {PATH}"), &[("range", &range)], "").await;
        assert_eq!(answer.status, StatusCode::PARTIAL_CONTENT, "{range}");
        assert!(answer.body == state[part.clone()], "{range}");
        let place = format!("bytes {}-{}/{len}", part.start, part.end - 1);
        assert_eq!(answer.header("content-range"), place);
        assert_eq!(answer.header("content-length"), part.len().to_string());
    }
    let beyond = format!("bytes={len}-");
    let answer = bench.send(&format!("GET {PATH}"), &[("range", &beyond)], "").await;
    assert_eq!(answer.status, StatusCode::RANGE_NOT_SATISFIABLE);
    assert_eq!(answer.header("content-range"), format!("bytes */{len}"));
}

#[tokio::test]
async fn what_the_client_has_is_not_sent_again() {
    let bench = Bench::new(&[1]);
    let etag = bench.ask(&format!("HEAD {PATH}")).await.header("etag").to_owned();
    let answer = bench.send(&format!("GET {PATH}"), &[("if-none-match", &etag)], "").await;
    assert_eq!(answer.status, StatusCode::NOT_MODIFIED);
    assert_eq!(answer.header("etag"), etag);
    assert!(answer.body.is_empty());
    let answer = bench.send(&format!("GET {PATH}"), &[("if-match", "\"other\"")], "").await;
    assert_eq!(answer.status, StatusCode::PRECONDITION_FAILED);
    let stale = [("if-range", "\"other\""), ("range", "bytes=0-0")];
    assert_eq!(bench.send(&format!("GET {PATH}"), &stale, "").await.status, StatusCode::OK);
    let fresh = [("if-range", etag.as_str()), ("range", "bytes=0-0")];
    let answer = bench.send(&format!("GET {PATH}"), &fresh, "").await;
    assert_eq!(answer.status, StatusCode::PARTIAL_CONTENT);
}

#[tokio::test]
async fn a_head_says_all_but_the_content() {
    let bench = Bench::new(&[1]);
    let answer = bench.ask(&format!("HEAD {PATH}")).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-length"), state(&bench).len().to_string());
    assert!(answer.body.is_empty());
    let answer = bench.ask("HEAD /v1/checkpoints/latest/archive").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert!(answer.body.is_empty());
}

#[tokio::test]
async fn only_listed_files_exist() {
    let bench = Bench::new(&[1]);
    std::fs::write(bench.dir.path().join("secret"), "secret").expect("writable");
    let dir = bench.store.dir(&Name::of_iteration(1));
    std::fs::write(dir.join("unlisted"), "secret").expect("writable");
    for file in [
        "unlisted",
        "labels.json",
        "nothing",
        "%2e%2e%2f%2e%2e%2fsecret",
        "..%2fiteration-00000001%2fstate.safetensors",
        "%2fetc%2fpasswd",
        "state.safetensors%00",
        "State.safetensors",
    ] {
        let answer = bench.ask(&format!("GET /v1/checkpoints/latest/files/{file}")).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{file}: {answer:?}");
    }
}

#[tokio::test]
async fn a_truncated_file_is_no_download() {
    let bench = Bench::new(&[1]);
    let path = bench.store.dir(&Name::of_iteration(1)).join(STATE);
    let file = std::fs::File::options().write(true).open(path).expect("writable");
    file.set_len(1000).expect("truncated");
    let answer = bench.ask(&format!("GET {PATH}")).await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR);
    assert!(answer.error().contains("1000 bytes"));
    let answer = bench.ask("GET /v1/checkpoints/latest/archive").await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{answer:?}");
}

#[tokio::test]
async fn an_archive_holds_every_file() {
    let bench = Bench::new(&[1]);
    let answer = bench.ask("GET /v1/checkpoints/latest/archive").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-type"), "application/x-tar");
    assert!(answer.header("content-disposition").contains("iteration-00000001.tar"));
    let dir = bench.store.dir(&Name::of_iteration(1));
    let mut archive = tar::Archive::new(&answer.body[..]);
    let mut files = 0;
    for entry in archive.entries().expect("an archive") {
        let mut entry = entry.expect("an entry");
        let path = entry.path().expect("a path").into_owned();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).expect("whole");
        let original = dir.join(path.file_name().expect("a file"));
        assert!(bytes == std::fs::read(original).expect("readable"), "{}", path.display());
        files += 1;
    }
    assert_eq!(files, 5);
}
