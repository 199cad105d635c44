//! Which part of a file an answer carries: conditions and byte ranges (RFC 9110, 13 and 14).
//!
//! Read here, because the crates for it do not do what the RFC says. Of a suffix that is longer than the file, which is
//! the whole file, `http-range-header` 0.4 makes an error and `headers` 0.4 nothing, and likewise of a last byte with
//! more digits than a u64 has. Neither tells what is no range, and ignored, from one outside the file, which is refused.

use std::ops::Range;

use axum::http::header::{CONTENT_RANGE, IF_MATCH, IF_NONE_MATCH, IF_RANGE, RANGE};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};

use super::problem::Problem;

/// What to answer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Selection {
    /// The whole file.
    Whole,
    /// These bytes of it, at least one.
    Part(Range<u64>),
    /// Nothing: the client has it.
    NotModified,
}

/// Decides what of a file of `len` bytes and strong entity tag `etag` the client wants.
pub(super) fn select(
    method: &Method,
    headers: &HeaderMap,
    etag: &str,
    len: u64,
) -> Result<Selection, Problem> {
    if headers.contains_key(IF_MATCH) && !lists(headers, &IF_MATCH, etag) {
        let message = format!("the file is {etag} and not what If-Match names");
        return Err(Problem::new(StatusCode::PRECONDITION_FAILED, message));
    }
    if is_known(headers, etag) {
        return Ok(Selection::NotModified);
    }
    // Of GET alone: to a HEAD the whole file is described.
    if method != Method::GET {
        return Ok(Selection::Whole);
    }
    // A date in If-Range never matches: files here are known by content, not by age.
    let same = headers.get(IF_RANGE).is_none_or(|tag| tag.as_bytes() == etag.as_bytes());
    let mut ranges = headers.get_all(RANGE).iter();
    match (ranges.next().and_then(|range| range.to_str().ok()), ranges.next()) {
        (Some(range), None) if same => part(range, len),
        _ => Ok(Selection::Whole),
    }
}

/// Whether the client has what the entity tag `etag` names.
pub(super) fn is_known(headers: &HeaderMap, etag: &str) -> bool {
    lists(headers, &IF_NONE_MATCH, etag)
}

/// Whether a list of entity tags holds `etag`, or is the star that stands for all.
fn lists(headers: &HeaderMap, name: &HeaderName, etag: &str) -> bool {
    let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    // Our tags are hexadecimal, so a comma never is a part of one that matches.
    values.flat_map(|value| value.split(',')).map(str::trim).any(|tag| {
        // `W/"…"` matches too; as the same content always has the same tag, that is no lie.
        tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag
    })
}

/// Reads `bytes=first-last`. What is no byte range is ignored, as are several at once, which a
/// server may; one outside the file is refused.
fn part(range: &str, len: u64) -> Result<Selection, Problem> {
    let Some(spec) = range.trim().strip_prefix("bytes=") else { return Ok(Selection::Whole) };
    let Some((first, last)) = spec.split_once('-') else { return Ok(Selection::Whole) };
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        // More digits than a u64 has is more bytes than any file has.
        digits.then(|| text.parse::<u64>().unwrap_or(u64::MAX))
    };
    let part = match (number(first.trim()), number(last.trim())) {
        (Some(first), Some(last)) if first <= last => first..last.saturating_add(1).min(len),
        (Some(first), None) if last.trim().is_empty() => first..len,
        (None, Some(suffix)) if first.trim().is_empty() => len.saturating_sub(suffix)..len,
        _ => return Ok(Selection::Whole),
    };
    if part.is_empty() {
        let message = format!("the range `{spec}` has no byte of the file, which has {len}");
        let total = HeaderValue::try_from(format!("bytes */{len}"))
            .map_err(|error| Problem::internal(&error))?;
        return Err(
            Problem::new(StatusCode::RANGE_NOT_SATISFIABLE, message).with(CONTENT_RANGE, total)
        );
    }
    Ok(Selection::Part(part))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(text: &str) -> Result<Selection, StatusCode> {
        part(text, 100).map_err(|problem| problem.status)
    }

    #[test]
    fn the_ranges_of_rfc_9110() {
        assert_eq!(range("bytes=0-0"), Ok(Selection::Part(0..1)));
        assert_eq!(range("bytes=10-19"), Ok(Selection::Part(10..20)));
        assert_eq!(range("bytes=90-"), Ok(Selection::Part(90..100)));
        assert_eq!(range("bytes=90-1000"), Ok(Selection::Part(90..100)));
        assert_eq!(range("bytes=-10"), Ok(Selection::Part(90..100)));
        assert_eq!(range("bytes=-1000"), Ok(Selection::Part(0..100)));
        assert_eq!(range("bytes=0-99999999999999999999999"), Ok(Selection::Part(0..100)));
        for outside in ["bytes=100-", "bytes=100-200", "bytes=-0", "bytes=99999999999999999999-"] {
            assert_eq!(range(outside), Err(StatusCode::RANGE_NOT_SATISFIABLE), "{outside}");
        }
        for ignored in ["bytes=5-4", "bytes=0-1,5-6", "lines=1-2", "bytes=", "bytes=-", "bytes=a-b"]
        {
            assert_eq!(range(ignored), Ok(Selection::Whole), "{ignored}");
        }
    }

    #[test]
    fn nothing_of_an_empty_file_is_a_part() {
        assert!(part("bytes=0-0", 0).is_err());
        assert!(part("bytes=-5", 0).is_err());
    }

    #[test]
    fn conditions_decide_before_ranges() {
        let asked = |method, fields: &[(HeaderName, &'static str)]| {
            let headers =
                fields.iter().map(|(name, value)| (name.clone(), HeaderValue::from_static(value)));
            select(&method, &headers.collect(), "\"ab\"", 100).map_err(|problem| problem.status)
        };
        let select = |fields: &[(HeaderName, &'static str)]| asked(Method::GET, fields);
        let part = Ok(Selection::Part(0..1));
        assert_eq!(select(&[]), Ok(Selection::Whole));
        assert_eq!(select(&[(IF_NONE_MATCH, "\"ab\"")]), Ok(Selection::NotModified));
        assert_eq!(select(&[(IF_NONE_MATCH, "\"x\", W/\"ab\"")]), Ok(Selection::NotModified));
        assert_eq!(select(&[(IF_NONE_MATCH, "*")]), Ok(Selection::NotModified));
        assert_eq!(select(&[(IF_NONE_MATCH, "\"x\""), (RANGE, "bytes=0-0")]), part);
        assert_eq!(select(&[(IF_MATCH, "\"x\"")]), Err(StatusCode::PRECONDITION_FAILED));
        assert_eq!(select(&[(IF_MATCH, "\"ab\""), (RANGE, "bytes=0-0")]), part);
        assert_eq!(select(&[(IF_RANGE, "\"ab\""), (RANGE, "bytes=0-0")]), part);
        assert_eq!(select(&[(IF_RANGE, "\"x\""), (RANGE, "bytes=0-0")]), Ok(Selection::Whole));
        for range in ["bytes=0-0", "bytes=100-"] {
            assert_eq!(asked(Method::HEAD, &[(RANGE, range)]), Ok(Selection::Whole), "{range}");
        }
    }
}
