//! Under which keys hub and hosts find each other.

use proto::message::HostId;

/// Where a host asks to be taken in; answered by the hub.
pub(crate) const HELLO: &str = "octopus/hello";
/// Where the hub says that it is there, and which policies it has.
pub(crate) const BEAT: &str = "octopus/beat";

/// Where the hub of a session answers with a policy.
pub(crate) fn policy(session: &str, version: u64) -> String {
    format!("octopus/{session}/policy/{version}")
}

/// All of them.
pub(crate) fn policies(session: &str) -> String {
    format!("octopus/{session}/policy/*")
}

/// Something of a host: `order`, which it answers, `beat`, which it says, or `alive`, which ends with it.
pub(crate) fn of_host(session: &str, host: HostId, what: &str) -> String {
    format!("octopus/{session}/host/{host}/{what}")
}

/// The same of all hosts.
pub(crate) fn of_hosts(session: &str, what: &str) -> String {
    format!("octopus/{session}/host/*/{what}")
}

/// The host in such a key.
pub(crate) fn host(key: &str) -> Option<HostId> {
    key.split('/').nth(3)?.parse().ok()
}

/// The version in the key of a policy.
pub(crate) fn version(key: &str) -> Option<u64> {
    key.split('/').nth(3)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_in_a_key_is_read_from_it() {
        assert_eq!(host(&of_host("ab12", 7, "beat")), Some(7));
        assert_eq!(version(&policy("ab12", 40)), Some(40));
        assert_eq!((host(HELLO), version("octopus/x/policy/new")), (None, None));
    }
}
