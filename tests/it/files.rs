//! What is no regular file, in the place of every file of a run and of every input: nothing waits for
//! it, nothing reads it without end, and whoever needs the file says what is there instead. And what
//! stands in files does not reach a terminal as it is.

use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use tests::{Run, octopus, program, stderr};

/// After that a command hangs.
const WATCHDOG: Duration = Duration::from_mins(2);

/// What stands in a file's place.
const KINDS: [(&str, &str); 4] = [
    ("pipe", "a pipe"),
    ("directory", "a directory"),
    ("zero", "a device"),
    ("socket", "a socket"),
];

fn put(kind: &str, path: &Path) {
    match kind {
        "pipe" => {
            let made = Command::new("mkfifo").arg(path).status().expect("mkfifo starts");
            assert!(made.success());
        }
        "directory" => std::fs::create_dir(path).expect("a directory"),
        "zero" => symlink("/dev/zero", path).expect("a link"),
        "socket" => drop(UnixListener::bind(path).expect("a socket")),
        other => panic!("{other}"),
    }
}

/// Runs `octopus` to its end, which must come; and it is no panic and no signal.
fn ends(args: &[&str], input: Stdio) -> Output {
    let mut child = Command::new(program("octopus"))
        .args(args)
        .stdin(input)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("octopus can be started");
    let begun = Instant::now();
    // What it says fits into the pipes.
    while child.try_wait().expect("own child").is_none() {
        if begun.elapsed() > WATCHDOG {
            let _ = child.kill();
            let _ = child.wait();
            panic!("`octopus {}` hangs", args.join(" "));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().expect("ended");
    let code = output.status.code();
    assert!(code.is_some_and(|code| code != 101), "{args:?}: {code:?}\n{}", stderr(&output));
    output
}

fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-r").args([from, to]).status().expect("cp starts");
    assert!(copied.success());
}

/// A run of two iterations that has finished.
fn finished() -> Run {
    let mut run = Run::train(&["--workers=1", "--iterations=2"]);
    run.succeed();
    run
}

const CHECKPOINT: &str = "checkpoints/iteration-00000002";

#[test]
fn no_command_waits_for_what_stands_in_a_files_place() {
    let run = finished();
    let dir = tempfile::tempdir().expect("tempdir");
    let checkpoint = |file: &str| format!("{CHECKPOINT}/{file}");
    let files: Vec<String> = [
        "config.toml",
        "robot.toml",
        "provenance.json",
        "metrics.jsonl",
        "evaluations.jsonl",
        "promised.jsonl",
        "budgets.json",
        "metrics.csv",
        "evaluation.json",
        "logs/learner.log",
        "run.lock",
        "http.token",
        "checkpoints/.lock",
        "checkpoints/catalogue.sqlite",
    ]
    .map(str::to_owned)
    .into_iter()
    .chain(["manifest.json", "labels.json", "config.toml", "state.safetensors"].map(checkpoint))
    .collect();
    let picture = dir.path().join("picture.svg");
    let picture = picture.to_str().expect("UTF-8");
    let original = run.path();
    let original = original.to_str().expect("UTF-8");
    for file in &files {
        for (kind, what) in KINDS {
            let place = dir.path().join("run");
            copy(&run.path(), &place);
            let path = place.join(file);
            let _ = std::fs::remove_file(&path);
            put(kind, &path);
            let there = place.to_str().expect("UTF-8");
            let newest = format!("{there}/{CHECKPOINT}");
            let commands: [&[&str]; 10] = [
                &["status", there],
                &["scale", there, "2"],
                &["resume", there, "--no-eval", "--iterations=2"],
                &["verify", there, original],
                &["plot", there, "--out", picture],
                &["checkpoints", "list", there],
                &["checkpoints", "show", &newest],
                &["checkpoints", "verify", there],
                &["checkpoints", "tag", &newest, "mine"],
                &["checkpoints", "prune", there, "--keep-latest=1"],
            ];
            for command in commands {
                let output = ends(command, Stdio::null());
                let said = stderr(&output);
                // Who needs the file says which it is, and what is there.
                let name = Path::new(file).file_name().expect("a name").to_string_lossy();
                assert!(
                    !said.contains("expected a regular file")
                        || (said.contains(&*name)
                            && (said.contains(what) || said.contains("a symbolic link"))),
                    "{command:?}: {said}"
                );
            }
            std::fs::remove_dir_all(&place).expect("own");
        }
    }
}

/// The commands that cannot do without the file refuse, with the code of a damaged run.
#[test]
fn who_needs_the_file_says_what_is_there() {
    let run = finished();
    let original = run.path();
    let original = original.to_str().expect("UTF-8");
    let dir = tempfile::tempdir().expect("tempdir");
    for (file, commands) in [
        ("config.toml", &["status", "resume", "verify"][..]),
        ("robot.toml", &["resume", "verify"]),
        ("metrics.jsonl", &["status", "resume", "verify"]),
        ("promised.jsonl", &["resume"]),
        ("budgets.json", &["resume", "verify"]),
        ("run.lock", &["status", "resume"]),
    ] {
        for (kind, what) in KINDS {
            let place = dir.path().join("run");
            copy(&run.path(), &place);
            let path = place.join(file);
            let _ = std::fs::remove_file(&path);
            put(kind, &path);
            let there = place.to_str().expect("UTF-8");
            for command in commands {
                let more: &[&str] = match *command {
                    "resume" => &["--no-eval", "--iterations=3"],
                    "verify" => &[original],
                    _ => &[],
                };
                let args = [&[*command, there], more].concat();
                let output = ends(&args, Stdio::null());
                let said = stderr(&output);
                assert_eq!(output.status.code(), Some(5), "{file}, {kind}, {args:?}: {said}");
                let is = said.contains(what) || said.contains("a symbolic link");
                assert!(said.contains(file) && is, "{file}, {kind}, {args:?}: {said}");
            }
            std::fs::remove_dir_all(&place).expect("own");
        }
    }
}

#[test]
fn inputs_are_regular_files_and_have_an_end() {
    let dir = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| dir.path().join(name);
    let out = at("out");
    let out = out.to_str().expect("UTF-8");
    for (kind, what) in KINDS {
        let path = at(kind);
        put(kind, &path);
        let there = path.to_str().expect("UTF-8");
        let commands: [(&[&str], i32); 7] = [
            (&["train", "--dry-run", "--config", there], 3),
            (&["train", "--dry-run", "--robot", there], 3),
            (&["train", "--dry-run", "--token-file", there], 3),
            (&["simulate", "--robot=paper", "--actions", there, "--out", out], 3),
            (&["simulate", "--robot", there, "--actions", "-", "--out", out], 3),
            (&["mjcf", "--robot", there], 3),
            (&["checkpoints", "import", there, "--store", out], 3),
        ];
        for (args, code) in commands {
            let output = ends(args, Stdio::null());
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
            assert!(said.contains(there) && said.contains(what), "{args:?}: {said}");
        }
    }
    assert!(!Path::new(out).exists(), "nothing was made");
    let endless = || Stdio::from(std::fs::File::open("/dev/zero").expect("a device"));
    let output = ends(&["simulate", "--robot=paper", "--actions=-", "--out", out], endless());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("standard input") && said.contains("longer than"), "{said}");
    let output = ends(&["checkpoints", "import", "-", "--store", out], endless());
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
}

/// Clears the screen, rings, writes a title: a terminal obeys.
const SEQUENCE: &str = "\u{1b}[2J\u{7}\u{9b}31m";

fn holds_no_control(output: &Output) {
    for (stream, bytes) in [("output", &output.stdout), ("error", &output.stderr)] {
        let text = String::from_utf8_lossy(bytes);
        let hidden = text.chars().find(|c| c.is_control() && *c != '\n' && *c != '\t');
        assert_eq!(hidden, None, "{stream}: {text:?}");
    }
}

#[test]
fn what_stands_in_files_does_not_command_the_terminal() {
    let run = finished();
    let path = run.path();
    let there = path.to_str().expect("UTF-8");
    let newest = path.join(CHECKPOINT);
    let newest = newest.to_str().expect("UTF-8");

    // A file's name, on the command line and in an archive.
    let dir = tempfile::tempdir().expect("tempdir");
    let strange = dir.path().join(format!("a{SEQUENCE}b.tar"));
    std::fs::write(&strange, "no archive").expect("writable");
    let store = dir.path().join("store");
    let (strange, store) = (strange.to_str().expect("UTF-8"), store.to_str().expect("UTF-8"));
    let output = octopus(&["checkpoints", "import", strange, "--store", store]);
    assert_eq!(output.status.code(), Some(3));
    assert!(stderr(&output).contains("a\\u{1b}[2J\\u{7}\\u{9b}31mb.tar"), "{}", stderr(&output));
    holds_no_control(&output);
    let archive = dir.path().join("x.tar");
    let inside = format!("x{SEQUENCE}");
    std::fs::create_dir(dir.path().join(&inside)).expect("a directory");
    std::fs::write(dir.path().join(&inside).join("manifest.json"), "{}").expect("writable");
    let packed = Command::new("tar")
        .current_dir(dir.path())
        .args(["--format=ustar", "-cf"])
        .arg(&archive)
        .arg(format!("{inside}/manifest.json"))
        .status();
    assert!(packed.expect("tar starts").success());
    let archive = archive.to_str().expect("UTF-8");
    let output = octopus(&["checkpoints", "import", archive, "--store", store]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    holds_no_control(&output);

    // A tag that no program of ours would have given, and names in a configuration and in metrics.
    let labels = PathBuf::from(newest).join("labels.json");
    let text = serde_json::json!({ "tags": [format!("t{SEQUENCE}")] }).to_string();
    std::fs::write(&labels, text).expect("own");
    for args in [
        &["checkpoints", "list", there][..],
        &["checkpoints", "show", newest],
        &["checkpoints", "list", there, "--json"],
    ] {
        holds_no_control(&octopus(args));
    }
    std::fs::remove_file(&labels).expect("own");
    let manifest = PathBuf::from(newest).join("manifest.json");
    let text = std::fs::read_to_string(&manifest).expect("own");
    let mut document: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    document["provenance"]["host"] = format!("h{SEQUENCE}").into();
    std::fs::write(&manifest, document.to_string()).expect("own");
    for args in [&["checkpoints", "show", newest][..], &["checkpoints", "show", newest, "--json"]] {
        let output = octopus(args);
        let shown = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(shown.contains("u{1b}[2J") || shown.contains("u001b[2J"), "{shown}");
        holds_no_control(&output);
    }
    std::fs::write(path.join("config.toml"), format!("a = \"{SEQUENCE}\"\n")).expect("own");
    let output = octopus(&["status", there]);
    assert!(!output.status.success());
    holds_no_control(&output);
}
