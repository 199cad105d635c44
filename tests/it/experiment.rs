//! `octopus experiment`: every experiment with tiny policies and few episodes, and what it refuses.

use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;
use tests::{SMALL, octopus, stderr};

/// A directory with a policy of each task, hardly trained.
pub(crate) fn policies() -> (TempDir, String) {
    let dir = tempfile::tempdir().expect("tempdir");
    for (task, scale) in [("trajectory", "0.8"), ("reorientation", "0.5")] {
        let run_dir = format!("--run-dir={}", dir.path().join(task).display());
        let scale = format!("--set=task.action_scale={scale}");
        let more = [run_dir.as_str(), "--workers=1", "--iterations=2", &scale];
        let args = [&["train", task][..], &more, SMALL].concat();
        let output = octopus(&args);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let path = dir.path().to_str().expect("UTF-8").to_owned();
    (dir, path)
}

/// What `octopus experiment` prints.
fn experiment(args: &[&str]) -> String {
    let output = octopus(&[&["experiment"], args].concat());
    assert!(output.status.success(), "{args:?}:\n{}", stderr(&output));
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Whether a terminal of 80 columns shows every line as one.
fn fits(table: &str) {
    for line in table.lines() {
        assert!(line.chars().count() <= 80, "{line}\nis too long in\n{table}");
    }
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&experiment(&[args, &["--json"]].concat())).expect("one JSON object")
}

/// Expects the exit code and the words on standard error.
fn refused(args: &[&str], code: i32, words: &[&str]) {
    let output = octopus(&[&["experiment"], args].concat());
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    for word in words {
        assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{args:?}:\n{message}");
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

/// Asserts that an object has these keys, given in alphabetical order with blanks between, and no others.
fn has_keys(value: &Value, wanted: &str) {
    let mut keys: Vec<_> = value.as_object().expect("an object").keys().cloned().collect();
    keys.sort();
    assert_eq!(keys.join(" "), wanted);
}

/// Asserts that all numbers of `value` are there: JSON has no NaN, it would be null.
fn all_finite(value: &Value, path: &str) {
    match value {
        Value::Null => {
            // The base has none of them, nor goals that can or cannot be reached.
            let absent = ["/agent", "/arm", "/position", "/reachable", "/within_reach_at_end"];
            assert!(absent.iter().any(|key| path.ends_with(key)), "{path} is null");
        }
        Value::Array(values) => {
            for value in values {
                all_finite(value, &format!("{path}[]"));
            }
        }
        Value::Object(values) => {
            for (key, value) in values {
                all_finite(value, &format!("{path}/{key}"));
            }
        }
        _ => {}
    }
}

/// What every result says about itself.
fn check_identity(result: &Value, name: &str, dir: &str, tasks: &[&str]) {
    has_keys(result, "episodes experiment policies protocol provenance results robot");
    let protocol = "actions control_period_s episodes seed settings steps";
    has_keys(&result["protocol"], protocol);
    assert_eq!(result["experiment"], name);
    assert_eq!(result["robot"]["name"], "paper");
    assert_eq!(result["robot"]["blake3"].as_str().expect("a hash").len(), 64);
    assert_eq!(result["protocol"]["control_period_s"], 0.4);
    let policies = list(&result["policies"]);
    assert_eq!(policies.len(), tasks.len(), "{name}");
    for (policy, task) in policies.iter().zip(tasks) {
        assert_eq!(policy["task"], *task);
        let manifest =
            Path::new(dir).join(task).join("checkpoints/iteration-00000002/manifest.json");
        let manifest = std::fs::read_to_string(manifest).expect("a manifest");
        let manifest: Value = serde_json::from_str(&manifest).expect("JSON");
        assert_eq!(policy["digest"], manifest["digest"]);
        assert_eq!(policy["policy_blake3"], manifest["files"]["policy.safetensors"]["blake3"]);
    }
}

const BOTH: [&str; 2] = ["trajectory", "reorientation"];

#[test]
fn every_experiment_measures_and_says_with_what() {
    let (_dir, dir) = policies();
    let common = ["--policies", &dir, "--episodes=3", "--steps=8", "--seed=5"];
    let run = |name: &str, more: &[&str]| json(&[&[name], &common[..], more].concat());

    // Precision is what `octopus eval` measures, number by number.
    let precision = run("precision", &[]);
    check_identity(&precision, "precision", &dir, &BOTH);
    for (result, task) in list(&precision["results"]).iter().zip(BOTH) {
        let run = format!("{dir}/{task}");
        let args = [&["eval", &run, "--json"], &common[2..]].concat();
        let evaluated: Value =
            serde_json::from_slice(&octopus(&args).stdout).expect("an evaluation");
        assert_eq!(result["summary"], evaluated, "{task}");
        let errors = list(&result["errors"]);
        assert_eq!(errors.len(), if task == "trajectory" { 8 } else { 1 });
        for error in errors {
            assert_eq!(list(&error["course"]["mean"]).len(), 8);
            // The course ends in the last error, the tail of eight steps is its mean.
            let mean: Vec<f64> = list(&error["course"]["mean"])
                .iter()
                .map(|x| x.as_f64().expect("number"))
                .collect();
            let close = |a: f64, b: &Value| (a - b.as_f64().expect("number")).abs() < 1e-6;
            assert!(close(mean[7], &error["final"]["mean"]));
            assert!(close(mean.iter().sum::<f64>() / 8.0, &error["tail"]["mean"]));
        }
        let rates = &result["summary"]["contact_rate_by_kind"];
        assert!(rates["arm_base"].is_number() && rates["arm_arm"].is_number());
    }
    all_finite(&precision["results"], "precision");

    let mut steps = common.to_vec();
    steps[3] = "--steps=16";
    let disturbance = json(&[&["disturbance"], &steps[..], &["--at=4"]].concat());
    check_identity(&disturbance, "disturbance", &dir, &BOTH);
    let results = list(&disturbance["results"]);
    let names: Vec<_> = results.iter().map(|r| (&r["task"], &r["disturbance"])).collect();
    assert_eq!(names.len(), 6, "{names:?}");
    has_keys(
        &results[0],
        "arm base_rate_peak base_rate_tail base_turns disturbance errors figure steps task what within_reach",
    );
    has_keys(
        &results[0]["errors"][0],
        "at before below_before below_tail below_tail_within_reach course error peak recovered \
         steps_to_recover tail threshold unit",
    );
    for result in results {
        let hand = result["task"] == "trajectory";
        assert_eq!(list(&result["errors"]).len(), if hand { 2 } else { 1 });
        let figure = &result["figure"];
        assert_eq!(list(&figure["base_rad"]).len(), 16);
        assert_eq!(list(&figure["hands"]).len(), usize::from(hand));
    }
    // A push leaves momentum: the base turns faster at the end than after push and pull.
    let rate = |index: usize| results[index]["base_rate_tail"]["mean"].as_f64().expect("number");
    assert!(rate(1) > 1.5 * rate(2), "{} {}", rate(1), rate(2));
    let turns = |index: usize| results[index]["base_turns"]["mean"].as_f64().expect("number");
    assert!(turns(1) > turns(2) && turns(2) > 0.0, "{} {}", turns(1), turns(2));
    assert!(results[2]["within_reach"].is_number() && results[5]["within_reach"].is_null());

    let failure = run("arm-failure", &["--arm=all"]);
    check_identity(&failure, "arm-failure", &dir, &BOTH[1..]);
    let results = list(&failure["results"]);
    has_keys(&results[0], "arm error failure figure success");
    has_keys(&results[0]["error"], "arm course error final min tail unit");
    has_keys(&results[0]["error"]["course"], "max mean p50 p90");
    assert_eq!(results.len(), 9, "none, then each arm held and limp");
    assert_eq!((&results[8]["failure"], &results[8]["arm"]), (&"limp".into(), &4.into()));
    assert_ne!(results[7]["error"], results[8]["error"], "a limp arm is not a held one");
    all_finite(&failure["results"], "arm-failure");

    let mass = run("base-mass", &["--masses=100,1000", "--thresholds=0.05,9"]);
    check_identity(&mass, "base-mass", &dir, &BOTH[1..]);
    let results = list(&mass["results"]);
    has_keys(&results[0], "error mass success total_mass");
    assert_eq!((results.len(), &results[1]["mass"]), (2, &1000.0.into()));
    assert_eq!(results[0]["success"][1], 1.0, "no error is beyond 9 rad");
    all_finite(&mass["results"], "base-mass");

    steps[3] = "--steps=72";
    let reassembly = json(&[&["reassembly"], &steps[..]].concat());
    check_identity(&reassembly, "reassembly", &dir, &BOTH);
    let results = list(&reassembly["results"]);
    has_keys(&results[0], "episodes errors figure goals poses reaching stage");
    assert_eq!(results.len(), 4, "two stages, two sets of goals");
    assert_eq!(results[2]["reaching"], serde_json::json!([[2, 0], [3, 70]]));
    assert_eq!((&results[0]["episodes"], &results[1]["episodes"]), (&1.into(), &3.into()));
    let own = &reassembly["protocol"]["settings"]["action_scale"];
    assert_eq!(own, &serde_json::json!({ "reaching": 0.8, "turning": 0.5 }));
    let slow = json(&[&["reassembly"], &steps[..], &["--action-scale=0.5"]].concat());
    assert_ne!(results[0]["errors"], slow["results"][0]["errors"]);
    all_finite(&reassembly["results"], "reassembly");

    // Beside a policy that learned both, to goals of a person, who gave none to the hands of the second episode.
    let scratch = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| scratch.path().join(name).display().to_string();
    let train = ["train", "mixed", "--run-dir", &at("mixed"), "--workers=1", "--iterations=1"];
    let output = octopus(&[&train[..], SMALL].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let goals = r#"[{"hands": [[0.4, -1.1, 4.2, 1.6, 0, 1.5]]}, {"base": [0.1, 0, 0]}]"#;
    std::fs::write(at("goals.json"), goals).expect("writable");
    let policies = ["reassembly", "--policies", &dir, "--steps=72", "--mixed", &at("mixed")];
    let drawn = json(&[&policies[..], &["--episodes=2"]].concat());
    let file = at("goals.json");
    let own = [&policies[..], &["--goals", &file]].concat();
    let (given, slow) = (json(&own), json(&[&own[..], &["--action-scale=0.1"]].concat()));
    let of_mixed = |found: &Value| list(&found["results"]).last().expect("results").clone();
    let [drawn, given, slow] = [&drawn, &given, &slow].map(of_mixed);
    assert_eq!((&drawn["by"], &drawn["goals"]), (&"mixed".into(), &"held out".into()));
    assert_eq!((&given["by"], &given["goals"]), (&"mixed".into(), &"given".into()));
    assert_eq!(given["episodes"], 2);
    assert_ne!(given["errors"], drawn["errors"]);
    assert_ne!(slow["errors"], given["errors"], "it is scaled, too");

    let sweeps = ["--sensors=0,10", "--torques=0,5", "--delays=0,1", "--arm-masses=1,2"];
    let noise = run("noise", &sweeps);
    check_identity(&noise, "noise", &dir, &BOTH);
    let results = list(&noise["results"]);
    has_keys(&results[0], "agents contact_rate errors quantity strength success task");
    assert_eq!(results.len(), 16);
    for task in results.chunks(8) {
        for sweep in task.chunks(2) {
            // Strength zero, no delay and the arms' own mass are one and the same.
            assert_eq!(sweep[0]["errors"], task[0]["errors"]);
            assert_ne!(sweep[1]["errors"], task[0]["errors"], "{}", sweep[1]["quantity"]);
        }
    }
    all_finite(&noise["results"], "noise");
    assert_eq!(noise["results"], run("noise", &sweeps)["results"], "the same seed, the same noise");

    // A policy beside itself does as it does; a controller has the tasks that it controls.
    let itself = format!("--beside={dir}/trajectory");
    let others = [itself.as_str(), "--beside=jacobian", "--beside=postures"];
    let beside = run("noise", &[&sweeps[..], &others].concat());
    let measured = list(&beside["results"]);
    assert_eq!(&measured[..16], results);
    let by = |name: &str| -> Vec<_> {
        measured[16..].iter().filter(|point| point["by"] == name).cloned().collect()
    };
    let strip = |point: &serde_json::Value| {
        let mut point = point.clone();
        point.as_object_mut().expect("an object").remove("by");
        point
    };
    assert_eq!(by("trajectory").iter().map(strip).collect::<Vec<_>>(), &results[..8]);
    assert_eq!((by("jacobian").len(), by("postures").len()), (16, 8));
    assert_eq!(list(&beside["policies"]).len(), 6);
}

#[test]
fn tables_are_for_people_and_compositions_are_policies() {
    let (_dir, dir) = policies();
    let run = format!("{dir}/trajectory");
    let composed = format!("{dir}/shared/mixed");
    let parts = [format!("1,2={run}:2"), format!("3,4={run}:2")];
    let compose = ["checkpoints", "compose", "--arm", &parts[0], "--arm", &parts[1]];
    let output = octopus(&[&compose[..], &["--out", &composed]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let few = ["--episodes=1", "--steps=20"];
    let of_run = experiment(&[&["precision", "--trajectory", &run], &few[..]].concat());
    let of_parts = experiment(&[&["precision", "--trajectory", &composed], &few[..]].concat());
    assert_eq!(of_run, of_parts);
    assert!(of_run.starts_with("trajectory\nnot within the paper's accuracy"), "{of_run}");
    assert!(of_run.contains("\n1 episode of 20 steps"), "{of_run}");
    assert!(!of_run.contains("agent 7"), "{of_run}");
    let agents = ["precision", "--agents", "--trajectory", &run];
    let of_agents = experiment(&[&agents, &few[..]].concat());
    assert!(of_agents.contains("agent 7 orientation"), "{of_agents}");
    fits(&of_agents);
    let all = ["--policies", &dir];
    let of_both = experiment(&[&["precision"], &all[..], &few].concat());
    assert!(of_both.starts_with(of_run.trim_end()) && of_both.contains("\n\nreorientation\n"));
    for (args, word) in [
        (&["disturbance", "--at=5"][..], "lift of arm 2"),
        (&["arm-failure"], "arm 4 limp"),
        (&["base-mass", "--masses=250"], "250 kg"),
        (&["noise", "--sensors=3", "--torques=1", "--delays=1", "--arm-masses=2"], "arm mass"),
    ] {
        let table = experiment(&[args, &all, &few].concat());
        assert!(table.contains(word), "{table}");
        fits(&table);
    }
    let table = experiment(&[&["reassembly", "--episodes=1", "--steps=71"], &all[..]].concat());
    assert!(table.contains("dual, the"), "{table}");
    fits(&table);
    fits(&of_both);
}

#[test]
fn experiments_that_cannot_be() {
    refused(&["precision"], 2, &["--trajectory or --reorientation", "--policies DIR"]);
    refused(&["reassembly"], 2, &["--trajectory and --reorientation"]);
    refused(&["base-mass"], 2, &["name one with --reorientation"]);
    refused(&["base-mass", "--trajectory=x", "--reorientation=x"], 2, &["no meaning here"]);
    refused(
        &["precision", "--policies=/no/such"],
        5,
        &["--policies /no/such", "wanted is one with"],
    );
    refused(&["precision", "--robot=no-such.toml"], 3, &["no-such.toml"]);
    for args in [
        &["precision", "--episodes=0"][..],
        &["noise", "--sensors=a,b"],
        &["base-mass", "--thresholds="],
        &["arm-failure", "--arm=0"],
        &["disturbance", "--force=-1"],
    ] {
        refused(args, 2, &["wants"]);
    }

    let (_dir, dir) = policies();
    let all = ["--policies", dir.as_str()];
    let run = format!("{dir}/trajectory");
    let wrong = ["arm-failure", "--reorientation", &run];
    refused(&wrong, 3, &["learned `trajectory`", "a policy for `reorientation` is wanted"]);
    let late = ["disturbance", "--steps=80"];
    refused(
        &[&late, &all[..]].concat(),
        2,
        &["--steps 80 ends before", "begins at step 75; it takes 86 at least"],
    );
    refused(&[&["arm-failure", "--arm=5"], &all[..]].concat(), 3, &["no arm 5", "has 4"]);
    refused(&[&["noise", "--delays=0.5"], &all[..]].concat(), 2, &["0.5 is no whole number"]);
    let lone = ["noise", "--reorientation", &format!("{dir}/reorientation"), "--beside", &run];
    refused(&lone, 3, &["learned `trajectory`", "no policy of that task is measured here"]);
    refused(&[&["base-mass", "--masses=0"], &all[..]].concat(), 2, &["wants numbers above 0"]);
    refused(&[&["base-mass", "--thresholds=0"], &all[..]].concat(), 2, &["wants numbers above 0"]);
    let two = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim-worker/simulator/robots/two-arm.toml");
    let other = ["precision", "--robot", two];
    refused(&[&other, &all[..]].concat(), 3, &["moves 4 arms", "has 2"]);

    // One of two is enough where one is; a directory with neither is missed.
    std::fs::rename(format!("{dir}/trajectory"), format!("{dir}/elsewhere")).expect("rename");
    let few = ["--episodes=1", "--steps=2"];
    assert!(experiment(&[&["precision"], &all[..], &few].concat()).starts_with("reorientation\n"));
    let wanted = ["--policies", "holds no `trajectory`", "`reorientation`, each", "--trajectory"];
    refused(&[&["reassembly"], &all[..]].concat(), 5, &wanted);
    refused(&["precision", "--policies=none"], 5, &["--policies none: is no directory"]);
}

#[test]
fn goals_of_ones_own_take_the_place_of_held_out_ones() {
    let (dir, path) = policies();
    let at = |name: &str| dir.path().join(name).display().to_string();
    let eval = |task: &str, more: &[&str]| {
        let policy = format!("{path}/{task}");
        let all = [&["eval", &policy, "--steps=4", "--json"], more].concat();
        let output = octopus(&all);
        assert!(output.status.success(), "{all:?}: {}", stderr(&output));
        let mut found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let goals = found.as_object_mut().expect("an object").remove("goals");
        (found, goals)
    };
    for (task, name) in [("trajectory", "hands.csv"), ("reorientation", "base.json")] {
        let save = ["--episodes=3", "--seed=5", "--save-goals", &at(name)];
        let (drawn, goals) = eval(task, &save);
        assert_eq!(goals, None);
        // The same goals from a file: the same numbers, all of them, whatever the seed.
        let (mut own, goals) = eval(task, &["--goals", &at(name)]);
        assert_eq!(goals, Some(at(name).into()));
        assert_eq!(list(&own["episodes"]).len(), 3);
        own["seed"] = 5.into();
        assert_eq!(own, drawn, "{task}");
        let (other, _) = eval(task, &["--episodes=3"]);
        assert_ne!(other["episodes"], drawn["episodes"], "{task}");
    }
    // One hand's goal moved: only that hand ends elsewhere as far as its error goes.
    let table = std::fs::read_to_string(at("hands.csv")).expect("written");
    let header = table.lines().next().expect("a header");
    assert!(
        header.starts_with("hand1_x,hand1_y,hand1_z,hand1_a,hand1_b,hand1_c,hand2_x"),
        "{header}"
    );
    std::fs::write(
        at("one.csv"),
        "hand2_x,hand2_y,hand2_z,hand2_a,hand2_b,hand2_c\n0.4,-1.1,4.2,1.6,0,1.5\n",
    )
    .expect("writable");
    let (one, _) = eval("trajectory", &["--goals", &at("one.csv")]);
    assert_eq!(list(&one["episodes"]).len(), 1);
    let trajectory = format!("{path}/trajectory");
    let precision =
        ["precision", "--trajectory", &trajectory, "--goals", &at("one.csv"), "--steps=4"];
    let found = json(&precision);
    assert_eq!(found["protocol"]["goals"], Value::from(at("one.csv")));
    assert_eq!(found["results"][0]["summary"]["episodes"], one["episodes"]);
    assert!(experiment(&precision).starts_with("goals of "));
    refused(&[&precision[..], &["--episodes=2"]].concat(), 2, &["--episodes 2", "1 episode"]);
    let reorientation = format!("{path}/reorientation");
    let other = ["precision", "--reorientation", &reorientation, "--goals", &at("one.csv")];
    refused(&other, 3, &["one.csv", "goals of the base"]);
    let missing = ["precision", "--trajectory", &trajectory, "--goals", &at("nothing.csv")];
    refused(&missing, 3, &["nothing.csv", "cannot be read"]);
    let wrong = octopus(&["eval", &trajectory, "--save-goals", &at("one.csv")]);
    assert_eq!(wrong.status.code(), Some(5), "{}", stderr(&wrong));
    let wrong = octopus(&[
        "eval",
        &trajectory,
        "--goals",
        &at("one.csv"),
        "--save-goals",
        &at("one.csv"),
        "--force",
    ]);
    assert_eq!(wrong.status.code(), Some(2), "{}", stderr(&wrong));
}

#[test]
fn a_controller_that_is_not_learned_takes_the_place_of_policies() {
    let found = json(&["precision", "--controller=jacobian", "--episodes=4", "--steps=60"]);
    assert_eq!(list(&found["policies"]).len(), 2);
    for (policy, task) in list(&found["policies"]).iter().zip(["trajectory", "reorientation"]) {
        assert_eq!((&policy["controller"], &policy["task"]), (&"jacobian".into(), &task.into()));
    }
    let median = |result: &Value| result["summary"]["overall"][0]["tail"]["p50"].as_f64();
    for result in list(&found["results"]) {
        assert!(
            median(result).is_some_and(|error| error < 1e-3),
            "{}",
            result["summary"]["overall"]
        );
    }
    // The same goals in `eval`, to the bit.
    let eval = ["eval", "--controller=jacobian", "--episodes=4", "--steps=60", "--json"];
    let eval = octopus(&eval);
    assert!(eval.status.success(), "{}", stderr(&eval));
    let eval: Value = serde_json::from_slice(&eval.stdout).expect("JSON");
    assert_eq!(eval["episodes"], found["results"][0]["summary"]["episodes"]);
    let table = experiment(&["arm-failure", "--controller=jacobian", "--episodes=2", "--steps=30"]);
    fits(&table);
    // Goal postures alone have no task in which the base turns.
    let alone = json(&["precision", "--controller=postures", "--episodes=4", "--steps=60"]);
    let [policy] = list(&alone["policies"]) else { panic!("{}", alone["policies"]) };
    assert_eq!(
        (&policy["controller"], &policy["task"]),
        (&"postures".into(), &"trajectory".into())
    );
    assert!(median(&alone["results"][0]).is_some_and(|error| error < 1e-3), "{alone}");
    refused(&["arm-failure", "--controller=postures"], 2, &["postures", "reorientation"]);
    let both = ["precision", "--controller=jacobian", "--policies=x"];
    refused(&both, 2, &["cannot be used with"]);
    for (args, words) in [
        (vec!["eval"], "RUN_DIR|CHECKPOINT"),
        (vec!["eval", "runs/a", "--controller=jacobian"], "cannot be used with"),
        (vec!["eval", "--controller=pid"], "jacobian"),
        (vec!["eval", "runs/a", "--task=reorientation"], "cannot be used with"),
    ] {
        let wrong = octopus(&args);
        assert_eq!(wrong.status.code(), Some(2), "{args:?}: {}", stderr(&wrong));
        assert!(stderr(&wrong).contains(words), "{args:?}: {}", stderr(&wrong));
    }
}
