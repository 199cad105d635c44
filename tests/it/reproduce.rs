//! `octopus reproduce`: all experiments with tiny policies, what it leaves, and what it refuses.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use rustix::process::Signal;
use serde_json::Value;
use tests::guide::repository;
use tests::{Owned, SMALL, kill, octopus, program, stderr};

use crate::experiment::policies;

const EXPERIMENTS: [&str; 6] =
    ["precision", "disturbance", "arm-failure", "base-mass", "reassembly", "noise"];

fn read(dir: &Path, name: &str) -> String {
    std::fs::read_to_string(dir.join(name)).expect("a file")
}

/// When each file was written.
fn times(dir: &Path) -> Vec<SystemTime> {
    let time = |name| dir.join(format!("{name}.json")).metadata().and_then(|file| file.modified());
    EXPERIMENTS.map(|name| time(name).expect("a file")).into()
}

/// Expects the exit code and the words on standard error.
fn refused(args: &[&str], code: i32, words: &[&str]) {
    let output = octopus(&[&["reproduce"], args].concat());
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    for word in words {
        assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{args:?}:\n{message}");
}

/// What links to an episode begin with.
const EPISODE: &str = "episodes.html#play=";

/// Asserts that every tag of a page is closed in its order, and that it takes nothing from elsewhere: it leads to places of its own, and to
/// episodes in the file beside it.
pub(crate) fn stands_alone(page: &str) {
    assert!(page.starts_with("<!DOCTYPE html>"), "{}", &page[..40]);
    let mut open: Vec<&str> = Vec::new();
    let style = (page.find("<style>").expect("a style"), page.find("</style>").expect("its end"));
    let body = [&page[..style.0], &page[style.1 + "</style>".len()..]].concat();
    for tag in body.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '/', '\n']).find(|word| !word.is_empty()).expect("a name");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "</{name}>");
        } else if !tag.ends_with('/') && !["!DOCTYPE", "meta"].contains(&name) {
            open.push(name);
        }
        for (attribute, value) in tag.split(' ').filter_map(|word| word.split_once("=\"")) {
            if ["href", "src", "xlink:href", "action", "data"].contains(&attribute) {
                let own =
                    value.starts_with('#') || attribute == "href" && value.starts_with(EPISODE);
                assert!(own, "{attribute}={value}");
            }
        }
        assert!(!["script", "link", "img", "iframe", "object"].contains(&name), "{tag}");
    }
    assert!(open.is_empty(), "{open:?}");
    let css = &page[style.0..style.1];
    assert!(!css.contains("url(") && !css.contains("@import"), "{css}");
}

#[test]
fn all_experiments_make_a_page_once() {
    let (_dir, dir) = policies();
    let scratch = tempfile::tempdir().expect("tempdir");
    let out = scratch.path().join("of all");
    let out = out.to_str().expect("UTF-8");
    let common = ["--quick", "--episodes=2", "--steps=90", "--seed=3"];
    let policies = ["--policies", &dir, "--out", out];
    let args = [&common[..], &policies].concat();
    let output = octopus(&[&["reproduce"], &args[..]].concat());
    assert!(output.status.success(), "a claim that fails is no error:\n{}", stderr(&output));
    let table = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(table.contains("of 11 claims hold") && table.contains("report.html"), "{table}");
    assert!(table.contains("trajectory, position"), "{table}");
    // A path is as long as it is.
    for line in table.lines().filter(|line| !line.contains(out)) {
        assert!(line.chars().count() <= 80, "{line}\nis too long in\n{table}");
    }

    // Each file is what `octopus experiment` prints.
    let dir_of = Path::new(out);
    for name in EXPERIMENTS {
        let result: Value =
            serde_json::from_str(&read(dir_of, &format!("{name}.json"))).expect("JSON");
        assert_eq!(result["experiment"], name);
        assert_eq!(result["protocol"]["episodes"], 2);
    }
    let alone = ["experiment", "arm-failure", "--policies", &dir, "--json"];
    let alone = octopus(&[&alone[..], &common[1..]].concat());
    let alone: Value = serde_json::from_slice(&alone.stdout).expect("JSON");
    let written: Value = serde_json::from_str(&read(dir_of, "arm-failure.json")).expect("JSON");
    for key in ["experiment", "protocol", "robot", "policies", "results"] {
        assert_eq!(alone[key], written[key], "{key}");
    }

    let page = read(dir_of, "report.html");
    stands_alone(&page);
    assert_eq!(
        page.matches("<figure>").count(),
        11,
        "each of them drawn, and what errs once more beside the yardstick"
    );
    let digest = written["policies"][0]["digest"].as_str().expect("a digest");
    assert!(page.contains(digest));
    assert!(page.contains("octopus experiment noise --policies="), "the command behind it");
    // What can be watched: all but arms of another mass, which no recording has.
    let watched = page.matches(EPISODE).count();
    if service::page::is_built() {
        assert!(watched > 20, "{watched} episodes");
        let player = read(dir_of, "episodes.html");
        for name in ["trajectory/policy.safetensors", "reorientation/policy.safetensors"] {
            assert!(player.contains(&format!("data-policy=\"{name}\"")), "{name}");
        }
    } else {
        assert_eq!(watched, 0);
    }

    // A second call does nothing again, but draws; also for a machine, and with learning curves.
    let before = times(dir_of);
    let runs = ["--json", "--runs", &format!("{dir}/trajectory")];
    let output = octopus(&[&["reproduce"], &args[..], &runs[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(times(dir_of), before);
    assert_eq!(stderr(&output), "", "nothing is played");
    let outcome: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(outcome["claims"].as_array().expect("claims").len(), 11);
    assert!(outcome["report"].as_str().expect("a path").ends_with("report.html"));
    let page = read(dir_of, "report.html");
    stands_alone(&page);
    assert!(page.contains("id=\"learning\""));

    // The same curves alone, against either.
    for over in ["env-steps", "time"] {
        let picture = scratch.path().join(format!("{over}.svg"));
        let picture = ["--over", over, "--out", picture.to_str().expect("UTF-8")];
        let run = format!("{dir}/trajectory");
        let output = octopus(&[&["plot", &run], &picture[..]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let table = String::from_utf8(output.stdout).expect("UTF-8");
        assert!(table.contains("mappo") && table.contains(picture[3]), "{table}");
        let svg = std::fs::read_to_string(picture[3]).expect("a picture");
        assert!(svg.starts_with("<svg") && svg.contains("Trajectory: return"), "{}", &svg[..200]);
        let json = octopus(&[&["plot", "--json", &run], &picture[..]].concat());
        let curves: Value = serde_json::from_slice(&json.stdout).expect("JSON");
        assert_eq!(curves[0]["returns"].as_array().expect("a curve").len(), 300);
    }
    let output = octopus(&["plot", "/no/such"]);
    assert_eq!(output.status.code(), Some(5), "{}", stderr(&output));

    // Kept in a file they are the same curves.
    let file = |name: &str| scratch.path().join(name).to_str().expect("UTF-8").to_owned();
    let (kept, picture) = (file("curves.json"), file("kept.svg"));
    let plot = |run: &str, more: &[&str]| {
        let output = octopus(&[&["plot", "--json", run, "--out", &picture][..], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    let of_run = plot(&format!("{dir}/trajectory"), &["--save", &kept]);
    let of_file = plot(&kept, &[]);
    let end = |curves: &Value| curves[0]["returns"][299][1].as_f64().expect("a number");
    assert!((end(&of_run) / end(&of_file) - 1.0).abs() < 1e-3, "{of_run}\n{of_file}");
    assert_eq!(of_run[0]["runs"], of_file[0]["runs"]);
    std::fs::write(&kept, "{}").expect("written");
    let output = octopus(&["plot", &kept, "--out", &picture]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("curves.json: is no file of curves"), "{}", stderr(&output));

    // One that is lost is made again, the others are not.
    std::fs::remove_file(dir_of.join("base-mass.json")).expect("removed");
    let output = octopus(&[&["reproduce"], &args[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let after = times(dir_of);
    assert_ne!(after[3], before[3]);
    assert_eq!((&after[..3], &after[4..]), (&before[..3], &before[4..]));

    // What is damaged or of others is refused and left as it is.
    let other_seed = ["--quick", "--episodes=2", "--steps=90", "--seed=4"];
    let words = ["precision.json", "made with other settings", "--out"];
    refused(&[&other_seed[..], &policies].concat(), 5, &words);
    let noise = read(dir_of, "noise.json");
    std::fs::write(dir_of.join("noise.json"), &noise[..noise.len() / 2]).expect("written");
    refused(&args, 5, &["noise.json", "is no whole result"]);
    assert_eq!(read(dir_of, "noise.json").len(), noise.len() / 2);
    std::fs::write(dir_of.join("noise.json"), noise).expect("written");
    std::fs::write(dir_of.join("report.html"), "mine").expect("written");
    refused(&args, 5, &["report.html", "was not made by this command"]);
    assert_eq!(read(dir_of, "report.html"), "mine");
}

/// The policies of the repository act as they are said to, with the curves of their trainings.
#[test]
fn the_shipped_policies_are_better_than_the_papers() {
    let scratch = tempfile::tempdir().expect("tempdir");
    let out = scratch.path().join("out");
    let policies = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies");
    let args = ["reproduce", "--quick", "--json", "--policies", policies, "--out"];
    let output = octopus(&[&args[..], &[out.to_str().expect("UTF-8")]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let outcome: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let claims = outcome["claims"].as_array().expect("claims");
    for what in ["trajectory, position", "trajectory, orientation", "reorientation"] {
        let claim = claims.iter().find(|claim| claim["what"] == what).expect(what);
        assert_eq!(claim["holds"], true, "{claim}");
        let stricter = claim["stricter"].as_array().expect("measures");
        assert!(stricter.iter().all(|measure| measure["holds"] == true), "{claim}");
    }
    let page = read(&out, "report.html");
    stands_alone(&page);
    for run in ["mappo-trajectory-1", "mappo-reorientation-1"] {
        assert!(page.contains(run), "{run}");
    }
}

/// From nothing: runs, policies of the best ones, experiments; what is there is not done again.
#[test]
fn everything_is_trained_once() {
    let scratch = tempfile::tempdir().expect("tempdir");
    let out = scratch.path().join("out");
    let reproduce = || {
        let small = SMALL.iter().filter_map(|set| set.strip_prefix("--set="));
        let more = ["run.evaluate_every=1", "run.evaluation_episodes=4", "run.best_after=0"];
        let budget = ["run.evaluation_steps=8", "run.checkpoint_every=1", "run.env_steps=384"];
        let sets = small.chain(more).chain(budget).map(|set| format!("--set={set}"));
        let mut args: Vec<String> = ["reproduce", "--train", "--seeds=2", "--baselines=ppo"]
            .into_iter()
            .chain(["--quick", "--episodes=2", "--steps=90", "--out"])
            .map(str::to_owned)
            .collect();
        args.push(out.display().to_string());
        args.extend(sets);
        let output = octopus(&args.iter().map(String::as_str).collect::<Vec<_>>());
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        let table = String::from_utf8(output.stdout).expect("UTF-8");
        assert!(table.starts_with("claim"), "results alone: {table}");
        said
    };
    let said = reproduce();
    assert!(said.contains("run 1 of 8") && said.contains("run 8 of 8"), "{said}");
    assert!(said.contains("ppo-reorientation-2"), "{said}");
    let page = read(&out, "report.html");
    stands_alone(&page);
    assert!(page.contains("id=\"learning\"") && page.contains("ppo-trajectory-1"));
    let manifest = |task: &str| -> Value {
        serde_json::from_str(&read(&out.join("policies").join(task), "manifest.json"))
            .expect("JSON")
    };
    // The better of two, by the scores that the runs gave their best.
    let score = |seed: u64| {
        let runs = out.join(format!("runs/mappo-trajectory-{seed}/checkpoints"));
        let entries = std::fs::read_dir(runs).expect("a store").flatten();
        let labels =
            entries.filter_map(|entry| std::fs::read(entry.path().join("labels.json")).ok());
        let labels = labels.map(|text| serde_json::from_slice::<Value>(&text).expect("JSON"));
        let scores = labels.filter_map(|labels| labels["score"]["value"].as_f64());
        scores.fold(f64::INFINITY, f64::min)
    };
    let better = if score(1) <= score(2) { 1 } else { 2 };
    let policy = manifest("trajectory");
    let run = policy["origins"][0]["run"].as_str().expect("a path");
    assert!(
        run.contains(&format!("mappo-trajectory-{better}/")),
        "{run}: {} {}",
        score(1),
        score(2)
    );

    // One that was stopped goes on, and ends as it did; the others are left alone.
    let last = out.join("runs/mappo-trajectory-1/checkpoints/iteration-00000003");
    let digest = |dir: &Path| {
        let manifest: Value = serde_json::from_str(&read(dir, "manifest.json")).expect("JSON");
        manifest["digest"].as_str().expect("a digest").to_owned()
    };
    let before = digest(&last);
    std::fs::remove_dir_all(&last).expect("removed");
    let said = reproduce();
    assert_eq!(said.matches("run ").count(), 1, "{said}");
    assert!(said.contains("run 1 of 8"), "{said}");
    // A slow disk may have cost the checkpoint before it, and then it goes on from an earlier one.
    let goes_on = ["iteration 3", "iterations 2 to 3", "iterations 1 to 3"];
    let goes_on = goes_on.map(|what| format!("trajectory: {what} of 128 env-steps"));
    assert!(goes_on.iter().any(|what| said.contains(what)), "{said}");
    assert_eq!(digest(&last), before);
    assert_eq!(manifest("trajectory"), policy);
}

#[test]
fn experiments_after_trainings_heed_ctrl_c() {
    let scratch = tempfile::tempdir().expect("tempdir");
    let out = scratch.path().join("out");
    let log = scratch.path().join("log");
    let more = ["run.evaluate_every=1", "run.evaluation_episodes=4", "run.best_after=0"];
    let budget = ["run.evaluation_steps=8", "run.env_steps=384"];
    let mut process = Owned::spawn(
        Command::new(program("octopus"))
            .args(["reproduce", "--train", "--seeds=1", "--baselines", "--out"])
            .arg(&out)
            .args(SMALL.iter().filter(|set| set.starts_with("--set=")))
            .args(more.iter().chain(&budget).map(|set| format!("--set={set}")))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(&log).expect("written")),
    );
    let trained = out.join("policies/reorientation/manifest.json");
    let watchdog = Instant::now() + Duration::from_mins(5);
    let ended = loop {
        if let Some(ended) = process.ended() {
            break ended;
        }
        assert!(Instant::now() < watchdog, "it hangs:\n{}", read(scratch.path(), "log"));
        // More than once: the first may come while the trainings' own handler is still in charge.
        if trained.exists() {
            kill(process.id(), Signal::INT);
        }
        std::thread::sleep(Duration::from_millis(100));
    };
    let said = read(scratch.path(), "log");
    assert_eq!(ended.code(), Some(130), "{said}");
    assert!(said.contains("stopped; `octopus reproduce --train --out="), "{said}");
    assert!(!out.join("report.html").exists(), "it went on");
}

#[test]
fn reproductions_that_cannot_be() {
    let scratch = tempfile::tempdir().expect("tempdir");
    let out = scratch.path().join("out");
    let out = ["--out", out.to_str().expect("UTF-8")];
    let nowhere = ["--policies=/no/such"];
    refused(&[&nowhere[..], &out].concat(), 5, &["--policies /no/such", "wanted is one with"]);
    refused(&["--quick", "--steps=0"], 2, &["wants"]);
    refused(&["--train", "--policies=/no/such"], 2, &["--policies", "--train"]);
    refused(&["--seeds=2"], 2, &["--train"]);
    // What would be refused after hours.
    refused(&[&["--train", "--steps=80"][..], &out].concat(), 2, &["--steps 80 ends before"]);
    let many = ["--train", "--episodes=1000000"];
    refused(&[&many[..], &out].concat(), 2, &["more than can be recorded"]);
    let robot = repository().join("sim-worker/simulator/robots/two-arm.toml");
    let two = format!("--set=robot.description={}", robot.display());
    refused(&[&["--train", &two][..], &out].concat(), 3, &["has 2 arms; the stages take four"]);
    let unseen = ["--train", "--set=run.evaluate_every=0"];
    refused(&[&unseen[..], &out].concat(), 2, &["run.evaluate_every = 0", "would be the best"]);
    let unknown = ["--train", "--set=run.colour=1"];
    refused(&[&unknown[..], &out].concat(), 3, &["run.colour"]);

    // Both policies are needed, and steps enough for what happens in them.
    let run_dir = format!("--run-dir={}", scratch.path().join("trajectory").display());
    let train = ["train", "trajectory", &run_dir, "--workers=1", "--iterations=2"];
    let output = octopus(&[&train[..], SMALL].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let one = ["--policies", scratch.path().to_str().expect("UTF-8"), "--steps=90"];
    refused(&[&one[..], &out].concat(), 5, &["reorientation"]);
    let few = ["--policies", scratch.path().to_str().expect("UTF-8"), "--steps=80"];
    refused(&[&few[..], &out].concat(), 2, &["--steps 80 ends before"]);
    let wrong = ["--runs=/no/such"];
    refused(&[&wrong[..], &one[..2], &out].concat(), 5, &["/no/such", "does not exist"]);
    assert!(!Path::new(out[1]).exists(), "nothing is left of what was refused");
}
