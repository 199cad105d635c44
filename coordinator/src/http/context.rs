//! What all requests share.

use std::sync::Arc;

use axum::http::StatusCode;
use tokio::sync::{Mutex, Semaphore};

use super::limits::Limits;
use super::problem::Problem;
use super::requests::Requests;
use super::token::Token;
use crate::checkpoint::{Checked, CheckpointError, CheckpointStore};
use crate::live::LiveRun;

/// The state that handlers are given.
pub(super) type Shared = Arc<Context>;

/// What all requests share.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) store: CheckpointStore,
    pub(super) live: Option<LiveRun>,
    pub(super) token: Option<Token>,
    pub(super) limits: Limits,
    /// Which files were found whole.
    pub(super) checked: Arc<Checked>,
    /// Counts requests.
    pub(super) requests: Requests,
    /// Bounds uploads.
    pub(super) uploads: Arc<Semaphore>,
    /// Bounds archives on their way out.
    pub(super) archives: Arc<Semaphore>,
    /// Held while an upload is taken into the store: two of one name meet there, not on the way.
    pub(super) import: Mutex<()>,
}

impl Context {
    pub(super) fn new(
        store: CheckpointStore,
        live: Option<LiveRun>,
        token: Option<Token>,
        limits: Limits,
    ) -> Self {
        Self {
            store,
            live,
            token,
            checked: Arc::default(),
            requests: Requests::default(),
            uploads: Arc::new(Semaphore::new(limits.uploads)),
            archives: Arc::new(Semaphore::new(limits.archives)),
            import: Mutex::new(()),
            limits,
        }
    }

    /// Does something with the store on a thread that may wait for the disk.
    pub(super) async fn with_store<T: Send + 'static>(
        &self,
        work: impl FnOnce(&CheckpointStore) -> Result<T, CheckpointError> + Send + 'static,
    ) -> Result<T, Problem> {
        let store = self.store.clone();
        Ok(blocking(move || work(&store)).await??)
    }

    /// Likewise, with the knowledge of which files are whole.
    pub(super) async fn with_checked<T: Send + 'static>(
        &self,
        work: impl FnOnce(&CheckpointStore, &Checked) -> Result<T, CheckpointError> + Send + 'static,
    ) -> Result<T, Problem> {
        let checked = Arc::clone(&self.checked);
        self.with_store(move |store| work(store, &checked)).await
    }

    /// Largest upload that is taken (bytes). Beside a live run it is a few times that run's state:
    /// an upload takes from the run's disk and processor.
    pub(super) async fn upload_limit(&self) -> Result<u64, Problem> {
        let limits = &self.limits;
        if self.live.is_none() {
            return Ok(limits.upload_bytes);
        }
        let survey = self.with_store(CheckpointStore::survey).await?;
        let own = survey
            .entries
            .iter()
            .filter(|entry| entry.name.iteration().is_some() && !entry.labels.imported);
        let state = own.map(|entry| entry.bytes).max().unwrap_or(0);
        let beside = limits.live_upload_states.saturating_mul(state);
        Ok(beside.max(limits.live_upload_bytes).min(limits.upload_bytes))
    }

    /// The live run, or an answer that says that there is none.
    pub(super) fn live(&self) -> Result<&LiveRun, Problem> {
        self.live.as_ref().ok_or_else(|| {
            Problem::new(
                StatusCode::NOT_FOUND,
                "this service stands beside no live run: it was started by `octopus serve`; the \
                 service of a run is named in its run.lock",
            )
        })
    }
}

/// Runs `work` on a thread that may wait.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Problem::internal(&error))
}
