//! Names of checkpoints and tags.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Prefix of the names that a run gives its checkpoints.
pub const ITERATION: &str = "iteration-";
/// Longest name (bytes).
const MAX_LEN: usize = 100;

/// The name of a checkpoint, which is that of its directory, or a tag.
///
/// A letter or digit, then up to 99 letters, digits, dots, underscores and dashes. So a name is
/// always one path component and never hidden, and no name leads out of a store.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

/// A text that is no [`Name`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` cannot be a name: {problem}; a name has 1 to {MAX_LEN} letters, digits, `.`, `_` \
     and `-`, and begins with a letter or digit"
)]
pub struct NameError {
    text: String,
    problem: String,
}

impl Name {
    /// The name of a run's checkpoint after `iteration` iterations.
    pub fn of_iteration(iteration: u64) -> Self {
        Self(format!("{ITERATION}{iteration:08}"))
    }

    /// Iterations trained on, if it is the name of a run's own checkpoint.
    pub fn iteration(&self) -> Option<u64> {
        let digits = self.0.strip_prefix(ITERATION)?;
        if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        digits.parse().ok()
    }

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Name {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let refuse = |problem: String| {
            let text: String = text.chars().take(2 * MAX_LEN).collect();
            Err(NameError { text: text.escape_debug().to_string(), problem })
        };
        let Some(first) = text.chars().next() else { return refuse("it is empty".to_owned()) };
        if text.len() > MAX_LEN {
            return refuse(format!("it has {} bytes", text.len()));
        }
        if !first.is_ascii_alphanumeric() {
            return refuse(format!("it begins with {first:?}"));
        }
        match text.chars().find(|c| !c.is_ascii_alphanumeric() && !"._-".contains(*c)) {
            Some(wrong) => refuse(format!("it holds {wrong:?}")),
            None => Ok(Self(text.to_owned())),
        }
    }
}

impl TryFrom<String> for Name {
    type Error = NameError;

    fn try_from(text: String) -> Result<Self, NameError> {
        text.parse()
    }
}

impl From<Name> for String {
    fn from(name: Name) -> Self {
        name.0
    }
}

impl AsRef<std::path::Path> for Name {
    fn as_ref(&self) -> &std::path::Path {
        self.0.as_ref()
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}
