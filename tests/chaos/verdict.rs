//! How a run ends that something was done to before it began.

use serde_json::{Value, json};

/// How one ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// With the bits of a run that was left alone.
    Survived,
    /// With a message that names what was done.
    Refused,
}

/// How many ended in which way.
#[derive(Debug, Default)]
pub struct Report {
    /// With the bits of a run that was left alone.
    pub survived: usize,
    /// With a message that names what was done.
    pub refused: usize,
}

impl Report {
    /// Counts one.
    pub fn count(&mut self, verdict: Verdict) {
        match verdict {
            Verdict::Survived => self.survived += 1,
            Verdict::Refused => self.refused += 1,
        }
    }

    /// As one JSON object.
    pub fn to_json(&self) -> Value {
        json!({ "survived": self.survived, "refused": self.refused })
    }
}
