//! The checkpoint service from outside: the real program, raw sockets, Python's own client.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;
use serde_json::Value;
use tests::{Run, assert_nothing_left, kill, octopus, program, python, stderr};

/// A running `octopus serve`; killed when dropped.
struct Served {
    process: Child,
    address: SocketAddr,
    /// The one that it has made for itself.
    token: String,
}

impl Served {
    fn start(store: &Path, more: &[&str]) -> Self {
        let mut process = Command::new(program("octopus"))
            .args(["serve", "--json", "--listen=127.0.0.1:0", "--store"])
            .arg(store)
            .args(more)
            .env("RUST_LOG", "trace")
            .env_remove("SPACEOCTOPUS_TOKEN")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(log(store)).expect("the log can be written"))
            .spawn()
            .expect("octopus can be started");
        let mut line = String::new();
        let stdout = process.stdout.take().expect("piped");
        let read = BufReader::new(stdout).read_line(&mut line);
        let said: Result<Value, _> = serde_json::from_str(&line);
        let said = said.ok().and_then(|said| {
            let token = std::fs::read_to_string(said["token_file"].as_str()?).ok()?;
            Some((said["address"].as_str()?.parse().ok()?, token.trim_end().to_owned()))
        });
        let Some((address, token)) = said else {
            let _ = process.kill();
            let _ = process.wait();
            panic!("{read:?} {line:?}: {:?}", std::fs::read_to_string(log(store)));
        };
        Self { process, address, token }
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).expect("connects")
    }

    /// Sends bytes as they are; returns everything that comes until the service closes.
    fn exchange(&self, request: &[u8]) -> Vec<u8> {
        let mut stream = self.connect();
        // A refused request may be answered before all of it is read.
        let _ = stream.write_all(request);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// The header that shows the token.
    fn bearer(&self) -> String {
        format!("Authorization: Bearer {}\r\n", self.token)
    }

    /// Asks for a path with the token; returns status line with headers, and the body.
    fn get(&self, path: &str, headers: &str) -> (String, Vec<u8>) {
        self.get_as_stranger(path, &format!("{}{headers}", self.bearer()))
    }

    /// The same without a token.
    fn get_as_stranger(&self, path: &str, headers: &str) -> (String, Vec<u8>) {
        let request =
            format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\r\n");
        split(&self.exchange(request.as_bytes()))
    }

    /// Files that the service has open although they have no name any more.
    fn nameless_files(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.process.id()))
            .expect("a living process")
            .flatten()
            .filter_map(|fd| std::fs::read_link(fd.path()).ok())
            .filter(|target| target.to_string_lossy().ends_with(" (deleted)"))
            .count()
    }

    fn interrupt(&mut self) -> Option<i32> {
        kill(self.process.id(), Signal::INT);
        self.process.wait().expect("own child").code()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Beside the store, so that it goes away with it.
fn log(store: &Path) -> PathBuf {
    store.with_extension("serve.log")
}

fn split(answer: &[u8]) -> (String, Vec<u8>) {
    let end = answer.windows(4).position(|four| four == b"\r\n\r\n").map_or(0, |at| at + 4);
    (String::from_utf8_lossy(&answer[..end]).to_lowercase(), answer[end..].to_vec())
}

/// A run of two iterations, one checkpoint.
fn trained() -> Run {
    let mut run = Run::train(&["--workers=1", "--iterations=2"]);
    run.succeed();
    run
}

fn checkpoint(run: &Run) -> PathBuf {
    run.path().join("checkpoints/iteration-00000002")
}

const STATE: &str = "/v1/checkpoints/latest/files/state.safetensors";

/// Names in a store, hidden ones included, but for the store's own.
fn inventory(store: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(store)
        .expect("readable")
        .map(|entry| entry.expect("entry").file_name().to_string_lossy().into_owned())
        .filter(|name| {
            ![".lock", ".http.token"].contains(&name.as_str())
                && !name.starts_with("catalogue.sqlite")
        })
        .collect();
    names.sort();
    names
}

/// Reads description and metrics of a service with the readers that others use.
const DESCRIPTION: &str = r#"
import json, sys, urllib.request
from openapi_spec_validator import OpenAPIV31SpecValidator
from prometheus_client.parser import text_string_to_metric_families
opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
opener.addheaders = [("Authorization", "Bearer " + sys.argv[2])]
def get(path):
    return opener.open(sys.argv[1] + path, timeout=60).read().decode()
document = json.loads(get("/openapi.json"))
errors = [error.message for error in OpenAPIV31SpecValidator(document).iter_errors()]
assert not errors, errors
for _ in range(2):
    families = {family.name: family for family in text_string_to_metric_families(get("/metrics"))}
assert families["octopus_checkpoints"].samples[0].value == 1
requests = families["octopus_http_requests"]
assert requests.type == "counter"
assert [s.value for s in requests.samples if s.labels["route"] == "/metrics"] == [1.0]
duration = families["octopus_http_request_duration_seconds"]
assert duration.type == "histogram"
"#;

/// Reads everything from one service, compares it with the files, and uploads it to another.
const ROUND_TRIP: &str = r#"
import hashlib, io, json, os, sys, tarfile, urllib.error, urllib.request
source, target, directory, source_token, target_token = sys.argv[1:]
urllib.request.install_opener(urllib.request.build_opener(urllib.request.ProxyHandler({})))
def ask(url, method="GET", data=None, **headers):
    request = urllib.request.Request(url, data=data, method=method)
    token = source_token if url.startswith(source) else target_token
    request.add_header("Authorization", "Bearer " + token)
    for name, value in headers.items():
        request.add_header(name.replace("_", "-"), value)
    with urllib.request.urlopen(request, timeout=60) as answer:
        return answer.status, answer.headers, answer.read()
def refused(url, **more):
    try:
        status, _, _ = ask(url, **more)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)["error"]
    raise AssertionError(f"{url}: {status}")
_, _, text = ask(source + "/v1/checkpoints")
entries = json.loads(text)["checkpoints"]
assert [entry["name"] for entry in entries] == ["iteration-00000002"], entries
_, _, text = ask(source + "/v1/checkpoints/latest")
manifest = json.loads(text)["manifest"]
assert len(manifest["files"]) == 4, manifest
for name, entry in manifest["files"].items():
    content = open(os.path.join(directory, name), "rb").read()
    url = source + "/v1/checkpoints/iteration-00000002/files/" + name
    status, headers, body = ask(url)
    assert status == 200 and body == content and len(body) == entry["len"], name
    assert headers["ETag"] == '"' + entry["blake3"] + '"', headers
    for first, last in [(0, 0), (3, 99), (len(content) - 5, len(content) + 5)]:
        status, headers, body = ask(url, Range=f"bytes={first}-{last}")
        assert status == 206 and body == content[first:last + 1], (name, first, last)
        end = min(last, len(content) - 1)
        assert headers["Content-Range"] == f"bytes {first}-{end}/{len(content)}", headers
    try:
        ask(url, Range=f"bytes={len(content)}-")
        raise AssertionError("a range outside the file")
    except urllib.error.HTTPError as error:
        assert error.code == 416 and error.headers["Content-Range"] == f"bytes */{len(content)}"
    try:
        ask(url, If_None_Match='"' + entry["blake3"] + '"')
        raise AssertionError("it was sent again")
    except urllib.error.HTTPError as error:
        assert error.code == 304
_, _, archive = ask(source + "/v1/checkpoints/latest/archive")
with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
    names = sorted(os.path.basename(member.name) for member in tar)
    assert names == sorted([*manifest["files"], "manifest.json"]), names
    for member in tar:
        content = open(os.path.join(directory, os.path.basename(member.name)), "rb").read()
        assert tar.extractfile(member).read() == content, member.name
status, _, text = ask(target + "/v1/checkpoints/copy", "PUT", archive)
assert status == 201 and json.loads(text)["name"] == "copy", text
status, _, _ = ask(target + "/v1/checkpoints/copy", "PUT", archive)
assert status == 200
_, _, back = ask(target + "/v1/checkpoints/copy/files/state.safetensors")
assert hashlib.sha256(back).digest() == hashlib.sha256(
    open(os.path.join(directory, "state.safetensors"), "rb").read()).digest()
broken = bytearray(archive)
broken[len(broken) // 2] ^= 1
code, error = refused(target + "/v1/checkpoints/broken", method="PUT", data=bytes(broken))
assert code == 422, (code, error)
code, error = refused(target + "/v1/checkpoints/iteration-00000003", method="PUT", data=archive)
assert code == 422 and "iteration" in error, (code, error)
ask(target + "/v1/checkpoints/copy/pin", "PUT")
code, error = refused(target + "/v1/checkpoints/copy", method="DELETE")
assert code == 409 and "pinned" in error, (code, error)
ask(target + "/v1/checkpoints/copy/tags/demo", "PUT")
assert json.loads(ask(target + "/v1/checkpoints/demo")[2])["labels"]["tags"] == ["demo"]
code, error = refused(target + "/v1/status")
assert code == 404 and "no live run" in error, (code, error)
_, headers, page = ask(target + "/metrics")
assert b"\noctopus_checkpoints 1\n" in page, page
"#;

#[test]
fn a_checkpoint_travels_from_one_service_to_another_through_python() {
    let run = trained();
    let dir = tempfile::tempdir().expect("tempdir");
    let store = dir.path().join("store");
    let source = Served::start(&run.path(), &[]);
    let mut target = Served::start(&store, &["--create"]);
    let output = Command::new(python())
        .args(["-c", ROUND_TRIP, &source.url(""), &target.url("")])
        .arg(checkpoint(&run))
        .args([&source.token, &target.token])
        .output()
        .expect("python starts");
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(inventory(&store), ["copy"]);
    for file in ["state.safetensors", "policy.safetensors", "manifest.json", "robot.toml"] {
        let read = |dir: PathBuf| std::fs::read(dir.join(file)).expect("readable");
        assert!(read(checkpoint(&run)) == read(store.join("copy")), "{file}");
    }
    // It is a checkpoint like any other.
    let copy = store.join("copy");
    let copy = copy.to_str().expect("UTF-8");
    let output = octopus(&["eval", copy, "--episodes=2", "--steps=5", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));

    let address = target.address;
    assert_eq!(target.interrupt(), Some(0), "Ctrl-C is the way to end it");
    assert!(TcpStream::connect(address).is_err(), "nobody listens any more");
}

#[test]
fn the_description_and_the_metrics_are_what_others_read() {
    let run = trained();
    let served = Served::start(&run.path(), &[]);
    let output = Command::new(python())
        .args(["-c", DESCRIPTION, &served.url(""), &served.token])
        .output()
        .expect("python starts");
    assert!(output.status.success(), "run `make venv` if a module is missing: {}", stderr(&output));
}

#[test]
fn two_hundred_at_once_are_all_served() {
    let run = trained();
    let served = Served::start(&run.path(), &[]);
    let state = std::fs::read(checkpoint(&run).join("state.safetensors")).expect("readable");
    std::thread::scope(|scope| {
        let clients: Vec<_> = (0..200)
            .map(|index| {
                let (served, state) = (&served, &state);
                scope.spawn(move || {
                    let path = if index % 2 == 0 { STATE } else { "/v1/checkpoints" };
                    let (head, body) = served.get(path, "");
                    assert!(head.starts_with("http/1.1 200"), "{head}");
                    assert!(index % 2 == 1 || body == *state, "the bytes of the file");
                })
            })
            .collect();
        for client in clients {
            client.join().expect("served");
        }
    });
}

#[test]
fn paths_do_not_lead_out_of_the_store() {
    let run = trained();
    let served = Served::start(&run.path(), &[]);
    std::fs::write(run.path().join("secret.txt"), "precious").expect("writable");
    for path in [
        "/v1/checkpoints/latest/files/../../../secret.txt",
        "/v1/checkpoints/latest/files/..%2f..%2f..%2fsecret.txt",
        "/v1/checkpoints/latest/files/%2e%2e%2f%2e%2e%2fsecret.txt",
        "/v1/checkpoints/latest/files/..%5c..%5csecret.txt",
        "/v1/checkpoints/latest/files/%252e%252e%252fsecret.txt",
        "/v1/checkpoints/..%2f..%2fsecret.txt/archive",
        "/v1/checkpoints/../../secret.txt",
        "/v1/checkpoints/..",
        "/v1/checkpoints/%2e%2e/files/secret.txt",
        "/v1/checkpoints/../files/secret.txt",
        "/v1/checkpoints/latest/files//etc/passwd",
        "/v1/checkpoints/latest/files/%2fetc%2fpasswd",
        "/v1/checkpoints/latest/files/state.safetensors%00.txt",
        "/v1/checkpoints/./latest/files/../secret.txt",
        "//etc/passwd",
        "/../../../../etc/passwd",
    ] {
        let (head, body) = served.get(path, "");
        let body = String::from_utf8_lossy(&body).into_owned();
        assert!(head.starts_with("http/1.1 40"), "{path}: {head}");
        assert!(body.contains("\"error\""), "{path}: {body}");
        assert!(!body.contains("precious") && !body.contains("root:"), "{path}: {body}");
    }
    let (head, _) = served.get("/v1/checkpoints", "");
    assert!(head.starts_with("http/1.1 200"), "it still serves: {head}");
}

#[test]
fn bytes_that_are_no_http_end_in_a_refusal() {
    let dir = tempfile::tempdir().expect("tempdir");
    let served = Served::start(&dir.path().join("store"), &["--create"]);
    for request in [
        &b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03hello, TLS\r\n\r\n"[..],
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /v1/checkpoints HTTP/1.1\r\n\r\n",
        b"PUT /v1/checkpoints/x HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
        b"PUT /v1/checkpoints/x HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"PUT /v1/checkpoints/x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\
          Content-Length: 6\r\n\r\nhello!",
    ] {
        // What a client that may ask gets wrong.
        let request = String::from_utf8_lossy(request);
        let request = request.replacen("Host: ", &format!("{}Host: ", served.bearer()), 1);
        let (head, _) = split(&served.exchange(request.as_bytes()));
        assert!(head.starts_with("http/1.1 4") || head.is_empty(), "{request:?}: {head}");
    }
    assert!(served.get("/health", "").0.starts_with("http/1.1 200"), "it still serves");
    assert_eq!(inventory(&dir.path().join("store")), [""; 0]);
}

#[test]
fn clients_that_trickle_hold_nobody_up() {
    let dir = tempfile::tempdir().expect("tempdir");
    let served = Served::start(&dir.path().join("store"), &["--create"]);
    // More than the service takes at a time; each byte comes alone and the head never ends.
    let mut slow: Vec<TcpStream> = (0..600).map(|_| served.connect()).collect();
    for byte in b"GET /health HTTP/1.1\r\nX: " {
        for stream in &mut slow {
            let _ = stream.write_all(&[*byte]);
        }
    }
    assert!(served.get("/health", "").0.starts_with("http/1.1 200"));
    for stream in &mut slow[..10] {
        // Closed by the service, though the client would have gone on.
        let mut rest = Vec::new();
        let _ = stream.read_to_end(&mut rest);
    }
}

#[test]
fn a_client_that_goes_in_mid_upload_leaves_nothing() {
    let dir = tempfile::tempdir().expect("tempdir");
    let store = dir.path().join("store");
    let served = Served::start(&store, &["--create"]);
    let head = format!(
        "PUT /v1/checkpoints/x HTTP/1.1\r\nHost: localhost\r\n{}Content-Length: 9000000\r\n\r\n",
        served.bearer()
    );
    let mut uploads: Vec<TcpStream> = (0..4).map(|_| served.connect()).collect();
    for stream in &mut uploads {
        stream.write_all(head.as_bytes()).expect("sends");
        stream.write_all(&vec![7; 1_000_000]).expect("sends");
    }
    let patience = Instant::now() + Duration::from_mins(1);
    while served.nameless_files() < 4 && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(served.nameless_files(), 4, "the uploads are under way");
    drop(uploads);
    while served.nameless_files() > 0 && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(served.nameless_files(), 0);
    assert_eq!(inventory(&store), [""; 0]);
    assert!(served.get("/health", "").0.starts_with("http/1.1 200"));
}

#[test]
fn a_token_is_needed_and_stays_secret() {
    const TOKEN: &str = "a-secret-of-twenty-eight-chars";
    let dir = tempfile::tempdir().expect("tempdir");
    let file = dir.path().join("token.txt");
    std::fs::write(&file, format!("{TOKEN}\n")).expect("writable");
    let store = dir.path().join("store");
    let flag = format!("--token-file={}", file.display());
    let served = Served::start(&store, &["--create", &flag]);
    let status =
        |path: &str, headers: &str| served.get_as_stranger(path, headers).0[9..12].to_owned();
    assert_eq!(status("/health", ""), "200");
    assert_eq!(status("/v1/checkpoints", ""), "401");
    assert_eq!(status("/metrics", "Authorization: Bearer wrong-wrong-wrong-wrong\r\n"), "401");
    let right = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(status("/v1/checkpoints", &right), "200");
    // Beside it the service has one of its own, for the programs of its user.
    assert_eq!(status("/v1/checkpoints", &served.bearer()), "200");
    let own = served.token.clone();
    let command_line = std::fs::read(format!("/proc/{}/cmdline", served.process.id()));
    assert!(!String::from_utf8_lossy(&command_line.expect("readable")).contains(TOKEN));
    drop(served);
    let said = std::fs::read_to_string(log(&store)).expect("readable");
    assert!(said.contains("/v1/checkpoints"), "requests are logged: {said}");
    assert!(!said.contains(TOKEN) && !said.contains("wrong-wrong"), "tokens are not");
    assert!(!said.contains(&own), "nor its own");
}

#[test]
fn services_that_cannot_be() {
    let dir = tempfile::tempdir().expect("tempdir");
    let here = dir.path().to_str().expect("UTF-8");
    let tokens = tempfile::tempdir().expect("tempdir");
    let short = tokens.path().join("short.txt");
    std::fs::write(&short, "too-short").expect("writable");
    let others = tokens.path().to_str().expect("UTF-8");
    let run = trained();
    let logs = run.path().join("logs");
    let logs = logs.to_str().expect("UTF-8");
    let inside = run.path().join("new");
    let inside = inside.to_str().expect("UTF-8");
    let short = short.to_str().expect("UTF-8");
    let held = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let held = held.local_addr().expect("an address").to_string();
    let missing = format!("{here}/missing");
    for (args, code, words) in [
        (&["--store", here, "--listen", "0.0.0.0:0"][..], 2, &["--token-file", "0.0.0.0"][..]),
        (&["--store", here, "--listen", "nowhere"], 2, &["nowhere"]),
        (&["--store", here, "--token-file", short], 3, &["short.txt", "16"]),
        (&["--store", here, "--token-file", "/no/such/file"], 3, &["/no/such/file"]),
        (&["--store", &missing], 5, &["missing", "--create"]),
        (&["--store", short], 5, &["no directory"]),
        (&["--store", others], 5, &["holds \"short.txt\" and no checkpoint"]),
        (&["--store", others, "--create"], 5, &["holds \"short.txt\" and no checkpoint"]),
        (&["--store", logs], 5, &["which is a run directory"]),
        (&["--store", inside, "--create"], 5, &["which is a run directory"]),
        (&["--store", here, "--listen", &held], 4, &[&held]),
        (&[], 2, &["--store"]),
    ] {
        let args: Vec<&str> = ["serve"].iter().chain(args).copied().collect();
        let output = octopus(&args);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {message}");
        for word in words {
            assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
        }
        assert!(!message.contains("too-short"), "a token is never shown: {message}");
        assert!(output.stdout.is_empty(), "{args:?}");
    }
    assert!(!Path::new(&missing).exists() && !Path::new(inside).exists());
    assert!(!tokens.path().join(".http.token").exists());
}

/// What cannot be written to can be shown all the same.
#[test]
fn to_show_a_directory_nothing_is_written_there() {
    const TOKEN: &str = "a-secret-of-twenty-eight-chars";
    let dir = tempfile::tempdir().expect("tempdir");
    let store = dir.path().join("store");
    let own = store.join(".http.token");
    std::fs::create_dir(&store).expect("a directory");
    let token = dir.path().join("token.txt");
    std::fs::write(&token, TOKEN).expect("writable");
    let token = format!("--token-file={}", token.display());
    let mut served = Served::start(&store, &["--read-only", &token]);
    assert_eq!(served.token, TOKEN);
    assert!(served.get("/v1/checkpoints", "").0.contains("200"));
    served.interrupt();
    assert!(!own.exists());
    // As where the disk takes nothing.
    std::fs::create_dir(&own).expect("a directory");
    let shown = store.display().to_string();
    for place in ["--store", "--runs"] {
        let refused = octopus(&["serve", place, &shown, "--read-only", "--listen=127.0.0.1:0"]);
        assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
        assert!(stderr(&refused).contains("--token-file FILE"), "{}", stderr(&refused));
    }
    drop(Served::start(&store, &["--read-only", &token]));
}

/// A name says nothing: whoever imports or copies a checkpoint gives it a later one.
#[test]
fn the_newest_of_a_run_is_what_the_run_has_come_to() {
    let run = trained();
    let mut other = Run::train(&["--workers=1", "--iterations=3", "--set=run.seed=8"]);
    other.succeed();
    let newest = |run: &Run| run.path().join("checkpoints/iteration-00000003");
    let copied = Command::new("cp").arg("-r").args([newest(&other), newest(&run)]).status();
    assert!(copied.expect("cp starts").success());
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let json = |output: std::process::Output| -> Value {
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice(&output.stdout).expect("JSON")
    };
    for imported in [false, true] {
        if imported {
            let labels = newest(&run).join("labels.json");
            std::fs::write(labels, r#"{"imported":true}"#).expect("writable");
        }
        let served = Served::start(&run.path(), &[]);
        let (_, latest) = served.get("/v1/checkpoints/latest", "");
        let latest: Value = serde_json::from_slice(&latest).expect("JSON");
        assert_eq!(latest["name"], "iteration-00000002");
        let eval = json(octopus(&["eval", path, "--episodes=2", "--steps=4", "--json"]));
        assert_eq!(eval["iteration"], 2);
        let status = json(octopus(&["status", path, "--json"]));
        let newest = status["checkpoint"].as_str().expect("a path");
        assert!(newest.ends_with("iteration-00000002"), "{newest}");
        let explicit = ["eval", &format!("{path}:3"), "--episodes=2", "--steps=4", "--json"];
        assert_eq!(json(octopus(&explicit))["iteration"], 3, "by its name it is found");
    }
}

/// Whoever holds the lock of a store makes changes wait, and nothing else.
#[test]
fn uploads_wait_for_a_held_lock_and_reads_do_not() {
    let run = trained();
    let dir = tempfile::tempdir().expect("tempdir");
    let store = dir.path().join("store");
    let archive = dir.path().join("a.tar");
    let (from, to) = (run.path(), archive.to_str().expect("UTF-8"));
    let from = from.to_str().expect("UTF-8");
    let there = store.to_str().expect("UTF-8");
    for args in [&["export", from, "--out", to][..], &["import", to, "--store", there]] {
        let output = octopus(&[&["checkpoints"], args].concat());
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let archive = std::fs::read(&archive).expect("readable");
    let served = Served::start(&store, &[]);
    let upload = |name: &str| {
        let mut request = format!(
            "PUT /v1/checkpoints/{name} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{}\
             Content-Length: {}\r\n\r\n",
            served.bearer(),
            archive.len()
        )
        .into_bytes();
        request.extend_from_slice(&archive);
        split(&served.exchange(&request)).0
    };
    let lock = std::fs::File::open(store.join(".lock")).expect("own");
    flock(&lock, FlockOperation::LockExclusive).expect("free");
    let names: Vec<String> = (0..8).map(|n| format!("copy-{n}")).collect();
    std::thread::scope(|scope| {
        let uploads: Vec<_> = names.iter().map(|name| scope.spawn(move || upload(name))).collect();
        // Each of them has its archive on the disk before it waits.
        let patience = Instant::now() + Duration::from_mins(1);
        while served.nameless_files() < 8 && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(5));
        }
        let one_more = upload("one-more");
        assert!(one_more.starts_with("http/1.1 503"), "{one_more}");
        for path in ["/v1/checkpoints", "/v1/checkpoints/latest", STATE, "/metrics", "/health"] {
            let (head, _) = served.get(path, "");
            assert!(head.starts_with("http/1.1 200"), "{path}: {head}");
        }
        // Until the first of them has lost its patience.
        while !uploads.iter().any(std::thread::ScopedJoinHandle::is_finished)
            && Instant::now() < patience
        {
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(lock);
        let answers: Vec<String> =
            uploads.into_iter().map(|upload| upload.join().expect("answered")).collect();
        let with = |code: &str| {
            answers.iter().filter(|head| head.starts_with(&format!("http/1.1 {code}"))).count()
        };
        assert!(with("503") > 0 && with("503") + with("201") == 8, "{answers:?}");
    });
    let (_, list) = served.get("/v1/checkpoints", "");
    let list: Value = serde_json::from_slice(&list).expect("JSON");
    let names = list["checkpoints"].as_array().expect("a list").iter();
    let names: Vec<&str> = names.map(|entry| entry["name"].as_str().expect("a name")).collect();
    assert!(!names.contains(&"one-more") && names.contains(&"iteration-00000002"), "{names:?}");
}

#[test]
fn a_live_run_is_scaled_and_asked_from_outside() {
    let refused = octopus(&["scale", "/no/such/run", "2"]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    let mut run = Run::train(&["--workers=1", "--iterations=100000"]);
    run.wait_for_iterations(2);
    let domain = run.domain();
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let output = octopus(&["scale", path, "2", "--json"]);
    assert!(output.status.success(), "{}\n{}", stderr(&output), run.log());
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(answer, serde_json::json!({ "workers": 2, "before": 1 }));
    let too_many = octopus(&["scale", path, "100000"]);
    assert_eq!(too_many.status.code(), Some(2), "{}", stderr(&too_many));

    let client = service::client::Client::of_run(&run.path(), None).expect("a service");
    // The run says a few times a second what it is doing.
    let patience = Instant::now() + Duration::from_mins(1);
    let mut status = client.status().expect("answers");
    while status.workers != 2 && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(10));
        status = client.status().expect("answers");
    }
    assert_eq!((status.workers, status.task.as_str()), (2, "trajectory"));
    let name = client.checkpoint_now().expect("commits").checkpoint.expect("at once");
    assert!(run.path().join("checkpoints").join(&name).join("manifest.json").is_file(), "{name}");
    run.signal(Signal::INT);
    run.succeed();
    assert!(client.status().is_err(), "the service ends with the run");
    let ended = octopus(&["scale", path, "2"]);
    assert_eq!(ended.status.code(), Some(5), "{}", stderr(&ended));
    assert_nothing_left(&domain);
}
