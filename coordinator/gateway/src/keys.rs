//! Under which keys hub and hosts find each other.
//!
//! All that is a host's stands below its name, so that the network can leave it to the machine whose certificate has
//! that name, see [`access`](crate::access).

use std::fmt::Write as _;

use proto::message::HostId;

/// Where the hub says that it is there, and which policies it has.
pub(crate) const BEAT: &str = "octopus/beat";
/// Where all hosts ask to be taken in.
pub(crate) const HELLOS: &str = "octopus/hello/*";
/// Where all hosts ask why they are not answered.
pub(crate) const STRANGERS: &str = "octopus/stranger/*";

/// Where a host asks to be taken in; answered by the hub.
pub(crate) fn hello(name: &str) -> String {
    format!("octopus/hello/{}", chunk(name))
}

/// Where a host asks why it is not answered there.
pub(crate) fn stranger(name: &str) -> String {
    format!("octopus/stranger/{}", chunk(name))
}

/// Where the hub of a session answers with a policy.
pub(crate) fn policy(session: &str, version: u64) -> String {
    format!("octopus/{session}/policy/{version}")
}

/// All of them.
pub(crate) fn policies(session: &str) -> String {
    format!("octopus/{session}/policy/*")
}

/// Something of a host: `order`, which it answers, `beat`, which it says, or `alive`, which ends with it.
pub(crate) fn of_host(session: &str, name: &str, host: HostId, what: &str) -> String {
    format!("octopus/{session}/host/{}/{host}/{what}", chunk(name))
}

/// The same of all hosts.
pub(crate) fn of_hosts(session: &str, what: &str) -> String {
    format!("octopus/{session}/host/*/*/{what}")
}

/// The name in the key of a hello.
pub(crate) fn is_of_name(key: &str, name: &str) -> bool {
    key.split('/').nth(2) == Some(&chunk(name))
}

/// The host in a key of [`of_host`], with its name as keys have it.
pub(crate) fn host(key: &str) -> Option<(HostId, &str)> {
    let mut chunks = key.split('/').skip(3);
    let name = chunks.next()?;
    Some((chunks.next()?.parse().ok()?, name))
}

/// The version in the key of a policy.
pub(crate) fn version(key: &str) -> Option<u64> {
    key.split('/').nth(3)?.parse().ok()
}

/// A name as a part of a key. What keys have no room for is written as `%` and two digits; names in certificates have
/// nothing of that.
pub(crate) fn chunk(name: &str) -> String {
    let mut chunk = String::with_capacity(name.len());
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.".contains(&byte) {
            chunk.push(char::from(byte));
        } else {
            // Writing into a text does not fail.
            let _ = write!(chunk, "%{byte:02x}");
        }
    }
    // A part of a key cannot be empty.
    if chunk.is_empty() { "%".to_owned() } else { chunk }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_in_a_key_is_read_from_it() {
        assert_eq!(host(&of_host("ab12", "lab-2", 7, "beat")), Some((7, "lab-2")));
        assert_eq!(version(&policy("ab12", 40)), Some(40));
        assert_eq!((host(&hello("lab")), version("octopus/x/policy/new")), (None, None));
        assert!(is_of_name(&hello("a b"), "a b") && !is_of_name(&hello("a"), "b"));
    }

    #[test]
    fn no_name_reaches_beyond_its_place() {
        for name in ["*", "a/b", "$*", "x?y#z", "ü", ""] {
            let key = of_host("s", name, 1, "order");
            assert!(!key.contains(['*', '$', '?', '#']), "{key}");
            assert_eq!(key.split('/').count(), 6, "{key}");
        }
        assert_eq!([chunk("lab-2.x_Y"), chunk("a/*"), chunk("")], ["lab-2.x_Y", "a%2f%2a", "%"]);
    }
}
