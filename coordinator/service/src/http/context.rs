//! What all requests share.

use std::sync::Arc;

use axum::http::StatusCode;
use store::checkpoint::{Checked, CheckpointError, CheckpointStore, LockTimeout};
use tokio::sync::{Mutex, watch};

use super::limits::Limits;
use super::places::Places;
use super::problem::Problem;
use super::requests::Requests;
use super::run_directory::Runs;
use super::token::Token;
use super::upload_space;
use crate::live::LiveRun;

/// The state that handlers are given.
pub(super) type Shared = Arc<Context>;

/// What all requests share.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) store: CheckpointStore,
    pub(super) live: Option<LiveRun>,
    /// The runs of a directory, if those are served.
    pub(super) runs: Option<Runs>,
    /// Whoever shows one of them may do everything.
    tokens: Vec<Token>,
    pub(super) limits: Limits,
    /// Whether nothing may be changed.
    pub(super) read_only: bool,
    /// Which files were found whole.
    pub(super) checked: Arc<Checked>,
    /// Counts requests.
    pub(super) requests: Requests,
    /// Bounds what clients do at a time.
    pub(super) places: Places,
    /// Becomes true when the service stops, which ends what has no end of its own.
    pub(super) stopping: watch::Sender<bool>,
    /// Held while an upload is taken into the store: two of one name meet there, not on the way.
    pub(super) import: Mutex<()>,
}

impl Context {
    pub(super) fn new(
        store: CheckpointStore,
        live: Option<LiveRun>,
        tokens: Vec<Token>,
        limits: Limits,
        read_only: bool,
    ) -> Self {
        Self {
            store: store.with_patience(LockTimeout::new(limits.lock_time)),
            live,
            runs: None,
            tokens,
            checked: Arc::default(),
            requests: Requests::default(),
            places: Places::new(&limits),
            stopping: watch::Sender::new(false),
            import: Mutex::new(()),
            limits,
            read_only,
        }
    }

    /// That of a directory of runs.
    pub(super) fn of_runs(self, runs: Option<Runs>) -> Self {
        Self { runs, ..self }
    }

    /// That of one of several runs, for looking only; it stops when this one does, and shares its places.
    pub(super) fn of_one_run(&self, store: CheckpointStore) -> Self {
        let own = Self::new(store, None, self.tokens.clone(), self.limits.clone(), true);
        Self { places: self.places.clone(), stopping: self.stopping.clone(), ..own }
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

    /// Likewise, for what changes the store.
    pub(super) async fn changing<T: Send + 'static>(
        &self,
        work: impl FnOnce(&CheckpointStore, &Checked) -> Result<T, CheckpointError> + Send + 'static,
    ) -> Result<T, Problem> {
        let place = self.places.changes.take()?;
        self.with_checked(move |store, checked| {
            // Until it is done, also if the client has gone meanwhile.
            let _place = place;
            work(store, checked)
        })
        .await
    }

    /// Whether what a client offers is a token of the service. All are compared, so that the time
    /// that it takes says nothing.
    pub(super) fn knows(&self, offered: &[u8]) -> bool {
        self.tokens.iter().fold(false, |known, token| token.matches(offered) | known)
    }

    /// Largest upload that is taken (bytes). Beside a live run it is a few times that run's state:
    /// an upload takes from the run's disk and processor. So do all together, and are refused when
    /// they have taken enough.
    pub(super) async fn upload_limit(&self) -> Result<u64, Problem> {
        let limits = &self.limits;
        if self.live.is_none() {
            return Ok(limits.upload_bytes);
        }
        let survey = self.with_store(CheckpointStore::survey).await?;
        let (own, foreign): (Vec<_>, Vec<_>) = survey
            .entries
            .iter()
            .partition(|entry| entry.name.iteration().is_some() && !entry.labels.imported);
        let state = own.iter().map(|entry| entry.bytes).max().unwrap_or(0);
        let beside = limits.live_upload_states.saturating_mul(state);
        let limit = beside.max(limits.live_upload_bytes).min(limits.upload_bytes);
        let taken = foreign.iter().fold(0, |sum: u64, entry| sum.saturating_add(entry.bytes));
        upload_space::check_total(taken, limits.live_uploads.saturating_mul(limit))?;
        Ok(limit)
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
