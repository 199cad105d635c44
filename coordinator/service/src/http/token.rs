//! The secret that a client of the service must know.

use std::fmt::{self, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use proto::{ExitCode, ExitError};
use store::regular_files;
use subtle::ConstantTimeEq as _;

/// The environment variable that holds the token.
pub const TOKEN_VARIABLE: &str = "SPACEOCTOPUS_TOKEN";
/// Fewer characters can be guessed.
const MIN_LEN: usize = 16;
/// More do not fit a header comfortably.
const MAX_LEN: usize = 1024;

/// A bearer token. Neither printed nor logged: its `Debug` form hides it.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Takes a token from text around which white space is ignored: 16 to 1024 printable ASCII
    /// characters. `origin` names the text's source in errors.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ExitError> {
        let token = text.trim();
        let wrong = |what: &str| {
            let message = format!(
                "{origin}: {what}; a token is {MIN_LEN} to {MAX_LEN} printable ASCII characters \
                 without spaces, for example of `openssl rand -hex 16`"
            );
            ExitError::new(ExitCode::BadInput, message)
        };
        if token.len() < MIN_LEN || token.len() > MAX_LEN {
            return Err(wrong(&format!("the token has {} characters", token.len())));
        }
        if !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(wrong("the token has a character that a header cannot carry"));
        }
        Ok(Self(token.to_owned()))
    }

    /// Reads a token from a file.
    pub fn from_file(path: &Path) -> Result<Self, ExitError> {
        let text = regular_files::read_text(path, regular_files::TEXT).map_err(|error| {
            let message = format!("{}: the token cannot be read: {error}", path.display());
            ExitError::new(ExitCode::BadInput, message)
        })?;
        // Only a warning: a container's secret may be readable to all who are in the container.
        if path.metadata().is_ok_and(|there| there.mode() & 0o004 != 0) {
            tracing::warn!(
                file = %path.display(),
                "every user of this machine can read the token; `chmod 600` lets only you"
            );
        }
        Self::parse(&text, &path.display().to_string())
    }

    /// Reads the token from [`TOKEN_VARIABLE`], if that is set and not empty.
    pub fn from_environment() -> Result<Option<Self>, ExitError> {
        match std::env::var(TOKEN_VARIABLE) {
            Ok(text) if text.is_empty() => Ok(None),
            Ok(text) => Self::parse(&text, TOKEN_VARIABLE).map(Some),
            Err(std::env::VarError::NotPresent) => Ok(None),
            Err(std::env::VarError::NotUnicode(_)) => Err(ExitError::new(
                ExitCode::BadInput,
                format!("{TOKEN_VARIABLE}: the token is not UTF-8"),
            )),
        }
    }

    /// The token that the command line names, or that of the environment.
    pub fn find(file: Option<&Path>) -> Result<Option<Self>, ExitError> {
        match file {
            Some(path) => Self::from_file(path).map(Some),
            None => Self::from_environment(),
        }
    }

    /// The page of the service that listens at `address` and knows this token, perhaps with what it shows first:
    /// `policy=NAME` or `play=EPISODE`, which need no escaping. The token stands where no browser sends it: in the
    /// fragment.
    pub fn page_address(&self, address: &str, shown: Option<&str>) -> String {
        let mut fragment = String::from("token=");
        for byte in self.0.bytes() {
            if byte.is_ascii_alphanumeric() {
                fragment.push(byte.into());
            } else {
                let _ = write!(fragment, "%{byte:02X}");
            }
        }
        let shown = shown.map_or_else(String::new, |shown| format!("{shown}&"));
        format!("http://{address}/#{shown}{fragment}")
    }

    /// A port that whoever knows the token finds again, outside the range from which the system gives: a run takes it
    /// if it is free, so that a page finds the run again when it is resumed. It says next to nothing of the token.
    pub fn port(&self) -> u16 {
        const FIRST: u16 = 20_000;
        const COUNT: u16 = 12_000;
        let hash = blake3::derive_key("spaceoctopus port of a run's service", self.0.as_bytes());
        FIRST + u16::from_le_bytes([hash[0], hash[1]]) % COUNT
    }

    /// Whether `offered` is the token. How long this takes says nothing about where they differ,
    /// nor, as hashes are compared, about the token's length.
    pub(super) fn matches(&self, offered: &[u8]) -> bool {
        let (own, other) = (blake3::hash(self.0.as_bytes()), blake3::hash(offered));
        own.as_bytes().ct_eq(other.as_bytes()).into()
    }

    /// The token itself.
    pub(super) fn text(&self) -> &str {
        &self.0
    }

    /// The value of a client's `Authorization` header.
    pub(crate) fn authorization(&self) -> String {
        format!("Bearer {}", self.0)
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(hidden)")
    }
}
