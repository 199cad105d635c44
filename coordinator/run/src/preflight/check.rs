//! How one check ended, and what to do about it.

use serde::Serialize;

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Enough.
    Good,
    /// A run works, but not as well as it could.
    Warning,
    /// A run does not work.
    Failure,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// Whether it is enough.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do about it.
    pub cure: Option<String>,
}

impl Check {
    /// Enough.
    pub fn good(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Good, found: found.into(), cure: None }
    }

    /// Not as good as it could be.
    pub fn warning(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Warning, found: found.into(), cure: Some(cure.into()) }
    }

    /// Not enough.
    pub fn failure(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Failure, found: found.into(), cure: Some(cure.into()) }
    }

    /// Found and cure in one sentence.
    pub fn sentence(&self) -> String {
        match &self.cure {
            Some(cure) => format!("{}: {}; {cure}", self.name, self.found),
            None => format!("{}: {}", self.name, self.found),
        }
    }
}
