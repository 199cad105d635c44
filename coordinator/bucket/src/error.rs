//! What can be wrong with a bucket.

use proto::{ExitCode, ExitError};
use store::checkpoint::CheckpointError;

use crate::secrets::hidden;

/// Longest piece of a server's answer that is shown (characters).
const SHOWN: usize = 200;

/// What can be wrong with a bucket.
#[derive(Debug, thiserror::Error)]
pub enum BucketError {
    /// It cannot be reached, or it does not let us; later it may.
    #[error("{place}: {reason}")]
    Away {
        /// The object or bucket.
        place: String,
        /// Why, and what to do.
        reason: String,
    },
    /// The address, or what was asked for, cannot be.
    #[error("{0}")]
    Refused(String),
    /// Another run keeps its checkpoints there.
    #[error(
        "{place}: belongs to another run, {run}; give this one a prefix of its own in run.checkpoints"
    )]
    Foreign {
        /// The bucket.
        place: String,
        /// The other run, 32 hexadecimal digits.
        run: String,
    },
    /// Another session of the run writes there now.
    #[error("{place}: another session of this run, on {host}, has taken it over")]
    TakenOver {
        /// The bucket.
        place: String,
        /// Its machine.
        host: String,
    },
    /// Something there is not as it was sent.
    #[error("{place}: {reason}")]
    Damaged {
        /// The object.
        place: String,
        /// How it shows.
        reason: String,
    },
    /// There is none.
    #[error("{place}: {what}")]
    NotFound {
        /// Where it was looked for.
        place: String,
        /// What is missing, and what to do.
        what: String,
    },
    /// Something of the local store.
    #[error(transparent)]
    Local(#[from] CheckpointError),
    /// A local file.
    #[error("{0}")]
    File(String),
}

impl BucketError {
    /// The error with the exit code that it ends a program with.
    pub fn exit(self) -> ExitError {
        let code = match &self {
            Self::Refused(_) => ExitCode::Usage,
            Self::Away { .. } => ExitCode::Environment,
            _ => ExitCode::RunDirectory,
        };
        ExitError::new(code, self.to_string())
    }

    /// Whether nothing that can change by itself is wrong: to try again is no use.
    pub(crate) fn is_final(&self) -> bool {
        matches!(self, Self::Refused(_) | Self::Foreign { .. } | Self::TakenOver { .. })
    }

    /// Whether files of a checkpoint here are in the way, and not the bucket.
    pub(crate) fn is_local(&self) -> bool {
        matches!(self, Self::Local(_) | Self::File(_))
    }

    pub(crate) fn of(place: String, error: &object_store::Error) -> Self {
        Self::Away { place, reason: told(error) }
    }

    pub(crate) fn damaged(place: String, reason: impl Into<String>) -> Self {
        Self::Damaged { place, reason: reason.into() }
    }
}

/// A client's error in words for people, without what a server repeats of credentials.
fn told(error: &object_store::Error) -> String {
    use object_store::Error;
    let whole = chain(error);
    let cause = match (element(&whole, "Code"), element(&whole, "Message")) {
        (Some(code), Some(message)) => format!("{code}: {message}"),
        (Some(code), None) => code.to_owned(),
        _ => whole.split('<').next().unwrap_or_default().trim().to_owned(),
    };
    let cause = hidden(&cause);
    let cause: String = cause.split_whitespace().collect::<Vec<_>>().join(" ");
    let cause: String = cause.chars().take(SHOWN).filter(|c| !c.is_control()).collect();
    let what = match error {
        _ if whole.contains("NoSuchBucket") => {
            "there is no such bucket; make it, or name another in run.checkpoints"
        }
        Error::PermissionDenied { .. } => "the credentials do not allow it",
        Error::Unauthenticated { .. } => "the credentials are not accepted",
        Error::NotFound { .. } => "is not there",
        _ => "cannot be reached",
    };
    format!("{what} ({cause})")
}

/// An error and its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let mut whole = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let cause_text = cause.to_string();
        if !whole.contains(&cause_text) {
            whole.push_str(": ");
            whole.push_str(&cause_text);
        }
        next = cause.source();
    }
    whole
}

/// The text of the first XML element of this name.
fn element<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(&format!("<{name}>"))?;
    rest.split('<').next()
}
