//! Why a text is no robot of ours.

/// What is wrong, where, and what would do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UrdfError {
    /// No XML.
    #[error("no XML: {0}")]
    Xml(String),
    /// An element says what it cannot.
    #[error("line {line}, {element}: {found}, expected {expected}")]
    Element {
        /// Where it stands, from 1.
        line: u32,
        /// What it is, with its name.
        element: String,
        /// What it says.
        found: String,
        /// What it should say.
        expected: String,
    },
    /// The whole is no robot that can be trained here.
    #[error("{found}; {expected}")]
    Robot {
        /// What it is.
        found: String,
        /// What it must be, and what to do.
        expected: String,
    },
}

impl UrdfError {
    pub(crate) fn robot(found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Robot { found: found.into(), expected: expected.into() }
    }
}
