//! The service on a socket: start, address, stop; and its description.

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use store::checkpoint::CheckpointStore;

use super::{Bench, TOKEN};
use crate::client::Client;
use crate::http::{Limits, Service, ServiceSpec, Token};
use crate::live::{LiveRun, LiveStatus};

fn token() -> Token {
    Token::parse(TOKEN, "test").expect("valid")
}

fn spec() -> ServiceSpec {
    ServiceSpec::new(CheckpointStore::new("/nonexistent/store"), token())
}

fn start(limits: Limits) -> Service {
    Service::start(ServiceSpec { limits, ..spec() }).expect("starts")
}

fn exchange(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("connects");
    stream.write_all(request.as_bytes()).expect("sends");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("reads");
    answer
}

const STATE: &str = "/v1/checkpoints/latest/files/state.safetensors";

/// The header that shows the token.
fn bearer() -> String {
    format!("Authorization: Bearer {TOKEN}\r\n")
}

const HEALTH: &str = "GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";

/// Folders of this process's threads that carry the name.
fn threads(name: &str) -> Vec<PathBuf> {
    let of_name = |thread: &PathBuf| {
        std::fs::read_to_string(thread.join("comm")).is_ok_and(|comm| comm.trim_end() == name)
    };
    let threads = std::fs::read_dir("/proc/self/task").expect("Linux").flatten();
    threads.map(|task| task.path()).filter(of_name).collect()
}

#[test]
fn it_answers_and_is_gone_after_it_was_stopped() {
    let service = start(Limits::default());
    let address = service.address();
    assert!(exchange(address, HEALTH).starts_with("HTTP/1.1 200 OK"));
    assert!(service.is_running());
    // A client that only sits there does not keep it.
    let mut idle = TcpStream::connect(address).expect("connects");
    idle.write_all(b"GET /hea").expect("sends");
    service.stop();
    assert!(TcpStream::connect(address).is_err(), "nobody listens");
    let mut rest = Vec::new();
    let _ = idle.read_to_end(&mut rest);
    // The port is free again.
    drop(idle);
    TcpListener::bind(address).expect("free");
}

#[test]
fn no_thread_is_left() {
    let service = start(Limits::default());
    // A thread that answers has its name already.
    assert!(exchange(service.address(), HEALTH).starts_with("HTTP/1.1 200 OK"));
    // Some are of services of other tests, which start and end meanwhile: of those that are there
    // now, every one has to end.
    let mut left = threads("http");
    assert!(!left.is_empty());
    drop(service);
    let patience = Instant::now() + Duration::from_mins(1);
    while !left.is_empty() && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(20));
        left.retain(|thread| thread.exists());
    }
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_port_that_is_taken_is_named() {
    let first = start(Limits::default());
    let spec = ServiceSpec { address: first.address(), ..spec() };
    let error = Service::start(spec).expect_err("taken");
    assert!(error.message.contains(&first.address().to_string()), "{error}");
}

/// All places are taken by clients that never finish a head, which would be waited for an hour.
#[test]
fn slow_heads_hold_nobody_up() {
    let limits = Limits { head_time: Duration::from_hours(1), connections: 4, ..Limits::default() };
    let service = start(limits);
    let address = service.address();
    let mut slow: Vec<TcpStream> =
        (0..16).map(|_| TcpStream::connect(address).expect("connects")).collect();
    for stream in &mut slow {
        let _ = stream.write_all(b"GET /health HTTP/1.1\r\nX: ");
    }
    assert!(exchange(address, HEALTH).starts_with("HTTP/1.1 200 OK"));
    // Those that came first had to go.
    for stream in &mut slow[..12] {
        let mut rest = Vec::new();
        let _ = stream.read_to_end(&mut rest);
    }
}

#[test]
fn slow_heads_are_cut_off() {
    let service = start(Limits { head_time: Duration::from_millis(200), ..Limits::default() });
    let mut slow = TcpStream::connect(service.address()).expect("connects");
    slow.write_all(b"GET /health HTTP/1.1\r\nX: ").expect("sends");
    let mut rest = Vec::new();
    let _ = slow.read_to_end(&mut rest);
}

/// Clients that have the token and are busy for ever: others get a place all the same.
#[test]
fn busy_connections_make_room_after_a_time() {
    let bench = Bench::new(&[1]);
    let limits =
        Limits { connections: 4, connection_time: Duration::from_millis(100), ..Limits::default() };
    let spec = ServiceSpec { limits, ..ServiceSpec::new(bench.store.clone(), token()) };
    let service = Service::start(spec).expect("starts");
    let request = format!("GET {STATE} HTTP/1.1\r\nHost: localhost\r\n{}\r\n", bearer());
    let mut busy: Vec<TcpStream> = (0..4)
        .map(|_| {
            let mut stream = TcpStream::connect(service.address()).expect("connects");
            // More answers than the system's buffers take, and nobody who reads them.
            stream.write_all(request.repeat(50).as_bytes()).expect("sends");
            let mut first = [0; 12];
            stream.read_exact(&mut first).expect("is served");
            assert_eq!(&first, b"HTTP/1.1 200");
            stream
        })
        .collect();
    for _ in 0..4 {
        assert!(exchange(service.address(), HEALTH).starts_with("HTTP/1.1 200 OK"));
    }
    let mut rest = Vec::new();
    let end = busy[0].read_to_end(&mut rest);
    assert!(end.is_err() || rest.len() < 50 * 800_000, "the oldest was cut off");
}

#[test]
fn who_may_not_ask_does_not_keep_the_connection() {
    let service = start(Limits { head_time: Duration::from_hours(1), ..Limits::default() });
    // It ends, although the client would keep it.
    let answer = exchange(service.address(), "GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 401") && answer.contains("connection: close"), "{answer}");
    let two = "GET /metrics HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n";
    assert!(exchange(service.address(), two).starts_with("HTTP/1.1 400"));
}

#[test]
fn a_reader_that_does_not_read_is_cut_off() {
    let bench = Bench::new(&[1]);
    let limits = Limits { pace_time: Duration::from_millis(200), ..Limits::default() };
    let spec = ServiceSpec { limits, ..ServiceSpec::new(bench.store.clone(), token()) };
    let service = Service::start(spec).expect("starts");
    let mut stream = TcpStream::connect(service.address()).expect("connects");
    let line = format!("GET {STATE} HTTP/1.1\r\nHost: localhost\r\n{}\r\n", bearer());
    // Answers pile up: far more than the system's buffers take.
    for _ in 0..200 {
        stream.write_all(line.as_bytes()).expect("sends");
    }
    std::thread::sleep(Duration::from_secs(2));
    let mut rest = Vec::new();
    let end = stream.read_to_end(&mut rest);
    let all = 200 * 800_000;
    assert!(end.is_err() || rest.len() < all, "{end:?} after {} bytes", rest.len());
}

#[test]
fn large_heads_are_refused() {
    let service = start(Limits::default());
    let head =
        format!("GET /health HTTP/1.1\r\nHost: localhost\r\nX: {}\r\n\r\n", "x".repeat(20_000));
    assert!(exchange(service.address(), &head).starts_with("HTTP/1.1 431"));
    let many = "X: y\r\n".repeat(100);
    let head = format!("GET /health HTTP/1.1\r\nHost: localhost\r\n{many}\r\n");
    assert!(exchange(service.address(), &head).starts_with("HTTP/1.1 431"));
    assert!(exchange(service.address(), "what is this?\r\n\r\n").starts_with("HTTP/1.1 400"));
}

#[test]
fn the_client_understands_the_service() {
    let live = LiveRun::new();
    live.publish(LiveStatus { iterations: 3, ..LiveStatus::default() });
    let spec = ServiceSpec { live: Some(live.clone()), ..spec() };
    let service = Service::start(spec).expect("starts");
    let client = Client::new(&service.address().to_string());
    let error = client.status().expect_err("no token").to_string();
    assert!(error.contains("token"), "{error}");
    let client = client.with_token(Some(token()));
    assert_eq!(client.status().expect("answers").iterations, 3);
    live.close();
    let error = client.scale(2, None).expect_err("the run has ended");
    assert!(error.to_string().contains("ending"), "{error}");
    let error = client.checkpoint_now().expect_err("the run has ended");
    assert!(error.to_string().contains("ending"), "{error}");
    service.stop();
    let error = client.status().expect_err("nobody listens").to_string();
    assert!(error.contains("no answer"), "{error}");
}

#[tokio::test]
async fn the_description_holds_every_route() {
    let bench = Bench::new(&[]);
    let document = bench.ask("GET /openapi.json").await.json();
    assert_eq!(document["openapi"], "3.1.0");
    let mut described: Vec<String> = Vec::new();
    let mut names = BTreeSet::new();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            if ["parameters", "summary", "description", "servers"].contains(&method.as_str()) {
                continue;
            }
            assert!(operation["summary"].is_string(), "{method} {path} says what it does");
            let name = operation["operationId"].as_str().expect("a name");
            assert!(names.insert(name.to_owned()), "{name} names one operation");
            for (status, response) in operation["responses"].as_object().expect("responses") {
                assert!(response["description"].is_string(), "{method} {path}: {status}");
            }
            described.push(format!("{} {path}", method.to_uppercase()));
        }
    }
    described.sort();
    // The list that the module's documentation gives.
    let mut listed: Vec<String> = include_str!("../mod.rs")
        .lines()
        .filter_map(|line| line.strip_prefix("//! "))
        .filter(|line| line.contains(" /"))
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            let (method, path) = (words.next()?, words.next()?);
            let known = ["GET", "POST", "PUT", "DELETE"].contains(&method);
            known.then(|| format!("{method} {path}"))
        })
        .collect();
    for path in ["/v1/checkpoints/{name}/pin", "/v1/checkpoints/{name}/tags/{tag}"] {
        listed.push(format!("DELETE {path}"));
    }
    listed.sort();
    assert_eq!(described, listed);
    // And each is there: whatever it answers, it is not that there is no such route or method.
    for line in described {
        if line == "GET /v1/events" {
            // It has no end; what it says is tried where it is.
            continue;
        }
        let line = line.replace("{name}", "x").replace("{file}", "y").replace("{tag}", "z");
        let answer = bench.ask(&line).await;
        let routed = answer.status.is_success() || !answer.error().contains("openapi.json");
        assert!(routed && answer.status.as_u16() != 405, "{line}: {answer:?}");
    }
}

#[tokio::test]
async fn the_description_knows_refusals_and_bytes() {
    let document = Bench::new(&[]).ask("GET /openapi.json").await.json();
    let upload = &document["paths"]["/v1/checkpoints/{name}"]["put"];
    let body = &upload["requestBody"]["content"]["application/x-tar"]["schema"];
    assert_eq!(*body, serde_json::json!({ "type": "string", "format": "binary" }));
    let file = &document["paths"]["/v1/checkpoints/{name}/files/{file}"]["get"];
    let body = &file["responses"]["200"]["content"]["application/octet-stream"]["schema"];
    assert_eq!(body["format"], "binary");
    assert!(document["components"]["schemas"]["ErrorBody"].is_object());
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            for status in ["400", "401", "431"] {
                let known = operation["responses"][status].is_object();
                let open = ["/", "/page/{file}", "/health"].contains(&path.as_str());
                assert_eq!(known, !open || status != "401", "{method} {path} {status}");
            }
        }
    }
    assert!(document["paths"]["/v1/workers"]["put"]["responses"]["415"].is_object());
}
