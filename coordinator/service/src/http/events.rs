//! All that happens, as it happens: one stream of server-sent events for each page that looks.
//!
//! What is recorded comes from the files, so that whoever was away says where it stopped and is sent the rest. The
//! files are looked at twice a second, whoever writes them; what has not changed is not sent.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::path::Path;
use std::time::Duration;

use axum::extract::State;
use axum::http::Uri;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{self, Stream};
use proto::run_dir::RunDir;
use serde::Serialize;
use serde::de::IgnoredAny;
use store::checkpoint::CheckpointStore;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{Interval, MissedTickBehavior, interval};

use super::checkpoints::CheckpointList;
use super::context::{Shared, blocking};
use super::log_lines::{LogLine, LogTails};
use super::problem::{ErrorBody, Problem};
use super::recorded::{self, piece};
use super::run_directory::trains;

/// Time between two looks.
const LOOK: Duration = Duration::from_millis(500);
/// How often a silent stream shows that it lives.
const ALIVE: Duration = Duration::from_secs(10);

/// All that happens, as server-sent events. `status`, `happened`: of the live run; `metrics`, `evaluations`: lines that
/// were recorded, from a place to the next (`from` 0: all before is void); `logs`: lines of the processes' logs;
/// `trains`: whether the run whose checkpoints these are goes on; `checkpoints`: the list, when it has changed.
#[utoipa::path(get, path = "/v1/events", tag = "run",
    params(
        ("metrics" = Option<u64>, Query, description = "Where lines of the metrics begin (bytes): the last `next`"),
        ("evaluations" = Option<u64>, Query, description = "Likewise, of the evaluations"),
    ),
    responses(
        (status = 200, description = "A stream without an end", body = String, content_type = "text/event-stream"),
        (status = 422, description = "A place is no number", body = ErrorBody),
        (status = 503, description = "Too many look already", body = ErrorBody),
    )
)]
pub(super) async fn events(
    State(context): State<Shared>,
    uri: Uri,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let place = |name| recorded::place(uri.query(), name);
    let (metrics, evaluations) = (place("metrics")?, place("evaluations")?);
    let watcher = Watcher::new(context, metrics, evaluations)?;
    let stream = stream::unfold(watcher, |mut watcher| async move {
        let event = watcher.next().await?;
        Some((Ok(event), watcher))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(ALIVE)))
}

/// A page that looks, and what it has been sent.
struct Watcher {
    context: Shared,
    files: Files,
    happened: u64,
    /// How the store looked when it was last listed, and the list.
    checkpoints: Option<(Vec<u8>, CheckpointList)>,
    waiting: VecDeque<Event>,
    looks: Interval,
    stopping: watch::Receiver<bool>,
    _place: OwnedSemaphorePermit,
}

/// Where it is in the files of the run.
#[derive(Default)]
struct Files {
    run: Option<RunDir>,
    trains: Option<bool>,
    metrics: u64,
    evaluations: u64,
    logs: LogTails,
}

/// What has happened in a live run.
#[derive(Serialize)]
struct Happened {
    /// The time of the run now (s).
    now_s: f64,
    list: Vec<crate::history::Happening>,
}

impl Watcher {
    fn new(context: Shared, metrics: u64, evaluations: u64) -> Result<Self, Problem> {
        let place = context.places.watchers.take()?;
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let files =
            Files { run: recorded::run_of(&context), metrics, evaluations, ..Files::default() };
        let stopping = context.stopping.subscribe();
        Ok(Self {
            context,
            files,
            happened: 0,
            checkpoints: None,
            waiting: VecDeque::new(),
            looks,
            stopping,
            _place: place,
        })
    }

    /// The next thing to say; none when the service stops.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if *self.stopping.borrow() {
                return None;
            }
            if let Some(event) = self.waiting.pop_front() {
                return Some(event);
            }
            tokio::select! {
                _ = self.looks.tick() => self.look().await,
                _ = self.stopping.changed() => {}
            }
        }
    }

    /// Looks at everything once. What cannot be read now may be later.
    async fn look(&mut self) {
        if let Some(live) = &self.context.live {
            self.waiting.push_back(event("status", &live.status()));
            let (list, next, now_s) = live.happened(self.happened);
            self.happened = next;
            self.waiting.push_back(event("happened", &Happened { now_s, list }));
        }
        let files = std::mem::take(&mut self.files);
        match blocking(move || files.read()).await {
            Ok((files, events)) => {
                self.files = files;
                self.waiting.extend(events);
            }
            Err(problem) => tracing::debug!(problem.message, "the files were not looked at"),
        }
        match self.list().await {
            Ok(found) => self.waiting.extend(found),
            Err(problem) => tracing::debug!(problem.message, "the checkpoints were not listed"),
        }
    }

    /// The checkpoints, if there are others than before.
    async fn list(&mut self) -> Result<Option<Event>, Problem> {
        let root = self.context.store.root().to_owned();
        let now = blocking(move || fingerprint(&root)).await?;
        if self.checkpoints.as_ref().is_some_and(|(before, _)| *before == now) {
            return Ok(None);
        }
        let survey = self.context.with_store(CheckpointStore::survey).await?;
        let list = CheckpointList { checkpoints: survey.entries, damaged: survey.damaged };
        // Files may be written anew with what was in them.
        let is_new = self.checkpoints.as_ref().is_none_or(|(_, before)| *before != list);
        let event = is_new.then(|| event("checkpoints", &list));
        self.checkpoints = Some((now, list));
        Ok(event)
    }
}

impl Files {
    /// What is new in them.
    fn read(mut self) -> (Self, Vec<Event>) {
        let mut events = Vec::new();
        if let Some(run) = &self.run {
            let trains = trains(run);
            if self.trains.replace(trains) != Some(trains) {
                events.push(event("trains", &trains));
            }
            events.extend(lines("metrics", &run.metrics_jsonl(), &mut self.metrics));
            events.extend(lines("evaluations", &run.evaluations(), &mut self.evaluations));
            let new: Vec<LogLine> = self.logs.read(&run.logs());
            if !new.is_empty() {
                events.push(event("logs", &new));
            }
        }
        (self, events)
    }
}

/// Lines of a file that are new. Those that are no JSON, which only somebody else can have written, are left out.
fn lines(name: &str, path: &Path, place: &mut u64) -> Option<Event> {
    let (from, bytes) = piece(path, *place).ok()?;
    let next = from + bytes.len() as u64;
    if bytes.is_empty() && next == *place {
        return None;
    }
    *place = next;
    let text = String::from_utf8_lossy(&bytes);
    let is_json = |line: &&str| serde_json::from_str::<IgnoredAny>(line).is_ok();
    let lines: Vec<&str> = text.lines().filter(is_json).collect();
    let data = format!("{{\"from\":{from},\"next\":{next},\"lines\":[{}]}}", lines.join(","));
    Some(named(name, &data))
}

/// What differs when a checkpoint has come, gone, or got other labels: each is another directory entry.
fn fingerprint(root: &Path) -> Vec<u8> {
    let mut all: Vec<_> = std::fs::read_dir(root)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| Some((entry.file_name(), entry.metadata().ok()?.modified().ok()?)))
        .collect();
    all.sort();
    format!("{all:?}").into_bytes()
}

fn event(name: &str, data: &impl Serialize) -> Event {
    named(name, &serde_json::to_string(data).unwrap_or_else(|_| "null".to_owned()))
}

fn named(name: &str, data: &str) -> Event {
    // Between the values of a JSON text line breaks mean nothing; inside an event they would.
    Event::default().event(name).data(data.replace(['\r', '\n'], " "))
}

impl std::fmt::Debug for Watcher {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Watcher").finish_non_exhaustive()
    }
}
