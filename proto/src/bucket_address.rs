//! Addresses of buckets, as a configuration and a command line hold them: `s3://bucket/prefix`.
//!
//! Only how they are written is known here. Credentials are in the environment and nowhere else: an address is written
//! into files and logs, so one that could hold a secret is refused.

/// What an address may begin with, and an example of each.
pub const SCHEMES: [(&str, &str); 4] = [
    ("s3", "s3://bucket/prefix"),
    ("gs", "gs://bucket/prefix"),
    ("az", "az://container/prefix"),
    ("file", "file:///mnt/shared/prefix"),
];

/// Whether `text` is meant to be an address, right or wrong, and no path.
pub fn is_address(text: &str) -> bool {
    text.split_once("://").is_some_and(|(scheme, _)| {
        !scheme.is_empty() && scheme.bytes().all(|byte| byte.is_ascii_alphanumeric())
    })
}

/// What is wrong with an address; nothing if it is one.
pub fn problem(text: &str) -> Option<String> {
    let Some((scheme, rest)) = text.split_once("://") else {
        return Some("has no `://`".to_owned());
    };
    if !SCHEMES.iter().any(|(known, _)| *known == scheme) {
        return Some(format!(
            "begins with `{}`, which is no kind of bucket",
            scheme.escape_debug()
        ));
    }
    let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
    if rest.contains(['@', '?', '#']) {
        return Some(
            "holds `@`, `?` or `#`: credentials belong into the environment, never into an address"
                .to_owned(),
        );
    }
    if rest.chars().any(|c| c.is_control() || c.is_whitespace() || c == '\\' || c == ':') {
        return Some("holds a colon, a backslash, white space or control characters".to_owned());
    }
    if scheme == "file" && !host.is_empty() {
        return Some(format!("names the host `{host}`: a directory's address has three slashes"));
    }
    if scheme != "file" && host.is_empty() {
        return Some("names no bucket".to_owned());
    }
    let path = path.trim_end_matches('/');
    if path.is_empty() {
        return Some("has no prefix: a run keeps what is its own below one".to_owned());
    }
    if path.split('/').any(|part| ["", ".", ".."].contains(&part)) {
        return Some("has an empty part, or one that is `.` or `..`".to_owned());
    }
    None
}

/// The same of lines of which each may have an address.
pub(crate) fn hidden_in_lines(text: &str) -> String {
    text.split('\n').map(hidden).collect::<Vec<_>>().join("\n")
}

/// The text without what could be a secret in an address: all before an `@`, all behind a `?`. For messages, which end in logs.
pub(crate) fn hidden(text: &str) -> String {
    let Some((before, rest)) = text.split_once("://") else { return text.to_owned() };
    let rest =
        rest.rsplit_once('@').map_or_else(|| rest.to_owned(), |(_, place)| format!("***@{place}"));
    let rest =
        rest.split_once('?').map_or_else(|| rest.clone(), |(place, _)| format!("{place}?***"));
    format!("{before}://{rest}")
}

/// How an address is written, for whoever has written another.
pub fn examples() -> String {
    let examples: Vec<String> = SCHEMES.iter().map(|(_, example)| format!("`{example}`")).collect();
    examples.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_paths_and_from_wrong_ones() {
        for (_, example) in SCHEMES {
            assert!(is_address(example));
            assert_eq!(problem(example), None, "{example}");
            assert_eq!(problem(&format!("{example}/")), None, "{example}/");
        }
        for path in ["runs/a", "runs/a:best", "/tmp/x://y", "://x", "a b://c"] {
            assert!(!is_address(path), "{path}");
        }
        for wrong in [
            "s3://",
            "s3:///prefix",
            "s3://bucket",
            "s3://bucket/",
            "s3://key:secret@bucket/prefix",
            "s3://bucket/prefix?X-Amz-Signature=1",
            "s3://bucket/a//b",
            "s3://bucket/../b",
            "s3://bucket/a b",
            "http://host/prefix",
            "file://host/prefix",
            "file:///",
        ] {
            assert!(problem(wrong).is_some(), "{wrong}");
        }
    }

    #[test]
    fn secrets_of_addresses_are_not_shown() {
        for (text, shown) in [
            ("s3://key:secret@bucket/a", "s3://***@bucket/a"),
            ("--set x=s3://k:a@b@c/d", "--set x=s3://***@c/d"),
            ("s3://bucket/a?X-Amz-Signature=1", "s3://bucket/a?***"),
            ("s3://bucket/a", "s3://bucket/a"),
            ("me@home", "me@home"),
            ("s3://k:s\nt@b/c", "s3://***@b/c"),
        ] {
            assert_eq!(hidden(text), shown);
        }
        let lines = "a = s3://k:s@b/c\nb = \"me@home\"";
        assert_eq!(hidden_in_lines(lines), "a = s3://***@b/c\nb = \"me@home\"");
    }
}
