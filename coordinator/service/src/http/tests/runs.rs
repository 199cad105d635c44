//! All runs of a directory.

use std::sync::Arc;

use axum::http::StatusCode;
use proto::run_dir::RunDir;
use store::checkpoint::CheckpointStore;
use tempfile::TempDir;

use super::{Bench, TOKEN, commit, config};
use crate::http::context::{Context, Shared};
use crate::http::limits::Limits;
use crate::http::router::router;
use crate::http::run_directory::Runs;
use crate::http::token::Token;

/// Two runs, and something else.
fn bench() -> Bench {
    bench_with(Limits::default()).0
}

/// Likewise, with other bounds, and what all requests share.
fn bench_with(limits: Limits) -> (Bench, Shared) {
    let dir = TempDir::new().expect("tempdir");
    for (name, iterations) in [("one", &[1, 2][..]), ("two", &[3])] {
        let run = RunDir::new(dir.path().join(name));
        std::fs::create_dir(run.path()).expect("writes");
        std::fs::write(run.config(), config().to_toml()).expect("writes");
        let lines = format!("{{\"iteration\":0}}\n{{\"iteration\":{}}}\n{{\"it", iterations[0]);
        std::fs::write(run.metrics_jsonl(), lines).expect("writes");
        for &iteration in iterations {
            commit(&CheckpointStore::new(run.checkpoints()), iteration);
        }
    }
    std::fs::create_dir(dir.path().join("else")).expect("writes");
    let store = CheckpointStore::new(dir.path().join("checkpoints"));
    let tokens = vec![Token::parse(TOKEN, "test").expect("valid")];
    let context = Context::new(store.clone(), None, tokens, limits, true);
    let context = Arc::new(context.of_runs(Some(Runs::new(dir.path().to_owned()))));
    (Bench { dir, store, router: router(Arc::clone(&context)) }, context)
}

#[tokio::test]
async fn each_run_has_a_service_of_its_own_below_its_name() {
    let bench = bench();
    assert_eq!(bench.ask("GET /health").await.json()["serves"], "runs");
    let list = bench.ask("GET /v1/runs").await.json();
    let names: Vec<_> =
        list["runs"].as_array().expect("runs").iter().map(|run| &run["name"]).collect();
    assert_eq!(names, ["one", "two"]);
    assert_eq!(list["runs"][1]["last"]["iteration"], 3, "the last whole line");
    assert_eq!(list["runs"][0]["config"]["network"]["hidden"][0], 4);
    assert_eq!(list["runs"][0]["live"], false);

    let found = bench.ask("GET /runs/two/v1/checkpoints").await.json();
    assert_eq!(found["checkpoints"][0]["name"], "iteration-00000003");
    let lines = bench.ask("GET /runs/one/v1/metrics?from=16").await;
    assert_eq!(&lines.body[..], b"{\"iteration\":1}\n");
    let file = bench.ask("GET /runs/one/v1/checkpoints/latest/files/robot.toml").await;
    assert_eq!(file.status, StatusCode::OK);
    assert_eq!(bench.ask("GET /runs/one/health").await.json()["serves"], "run");
    let head = bench.ask("HEAD /runs/one/v1/checkpoints/latest/files/robot.toml").await;
    assert_eq!(head.header("content-length"), file.body.len().to_string());
    let head = bench.ask("HEAD /runs/one/v1/checkpoints/latest/archive").await;
    assert_eq!(head.header("content-length"), "", "not known before it is made");
}

#[tokio::test]
async fn a_name_may_be_escaped() {
    let bench = bench();
    let trial = RunDir::new(bench.dir.path().join("gamma=0.95,seed=0"));
    std::fs::create_dir(trial.path()).expect("writes");
    std::fs::write(trial.config(), config().to_toml()).expect("writes");
    std::fs::write(trial.metrics_jsonl(), "{\"iteration\":7}\n").expect("writes");
    for name in ["gamma=0.95,seed=0", "gamma%3D0.95%2Cseed%3D0", "gamma%3d0.95,seed=%30"] {
        let lines = bench.ask(&format!("GET /runs/{name}/v1/metrics")).await;
        assert_eq!(&lines.body[..], b"{\"iteration\":7}\n", "{name}");
        assert_eq!(bench.ask(&format!("GET /runs/{name}/")).await.status, page(&bench).await);
    }
    let wrong = bench.ask("GET /runs/gamma%FF/v1/metrics").await;
    assert_eq!(wrong.status, StatusCode::BAD_REQUEST, "no text");
}

/// They have one pool of threads, which slow downloads of several runs would fill.
#[tokio::test]
async fn all_runs_together_send_as_many_archives_as_one() {
    let (bench, context) = bench_with(Limits { archives: 1, ..Limits::default() });
    let archives =
        ["one", "two"].map(|run| format!("GET /runs/{run}/v1/checkpoints/latest/archive"));
    let place = context.places.archives.take().expect("free");
    for line in &archives {
        assert_eq!(bench.ask(line).await.status, StatusCode::SERVICE_UNAVAILABLE, "{line}");
    }
    drop(place);
    assert_eq!(bench.ask(&archives[1]).await.status, StatusCode::OK);
}

/// How the page of a run is answered here, where it may not be built.
async fn page(bench: &Bench) -> StatusCode {
    bench.ask("GET /runs/one/").await.status
}

#[tokio::test]
async fn a_run_among_others_is_as_guarded_as_one_alone() {
    let bench = bench();
    for line in [
        "GET /runs/one/v1/checkpoints",
        "GET /runs/one/health",
        "GET /v1/runs",
        "GET /runs/none/v1/metrics",
    ] {
        let answer = bench.send(line, &[("authorization", "")], "").await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{line}");
    }
    for line in [
        "DELETE /runs/one/v1/checkpoints/iteration-00000001",
        "PUT /runs/one/v1/checkpoints/iteration-00000001/pin",
        "PUT /runs/one/v1/checkpoints/new",
    ] {
        assert_eq!(bench.ask(line).await.status, StatusCode::FORBIDDEN, "{line}");
    }
    for line in [
        "GET /runs/none/v1/checkpoints",
        "GET /runs/else/v1/checkpoints",
        "GET /runs/../v1/checkpoints",
        "GET /runs/%2e%2e/v1/checkpoints",
        "GET /runs/one%2f..%2ftwo/v1/checkpoints",
        "GET /runs/else%2f..%2fone/v1/checkpoints",
        "GET /runs/%2e/v1/checkpoints",
        "GET /runs/one%00/v1/checkpoints",
        "GET /runs/one/v1/runs",
        "GET /runs/one/runs/two/v1/checkpoints",
    ] {
        assert_eq!(bench.ask(line).await.status, StatusCode::NOT_FOUND, "{line}");
    }
    // Strangers get the page, and it says nothing of which runs there are.
    let page = |name: &str| format!("GET /runs/{name}/");
    let [there, none] = [page("one"), page("none")];
    let stranger = [("authorization", "")];
    let (there, none) =
        (bench.send(&there, &stranger, "").await, bench.send(&none, &stranger, "").await);
    assert_eq!((there.status, there.body), (none.status, none.body));
    assert_eq!(Bench::new(&[1]).ask("GET /v1/runs").await.status, StatusCode::NOT_FOUND);
}
