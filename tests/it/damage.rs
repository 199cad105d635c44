//! What a run may start from: its own checkpoints, whole files, and nothing that was changed without a
//! word. `make chaos` damages many more.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Output;

use proto::config::{Layers, Preset};
use run::signals::StopRequests;
use rustix::process::Signal;
use serde_json::Value;
use tests::chaos::damage::{self, Damage, Patient};
use tests::chaos::verdict::Verdict;
use tests::{Run, assert_nothing_left, kill, octopus, stderr};

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Writes a file of a checkpoint anew, and its hash into the manifest.
fn recommit(checkpoint: &Path, file: &str, change: impl Fn(&mut Vec<u8>)) {
    let path = checkpoint.join(file);
    let mut bytes = std::fs::read(&path).expect("readable");
    change(&mut bytes);
    std::fs::write(&path, &bytes).expect("writable");
    let manifest = checkpoint.join("manifest.json");
    let mut said: Value =
        serde_json::from_slice(&std::fs::read(&manifest).expect("readable")).expect("JSON");
    said["files"][file]["len"] = bytes.len().into();
    said["files"][file]["blake3"] = blake3::hash(&bytes).to_hex().as_str().into();
    std::fs::write(&manifest, said.to_string()).expect("writable");
}

fn checkpoint(run_dir: &Path, iteration: u64) -> PathBuf {
    run_dir.join(format!("checkpoints/iteration-{iteration:08}"))
}

fn digests(run_dir: &Path) -> Vec<String> {
    let lines = std::fs::read_to_string(run_dir.join("metrics.jsonl")).expect("metrics");
    let digest = |line: &str| {
        let line: Value = serde_json::from_str(line).expect("JSON");
        line["digest"].as_str().expect("a digest").to_owned()
    };
    lines.lines().map(digest).collect()
}

/// Resumes and expects the exit code and the words.
fn resumed(run_dir: &Path, code: i32, words: &[&str]) -> Output {
    let output = damage::resume(run_dir).expect("ends");
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is not in\n{said}");
    }
    assert!(!said.contains("panicked"), "{said}");
    output
}

/// Ways in which a run directory was once damaged without a word, or with a wrong one.
#[test]
fn damage_is_survived_or_said() {
    let patient = Patient::new().expect("trains");
    let newest = Path::new("checkpoints/iteration-00000010");
    let metrics = Path::new("metrics.jsonl");
    for (file, damage, expected) in [
        (metrics, Damage::Double, Verdict::Refused),
        (metrics, Damage::Halve, Verdict::Survived),
        (Path::new("promised.jsonl"), Damage::Digit(300), Verdict::Refused),
        (Path::new("promised.jsonl"), Damage::Lose, Verdict::Survived),
        (Path::new("config.toml"), Damage::Empty, Verdict::Refused),
        (Path::new("robot.toml"), Damage::Empty, Verdict::Refused),
        (Path::new("budgets.json"), Damage::Lose, Verdict::Survived),
        (Path::new("budgets.json"), Damage::Halve, Verdict::Refused),
        (&newest.join("state.safetensors"), Damage::Flip(99_999), Verdict::Survived),
        (&newest.join("manifest.json"), Damage::Empty, Verdict::Survived),
    ] {
        let verdict = patient.try_with(file, damage).unwrap_or_else(|error| panic!("{error:#}"));
        assert_eq!(verdict, expected, "{} {damage}", file.display());
    }
}

/// The file is not sealed, but it says nothing alone: another budget in it is another than that of `config.toml`.
#[test]
fn a_changed_digit_of_the_budgets_is_said_with_the_file() {
    let patient = Patient::new().expect("trains");
    let text =
        std::fs::read_to_string(patient.copy().expect("copies").path().join("run/budgets.json"));
    let digits = text.expect("readable").bytes().filter(u8::is_ascii_digit).count();
    for digit in 0..digits {
        let copy = patient.copy().expect("copies");
        let dir = copy.path().join("run");
        Damage::Digit(u32::try_from(digit).expect("few"))
            .inflict(&dir.join("budgets.json"))
            .expect("own");
        let output = damage::resume(&dir).expect("ends");
        assert!(stderr(&output).contains("budgets.json"), "digit {digit}: {}", stderr(&output));
        assert!([0, 5].contains(&output.status.code().expect("no signal")), "{}", stderr(&output));
    }
}

#[test]
fn whatever_is_damaged_the_bits_are_the_same_or_the_file_is_named() {
    let mut story = String::new();
    let mut narrate = |line: &str| story = format!("{story}\n{line}");
    let report = damage::run(12, 1, &StopRequests::new(), &mut narrate);
    let report = report.unwrap_or_else(|error| panic!("{error:#}\n{story}"));
    assert_eq!(report.survived + report.refused, 12);
}

/// Of the same seed and robot, but with another budget, over which the learning rate falls.
#[test]
fn a_checkpoint_of_another_budget_is_no_base() {
    let patient = Patient::new().expect("trains");
    let mut other = Run::train(&["--workers=2", "--overlap=0", "--iterations=12"]);
    other.succeed();
    let foreign = checkpoint(&other.path(), 12);
    assert_ne!(digests(&other.path())[11], patient.calm()[11], "another course");

    // It is not taken in, neither where the run knows better nor where it does not.
    let place = tempfile::tempdir().expect("tempdir");
    let archive = |iteration: u64| {
        let path = place.path().join(format!("{iteration}.tar"));
        let from = format!("{}:{iteration}", other.path().display());
        let exported = octopus(&["checkpoints", "export", &from, "--force", "--out", text(&path)]);
        assert!(exported.status.success(), "{}", stderr(&exported));
        path
    };
    let copy = patient.copy().expect("copies");
    let dir = copy.path().join("run");
    let import = |iteration| {
        let archive = archive(iteration);
        octopus(&["checkpoints", "import", text(&archive), "--store", text(&dir)])
    };
    let refused = import(12);
    assert_eq!(refused.status.code(), Some(3), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("of another course than this run: its digest is"));
    let lines = std::fs::read_to_string(dir.join("metrics.jsonl")).expect("metrics");
    let kept: String = lines.split_inclusive('\n').take(11).collect();
    std::fs::write(dir.join("metrics.jsonl"), kept).expect("writable");
    let refused = import(12);
    assert_eq!(refused.status.code(), Some(3), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("of another course"), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("run.env_steps"), "{}", stderr(&refused));

    // Copied in by hand, with or without a word that it is a stranger.
    for imported in [true, false] {
        let copy = patient.copy().expect("copies");
        let dir = copy.path().join("run");
        damage::copy_dir(&foreign, &checkpoint(&dir, 12)).expect("copies");
        let words: &[&str] = if imported {
            let labels = checkpoint(&dir, 12).join("labels.json");
            std::fs::write(labels, r#"{"imported":true}"#).expect("writable");
            &[]
        } else {
            &["iteration-00000012: has digest", "metrics.jsonl", "going on from checkpoint 10"]
        };
        resumed(&dir, 0, words);
        assert_eq!(digests(&dir), patient.calm());
    }
}

/// Nothing is recorded of where it would come from, so that it has to prove itself.
#[test]
fn a_foreign_checkpoint_beyond_the_metrics_promises_nothing() {
    let patient = Patient::new().expect("trains");
    let flags = ["--workers=2", "--overlap=0", "--iterations=20"];
    let mut other = Run::train(&[&flags[..], &["--set=run.seed=8"]].concat());
    other.succeed();
    let mut same = Run::train(&flags);
    same.succeed();
    assert_eq!(same.digests(), patient.calm());
    // The right state, under a digest that is none of its own.
    let manifest = checkpoint(&same.path(), 20).join("manifest.json");
    let text = std::fs::read_to_string(&manifest).expect("readable");
    let reversed: String = patient.calm()[19].chars().rev().collect();
    std::fs::write(&manifest, text.replace(&patient.calm()[19], &reversed)).expect("writable");
    for foreign in [other, same] {
        let copy = patient.copy().expect("copies");
        let dir = copy.path().join("run");
        damage::copy_dir(&checkpoint(&foreign.path(), 20), &checkpoint(&dir, 20)).expect("copies");
        resumed(&dir, 0, &["iteration-00000020 is of 20", "going on from checkpoint 10 instead"]);
        assert_eq!(digests(&dir), patient.calm());
    }
}

/// Gives a live run without a checkpoint one of another run, kills its learner, and expects that it goes on from its
/// own beginning; returns what it said.
fn goes_on_from_its_own(give: impl FnOnce(&Run, &Run)) -> String {
    let mut other = Run::train(&["--workers=2", "--overlap=0", "--iterations=7"]);
    other.succeed();
    let iterations = "--iterations=300";
    let mut calm = Run::train(&["--workers=2", "--overlap=0", iterations]);
    calm.succeed();
    let mut run =
        Run::train(&["--workers=2", "--overlap=0", iterations, "--set=run.checkpoint_every=0"]);
    run.wait_for_iterations(9);
    let domain = run.domain();
    give(&run, &other);
    for learner in run.children("learner") {
        kill(learner, Signal::KILL);
    }
    run.succeed();
    assert!(run.log().contains("going on from iteration 0"), "{}", run.log());
    assert_eq!(run.digests(), calm.digests());
    assert_nothing_left(&domain);
    run.log()
}

/// Whoever may upload gives a live run no base of his own.
#[test]
fn an_uploaded_checkpoint_of_another_course_is_refused_and_no_base_of_a_live_run() {
    goes_on_from_its_own(|run, other| {
        let place = tempfile::tempdir().expect("tempdir");
        let archive = place.path().join("a.tar");
        let from = format!("{}:7", other.path().display());
        let exported = octopus(&["checkpoints", "export", &from, "--out", text(&archive)]);
        assert!(exported.status.success(), "{}", stderr(&exported));
        let answer = put(run, "iteration-00000007", &std::fs::read(&archive).expect("readable"));
        assert!(answer.starts_with("HTTP/1.1 422"), "{answer}");
        assert!(answer.contains("of another course than this run"), "{answer}");
    });
}

/// Uploads an archive to the service beside a run; its answer.
fn put(run: &Run, name: &str, archive: &[u8]) -> String {
    let read = |file: &str| std::fs::read_to_string(run.path().join(file)).expect("readable");
    let holder: Value = serde_json::from_str(&read("run.lock")).expect("JSON");
    let mut stream =
        TcpStream::connect(holder["http"].as_str().expect("a service")).expect("connects");
    let head = format!(
        "PUT /v1/checkpoints/{name} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
         Authorization: Bearer {}\r\nContent-Length: {}\r\n\r\n",
        read("http.token").trim_end(),
        archive.len()
    );
    stream.write_all(head.as_bytes()).expect("sends");
    // A refused one may be answered before all of it is read.
    let _ = stream.write_all(archive);
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

#[test]
fn a_checkpoint_of_another_course_is_no_base_of_a_live_run() {
    let said = goes_on_from_its_own(|run, other| {
        let place = checkpoint(&run.path(), 7);
        damage::copy_dir(&checkpoint(&other.path(), 7), &place).expect("copies");
        std::fs::write(place.join("labels.json"), r#"{"imported":true}"#).expect("writable");
    });
    assert!(said.contains("it was imported"), "{said}");
}

/// Such a state once ended every resume, each of which promised that the next would go on.
#[test]
fn a_state_that_the_learner_does_not_start_from_is_passed_over() {
    let patient = Patient::new().expect("trains");
    let last = |bytes: &mut Vec<u8>| *bytes.last_mut().expect("not empty") ^= 1;
    let format = |bytes: &mut Vec<u8>| {
        let mark = b"training state 1";
        let place = bytes.windows(mark.len()).position(|window| window == mark);
        bytes[place.expect("a mark") + mark.len() - 1] = b'9';
    };
    for (change, word) in [
        (&last as &dyn Fn(&mut Vec<u8>), "found digest"),
        (&format as &dyn Fn(&mut Vec<u8>), "its format is `spaceoctopus training state 9`"),
    ] {
        let copy = patient.copy().expect("copies");
        let dir = copy.path().join("run");
        recommit(&checkpoint(&dir, 10), "state.safetensors", change);
        let words = [word, "iteration-00000010", "going on from checkpoint 5 instead"];
        resumed(&dir, 0, &words);
        assert_eq!(digests(&dir), patient.calm());
    }
    // There is none before.
    let copy = patient.copy().expect("copies");
    let dir = copy.path().join("run");
    std::fs::remove_dir_all(checkpoint(&dir, 5)).expect("removable");
    recommit(&checkpoint(&dir, 10), "state.safetensors", format);
    for _ in 0..2 {
        let output = resumed(&dir, 5, &["its format is", "no other checkpoint to go on from"]);
        assert!(!stderr(&output).contains("goes on from"), "{}", stderr(&output));
    }
}

#[test]
fn a_budget_that_was_changed_by_hand_or_halfway_is_said_and_is_no_difference() {
    let patient = Patient::new().expect("trains");
    let copy = patient.copy().expect("copies");
    let dir = copy.path().join("run");
    let config = dir.join("config.toml");
    let before = std::fs::read_to_string(&config).expect("readable");
    let steps = |iterations: u64| format!("env_steps = {}", iterations * 16 * 8);
    assert!(before.contains(&steps(20)), "{before}");
    std::fs::write(&config, before.replace(&steps(20), &steps(22))).expect("writable");
    resumed(&dir, 0, &["config.toml: run.env_steps is 2816, and was 2560"]);
    let ended = digests(&dir);
    assert_eq!((ended.len(), &ended[..10]), (22, &patient.calm()[..10]));
    assert_ne!(ended[10], patient.calm()[10], "another course");

    // The same as with the flag, and said once.
    let copy = patient.copy().expect("copies");
    let flagged = copy.path().join("run");
    let output = octopus(&["resume", text(&flagged), "--no-eval", "--iterations=22"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(digests(&flagged), ended);
    let again = octopus(&["resume", text(&flagged), "--no-eval"]);
    assert!(again.status.success() && !stderr(&again).contains("by hand"), "{}", stderr(&again));
}

#[test]
fn a_run_whose_checkpoints_are_gone_is_not_said_to_have_had_none() {
    let mut run = Run::train(&["--workers=2", "--overlap=0", "--iterations=6"]);
    run.succeed();
    let before = run.digests();
    for iteration in [5, 6] {
        std::fs::remove_dir_all(checkpoint(&run.path(), iteration)).expect("removable");
    }
    let output =
        resumed(&run.path(), 0, &["6 iterations are recorded, which must end as they did"]);
    assert!(!stderr(&output).contains("before its first"), "{}", stderr(&output));
    assert_eq!(run.digests(), before);

    // Under another budget they end otherwise.
    for iteration in [5, 6] {
        let _ = std::fs::remove_dir_all(checkpoint(&run.path(), iteration));
    }
    let path = run.path();
    let longer = octopus(&["resume", text(&path), "--no-eval", "--listen=off", "--iterations=8"]);
    let said = stderr(&longer);
    assert!(longer.status.success(), "{said}");
    assert!(said.contains("not compared with 6 recorded iterations"), "{said}");
    assert!(!said.contains("must end as"), "{said}");
}

#[test]
fn a_run_without_a_checkpoint_says_how_to_get_one() {
    let mut run = Run::train(&["--iterations=100000", "--set=run.checkpoint_every=0"]);
    run.wait_for_iterations(3);
    let path = run.path();
    let path = text(&path);
    let eval = ["eval", path, "--episodes=2", "--steps=4"];
    let output = octopus(&eval);
    assert_eq!(output.status.code(), Some(5), "{}", stderr(&output));
    assert!(stderr(&output).contains("octopus checkpoints commit"), "{}", stderr(&output));
    let committed = octopus(&["checkpoints", "commit", path]);
    assert!(committed.status.success(), "{}", stderr(&committed));
    let said = String::from_utf8_lossy(&committed.stdout).into_owned();
    assert!(said.contains("committed iteration-"), "{said}");
    let output = octopus(&eval);
    assert!(output.status.success(), "{}", stderr(&output));
    run.signal(Signal::INT);
    run.succeed();
    let refused = octopus(&["checkpoints", "commit", path]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("no run is going on"), "{}", stderr(&refused));
}

/// What the coordinator expects of a training state is what learners write, whatever is learned.
#[test]
fn what_learners_write_is_what_is_expected() {
    for more in [
        &["--preset=paper"][..],
        &["--preset=paper", "--algorithm=ppo", "--set=network.input_norm=\"running\""],
        &["--preset=release", "--algorithm=maddpg"],
        &[
            "--preset=release",
            "--set=optimizer.target_kl=0.01",
            "--set=network.input_norm=\"layer_norm\"",
        ],
        &[
            "--algorithm=ippo",
            "--set=network.input_norm=\"running\"",
            "--set=network.layer_norm=true",
        ],
    ] {
        let few = ["--iterations=2", "--set=run.evaluate_every=0", "--set=run.checkpoints_kept=1"];
        let mut run = Run::train(&[&few[..], more].concat());
        run.succeed();
        let verified = octopus(&["checkpoints", "verify", text(&run.path())]);
        assert!(verified.status.success(), "{more:?}: {}", stderr(&verified));
    }
}

/// Notes were compared by one of their three reasons, and the others never said.
#[test]
fn status_says_what_is_damaged_also_into_a_pipe_while_it_watches() {
    let dir = tempfile::tempdir().expect("tempdir");
    let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
    std::fs::write(dir.path().join("config.toml"), config.to_toml()).expect("writable");
    std::fs::create_dir_all(checkpoint(dir.path(), 1)).expect("made");
    // It is at rest, so that it is shown once.
    for more in [&["--watch"][..], &["--watch", "--json"]] {
        let output = octopus(&[&["status", text(dir.path())], more].concat());
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        assert_eq!(said.matches("holds 0 of 1 iterations").count(), 1, "{said}");
    }
}
