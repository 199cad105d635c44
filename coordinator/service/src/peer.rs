//! Whether the service that a lock file names is one of this user's own, before a token goes there.
//!
//! The lock file says which process listens where. It is believed only if nobody else can have
//! written it ([`store::owned_files`]); but the process may have been killed, and another user's may listen at
//! its address since. So the kernel is asked whose process that is, and whose socket.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;

use store::lock::Holder;
use store::{owned_files, regular_files};

/// State of a socket that listens, in the kernel's tables.
const LISTEN: &str = "0A";

/// Where the service of `holder` is reached, if it is a process of this user that listens there.
pub fn address(holder: &Holder, announced: &str) -> Result<SocketAddr, String> {
    let user = owned_files::user();
    let listening: SocketAddr = announced.parse().map_err(|_| {
        format!("`{}` is no address, such as 127.0.0.1:8270", announced.escape_debug())
    })?;
    let pid = holder.pid;
    let process = PathBuf::from(format!("/proc/{pid}"));
    let owner = process.metadata().map_err(|_| format!("there is no process {pid}"))?.uid();
    if owner != user {
        return Err(format!("process {pid} belongs to user {owner}, not to you (user {user})"));
    }
    let table = if listening.is_ipv4() { "/proc/net/tcp" } else { "/proc/net/tcp6" };
    let text = regular_files::read_text(table.as_ref(), regular_files::RECORD)
        .map_err(|error| format!("{table}: cannot be read: {error}"))?;
    match listeners(&text, listening).as_slice() {
        [] => Err(format!("nobody listens at {listening}")),
        users if users.iter().all(|listener| *listener == user) => Ok(reached(listening)),
        users => {
            let other = users.iter().find(|listener| **listener != user).unwrap_or(&user);
            Err(format!("at {listening} listens user {other}, not you (user {user})"))
        }
    }
}

/// The users who listen at `address`, by the kernel's table.
fn listeners(table: &str, address: SocketAddr) -> Vec<u32> {
    let rows = table.lines().skip(1).filter_map(|line| {
        // sl, local address, remote address, state, queues, timer, retransmits, user.
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let (local, state) = (socket_address(words.get(1)?)?, *words.get(3)?);
        (local == address && state == LISTEN).then_some(words.get(7)?.parse().ok()?)
    });
    rows.collect()
}

/// An address as the kernel's tables hold it, `0100007F:1F90`: words of the processor, then the port.
fn socket_address(text: &str) -> Option<SocketAddr> {
    let (ip, port) = text.split_once(':')?;
    let port = u16::from_str_radix(port, 16).ok()?;
    let word = |at: usize| Some(u32::from_str_radix(ip.get(at..at + 8)?, 16).ok()?.to_ne_bytes());
    let ip = match ip.len() {
        8 => IpAddr::from(word(0)?),
        32 => {
            let mut octets = [0; 16];
            for (index, part) in octets.chunks_exact_mut(4).enumerate() {
                part.copy_from_slice(&word(8 * index)?);
            }
            IpAddr::from(octets)
        }
        _ => return None,
    };
    Some(SocketAddr::new(ip, port))
}

/// Where a socket that listens at `address` is reached from this machine.
fn reached(address: SocketAddr) -> SocketAddr {
    let ip = match address.ip() {
        ip if !ip.is_unspecified() => ip,
        IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
    };
    SocketAddr::new(ip, address.port())
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    fn holder(pid: u32) -> Holder {
        Holder { pid, domain: "spaceoctopus-test".to_owned(), http: None }
    }

    /// The tables are those of a little-endian processor: 127.0.0.1:8270 and [::1]:8270.
    #[test]
    fn the_kernels_tables_are_read() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n   \
             0: 0100007F:204E 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000        0 1049 1 0\n   \
             1: 0100007F:204E 0100007F:8162 01 00000000:00000000 00:00000000 00000000  1001        0 4552 1 0\n   \
             2: 00000000000000000000000001000000:204E 0:0 0A 0:0 0:0 0  1002        0 4552 1 0\n   \
             3: nonsense\n";
        let listening = |address: &str| listeners(table, address.parse().expect("an address"));
        assert_eq!(listening("127.0.0.1:8270"), [1000]);
        assert_eq!(listening("[::1]:8270"), [1002]);
        assert_eq!(listening("127.0.0.1:8271"), [0; 0]);
        assert_eq!(reached("0.0.0.0:1".parse().expect("valid")).to_string(), "127.0.0.1:1");
        assert_eq!(reached("[::]:1".parse().expect("valid")).to_string(), "[::1]:1");
        assert_eq!(reached("10.0.0.1:1".parse().expect("valid")).to_string(), "10.0.0.1:1");
    }

    #[test]
    fn only_a_process_that_lives_and_a_socket_that_listens_are_believed() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let here = listener.local_addr().expect("an address").to_string();
        let own = holder(std::process::id());
        assert_eq!(address(&own, &here).expect("own").to_string(), here);
        // Beyond what any system gives to a process.
        let error = address(&holder(u32::MAX), &here).expect_err("no process");
        assert!(error.contains("no process"), "{error}");
        for wrong in ["", "evil.example:80", "127.0.0.1", "http://127.0.0.1:1", "\u{1b}[2J"] {
            let error = address(&own, wrong).expect_err(wrong);
            assert!(error.contains("no address") && !error.contains('\u{1b}'), "{error}");
        }
        drop(listener);
        let error = address(&own, &here).expect_err("nobody listens");
        assert!(error.contains("nobody listens"), "{error}");
        // A service elsewhere, as a forged file would name one.
        let error = address(&own, "192.0.2.1:80").expect_err("elsewhere");
        assert!(error.contains("nobody listens at 192.0.2.1:80"), "{error}");
    }
}
