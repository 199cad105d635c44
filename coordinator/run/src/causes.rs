//! An error with its causes, as a person reads it.

/// An error and its causes, each said once. Most of our errors name the system's reason in their own words,
/// and have it as their cause, too.
pub fn told(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |mut told, cause| {
        let cause = cause.to_string();
        let cause = cause.trim_end();
        if told.is_empty() {
            told.push_str(cause);
        } else if !told.contains(cause) {
            told.push_str(": ");
            told.push_str(cause);
        }
        told
    })
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use anyhow::Context as _;
    use store::checkpoint::CheckpointError;

    use super::*;

    #[test]
    fn no_cause_is_said_twice() {
        let source = Error::from(ErrorKind::PermissionDenied);
        let error = CheckpointError::Io { path: "state".into(), action: "read", source };
        let error = Err::<(), _>(error).context("runs/a").expect_err("an error");
        assert_eq!(told(&error), "runs/a: state: cannot read: permission denied");
    }

    #[test]
    fn a_cause_that_is_not_named_is_added() {
        let error = Err::<(), _>(Error::from(ErrorKind::NotFound)).context("in.csv\n");
        assert_eq!(told(&error.expect_err("an error")), "in.csv: entity not found");
    }
}
