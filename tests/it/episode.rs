//! `octopus experiment episode`: what somebody did in the page, again.

use std::path::Path;

use serde_json::{Value, json};
use tests::{octopus, stderr};

fn policy(task: &str) -> String {
    format!("{}/../deploy/policies/{task}", env!("CARGO_MANIFEST_DIR"))
}

fn recording(dir: &Path, value: &Value) -> String {
    let path = dir.join("episode.json");
    std::fs::write(&path, value.to_string()).expect("writable");
    path.display().to_string()
}

fn played(script: &str, policies: &[&str], more: &[&str]) -> Value {
    let policies: Vec<String> = policies.iter().map(|path| format!("--policy={path}")).collect();
    let policies: Vec<&str> = policies.iter().map(String::as_str).collect();
    let flags = ["experiment", "episode", "--script", script, "--json"];
    let output = octopus(&[&flags[..], &policies, more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// An evaluation plays sixteen episodes side by side, this command one alone.
#[test]
fn an_episode_that_nobody_touched_is_that_of_an_evaluation() {
    let dir = tempfile::tempdir().expect("tempdir");
    let policy = policy("trajectory");
    let output = octopus(&["eval", &policy, "--episodes=3", "--steps=30", "--seed=4", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let evaluated: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let script = json!({ "start": { "seed": 4, "episode": 2 }, "steps": 30, "events": [] });
    let played = played(&recording(dir.path(), &script), &[&policy], &[]);
    let hands = evaluated["episodes"][2]["hands"].as_array().expect("a list");
    for (arm, hand) in hands.iter().enumerate() {
        assert_eq!(hand["position"]["last"], played["position_m"][arm]);
        assert_eq!(hand["orientation"]["last"], played["orientation_rad"][arm]);
    }
}

#[test]
fn what_was_done_is_done_again_to_the_bit() {
    let dir = tempfile::tempdir().expect("tempdir");
    let out = dir.path().join("states.csv").display().to_string();
    let events = json!([
        { "step": 0, "event": { "hand_goal": { "arm": 1, "pose": [0.4, -1.1, 4.2, 1.6, 0.0, 1.5] } } },
        { "step": 3, "event": { "arm": { "arm": 0, "control": "limp" } } },
        { "step": 5, "event": { "effect": { "steps": 4, "effect": {
            "wrench": { "body": 3, "point": [0, 0, 0], "force": [0, 30, 0], "torque": [0, 0, 0] } } } } },
        { "step": 9, "event": { "arm": { "arm": 2, "control": { "policy": 1 } } } },
        { "step": 12, "event": { "base_mass": { "mass": 250.0 } } },
        { "step": 14, "event": { "delay": { "steps": 1 } } },
    ]);
    let script = json!({ "start": {}, "steps": 20, "events": events });
    let both = [policy("trajectory"), policy("reorientation")];
    let both = [both[0].as_str(), both[1].as_str()];
    let path = recording(dir.path(), &json!({ "policies": [], "script": script }));
    let first = played(&path, &both, &["--out", &out]);
    assert_eq!(first, played(&path, &both, &[]));
    let table = std::fs::read_to_string(&out).expect("written");
    assert_eq!(table.lines().count(), 21, "a header and a row for each control step");

    let calm = json!({ "start": {}, "steps": 20, "events": [] });
    let calm = played(&recording(dir.path(), &calm), &both, &[]);
    assert_ne!(first["states_blake3"], calm["states_blake3"], "nothing was done");
}

#[test]
fn recordings_that_cannot_be_played_are_refused() {
    let dir = tempfile::tempdir().expect("tempdir");
    let policy = policy("trajectory");
    let event = |event: Value| json!({ "steps": 5, "events": [{ "step": 2, "event": event }] });
    let part = |digest: &str| {
        let policies = json!([{ "name": "best", "digest": digest }, { "name": "other" }]);
        json!({ "policies": policies, "script": { "steps": 5 } })
    };
    let digest = "00000000000000000000000000000000";
    for (value, words) in [
        (json!({ "steps": "five" }), &["is no recording", "five"][..]),
        (json!({ "script": { "steps": 5, "evnts": [] } }), &["is no recording", "evnts"]),
        (json!({ "steps": 2_000_000 }), &["2000000 control steps"]),
        (json!({ "steps": 5, "start": { "state": [1.0] } }), &["start", "numbers of the state"]),
        (
            event(json!({ "hand_goal": { "arm": 4, "pose": [0, 0, 0, 0, 0, 0] } })),
            &["step 2", "arm 4"],
        ),
        (
            event(json!({ "arm": { "arm": 0, "control": { "policy": 1 } } })),
            &["step 2", "policy 1"],
        ),
        (part(digest), &["policy 0, `best`", digest, "has the digest"]),
        (part(""), &["policy 1, `other`", "--policy"]),
    ] {
        let path = recording(dir.path(), &value);
        let output = octopus(&["experiment", "episode", "--script", &path, "--policy", &policy]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(3), "{value}: {message}");
        assert!(message.contains("episode.json"), "{message}");
        for word in words {
            assert!(message.contains(word), "{value}: `{word}` is not in\n{message}");
        }
    }
}
