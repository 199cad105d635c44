//! A server of S3 for tests, and a wire to it that can be cut.

use std::io::{BufRead as _, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use crate::{Owned, crosscheck, program, python};

/// What a test's credentials are: words that no file may hold.
pub const KEY_ID: &str = "AKIDTESTSFORNOBODY42";
/// The secret one.
pub const SECRET: &str = "bm9ib2R5LXNoYWxsLXNlZS10aGlz";

/// moto, in a process that ends with this.
#[derive(Debug)]
pub struct S3Server {
    _process: Owned,
    port: u16,
}

impl S3Server {
    /// Starts it, with the bucket `bucket`.
    pub fn start() -> Self {
        let mut command = Command::new(python());
        command.arg(crosscheck("s3_server.py"));
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("python starts");
        let mut line = String::new();
        let stdout = child.stdout.take().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let process = Owned::from(child);
        let port = line.trim().parse().expect("a port");
        let server = Self { _process: process, port };
        server.ask("PUT", "/bucket", "");
        server
    }

    /// Its port on this machine.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Says what becomes of requests from now on; see `crosscheck/s3_server.py`.
    pub fn fail(&self, fault: &str) {
        self.ask("PUT", "/-/fault", fault);
    }

    /// One request; returns the body of the answer.
    pub fn ask(&self, method: &str, path: &str, body: &str) -> String {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("it listens");
        let length = body.len();
        // An S3 server tells its own by how they are signed; moto looks at no more than that they are.
        let request = format!(
            "{method} {path} HTTP/1.0\r\nHost: 127.0.0.1\r\nContent-Length: {length}\r\nAuthorization: \
             AWS4-HMAC-SHA256 Credential=a/20260101/us-east-1/s3/aws4_request\r\n\r\n{body}"
        );
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("an answer");
        let answer = String::from_utf8_lossy(&answer).into_owned();
        assert!(answer.contains(" 200 "), "{method} {path}: {answer}");
        answer.split_once("\r\n\r\n").map(|(_, body)| body.to_owned()).unwrap_or_default()
    }
}

/// The environment of a program that finds its bucket at `port`.
pub fn credentials(port: u16) -> Vec<(&'static str, String)> {
    vec![
        ("AWS_ACCESS_KEY_ID", KEY_ID.to_owned()),
        ("AWS_SECRET_ACCESS_KEY", SECRET.to_owned()),
        ("AWS_REGION", "us-east-1".to_owned()),
        ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{port}")),
    ]
}

/// Runs `octopus` to its end with these credentials.
pub fn octopus_at(port: u16, args: &[&str]) -> Output {
    let mut command = Command::new(program("octopus"));
    command.args(args).envs(credentials(port)).stdin(Stdio::null());
    command.output().expect("octopus can be started")
}

/// Whether any file below `dir` holds one of the credentials.
pub fn tells_secrets(dir: &Path) -> bool {
    let holds =
        |bytes: &[u8], word: &str| bytes.windows(word.len()).any(|at| at == word.as_bytes());
    std::fs::read_dir(dir).into_iter().flatten().flatten().any(|entry| {
        let path = entry.path();
        if path.is_dir() {
            return tells_secrets(&path);
        }
        let bytes = std::fs::read(&path).unwrap_or_default();
        holds(&bytes, KEY_ID) || holds(&bytes, SECRET)
    })
}

/// A wire between a program and a server.
#[derive(Debug)]
pub struct Wire {
    port: u16,
    state: Arc<State>,
}

#[derive(Debug)]
struct State {
    /// Bytes towards the server until the wire is cut.
    left: AtomicI64,
    /// Nobody gets through.
    down: AtomicBool,
    ended: AtomicBool,
}

impl Wire {
    /// To the server at this port.
    pub fn to(server: u16) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
        let port = listener.local_addr().expect("bound").port();
        let state = Arc::new(State {
            left: AtomicI64::new(i64::MAX),
            down: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        });
        let shared = Arc::clone(&state);
        std::thread::spawn(move || {
            for client in listener.incoming() {
                if shared.ended.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(client) = client else { continue };
                if shared.down.load(Ordering::Relaxed) {
                    continue;
                }
                if let Ok(server) = TcpStream::connect(("127.0.0.1", server)) {
                    join(client, server, &shared);
                }
            }
        });
        Self { port, state }
    }

    /// The port to connect to.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Takes the wire down, or puts it up again.
    pub fn set_down(&self, down: bool) {
        self.state.down.store(down, Ordering::Relaxed);
    }

    /// Cuts all connections when so many more bytes have gone to the server, in the middle of whatever that is; new
    /// ones get through.
    pub fn cut_after(&self, bytes: i64) {
        self.state.left.store(bytes, Ordering::Relaxed);
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::Relaxed);
        // The thread sees it when somebody comes.
        let _ = TcpStream::connect(("127.0.0.1", self.port));
    }
}

/// Copies both ways until one side ends or the wire is cut.
fn join(client: TcpStream, server: TcpStream, state: &Arc<State>) {
    let (mut answers, mut to_client) =
        (server.try_clone().expect("a socket"), client.try_clone().expect("a socket"));
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut answers, &mut to_client);
        let _ = to_client.shutdown(Shutdown::Both);
    });
    let state = Arc::clone(state);
    std::thread::spawn(move || {
        let (mut client, mut server) = (client, server);
        let mut buffer = [0; 4096];
        while let Ok(read @ 1..) = client.read(&mut buffer) {
            let left = state.left.fetch_sub(read as i64, Ordering::Relaxed);
            if left < read as i64 {
                // Whoever comes next gets through.
                state.left.store(i64::MAX, Ordering::Relaxed);
                let _ = server.write_all(&buffer[..left.max(0) as usize]);
                break;
            }
            if server.write_all(&buffer[..read]).is_err() {
                break;
            }
        }
        let _ = server.shutdown(Shutdown::Both);
        let _ = client.shutdown(Shutdown::Both);
    });
}
