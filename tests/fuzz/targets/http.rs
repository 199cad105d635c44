//! Bytes as a client sends them to the HTTP service, over a connection of this machine: whatever
//! they are, nothing panics and nothing is the service's own failure.

#![no_main]

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::OnceLock;
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use nix::sys::signal::{SigSet, Signal};
use proto::DigestBuilder;
use service::http::{Limits, Service, ServiceSpec, Token};
use store::checkpoint::Snapshot;

/// The service of this process, which lives as long as it.
fn address() -> SocketAddr {
    static SERVICE: OnceLock<Service> = OnceLock::new();
    SERVICE
        .get_or_init(|| {
            let store = fuzz::empty_store("served");
            let bytes = fuzz::tensors("policy.", &["counters"]);
            // Of what is no policy's: all numbers of these tensors are one half.
            let mut digest = DigestBuilder::new();
            digest.field("counters", &0.5_f32.to_le_bytes());
            let snapshot = Snapshot { iteration: 1, digest: digest.finish(), bytes };
            let config = fuzz::small_config();
            store
                .commit(&snapshot, &config, &fuzz::robot_toml(), &serde_json::Value::Null)
                .expect("a valid snapshot");
            let limits = Limits { upload_bytes: 1 << 20, ..Limits::default() };
            let token = Token::parse(TOKEN, "fuzz").expect("valid");
            Service::start(ServiceSpec { limits, ..ServiceSpec::new(store, token) })
                .expect("starts")
        })
        .address()
}

/// Seeds show it, so that what grows from them comes past it.
const TOKEN: &str = "fuzz-fuzz-fuzz-fuzz";

fn request(line: &str, rest: &str) -> Vec<u8> {
    format!("{line} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n{rest}\r\n")
        .into_bytes()
}

fn seeds() -> Vec<Vec<u8>> {
    let with_body = |line: &str, body: &str| {
        let headers =
            format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
        [request(line, &headers), body.as_bytes().to_vec()].concat()
    };
    let name = "/v1/checkpoints/iteration-00000001";
    let mut seeds: Vec<Vec<u8>> =
        ["/", "/page/page.js", "/health", "/metrics", "/openapi.json", "/v1/status", "/v1/events"]
            .iter()
            .map(|path| request(&format!("GET {path}"), ""))
            .collect();
    seeds.extend([
        request("GET /v1/checkpoints?limit=2", "Connection: close\r\n"),
        request("GET /v1/checkpoints/latest", "If-None-Match: \"x\"\r\n"),
        request(&format!("GET {name}/archive"), ""),
        request(&format!("GET {name}/files/config.toml"), "Range: bytes=0-99,200-\r\n"),
        request(&format!("PUT {name}/pin"), ""),
        request(&format!("DELETE {name}/pin"), ""),
        request(&format!("PUT {name}/tags/paper"), ""),
        with_body("PUT /v1/checkpoints/copy", "no archive"),
        with_body("PUT /v1/workers", "{\"workers\": 3}"),
        with_body("POST /v1/checkpoints", "{}"),
    ]);
    seeds
}

fn is_events(answer: &[u8]) -> bool {
    let kind = b"content-type: text/event-stream";
    answer.windows(kind.len()).any(|window| window == kind)
}

fuzz_target!(
    init: {
        fuzz::write_seeds(seeds);
        // As in every Rust program, whose `main` libFuzzer takes the place of: who writes to a client that has gone gets an error. The
        // threads of the service inherit it.
        SigSet::from(Signal::SIGPIPE).thread_block().expect("a valid signal");
        address();
    },
    |bytes: &[u8]| {
        let mut stream = TcpStream::connect(address()).expect("the service listens");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a valid time");
        // The service may close the connection before it has read everything.
        let _ = stream.write_all(bytes);
        let _ = stream.shutdown(Shutdown::Write);
        let mut answer = Vec::new();
        let mut piece = [0; 1 << 14];
        // A stream of events has no end: behind bytes that are no request, nobody sees that the client has ended.
        while !is_events(&answer) {
            match stream.read(&mut piece) {
                Ok(0) => break,
                Ok(n) => answer.extend_from_slice(&piece[..n]),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                    panic!("no answer and no end within 20 s")
                }
                Err(_) => break,
            }
        }
        for code in ["500", "501"] {
            let line = format!("HTTP/1.1 {code}");
            assert!(!answer.starts_with(line.as_bytes()), "{}", String::from_utf8_lossy(&answer));
        }
    }
);
