//! Checkpoints as JSON: the list, one of them, pins, tags, removal.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::context::Shared;
use super::params::Params;
use super::problem::{ErrorBody, Problem};
use crate::checkpoint::{
    CheckpointError, CheckpointStore, DamagedEntry, Entry, Kind, LATEST, Manifest, Name,
};

/// Everything in the store.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckpointList {
    /// Checkpoints, the run's own last and in order of iteration.
    pub checkpoints: Vec<Entry>,
    /// Directories whose manifest cannot be read.
    pub damaged: Vec<DamagedEntry>,
}

/// One checkpoint and what its manifest says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckpointDetail {
    /// The checkpoint at a glance.
    #[serde(flatten)]
    pub entry: Entry,
    /// Its manifest.
    pub manifest: Manifest,
}

/// All checkpoints.
#[utoipa::path(get, path = "/v1/checkpoints", tag = "checkpoints", responses(
    (status = 200, description = "All of them", body = CheckpointList),
    (status = 500, description = "The store cannot be read", body = ErrorBody),
))]
pub(super) async fn list(State(context): State<Shared>) -> Result<Json<CheckpointList>, Problem> {
    let survey = context.with_store(CheckpointStore::survey).await?;
    Ok(Json(CheckpointList { checkpoints: survey.entries, damaged: survey.damaged }))
}

/// One checkpoint, by its name, a tag, `latest` or `best`.
#[utoipa::path(get, path = "/v1/checkpoints/{name}", tag = "checkpoints",
    params(("name" = String, Path, description = "Name, tag, `latest` or `best`")),
    responses(
        (status = 200, description = "It and its manifest", body = CheckpointDetail),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 500, description = "Its manifest is damaged", body = ErrorBody),
    )
)]
pub(super) async fn show(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<Json<CheckpointDetail>, Problem> {
    let detail = context
        .with_store(move |store| {
            let entry = find(store, &name)?;
            let manifest = Manifest::read(&entry.dir)?;
            Ok(CheckpointDetail { entry, manifest })
        })
        .await?;
    Ok(Json(detail))
}

/// Removes a checkpoint. Wants its own name, because what a tag means may change meanwhile.
#[utoipa::path(delete, path = "/v1/checkpoints/{name}", tag = "checkpoints",
    params(("name" = String, Path, description = "Name")),
    responses(
        (status = 204, description = "Removed"),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 409, description = "It is pinned", body = ErrorBody),
    )
)]
pub(super) async fn delete(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<StatusCode, Problem> {
    context.with_store(move |store| store.delete(&name.parse()?)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Keeps a checkpoint until it is unpinned.
#[utoipa::path(put, path = "/v1/checkpoints/{name}/pin", tag = "checkpoints",
    params(("name" = String, Path, description = "Name")),
    responses(
        (status = 200, description = "As it is now", body = Entry),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
    )
)]
pub(super) async fn pin(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<Json<Entry>, Problem> {
    change(&context, name, |store, name| store.pin(name, true)).await
}

/// Lets a checkpoint go.
#[utoipa::path(delete, path = "/v1/checkpoints/{name}/pin", tag = "checkpoints",
    params(("name" = String, Path, description = "Name")),
    responses(
        (status = 200, description = "As it is now", body = Entry),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
    )
)]
pub(super) async fn unpin(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<Json<Entry>, Problem> {
    change(&context, name, |store, name| store.pin(name, false)).await
}

/// Gives a checkpoint a tag, and takes it from the one that had it.
#[utoipa::path(put, path = "/v1/checkpoints/{name}/tags/{tag}", tag = "checkpoints",
    params(
        ("name" = String, Path, description = "Name"),
        ("tag" = String, Path, description = "Tag"),
    ),
    responses(
        (status = 200, description = "As it is now", body = Entry),
        (status = 400, description = "Not a name or tag", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 422, description = "A tag that cannot be given", body = ErrorBody),
    )
)]
pub(super) async fn tag(
    State(context): State<Shared>,
    Params((name, tag)): Params<(String, String)>,
) -> Result<Json<Entry>, Problem> {
    change(&context, name, move |store, name| store.tag(name, &tag)).await
}

/// Takes a tag from a checkpoint.
#[utoipa::path(delete, path = "/v1/checkpoints/{name}/tags/{tag}", tag = "checkpoints",
    params(
        ("name" = String, Path, description = "Name"),
        ("tag" = String, Path, description = "Tag"),
    ),
    responses(
        (status = 200, description = "As it is now", body = Entry),
        (status = 400, description = "Not a name or tag", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 422, description = "It has no such tag, or one that moves by itself", body = ErrorBody),
    )
)]
pub(super) async fn untag(
    State(context): State<Shared>,
    Params((name, tag)): Params<(String, String)>,
) -> Result<Json<Entry>, Problem> {
    change(&context, name, move |store, name| store.untag(name, &tag)).await
}

/// Changes something about a checkpoint and shows it as it is then.
async fn change(
    context: &Shared,
    name: String,
    work: impl FnOnce(&CheckpointStore, &Name) -> Result<(), CheckpointError> + Send + 'static,
) -> Result<Json<Entry>, Problem> {
    let entry = context
        .with_store(move |store| {
            let name: Name = name.parse()?;
            work(store, &name)?;
            store.entry(&name)
        })
        .await?;
    Ok(Json(entry))
}

/// The checkpoint that a path names: by its own name, a tag, `latest` or `best`. Unlike a
/// [`Selector`](crate::checkpoint::Selector) this reads manifests only, as every request does it.
pub(super) fn find(store: &CheckpointStore, text: &str) -> Result<Entry, CheckpointError> {
    let name: Name = text.parse()?;
    let there = store.entry(&name);
    if let Err(CheckpointError::NotFound { .. }) = &there {
        let own = |entry: &Entry| entry.name.iteration().is_some() && entry.kind == Kind::Training;
        let entries = store.entries()?;
        let latest = entries.iter().rfind(|entry| text == LATEST && own(entry));
        let tagged = || entries.iter().find(|entry| entry.labels.has_tag(text));
        if let Some(entry) = latest.or_else(tagged) {
            return Ok(entry.clone());
        }
    }
    there
}
