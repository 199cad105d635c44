//! `octopus film`: its files read by another program, and what it refuses.

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tests::{crosscheck, octopus, python, stderr};

/// A policy of the repository.
fn policy(task: &str) -> String {
    format!("{}/../deploy/policies/{task}", env!("CARGO_MANIFEST_DIR"))
}

/// A short film of small pictures.
const SHORT: &[&str] = &["--steps=12", "--size=96x64", "--fps=10", "--speed=4"];

/// What `octopus film` prints of a film that it makes.
fn film(out: &Path, task: &str, more: &[&str]) -> Value {
    let out = format!("--out={}", out.display());
    let output = octopus(&[&["film", &policy(task), &out, "--json"], SHORT, more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// What Pillow finds in a film.
fn read(path: &Path) -> Value {
    let output = Command::new(python()).arg(crosscheck("film.py")).arg(path).output();
    let output = output.expect("Python starts");
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

/// 12 control steps are 4.8 s, four times as fast 1.2 s, of ten pictures a second and one more.
#[test]
fn pillow_reads_every_format() {
    let dir = tempfile::tempdir().expect("tempdir");
    let mut exact = Vec::new();
    for (name, format) in
        [("a.gif", "GIF"), ("a.png", "PNG"), ("a.apng", "PNG"), ("a.webp", "WEBP")]
    {
        let path = dir.path().join(name);
        let made = film(&path, "trajectory", &[]);
        assert_eq!((&made["width"], &made["height"]), (&96.into(), &64.into()));
        assert_eq!(made["pictures"], 13);
        let bytes = path.metadata().expect("written").len();
        assert_eq!(made["bytes"], bytes);
        assert_eq!(list(&made["position_m"]).len(), 4);
        assert_eq!(made["attitude_rad"], Value::Null);

        let seen = read(&path);
        assert_eq!(seen["format"], format, "{name}");
        assert_eq!(seen["size"], serde_json::json!([96, 64]));
        assert_eq!(seen["loop"], 0, "{name} has no end");
        // Pillow joins pictures that look the same and adds up their times.
        let durations = list(&seen["durations_ms"]).iter().map(|ms| ms.as_f64().expect("a time"));
        let whole: f64 = durations.sum();
        let wanted = made["duration_s"].as_f64().expect("a time") * 1000.0;
        assert!((whole - wanted).abs() < 11.0, "{name}: {whole} ms, not {wanted} ms");
        assert!(list(&seen["digests"]).len() >= 12, "{name}: the robot moves");
        // The ground is the same in every format, to the level.
        for corner in list(&seen["corners"]) {
            assert_eq!(*corner, serde_json::json!([246, 247, 249]), "{name}");
        }
        if format == "GIF" {
            assert!(seen["colors"].as_u64().is_some_and(|colors| colors <= 255));
        } else {
            exact.push(seen["digests"].clone());
        }
    }
    assert!(exact.windows(2).all(|pair| pair[0] == pair[1]), "APNG and WebP show the same");
}

#[test]
fn the_same_command_gives_the_same_bytes() {
    let dir = tempfile::tempdir().expect("tempdir");
    for name in ["a.gif", "a.png", "a.webp"] {
        let path = dir.path().join(name);
        let [first, second] = [0, 1].map(|_| {
            film(&path, "reorientation", &["--orbit=30"]);
            std::fs::read(&path).expect("written")
        });
        assert!(first == second, "{name}");
        film(&path, "reorientation", &["--orbit=30", "--episode=1"]);
        assert!(std::fs::read(&path).expect("written") != first, "{name}: another goal");
    }
    let left = std::fs::read_dir(dir.path()).expect("a directory").count();
    assert_eq!(left, 3, "the films and nothing else");
}

#[test]
fn goals_may_be_given() {
    let dir = tempfile::tempdir().expect("tempdir");
    let path = dir.path().join("a.gif");
    let far = film(&path, "trajectory", &["--hand-goal=2,0.4,-3.2,4.2,0,0,0"]);
    let errors = list(&far["position_m"]);
    assert!(errors[1].as_f64().is_some_and(|error| error > 1.0), "{far}");
    let turned = film(&path, "reorientation", &["--base-goal=0,0,0"]);
    assert!(turned["attitude_rad"].as_f64().is_some_and(|error| error < 0.2), "{turned}");
}

#[test]
fn what_is_wrong_is_refused_and_leaves_nothing() {
    let dir = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| dir.path().join(name).display().to_string();
    let mine = at("mine.gif");
    std::fs::write(&mine, "not a film").expect("written");
    let damaged = dir.path().join("damaged");
    std::fs::create_dir(&damaged).expect("made");
    for file in ["config.toml", "manifest.json", "robot.toml"] {
        let from = Path::new(&policy("trajectory")).join(file);
        std::fs::copy(from, damaged.join(file)).expect("copied");
    }
    std::fs::write(damaged.join("policy.safetensors"), "none").expect("written");
    let (good, damaged) = (policy("trajectory"), damaged.display().to_string());
    let inside = format!("{damaged}/a.gif");
    let cases: &[(&str, &str, &[&str], i32, &str)] = &[
        (&good, &at("a.svg"), &[], 2, "ends in .gif"),
        (&good, &at("a"), &[], 2, "ends in .gif"),
        (&good, "-", &[], 2, "ends in .gif"),
        (&good, &at("a.gif"), &["--size=8x8"], 2, "such as 640x480"),
        (&good, &at("a.gif"), &["--fps=0"], 2, "from 1 to 50"),
        (&good, &at("a.gif"), &["--speed=0"], 2, "from 0.01 to 1000"),
        (&good, &at("a.gif"), &["--view=0,95"], 2, "such as 36,21"),
        (&good, &at("a.gif"), &["--steps=100000", "--speed=0.1"], 2, "larger --speed"),
        (&good, &at("a.gif"), &["--base-goal=0,0,0"], 2, "learned `trajectory`"),
        (&good, &at("a.gif"), &["--hand-goal=5,0,0,4,0,0,0"], 2, "has 4 hands"),
        (&good, &at("a.gif"), &["--robot=/no/such.toml"], 3, "/no/such.toml"),
        (&at("none"), &at("a.gif"), &[], 5, "none"),
        (&damaged, &at("a.gif"), &[], 5, "damaged"),
        (&good, &mine, &[], 5, "--force writes over it"),
        (&good, &inside, &[], 5, "which is a checkpoint"),
        (&good, &at("no/such/a.gif"), &["--steps=1", "--size=32x32"], 1, "cannot be written"),
        // Before the policy is looked for, let alone a picture drawn.
        (&at("none"), "/proc/a.gif", &[], 1, "--out /proc/a.gif: cannot be written"),
    ];
    for (policy, out, more, code, said) in cases {
        let output = octopus(&[&["film", policy, "--out", out], *more].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(*code), "{out} {more:?}:\n{message}");
        assert!(message.contains(said), "{out} {more:?}: `{said}` is not in\n{message}");
        assert!(!message.contains("panicked"), "{message}");
    }
    let mut names: Vec<String> = std::fs::read_dir(dir.path())
        .expect("a directory")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["damaged", "mine.gif"], "nothing is left of what was refused");
    assert_eq!(std::fs::read_to_string(&mine).expect("mine"), "not a film");
    // What was asked for is done, also over what is there.
    let output = octopus(&[&["film", &good, "--out", &mine, "--force"], SHORT].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(std::fs::read(&mine).expect("a film").starts_with(b"GIF89a"));
}
