//! What `/openapi.json` says beside the routes: its head, and what every route may answer.

use std::collections::BTreeMap;

use utoipa::openapi::path::Operation;
use utoipa::openapi::schema::{KnownFormat, SchemaFormat, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, ObjectBuilder, OpenApi as Document, Ref, RefOr, Response, ResponseBuilder,
    Schema,
};
use utoipa::{IntoResponses, Modify, OpenApi, PartialSchema, ToSchema};

use super::access;

const DESCRIPTION: &str = "\
Checkpoints of multi-arm space robots' training, and the run that makes them if the service stands \
beside one (`octopus train`). `octopus serve` stands beside none: `/v1/status`, `/v1/workers` and POST \
of `/v1/checkpoints` answer 404 then, and so do `/v1/metrics` and `/v1/evaluations` where the checkpoints \
are not those of a run. `octopus serve --runs` serves all runs of a directory, in `/v1/runs` and below \
`/runs/`.

Where a route reads, NAME is a checkpoint's own name, a tag, `latest` (the newest whole one from \
which training can go on) or `best` (the one with the lowest score). Where a route changes \
something it is the checkpoint's own name; anything else is answered with 409 and what it means now.

Every failure is `{\"error\": \"...\"}`, but for what is wrong with a request's head. A path that is \
not listed here is answered with 404, a method that is not listed for its path with 405 and the \
header `Allow`.";

const TOKEN: &str = "\
That in the file `http.token` of the run directory, or `.http.token` of the store that is served, \
which only the service's user can read; or the one that the service was started with.";

/// The document's head; the routes add themselves.
#[derive(Debug, OpenApi)]
#[openapi(
    info(
        title = "SpaceOctopus checkpoint service",
        description = DESCRIPTION
    ),
    servers((url = "/", description = "This service")),
    tags(
        (name = "checkpoints", description = "Committed training states"),
        (name = "run", description = "Runs: what they do and have recorded"),
        (name = "service", description = "The service itself"),
    ),
    security(("token" = [])),
    modifiers(&TokenScheme),
)]
struct Head;

struct TokenScheme;

impl Modify for TokenScheme {
    fn modify(&self, document: &mut Document) {
        let scheme =
            HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(TOKEN)).build();
        let components = document.components.get_or_insert_default();
        components.add_security_scheme("token", SecurityScheme::Http(scheme));
    }
}

/// The document before the routes add themselves.
pub(super) fn head() -> Document {
    Head::openapi()
}

/// Bytes as they are: of a file or an archive.
#[derive(Debug)]
pub(super) struct Bytes;

impl PartialSchema for Bytes {
    fn schema() -> RefOr<Schema> {
        let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new().schema_type(Type::String).format(Some(format)).into()
    }
}

impl ToSchema for Bytes {}

/// What every change of a checkpoint may answer instead of what was wanted.
#[derive(Debug)]
pub(super) struct Refusals;

impl IntoResponses for Refusals {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        let refusals = [
            ("400", "Not a name, or not a tag"),
            ("404", "No such checkpoint"),
            ("409", "Not the checkpoint's own name"),
            ("503", "Others change the store; try again"),
        ];
        refusals.map(|(status, why)| (status.to_owned(), RefOr::T(problem(why)))).into()
    }
}

/// Adds to every route what the layers around it may answer.
pub(super) fn complete(document: &mut Document) {
    for (path, item) in &mut document.paths.paths {
        for operation in [&mut item.put, &mut item.post, &mut item.delete].into_iter().flatten() {
            let read_only =
                "The service was started to be looked at only, or a page of another origin asks";
            answer(operation, "403", problem(read_only));
        }
        let operations = [&mut item.get, &mut item.put, &mut item.post, &mut item.delete];
        for operation in operations.into_iter().flatten() {
            if path != "/page/{file}" && !access::is_public(path) {
                let needed = "The request does not show the token";
                answer(operation, "401", problem(needed));
                let foreign = "The request comes from a page of another origin";
                answer(operation, "403", problem(foreign));
            }
            let host = "The request does not name one host";
            answer(operation, "400", problem(host));
            let large = "The request's head is too large; the answer has no body";
            answer(operation, "431", ResponseBuilder::new().description(large).build());
        }
    }
}

fn answer(operation: &mut Operation, status: &str, response: Response) {
    operation.responses.responses.entry(status.to_owned()).or_insert(RefOr::T(response));
}

fn problem(description: &str) -> Response {
    let schema = Ref::from_schema_name("ErrorBody");
    let content = ContentBuilder::new().schema(Some(schema)).build();
    ResponseBuilder::new().description(description).content("application/json", content).build()
}
