//! Downloads: whole files, ranges, conditions, archives.

use axum::http::StatusCode;
use store::checkpoint::{Manifest, Name, STATE};

use super::Bench;

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
    for range in ["bytes=0-9", "bytes=999999999-"] {
        let part = bench.send(&format!("HEAD {PATH}"), &[("range", range)], "").await;
        assert_eq!((part.status, &part.headers), (answer.status, &answer.headers), "{range}");
    }
    let answer = bench.ask("HEAD /v1/checkpoints/latest/archive").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-length"), "", "not known before it is made");
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

/// Flips a bit in the middle of a file, which keeps its length.
fn damage(bench: &Bench, iteration: u64, file: &str) {
    let path = bench.store.dir(&Name::of_iteration(iteration)).join(file);
    let mut bytes = std::fs::read(&path).expect("readable");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("writable");
}

#[tokio::test]
async fn latest_steps_over_what_is_damaged_and_says_so() {
    let bench = Bench::new(&[1, 2, 3]);
    let paths = ["", "/archive", "/files/state.safetensors", "/files/manifest.json"];
    let latest = async |path: &str, iteration: u64, passed_over: &str| {
        let own = format!("/v1/checkpoints/{}{path}", Name::of_iteration(iteration));
        let expected = bench.ask(&format!("GET {own}")).await;
        assert_eq!(expected.status, StatusCode::OK, "{path}: {expected:?}");
        let answer = bench.ask(&format!("GET /v1/checkpoints/latest{path}")).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}: {answer:?}");
        assert!(answer.body == expected.body, "{path}");
        assert_eq!(answer.header("octopus-passed-over"), passed_over, "{path}");
        let head = bench.ask(&format!("HEAD /v1/checkpoints/latest{path}")).await;
        assert_eq!(head.header("octopus-passed-over"), passed_over, "{path}");
    };
    for path in paths {
        latest(path, 3, "").await;
    }
    // Found whole before, so that the change is what is noticed.
    damage(&bench, 3, "state.safetensors");
    for path in paths {
        latest(path, 2, "iteration-00000003").await;
    }
    std::fs::write(bench.store.dir(&Name::of_iteration(2)).join("manifest.json"), "{}")
        .expect("writable");
    for path in paths {
        latest(path, 1, "iteration-00000003, iteration-00000002").await;
    }
    damage(&bench, 1, "policy.safetensors");
    for path in paths {
        let answer = bench.ask(&format!("GET /v1/checkpoints/latest{path}")).await;
        assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{path}");
        assert!(answer.error().contains("iteration-00000003"), "{}", answer.error());
    }
    // Mended it is served again.
    damage(&bench, 3, "state.safetensors");
    latest("", 3, "").await;
}

#[tokio::test]
async fn a_damaged_file_is_not_served_by_any_name() {
    let bench = Bench::new(&[1]);
    bench.store.tag(&Name::of_iteration(1), "mine").expect("tags");
    damage(&bench, 1, "policy.safetensors");
    for name in ["iteration-00000001", "mine"] {
        for _ in 0..2 {
            let path = format!("/v1/checkpoints/{name}/files");
            let answer = bench.ask(&format!("GET {path}/policy.safetensors")).await;
            assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{answer:?}");
            let error = answer.error();
            for word in ["policy.safetensors", "BLAKE3", "GET /v1/checkpoints"] {
                assert!(error.contains(word), "{error}");
            }
            let answer = bench.ask(&format!("GET {path}/state.safetensors")).await;
            assert_eq!(answer.status, StatusCode::OK, "the others are whole");
        }
    }
}

#[tokio::test]
async fn nothing_is_reached_through_a_link() {
    let bench = Bench::new(&[1]);
    let precious = bench.dir.path().join("precious");
    std::fs::create_dir(&precious).expect("mkdir");
    let own = bench.store.dir(&Name::of_iteration(1));
    for file in std::fs::read_dir(&own).expect("readable").flatten() {
        std::fs::copy(file.path(), precious.join(file.file_name())).expect("copy");
    }
    std::os::unix::fs::symlink(&precious, bench.store.root().join("linked")).expect("link");
    for line in [
        "GET /v1/checkpoints/linked",
        "GET /v1/checkpoints/linked/files/manifest.json",
        "GET /v1/checkpoints/linked/archive",
        "PUT /v1/checkpoints/linked/pin",
        "DELETE /v1/checkpoints/linked",
    ] {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{line}: {answer:?}");
    }
    std::fs::remove_file(own.join("config.toml")).expect("remove");
    std::os::unix::fs::symlink("/etc/passwd", own.join("config.toml")).expect("link");
    let answer = bench.ask("GET /v1/checkpoints/iteration-00000001/files/config.toml").await;
    assert!(answer.error().contains("is a symbolic link"), "{}", answer.error());
    assert!(!precious.join("labels.json").exists());
}
