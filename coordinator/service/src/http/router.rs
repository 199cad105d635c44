//! All routes, each with its description.

use std::sync::LazyLock;

use axum::extract::{Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get};
use axum::{Extension, Json, Router};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::context::Shared;
use super::counting;
use super::problem::Problem;
use super::{
    access, archives, checkpoints, differences, document, events, files, metrics, page, recorded,
    run, runs, uploads,
};

/// All routes and the document that describes them.
fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(document::head())
        .routes(routes!(page::home))
        .routes(routes!(page::file))
        .routes(routes!(health))
        .routes(routes!(metrics::metrics))
        .routes(routes!(openapi))
        .routes(routes!(checkpoints::list, run::commit))
        .routes(routes!(checkpoints::show, uploads::upload, checkpoints::delete))
        .routes(routes!(archives::download))
        .routes(routes!(files::download))
        .routes(routes!(differences::show))
        .routes(routes!(checkpoints::pin, checkpoints::unpin))
        .routes(routes!(checkpoints::tag, checkpoints::untag))
        .routes(routes!(events::events))
        .routes(routes!(recorded::metrics))
        .routes(routes!(recorded::evaluations))
        .routes(routes!(run::status))
        .routes(routes!(run::scale))
        .routes(routes!(runs::list))
        .routes(routes!(runs::one))
}

/// The whole service: routes, refusals, and the layers around them.
pub(super) fn router(context: Shared) -> Router {
    Router::from(routes())
        // Of one run; axum writes a path of several parts so, and OpenAPI cannot.
        .route("/runs/{run}/", get(runs::one))
        .route("/runs/{run}/{first}/{*rest}", any(runs::one))
        .fallback(no_route)
        .method_not_allowed_fallback(no_method)
        .layer(Extension(runs::Serve(router)))
        .layer(from_fn_with_state(context.clone(), access::layer))
        .layer(from_fn_with_state(context.clone(), counting::layer))
        .layer(from_fn(caution))
        .with_state(context)
}

/// How the service is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(super) struct Health {
    /// `ok`.
    status: String,
    /// Version of the program.
    version: String,
    /// Whether it refuses to change anything.
    read_only: bool,
    /// What it serves: a `run`, live or not, a `store` of checkpoints, or all `runs` of a directory.
    serves: String,
}

/// Says that the service is alive. Needs no token.
#[utoipa::path(get, path = "/health", tag = "service", security(()), responses(
    (status = 200, description = "Alive", body = Health),
))]
async fn health(State(context): State<Shared>) -> Json<Health> {
    Json(Health {
        status: "ok".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        read_only: context.read_only,
        serves: match (&context.runs, recorded::run_of(&context)) {
            (Some(_), _) => "runs",
            (None, Some(_)) => "run",
            (None, None) => "store",
        }
        .to_owned(),
    })
}

/// This document.
#[utoipa::path(get, path = "/openapi.json", tag = "service", responses(
    (status = 200, description = "OpenAPI 3.1", body = Object),
))]
async fn openapi() -> impl IntoResponse {
    static DOCUMENT: LazyLock<String> = LazyLock::new(|| {
        let mut document = routes().into_openapi();
        document::complete(&mut document);
        document.to_pretty_json().expect("the document has a JSON form")
    });
    ([(CONTENT_TYPE, "application/json")], DOCUMENT.as_str())
}

async fn no_route(request: Request) -> Problem {
    let message = format!("no `{}` here; GET /openapi.json lists what is", request.uri().path());
    Problem::new(StatusCode::NOT_FOUND, message)
}

async fn no_method(request: Request) -> Problem {
    let message = format!(
        "`{}` has no method {}; the Allow header lists its methods",
        request.uri().path(),
        request.method()
    );
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, message)
}

/// Whatever is served, no browser shall take it for a page or keep what a token protects.
async fn caution(request: Request, next: axum::middleware::Next) -> Response {
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    headers.insert("x-content-type-options", HeaderValue::from_static("nosniff"));
    headers.entry("cache-control").or_insert(HeaderValue::from_static("no-store"));
    response
}
