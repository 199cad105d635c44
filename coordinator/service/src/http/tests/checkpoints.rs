//! Lists, entries, pins, tags, removal, and what is no route.

use std::sync::Arc;
use std::time::Duration;

use axum::http::StatusCode;
use rustix::fs::{FlockOperation, flock};
use store::checkpoint::{Name, Score};
use tokio::task::JoinSet;

use super::Bench;
use crate::http::limits::Limits;

#[tokio::test]
async fn an_empty_store_is_an_empty_list() {
    let bench = Bench::new(&[]);
    let answer = bench.ask("GET /v1/checkpoints").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.json(), serde_json::json!({ "checkpoints": [], "damaged": [] }));
    let answer = bench.ask("GET /v1/checkpoints/latest").await;
    assert_eq!(answer.status, StatusCode::NOT_FOUND);
    assert!(answer.error().contains("latest"));
}

#[tokio::test]
async fn checkpoints_are_listed_and_found_by_every_name() {
    let bench = Bench::new(&[5, 10]);
    let score = |value| Score { value, errors: [].into(), episodes: 1, steps: 1, seed: 0 };
    let name = |iteration| Name::of_iteration(iteration);
    bench.store.record_score(&name(5), score(1.0)).expect("scored");
    bench.store.record_score(&name(10), score(2.0)).expect("scored");
    bench.store.tag(&name(5), "paper").expect("tagged");

    let list = bench.ask("GET /v1/checkpoints").await.json();
    let names: Vec<_> = list["checkpoints"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|entry| entry["name"].as_str().expect("a name"))
        .collect();
    assert_eq!(names, ["iteration-00000005", "iteration-00000010"]);
    for (asked, found) in [
        ("iteration-00000005", 5),
        ("iteration-00000010", 10),
        ("latest", 10),
        ("best", 5),
        ("paper", 5),
    ] {
        let answer = bench.ask(&format!("GET /v1/checkpoints/{asked}")).await;
        assert_eq!(answer.status, StatusCode::OK, "{asked}: {answer:?}");
        assert_eq!(answer.json()["iteration"], found, "{asked}");
        assert_eq!(answer.json()["manifest"]["iteration"], found, "{asked}");
    }
}

#[tokio::test]
async fn two_checkpoints_are_compared_by_any_of_their_names() {
    let bench = Bench::new(&[5, 10]);
    bench.store.tag(&Name::of_iteration(5), "paper").expect("tagged");
    let answer = bench.ask("GET /v1/checkpoints/paper/differences/latest").await;
    assert_eq!(answer.status, StatusCode::OK, "{answer:?}");
    let found = answer.json();
    assert_eq!((&found["same"], &found["same_robot"]), (&false.into(), &true.into()));
    let tensors = found["tensors"].as_array().expect("a list");
    assert!(!tensors.is_empty());
    for tensor in tensors {
        let name = tensor["tensor"].as_str().expect("a name");
        assert!(name.starts_with("policy.safetensors/"), "{name}");
        assert!(tensor["norm"].as_f64().expect("a number") > 0.0, "{tensor}");
    }
    let same = bench.ask("GET /v1/checkpoints/paper/differences/iteration-00000005").await.json();
    assert_eq!((&same["same"], &same["tensors"]), (&true.into(), &serde_json::json!([])));
    let answer = bench.ask("GET /v1/checkpoints/paper/differences/nothing").await;
    assert_eq!(answer.status, StatusCode::NOT_FOUND, "{answer:?}");
    assert!(answer.error().contains("nothing"));
}

#[tokio::test]
async fn what_is_no_checkpoint_is_not_found_and_what_is_no_name_is_refused() {
    let bench = Bench::new(&[1]);
    for name in ["iteration-00000002", "nothing", "best"] {
        for line in [
            format!("GET /v1/checkpoints/{name}"),
            format!("GET /v1/checkpoints/{name}/archive"),
            format!("GET /v1/checkpoints/{name}/files/manifest.json"),
            format!("DELETE /v1/checkpoints/{name}"),
            format!("PUT /v1/checkpoints/{name}/pin"),
            format!("DELETE /v1/checkpoints/{name}/pin"),
            format!("PUT /v1/checkpoints/{name}/tags/t"),
        ] {
            let answer = bench.ask(&line).await;
            assert_eq!(answer.status, StatusCode::NOT_FOUND, "{line}: {answer:?}");
            assert!(answer.error().contains(name), "{line}");
        }
    }
    for name in ["..", "%2e%2e", "..%2fx", "a%2fb", ".lock", "%00", "a%20b", "-x", "%c3%bc"] {
        for line in [
            format!("GET /v1/checkpoints/{name}"),
            format!("GET /v1/checkpoints/{name}/archive"),
            format!("GET /v1/checkpoints/{name}/files/manifest.json"),
            format!("DELETE /v1/checkpoints/{name}"),
            format!("PUT /v1/checkpoints/{name}"),
            format!("PUT /v1/checkpoints/{name}/pin"),
            format!("PUT /v1/checkpoints/iteration-00000001/tags/{name}"),
        ] {
            let answer = bench.ask(&line).await;
            assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{line}: {answer:?}");
            assert!(!answer.error().is_empty(), "{line}");
        }
    }
    assert_eq!(bench.ask("GET /v1/checkpoints/%ff").await.status, StatusCode::BAD_REQUEST);
    assert_eq!(bench.inventory(), ["iteration-00000001"]);
}

#[tokio::test]
async fn a_pinned_checkpoint_is_not_removed() {
    let bench = Bench::new(&[1]);
    let base = "/v1/checkpoints/iteration-00000001";
    let pinned = bench.ask(&format!("PUT {base}/pin")).await;
    assert_eq!(pinned.status, StatusCode::OK);
    assert_eq!(pinned.json()["labels"]["pinned"], true);
    let refused = bench.ask(&format!("DELETE {base}")).await;
    assert_eq!(refused.status, StatusCode::CONFLICT);
    assert!(refused.error().contains("`DELETE /v1/checkpoints/iteration-00000001/pin`"));
    assert_eq!(bench.ask(&format!("DELETE {base}/pin")).await.json()["labels"]["pinned"], false);
    assert_eq!(bench.ask(&format!("DELETE {base}")).await.status, StatusCode::NO_CONTENT);
    assert_eq!(bench.ask(&format!("DELETE {base}")).await.status, StatusCode::NOT_FOUND);
    assert_eq!(bench.inventory(), [""; 0]);
}

#[tokio::test]
async fn tags_come_and_go() {
    let bench = Bench::new(&[1, 2]);
    let tag = |iteration: u64, tag: &str| {
        format!("/v1/checkpoints/{}/tags/{tag}", Name::of_iteration(iteration))
    };
    let answer = bench.ask(&format!("PUT {}", tag(1, "demo"))).await;
    assert_eq!(answer.json()["labels"]["tags"], serde_json::json!(["demo"]));
    let answer = bench.ask(&format!("PUT {}", tag(2, "demo"))).await;
    assert_eq!(answer.status, StatusCode::OK, "it moves");
    assert_eq!(bench.ask("GET /v1/checkpoints/demo").await.json()["iteration"], 2);
    for reserved in ["latest", "best", "7", "iteration-00000001"] {
        let answer = bench.ask(&format!("PUT {}", tag(1, reserved))).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{reserved}: {answer:?}");
    }
    assert_eq!(bench.ask(&format!("DELETE {}", tag(2, "demo"))).await.status, StatusCode::OK);
    let gone = bench.ask(&format!("DELETE {}", tag(2, "demo"))).await;
    assert_eq!(gone.status, StatusCode::NOT_FOUND);
    assert!(gone.error().contains("has no tag `demo`"), "{gone:?}");
    assert_eq!(bench.ask("GET /v1/checkpoints/demo").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_damaged_manifest_is_said_to_be_damaged() {
    let bench = Bench::new(&[1, 2]);
    let path = bench.store.dir(&Name::of_iteration(2)).join("manifest.json");
    std::fs::write(path, "{").expect("writable");
    let list = bench.ask("GET /v1/checkpoints").await.json();
    assert_eq!(list["checkpoints"].as_array().map(Vec::len), Some(1));
    assert_eq!(list["damaged"][0]["name"], "iteration-00000002");
    let answer = bench.ask("GET /v1/checkpoints/iteration-00000002").await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR);
    assert!(answer.error().contains("manifest"));
    assert_eq!(bench.ask("GET /v1/checkpoints/latest").await.json()["iteration"], 1);
}

#[tokio::test]
async fn what_is_no_route_or_method_is_said_in_json() {
    let bench = Bench::new(&[]);
    for path in
        ["/page", "/v1", "/v2/checkpoints", "/v1/checkpoints/a/b", "/v1/checkpoints/a/files/b/c"]
    {
        let answer = bench.ask(&format!("GET {path}")).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{path}");
        assert!(answer.error().contains("openapi.json"), "{path}");
    }
    let answer = bench.ask("DELETE /v1/checkpoints").await;
    assert_eq!(answer.status, StatusCode::METHOD_NOT_ALLOWED);
    assert!(answer.error().contains("DELETE"));
    assert!(answer.header("allow").contains("POST"), "{answer:?}");
    assert_eq!(answer.header("x-content-type-options"), "nosniff");
}

#[tokio::test]
async fn changes_want_the_checkpoints_own_name() {
    let bench = Bench::new(&[1, 2]);
    let score = Score { value: 1.0, errors: [].into(), episodes: 1, steps: 1, seed: 0 };
    bench.store.record_score(&Name::of_iteration(1), score).expect("scored");
    bench.store.tag(&Name::of_iteration(1), "demo").expect("tagged");
    for (said, now) in [("latest", 2), ("best", 1), ("demo", 1)] {
        for line in [
            format!("DELETE /v1/checkpoints/{said}"),
            format!("PUT /v1/checkpoints/{said}/pin"),
            format!("DELETE /v1/checkpoints/{said}/pin"),
            format!("PUT /v1/checkpoints/{said}/tags/t"),
            format!("DELETE /v1/checkpoints/{said}/tags/demo"),
        ] {
            let answer = bench.ask(&line).await;
            assert_eq!(answer.status, StatusCode::CONFLICT, "{line}: {answer:?}");
            let words = format!("`{said}` is now {}", Name::of_iteration(now));
            assert!(answer.error().contains(&words), "{line}: {}", answer.error());
        }
    }
    let list = bench.ask("GET /v1/checkpoints").await.json();
    assert_eq!(list["checkpoints"][1]["labels"]["imported"], false, "{list}");
}

#[tokio::test]
async fn the_newest_of_a_run_is_not_removed_and_nobody_hears_of_paths() {
    let bench = Bench::new(&[1, 2]);
    let root = bench.store.root();
    std::fs::write(root.parent().expect("a run").join("config.toml"), "").expect("write");
    let refused = bench.ask("DELETE /v1/checkpoints/iteration-00000002").await;
    assert_eq!(refused.status, StatusCode::CONFLICT);
    assert!(refused.error().contains("newest whole checkpoint of its run"), "{refused:?}");
    let older = bench.ask("DELETE /v1/checkpoints/iteration-00000001").await;
    assert_eq!(older.status, StatusCode::NO_CONTENT);
    std::fs::write(root.join("iteration-00000002/policy.safetensors"), "x").expect("write");
    let path = root.to_str().expect("UTF-8");
    for line in [
        "DELETE /v1/checkpoints/iteration-00000001",
        "GET /v1/checkpoints/latest",
        "GET /v1/checkpoints/iteration-00000002/archive",
        "GET /v1/checkpoints/iteration-00000002/files/policy.safetensors",
        "DELETE /v1/checkpoints/iteration-00000002/tags/x",
    ] {
        let error = bench.ask(line).await.error();
        assert!(!error.contains(path) && !error.contains("octopus "), "{line}: {error}");
    }
}

/// Each change that waits holds a thread. Once there were as many as threads, and then nothing was
/// answered any more.
#[tokio::test]
async fn changes_that_wait_for_the_lock_keep_no_reader_out() {
    let limits = Limits { lock_time: Duration::from_hours(1), ..Limits::default() };
    let most = limits.changes;
    let bench = Bench::with(&[1], None, limits);
    let lock = std::fs::File::open(bench.store.root().join(".lock")).expect("own");
    flock(&lock, FlockOperation::LockExclusive).expect("free");
    let bench = Arc::new(bench);
    let mut changes = JoinSet::new();
    for _ in 0..70 {
        let bench = Arc::clone(&bench);
        changes.spawn(async move { bench.ask("PUT /v1/checkpoints/iteration-00000001/pin").await });
    }
    // Those that find no thread to wait on are refused, though nobody gives the lock back.
    for _ in 0..70 - most {
        let answer = changes.join_next().await.expect("one of 70").expect("no panic");
        assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE, "{answer:?}");
        assert_eq!(answer.header("retry-after"), "1");
    }
    for line in ["GET /v1/checkpoints", "GET /metrics", "GET /v1/checkpoints/latest"] {
        assert_eq!(bench.ask(line).await.status, StatusCode::OK, "{line}");
    }
    assert!(changes.try_join_next().is_none(), "the others wait");
    drop(lock);
    let waited = changes.join_all().await;
    assert_eq!(waited.len(), most);
    for answer in waited {
        assert_eq!(answer.status, StatusCode::OK, "{answer:?}");
    }
}

#[tokio::test]
async fn a_change_does_not_wait_for_ever() {
    let limits = Limits { lock_time: Duration::from_millis(50), ..Limits::default() };
    let bench = Bench::with(&[1], None, limits);
    let lock = std::fs::File::open(bench.store.root().join(".lock")).expect("own");
    flock(&lock, FlockOperation::LockExclusive).expect("free");
    for line in
        ["PUT /v1/checkpoints/iteration-00000001/pin", "DELETE /v1/checkpoints/iteration-00000001"]
    {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE, "{line}");
        assert!(answer.error().contains("another program"), "{}", answer.error());
    }
}
