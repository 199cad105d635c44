//! Tasks beside the paper's: they train to the same bits whatever the workers, are evaluated, shown, and refused where they have no place.

use serde_json::Value;
use tests::{Run, WITH_POSTURES, octopus, stderr};

/// A run of three iterations.
fn trained(task: &str, workers: &str, more: &[&str]) -> Run {
    let mut run = Run::new();
    run.start_training_of(task, &[&["--iterations=3", workers], more].concat());
    run.succeed();
    run
}

/// What `octopus eval` finds over three episodes.
fn evaluated(run: &Run) -> Value {
    let path = run.path().display().to_string();
    let output = octopus(&["eval", &path, "--episodes=3", "--steps=20", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The errors of a summary's list, by name.
fn names(list: &Value) -> Vec<&str> {
    let all = list.as_array().expect("a list").iter();
    all.map(|error| error["error"].as_str().expect("a name")).collect()
}

/// Makes a film of it, and sees that controllers are refused.
fn shown_and_not_exported(run: &Run, task: &str) {
    let (path, place) = (run.path().display().to_string(), tempfile::tempdir().expect("tempdir"));
    let film = place.path().join("film.gif").display().to_string();
    let out = format!("--out={film}");
    let output = octopus(&["film", &path, &out, "--steps=5", "--size=64x48", "--fps=5"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(std::fs::metadata(&film).expect("a film").len() > 500);

    let controller = place.path().join("controller");
    let out = format!("--out={}", controller.display());
    let output = octopus(&["export", &path, &out, "--episodes=1"]);
    assert!(!output.status.success());
    let said = stderr(&output);
    assert!(said.contains(&format!("policies of task `{task}` cannot be exported")), "{said}");
    assert!(!controller.exists(), "nothing is left of it");
}

#[test]
fn a_body_is_captured_to_the_same_bits() {
    let one = trained("capture", "--workers=1", WITH_POSTURES);
    let two = trained("capture", "--workers=2", WITH_POSTURES);
    assert_eq!(one.digests(), two.digests());
    let found = evaluated(&one);
    assert_eq!(names(&found["overall"]), ["position", "orientation"]);
    let held = &found["held"];
    let share = held["episodes"].as_f64().expect("a share");
    assert!((0.0..=1.0).contains(&share) && held["untouched"].as_f64() <= Some(share), "{held}");
    for episode in found["episodes"].as_array().expect("episodes") {
        assert!(episode["held"]["longest"].as_u64() <= Some(20), "{episode}");
    }
    assert!(found["reachable"].is_null(), "goals that move are not looked for one by one");
    shown_and_not_exported(&one, "capture");
}

#[test]
fn half_of_the_arms_reach_while_the_others_turn() {
    let one = trained("mixed", "--workers=1", &[]);
    let two = trained("mixed", "--workers=2", &[]);
    assert_eq!(one.digests(), two.digests());
    let found = evaluated(&one);
    assert_eq!(names(&found["overall"]), ["position", "orientation", "base"]);
    // Two arms that reach have two agents each; the others all answer for the base.
    assert_eq!(names(&found["agents"]), ["position", "orientation"].repeat(2));
    assert!(found["held"].is_null());
    shown_and_not_exported(&one, "mixed");
}

#[test]
fn a_task_for_two_arms_is_refused_on_a_robot_with_one() {
    let robots =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../sim-worker/simulator/robots/two-arm.toml");
    let two = std::fs::read_to_string(robots).expect("it is there");
    let at = two.rfind("[[arms]]").expect("two arms");
    let place = tempfile::tempdir().expect("tempdir");
    let robot = place.path().join("one.toml");
    std::fs::write(&robot, &two[..at]).expect("room");
    let (runs, robot) = (place.path().join("run"), robot.display().to_string());
    let (out, set) =
        (format!("--run-dir={}", runs.display()), format!("--set=robot.description={robot}"));
    let output = octopus(&["train", "mixed", &out, &set, "--iterations=1"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(said.contains("has 1 arm, and task `mixed` needs 2"), "{said}");
    assert!(!runs.exists(), "nothing is left of it");
}
