//! What differs between two checkpoints.

use axum::Json;
use axum::extract::State;
use store::checkpoint::{Difference, compare_policies};

use super::checkpoints::find;
use super::context::Shared;
use super::params::Params;
use super::problem::{ErrorBody, Problem};

/// What differs between two checkpoints: keys of their configurations, robots, and tensors of their policies. Training
/// states are left out; `octopus checkpoints diff` compares these, too.
#[utoipa::path(get, path = "/v1/checkpoints/{name}/differences/{other}", tag = "checkpoints",
    operation_id = "differences",
    params(
        ("name" = String, Path, description = "Name, tag, `latest` or `best`"),
        ("other" = String, Path, description = "Likewise"),
    ),
    responses(
        (status = 200, description = "What differs", body = Difference),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 500, description = "One of them is damaged", body = ErrorBody),
        (status = 503, description = "Too many at once; try again", body = ErrorBody),
    )
)]
pub(super) async fn show(
    State(context): State<Shared>,
    Params((name, other)): Params<(String, String)>,
) -> Result<Json<Difference>, Problem> {
    // Each reads whole policies, as an archive does.
    let place = context.places.archives.take()?;
    let difference = context
        .with_checked(move |store, checked| {
            let _place = place;
            let dirs = [find(store, checked, &name)?, find(store, checked, &other)?];
            let [a, b] = dirs.map(|choice| checked.load(&choice.entry.dir));
            compare_policies(&a?, &b?)
        })
        .await?;
    Ok(Json(difference))
}
