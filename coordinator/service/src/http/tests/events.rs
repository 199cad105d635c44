//! The stream of all that happens.

use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use axum::response::Response;
use futures_util::StreamExt as _;
use proto::run_dir::RunDir;
use serde_json::Value;
use store::lock::RunLock;
use tower::ServiceExt as _;

use super::{Bench, TOKEN, commit, config};
use crate::history::What;
use crate::http::limits::Limits;
use crate::live::{LiveRun, LiveStatus};

/// A stream that is being read.
struct Heard {
    body: axum::body::BodyDataStream,
    text: String,
}

impl Heard {
    async fn open(bench: &Bench, path: &str) -> Self {
        let response = ask(bench, path).await;
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Self { body: response.into_body().into_data_stream(), text: String::new() }
    }

    /// The data of the next event of this name; others are passed over.
    async fn next(&mut self, name: &str) -> Value {
        loop {
            let (event, data) = self.any().await;
            if event == name {
                return data;
            }
        }
    }

    /// The next event: its name and data.
    async fn any(&mut self) -> (String, Value) {
        loop {
            while let Some((event, rest)) = self.text.split_once("\n\n") {
                let (event, rest) = (event.to_owned(), rest.to_owned());
                self.text = rest;
                // What keeps a stream alive is none.
                let event = event.strip_prefix("event: ");
                if let Some((name, data)) = event.and_then(|event| event.split_once("\ndata: ")) {
                    return (name.to_owned(), serde_json::from_str(data).expect("JSON"));
                }
            }
            let piece = tokio::time::timeout(Duration::from_mins(1), self.body.next()).await;
            let piece = piece.expect("something comes").expect("the stream goes on");
            self.text += std::str::from_utf8(&piece.expect("whole")).expect("UTF-8");
        }
    }
}

async fn ask(bench: &Bench, path: &str) -> Response {
    let request = Request::builder()
        .uri(path)
        .header("host", "127.0.0.1:8270")
        .header("authorization", format!("Bearer {TOKEN}"))
        .body(Body::empty());
    bench.router.clone().oneshot(request.expect("a request")).await.expect("infallible")
}

#[tokio::test]
async fn whoever_was_away_is_sent_the_rest() {
    let live = LiveRun::new();
    live.publish(LiveStatus { iterations: 7, ..LiveStatus::default() });
    live.tell(What::Died { worker: Some(1), cause: "killed".to_owned() });
    let bench = Bench::with(&[1], Some(live.clone()), Limits::default());
    let run = RunDir::new(bench.dir.path());
    std::fs::write(run.config(), config().to_toml()).expect("writes");
    std::fs::write(run.metrics_jsonl(), "{\"iteration\":0}\n{\"iteration\":1}\n{\"iter")
        .expect("writes");
    std::fs::create_dir(run.logs()).expect("writes");
    std::fs::write(run.logs().join("learner.log"), "a word\n").expect("writes");

    let mut heard = Heard::open(&bench, "/v1/events").await;
    assert_eq!(heard.next("status").await["iterations"], 7);
    let happened = heard.next("happened").await;
    assert_eq!(happened["list"][0]["what"], "died");
    assert_eq!(happened["list"][0]["worker"], 1);
    let lines = heard.next("metrics").await;
    assert_eq!((&lines["from"], &lines["next"]), (&0.into(), &32.into()));
    assert_eq!(lines["lines"], serde_json::json!([{"iteration": 0}, {"iteration": 1}]));
    assert_eq!(heard.next("logs").await[0]["text"], "a word");
    let list = heard.next("checkpoints").await;
    assert_eq!(list["checkpoints"].as_array().expect("a list").len(), 1);

    // What comes is told, and nothing twice.
    std::fs::write(
        run.metrics_jsonl(),
        "{\"iteration\":0}\n{\"iteration\":1}\nno json\n{\"iteration\":2}\n",
    )
    .expect("writes");
    live.tell(What::Note { text: "one\r\nnote".to_owned() });
    commit(&bench.store, 2);
    let happened = heard.next("happened").await;
    assert_eq!(happened["list"][0]["text"], "one\r\nnote");
    assert_eq!(happened["list"].as_array().expect("a list").len(), 1);
    let lines = heard.next("metrics").await;
    assert_eq!(
        (&lines["from"], &lines["lines"]),
        (&32.into(), &serde_json::json!([{"iteration": 2}]))
    );
    let list = heard.next("checkpoints").await;
    assert_eq!(list["checkpoints"].as_array().expect("a list").len(), 2);
    bench.store.pin(&"iteration-00000001".parse().expect("a name"), true).expect("pins");
    assert_eq!(heard.next("checkpoints").await["checkpoints"][0]["labels"]["pinned"], true);

    let mut heard = Heard::open(&bench, "/v1/events?metrics=32").await;
    let lines = heard.next("metrics").await;
    assert_eq!(
        (&lines["from"], &lines["lines"]),
        (&32.into(), &serde_json::json!([{"iteration": 2}]))
    );
    assert_eq!(
        ask(&bench, "/v1/events?metrics=x").await.status(),
        StatusCode::UNPROCESSABLE_ENTITY
    );
}

/// A copy of a bucket is written anew every few seconds.
#[tokio::test]
async fn a_list_is_sent_when_it_is_another() {
    let bench = Bench::with(&[1], Some(LiveRun::new()), Limits::default());
    let mut heard = Heard::open(&bench, "/v1/events").await;
    heard.next("checkpoints").await;
    std::fs::write(bench.store.root().join("stray"), "").expect("writes");
    // Of the look under way, and of one that has seen that.
    let mut looks = 0;
    while looks < 3 {
        let (event, _) = heard.any().await;
        assert_ne!(event, "checkpoints", "the same list once more");
        looks += usize::from(event == "status");
    }
    commit(&bench.store, 2);
    let list = heard.next("checkpoints").await;
    assert_eq!(list["checkpoints"].as_array().expect("a list").len(), 2);
}

/// Beside no live run nothing else says so.
#[tokio::test]
async fn whether_the_run_goes_on_is_told() {
    let bench = Bench::new(&[1]);
    let run = RunDir::new(bench.dir.path());
    std::fs::write(run.config(), config().to_toml()).expect("writes");
    let mut heard = Heard::open(&bench, "/v1/events").await;
    assert_eq!(heard.next("trains").await, false);
    let lock = RunLock::acquire(&run.lock(), "a-domain").expect("free");
    assert_eq!(heard.next("trains").await, true);
    drop(lock);
    assert_eq!(heard.next("trains").await, false);
}

#[tokio::test]
async fn so_many_may_look_and_a_place_is_free_again() {
    let limits = Limits { watchers: 2, ..Limits::default() };
    let bench = Bench::with(&[1], None, limits);
    let mut first = Heard::open(&bench, "/v1/events").await;
    let _second = Heard::open(&bench, "/v1/events").await;
    first.next("checkpoints").await;
    assert_eq!(ask(&bench, "/v1/events").await.status(), StatusCode::SERVICE_UNAVAILABLE);
    drop(first);
    Heard::open(&bench, "/v1/events").await;
}
