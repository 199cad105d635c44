//! What can be wrong with a robot description.

/// A robot that cannot be read or is no robot.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// The text is no description: syntax, a missing or unknown key, a wrong type.
    #[error("robot {path}: {reason}")]
    Parse {
        /// Where the text comes from.
        path: String,
        /// The parser's words, with line and key.
        reason: String,
    },
    /// A value makes no sense.
    #[error("robot {path}: {key} is {found}, expected {expected}")]
    Value {
        /// Where the text comes from.
        path: String,
        /// The key, with its table.
        key: String,
        /// What stands there.
        found: String,
        /// What must stand there.
        expected: String,
    },
}
