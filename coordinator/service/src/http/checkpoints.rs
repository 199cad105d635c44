//! Checkpoints as JSON: the list, one of them, pins, tags, removal.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, StatusCode};
use axum::response::IntoResponse as _;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use store::checkpoint::{
    Checked, CheckpointError, CheckpointStore, DamagedEntry, Entry, Kind, LATEST, Manifest, Name,
    Ownership,
};
use utoipa::ToSchema;

use super::context::Shared;
use super::document::Refusals;
use super::params::Params;
use super::problem::{ErrorBody, Problem};

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
        (status = 200, description = "It and its manifest", body = CheckpointDetail,
            headers(("octopus-passed-over" = String,
                description = "Newer ones than `latest` that are damaged"))),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 500, description = "Its manifest is damaged", body = ErrorBody),
    )
)]
pub(super) async fn show(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<Response, Problem> {
    let (choice, manifest) = context
        .with_checked(move |store, checked| {
            let choice = find(store, checked, &name)?;
            let manifest = Manifest::read(&choice.entry.dir)?;
            Ok((choice, manifest))
        })
        .await?;
    let header = choice.header();
    Ok((header, Json(CheckpointDetail { entry: choice.entry, manifest })).into_response())
}

/// Removes a checkpoint. Wants its own name, because what a tag means may change meanwhile.
#[utoipa::path(delete, path = "/v1/checkpoints/{name}", tag = "checkpoints",
    params(("name" = String, Path, description = "Name")),
    responses(
        Refusals,
        (status = 204, description = "Removed"),
        (status = 409, description = "It is pinned, it is the newest whole one of its run, or this \
            is not its own name", body = ErrorBody),
    )
)]
pub(super) async fn delete(
    State(context): State<Shared>,
    Params(name): Params<String>,
) -> Result<StatusCode, Problem> {
    own(&context, name, CheckpointStore::delete).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Keeps a checkpoint until it is unpinned.
#[utoipa::path(put, path = "/v1/checkpoints/{name}/pin", tag = "checkpoints",
    params(("name" = String, Path, description = "Name")),
    responses(Refusals, (status = 200, description = "As it is now", body = Entry))
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
    responses(Refusals, (status = 200, description = "As it is now", body = Entry))
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
        Refusals,
        (status = 200, description = "As it is now", body = Entry),
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
        Refusals,
        (status = 200, description = "As it is now", body = Entry),
        (status = 404, description = "No such checkpoint, or it has no such tag", body = ErrorBody),
        (status = 422, description = "A tag that moves by itself", body = ErrorBody),
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
    let work = |store: &CheckpointStore, name: &Name| {
        work(store, name)?;
        store.entry(name)
    };
    Ok(Json(own(context, name, work).await?))
}

/// Does something to the checkpoint whose own name is `name`. What `latest`, `best` or a tag mean may
/// change before it is done, so these are refused, with what they mean now.
async fn own<T: Send + 'static>(
    context: &Shared,
    name: String,
    work: impl FnOnce(&CheckpointStore, &Name) -> Result<T, CheckpointError> + Send + 'static,
) -> Result<T, Problem> {
    let done = context.changing(move |store, checked| {
        let name: Name = name.parse()?;
        match work(store, &name) {
            Err(absent @ CheckpointError::Absent { .. }) => {
                match find(store, checked, name.as_str()) {
                    Ok(choice) => Ok(Err((name, choice.entry.name))),
                    Err(_) => Err(absent),
                }
            }
            outcome => outcome.map(Ok),
        }
    });
    done.await?.map_err(|(said, now)| {
        let message = format!(
            "name the checkpoint itself: `{said}` is now {now}, and may soon be another one"
        );
        Problem::new(StatusCode::CONFLICT, message)
    })
}

/// Names the damaged checkpoints that were newer than the one that `latest` gave.
pub(super) const PASSED_OVER: HeaderName = HeaderName::from_static("octopus-passed-over");
/// Most names in that header.
const MAX_PASSED: usize = 16;

/// What a path names.
#[derive(Debug)]
pub(super) struct Choice {
    pub(super) entry: Entry,
    /// Newer ones that `latest` would be if they were not damaged.
    passed_over: Vec<Name>,
}

impl Choice {
    /// The header that says what was passed over, if anything was.
    pub(super) fn header(&self) -> Option<[(HeaderName, String); 1]> {
        let names: Vec<&str> = self.passed_over.iter().map(Name::as_str).take(MAX_PASSED).collect();
        (!names.is_empty()).then(|| [(PASSED_OVER, names.join(", "))])
    }
}

/// The checkpoint that a path names: by its own name, a tag, `latest` or `best`. Unlike a
/// [`Selector`](store::checkpoint::Selector) this hashes nothing twice, as every request does it.
pub(super) fn find(
    store: &CheckpointStore,
    checked: &Checked,
    text: &str,
) -> Result<Choice, CheckpointError> {
    let name: Name = text.parse()?;
    if text == LATEST {
        return latest(store, checked);
    }
    let entry = match store.entry(&name) {
        Err(absent @ CheckpointError::Absent { .. }) => {
            let mut entries = store.entries()?.into_iter();
            entries.find(|entry| entry.labels.has_tag(text)).ok_or(absent)?
        }
        there => there?,
    };
    Ok(Choice { entry, passed_over: Vec::new() })
}

/// The newest of the run's own checkpoints from which training can go on and that is whole; one that the run
/// has not come to itself only where there is no other.
fn latest(store: &CheckpointStore, checked: &Checked) -> Result<Choice, CheckpointError> {
    let survey = store.survey()?;
    let damaged = survey.damaged.into_iter().map(|damaged| {
        let DamagedEntry { name, dir, reason } = damaged;
        (name, Err(CheckpointError::Damaged { path: dir, reason }))
    });
    let whole = survey.entries.into_iter().filter(|entry| entry.kind == Kind::Training);
    let mut own: Vec<(Name, Result<Entry, CheckpointError>)> =
        whole.map(|entry| (entry.name.clone(), Ok(entry))).chain(damaged).collect();
    own.retain(|(name, _)| name.iteration().is_some());
    own.sort_by_key(|(name, _)| name.iteration());
    let ownership = Ownership::of(store);
    let (foreign, own): (Vec<_>, Vec<_>) = own.into_iter().rev().partition(|(name, entry)| {
        let manifest = entry.as_ref().ok().map(|entry| (entry.iteration, entry.digest));
        ownership.is_foreign(&store.dir(name), manifest)
    });
    let mut passed_over = Vec::new();
    let mut newest_damage = None;
    for (name, entry) in own.into_iter().chain(foreign) {
        match entry.and_then(|entry| checked.check(&entry.dir).map(|()| entry)) {
            Ok(entry) => return Ok(Choice { entry, passed_over }),
            // Removed meanwhile.
            Err(_) if !store.dir(&name).exists() => {}
            Err(error) => {
                tracing::debug!(%error, "`latest` is the one before");
                passed_over.push(name);
                newest_damage.get_or_insert(error);
            }
        }
    }
    Err(newest_damage.unwrap_or_else(|| CheckpointError::NotFound {
        path: store.root().to_owned(),
        what: "no `latest` here: no checkpoint of a run from which training can go on".to_owned(),
    }))
}
