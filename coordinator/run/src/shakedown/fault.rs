//! What is wrong with a robot at home.

/// What is wrong with a robot.
#[derive(Debug, PartialEq)]
pub(super) struct Fault {
    pub(super) found: String,
    pub(super) expected: &'static str,
    pub(super) cure: String,
}
