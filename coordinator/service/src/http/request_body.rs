//! Reads bodies of requests: never more than a limit, never slower than a pace.

use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Poll, ready};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody as _};
use axum::extract::Request;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE, EXPECT};
use axum::http::{HeaderMap, StatusCode};
use serde::de::DeserializeOwned;

use super::limits::Limits;
use super::minimum_rate::MinimumRate;
use super::problem::Problem;

/// Bytes that are read and dropped before a refusal, see [`RequestBody::discard`].
const DISCARDED: u64 = 4 << 20;
/// Time for them.
const DISCARD_TIME: Duration = Duration::from_secs(1);

/// A body on its way in.
#[derive(Debug)]
pub(super) struct RequestBody {
    headers: HeaderMap,
    body: Body,
    pace: MinimumRate,
    limit: u64,
    taken: u64,
}

impl RequestBody {
    /// The body of a request, of `limit` bytes at most.
    pub(super) fn new(request: Request, limit: u64, limits: &Limits) -> Self {
        let (parts, body) = request.into_parts();
        Self { headers: parts.headers, body, pace: MinimumRate::new(limits), limit, taken: 0 }
    }

    /// The length that the client announced.
    pub(super) fn announced(&self) -> Option<u64> {
        self.headers.get(CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
    }

    /// Bytes of it that have come.
    pub(super) fn taken(&self) -> u64 {
        self.taken
    }

    /// Refuses a body that is announced to be too large, before any of it is read.
    pub(super) fn check_announced(&self) -> Result<(), Problem> {
        match self.announced() {
            Some(len) if len > self.limit => Err(self.too_large()),
            _ => Ok(()),
        }
    }

    /// The next piece, or `None` at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let Some(bytes) = poll_fn(|context| self.poll(context)).await? else { return Ok(None) };
        self.taken += bytes.len() as u64;
        if self.taken > self.limit {
            return Err(self.too_large());
        }
        Ok(Some(bytes))
    }

    fn poll(
        &mut self,
        context: &mut std::task::Context<'_>,
    ) -> Poll<Result<Option<Bytes>, Problem>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let moved = match &polled {
            Poll::Ready(Some(Ok(frame))) => {
                Poll::Ready(frame.data_ref().map_or(0, |bytes| bytes.len() as u64))
            }
            Poll::Ready(_) => Poll::Ready(0),
            Poll::Pending => Poll::Pending,
        };
        let pace = self.pace.judge(context, moved);
        Poll::Ready(match polled {
            Poll::Ready(None) => Ok(None),
            Poll::Ready(Some(Ok(frame))) => Ok(Some(frame.into_data().unwrap_or_default())),
            Poll::Ready(Some(Err(error))) => {
                let message = format!("the request's body ended early: {error}");
                Err(Problem::new(StatusCode::BAD_REQUEST, message))
            }
            Poll::Pending => {
                let late = ready!(pace).err().map_or_else(String::new, |late| late.to_string());
                let message = format!("the request's body came too slowly: {late}");
                Err(Problem::new(StatusCode::REQUEST_TIMEOUT, message))
            }
        })
    }

    /// Reads the whole body as JSON.
    pub(super) async fn json<T: DeserializeOwned>(mut self) -> Result<T, Problem> {
        if let Some(kind) = self.headers.get(CONTENT_TYPE) {
            let kind = kind.to_str().unwrap_or_default();
            let essence = kind.split(';').next().unwrap_or_default().trim();
            if !essence.eq_ignore_ascii_case("application/json") {
                let message = format!("the body is `{kind}`, expected application/json");
                return Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, message));
            }
        }
        self.check_announced()?;
        let mut bytes = Vec::new();
        while let Some(piece) = self.next().await? {
            bytes.extend_from_slice(&piece);
        }
        let unexpected = |error: &str| {
            let message = format!("the body is not the JSON that is expected here: {error}");
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, message)
        };
        // Of a list serde would take the elements for the fields, in order.
        if bytes.trim_ascii_start().starts_with(b"[") {
            return Err(unexpected("a list, expected an object in braces"));
        }
        serde_json::from_slice(&bytes).map_err(|error| unexpected(&in_words(&error.to_string())))
    }

    /// Reads what a client that is about to be refused has sent already, within bounds. A socket
    /// that is closed with unread bytes in it resets, and many clients then lose the answer.
    pub(super) async fn discard(mut self) {
        if self.headers.contains_key(EXPECT) {
            // It waits for our word before it sends.
            return;
        }
        let up_to = self.taken.saturating_add(DISCARDED);
        self.limit = up_to;
        let drain = async { while let Ok(Some(_)) = self.next().await {} };
        let _ = tokio::time::timeout(DISCARD_TIME, drain).await;
    }

    fn too_large(&self) -> Problem {
        let message = format!("the body is larger than {} bytes, which is the limit", self.limit);
        Problem::new(StatusCode::PAYLOAD_TOO_LARGE, message)
    }
}

/// What serde says, without the names of types that only a programmer of this service knows.
fn in_words(error: &str) -> String {
    let types = ["usize", "u64", "u32", "u16", "u8"];
    let mut words = error.to_owned();
    for name in types {
        words = words
            .replace(&format!("expected {name}"), "expected a whole number that is not negative");
    }
    match words.find("expected struct ") {
        Some(at) => {
            let rest = words[at..].split_once(" at line").map_or("", |(_, rest)| rest);
            let place = if rest.is_empty() { String::new() } else { format!(" at line{rest}") };
            format!("{}expected an object in braces{place}", &words[..at])
        }
        None => words,
    }
}

#[cfg(test)]
mod tests {
    use super::in_words;

    #[test]
    fn types_are_said_in_words() {
        let error = |text| serde_json::from_str::<crate::http::ScaleRequest>(text).expect_err(text);
        for (text, words) in [
            ("{\"workers\": \"4\"}", "expected a whole number that is not negative at line 1"),
            ("{\"workers\": -1}", "expected a whole number that is not negative at line 1"),
            ("7", "expected an object in braces at line 1"),
        ] {
            let said = in_words(&error(text).to_string());
            assert!(said.contains(words), "{text}: {said}");
            assert!(!said.contains("usize") && !said.contains("struct"), "{text}: {said}");
        }
    }
}
