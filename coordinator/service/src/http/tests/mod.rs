//! The service without a network: requests go straight through the router.

mod access;
mod checkpoints;
mod events;
mod files;
mod fuzz;
mod page;
mod run;
mod runs;
mod service;
mod uploads;

use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::http::{HeaderMap, Request, StatusCode};
use proto::config::{Config, Layers, Preset};
use serde_json::Value;
use simulator::robot::Robot;
use store::checkpoint::CheckpointStore;
use store::checkpoint::fixtures::snapshot_of;
use tempfile::TempDir;
use tower::ServiceExt as _;

use super::context::Context;
use super::limits::Limits;
use super::router::router;
use super::token::Token;
use crate::live::LiveRun;

/// The tokens of every service here.
const TOKEN: &str = "correct-horse-battery";
const OTHER_TOKEN: &str = "staple-staple-staple";

/// A service of a store in a directory of its own.
struct Bench {
    dir: TempDir,
    store: CheckpointStore,
    router: Router,
}

/// What a service answered.
#[derive(Debug)]
struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: Bytes,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {:?}", String::from_utf8_lossy(&self.body)))
    }

    /// The message of a refusal.
    fn error(&self) -> String {
        assert!(!self.status.is_success(), "{self:?}");
        self.json()["error"].as_str().unwrap_or_else(|| panic!("{self:?}")).to_owned()
    }

    fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("text"))
    }
}

impl Bench {
    /// A store with checkpoints of these iterations, beside no run.
    fn new(iterations: &[u64]) -> Self {
        Self::with(iterations, None, Limits::default())
    }

    fn with(iterations: &[u64], live: Option<LiveRun>, limits: Limits) -> Self {
        let dir = tempfile::tempdir().expect("tempdir");
        let store = CheckpointStore::new(dir.path().join("checkpoints"));
        for &iteration in iterations {
            commit(&store, iteration);
        }
        let tokens = [TOKEN, OTHER_TOKEN].map(|token| Token::parse(token, "test").expect("valid"));
        let context = Context::new(store.clone(), live, tokens.into(), limits, false);
        Self { dir, store, router: router(Arc::new(context)) }
    }

    /// Likewise, but nothing may be changed.
    fn read_only(iterations: &[u64]) -> Self {
        let Self { dir, store, .. } = Self::new(iterations);
        let token = Token::parse(TOKEN, "test").expect("valid");
        let context = Context::new(store.clone(), None, vec![token], Limits::default(), true);
        Self { dir, store, router: router(Arc::new(context)) }
    }

    /// Sends a request with these headers, and the token unless they say otherwise.
    async fn send(&self, line: &str, headers: &[(&str, &str)], body: impl Into<Body>) -> Answer {
        let (method, path) = line.split_once(' ').expect("METHOD PATH");
        let mut request = Request::builder().method(method).uri(path);
        let bearer = format!("Bearer {TOKEN}");
        for (name, value) in [("host", "127.0.0.1:8270"), ("authorization", &bearer)] {
            if !headers.iter().any(|(there, _)| *there == name) {
                request = request.header(name, value);
            }
        }
        for (name, value) in headers {
            // An empty value stands for no header.
            if !value.is_empty() {
                request = request.header(*name, *value);
            }
        }
        self.request(request.body(body.into()).expect("a request")).await
    }

    async fn request(&self, request: Request<Body>) -> Answer {
        let response = self.router.clone().oneshot(request).await.expect("infallible");
        let (parts, body) = response.into_parts();
        let body = to_bytes(body, usize::MAX).await.expect("whole");
        Answer { status: parts.status, headers: parts.headers, body }
    }

    async fn ask(&self, line: &str) -> Answer {
        self.send(line, &[], Body::empty()).await
    }

    async fn put_json(&self, path: &str, body: &str) -> Answer {
        let headers = [("content-type", "application/json")];
        self.send(&format!("PUT {path}"), &headers, body.to_owned()).await
    }

    /// Everything in the directory of the store, hidden files included, but for the store's own.
    fn inventory(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.store.root())
            .map(|entries| {
                entries
                    .map(|entry| entry.expect("entry").file_name().to_string_lossy().into_owned())
                    .filter(|name| name != ".lock" && !name.starts_with("catalogue.sqlite"))
                    .collect()
            })
            .unwrap_or_default();
        names.sort();
        names
    }
}

/// A small configuration.
fn config() -> Config {
    Layers::new(Preset::Tuned, None)
        .set("network.hidden=[4]")
        .and_then(|layers| layers.set("network.critic_hidden=[32]"))
        .and_then(|layers| layers.resolve())
        .expect("valid")
}

/// Commits a whole checkpoint whose numbers depend on the iteration, long enough for several pieces
/// of a download.
fn commit(store: &CheckpointStore, iteration: u64) -> PathBuf {
    let robot = Robot::builtin("paper").expect("built in").to_toml();
    let snapshot = snapshot_of(&config(), iteration, iteration as f32);
    store.commit(&snapshot, &config(), &robot, &serde_json::json!({})).expect("commits")
}
