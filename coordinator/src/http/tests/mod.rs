//! The service without a network: requests go straight through the router.

mod access;
mod checkpoints;
mod files;
mod fuzz;
mod run;
mod service;
mod uploads;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::http::{HeaderMap, Request, StatusCode};
use proto::DigestBuilder;
use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::Value;
use simulator::robot::Robot;
use tempfile::TempDir;
use tower::ServiceExt as _;

use super::context::Context;
use super::limits::Limits;
use super::router::router;
use super::token::Token;
use crate::checkpoint::{CheckpointStore, Snapshot};
use crate::live::LiveRun;

/// A token.
const TOKEN: &str = "correct-horse-battery";

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
    /// A store with checkpoints of these iterations, beside no run, without a token.
    fn new(iterations: &[u64]) -> Self {
        Self::with(iterations, None, None, Limits::default())
    }

    fn with(
        iterations: &[u64],
        live: Option<LiveRun>,
        token: Option<&str>,
        limits: Limits,
    ) -> Self {
        let dir = tempfile::tempdir().expect("tempdir");
        let store = CheckpointStore::new(dir.path().join("checkpoints"));
        for &iteration in iterations {
            commit(&store, iteration);
        }
        let token = token.map(|token| Token::parse(token, "test").expect("valid"));
        let context = Context::new(store.clone(), live, token, limits);
        Self { dir, store, router: router(Arc::new(context)) }
    }

    /// Sends a request with these headers, as a client on this machine does.
    async fn send(&self, line: &str, headers: &[(&str, &str)], body: impl Into<Body>) -> Answer {
        let (method, path) = line.split_once(' ').expect("METHOD PATH");
        let mut request = Request::builder().method(method).uri(path);
        if !headers.iter().any(|(name, _)| *name == "host") {
            request = request.header("host", "127.0.0.1:8270");
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
        .and_then(|layers| layers.resolve())
        .expect("valid")
}

/// Commits a whole checkpoint whose numbers depend on the iteration.
fn commit(store: &CheckpointStore, iteration: u64) -> PathBuf {
    let robot = Robot::builtin("paper").expect("built in");
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), robot.n_arms));
    let values: Vec<u8> =
        (0..layout.len).flat_map(|index| (index as f32 + iteration as f32).to_le_bytes()).collect();
    // Long enough for several pieces of a download.
    let moments: Vec<u8> =
        (0..100_000u64).flat_map(|index| ((index ^ iteration) as f64).to_le_bytes()).collect();
    let counter = iteration.to_le_bytes();
    let mut tensors = vec![
        ("counter", TensorView::new(Dtype::I64, vec![1], &counter).expect("eight bytes")),
        ("moments", TensorView::new(Dtype::F64, vec![100_000], &moments).expect("sized")),
    ]
    .into_iter()
    .map(|(name, view)| (name.to_owned(), view))
    .collect::<Vec<_>>();
    let mut digest = DigestBuilder::new();
    for (name, view) in &tensors {
        digest.field(name, view.data());
    }
    for spec in &layout.tensors {
        let bytes = &values[4 * spec.offset..4 * spec.range().end];
        let view = TensorView::new(Dtype::F32, spec.shape.clone(), bytes).expect("sized");
        tensors.push((format!("policy.{}", spec.name), view));
    }
    let metadata = HashMap::from([("iteration".to_owned(), iteration.to_string())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).expect("serialises");
    let snapshot = Snapshot { iteration, digest: digest.finish(), bytes };
    let toml = robot.to_toml();
    store.commit(&snapshot, &config(), &toml, &serde_json::json!({})).expect("commits")
}
