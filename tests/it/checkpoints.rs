//! `octopus checkpoints`: what runs leave, kept, compared, copied and put together.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tests::{Owned, Run, SMALL, octopus, program, python, stderr};

/// A finished run with checkpoints after 2, 4 and 6 iterations.
fn run(more: &[&str]) -> (Run, String) {
    let args = ["--workers=1", "--iterations=6", "--set=run.checkpoint_every=2"];
    let mut run = Run::train(&[&args, more].concat());
    run.succeed();
    let path = run.path().to_str().expect("UTF-8").to_owned();
    (run, path)
}

/// Runs `octopus checkpoints` and expects the exit code.
fn checkpoints(args: &[&str], code: i32) -> Output {
    let output = octopus(&[&["checkpoints"], args].concat());
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    assert!(!message.contains("panicked"), "{args:?}:\n{message}");
    output
}

fn text(args: &[&str]) -> String {
    String::from_utf8(checkpoints(args, 0).stdout).expect("UTF-8")
}

fn json(args: &[&str]) -> Value {
    let output = checkpoints(&[args, &["--json"]].concat(), 0);
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Expects the exit code and the words on standard error.
fn refused(args: &[&str], code: i32, words: &[&str]) {
    let message = stderr(&checkpoints(args, code));
    for word in words {
        assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
    }
}

/// Runs Python and returns what it printed.
fn ask_python(script: &str, args: &[&str]) -> String {
    let output =
        Command::new(python()).args(["-c", script]).args(args).output().expect("python starts");
    assert!(output.status.success(), "{}", stderr(&output));
    String::from_utf8(output.stdout).expect("UTF-8").trim_end().to_owned()
}

fn names(store: &str) -> Vec<String> {
    let list = json(&["list", store]);
    let entries = list["entries"].as_array().expect("entries").clone();
    entries.iter().map(|entry| entry["name"].as_str().expect("a name").to_owned()).collect()
}

fn flip(path: &Path) {
    let mut bytes = std::fs::read(path).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("write");
}

/// What is in a store besides checkpoints.
fn temporary(store: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(store).expect("readable").map(|entry| entry.expect("entry"));
    let hidden = |name: &str| name.starts_with('.') && name != ".lock";
    entries
        .filter(|entry| hidden(&entry.file_name().to_string_lossy()))
        .map(|entry| entry.path())
        .collect()
}

#[test]
fn a_runs_checkpoints_are_listed_shown_verified_and_compared() {
    let (_run, dir) = run(&[]);
    let own = ["iteration-00000002", "iteration-00000004", "iteration-00000006"];
    assert_eq!(names(&dir), own);
    assert_eq!(names(&format!("{dir}/checkpoints")), own);
    let table = text(&["list", &dir]);
    assert!(own.iter().all(|name| table.contains(name)) && table.contains("768"), "{table}");

    let shown = json(&["show", &format!("{dir}:4")]);
    assert_eq!((&shown["name"], &shown["iteration"]), (&own[1].into(), &4.into()));
    assert_eq!(shown["kind"], "training");
    let tensors = shown["tensors"].as_array().expect("tensors");
    let head = tensors.iter().find(|t| t["name"] == "head.weight").expect("every actor has one");
    assert_eq!(head["shape"], serde_json::json!([8, 16, 3]));
    let words = text(&["show", &format!("{dir}:4")]);
    assert!(words.contains("BLAKE3") && !words.contains("8 × 16 × 3"), "{words}");
    assert!(words.lines().next().expect("a summary").contains("whole: training goes on from it"));
    let words = text(&["show", "--tensors", &format!("{dir}:4")]);
    assert!(words.contains("8 × 16 × 3"), "{words}");

    // The digest is the one that the metrics have for that iteration, and anybody can compute it.
    let metrics = std::fs::read_to_string(format!("{dir}/metrics.jsonl")).expect("metrics");
    let fourth: Value =
        serde_json::from_str(metrics.lines().nth(3).expect("a line")).expect("JSON");
    assert_eq!(shown["digest"], fourth["digest"]);

    let verified = json(&["verify", &dir]);
    let verified = verified.as_array().expect("a list");
    assert_eq!(verified.len(), 3);
    assert!(verified.iter().all(|one| one["problems"] == serde_json::json!([])), "{verified:?}");
    assert!(text(&["verify", &format!("{dir}:6")]).contains("whole, 4 files"));

    assert!(text(&["diff", &format!("{dir}:2"), &format!("{dir}:2")]).contains("the same"));
    let output = checkpoints(&["diff", &format!("{dir}:2"), &dir, "--json"], 1);
    let difference: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(difference["config"], serde_json::json!([]));
    let changed = difference["tensors"].as_array().expect("a list");
    let counter = changed.iter().find(|t| t["tensor"] == "state.safetensors/counters.iteration");
    assert_eq!(counter.expect("it differs")["max_abs"], 4.0);

    // The same numbers from Python, with safetensors alone.
    let script = "import sys, numpy as np, safetensors.numpy as st\n\
                  a, b = (st.load_file(p + '/policy.safetensors') for p in sys.argv[1:])\n\
                  d = a['head.weight'].astype(np.float64) - b['head.weight']\n\
                  print(repr(float(np.abs(d).max())), repr(float(np.sqrt((d * d).sum()))))";
    let at = |name: &str| format!("{dir}/checkpoints/{name}");
    let found = ask_python(script, &[&at(own[0]), &at(own[2])]);
    let (max, norm) = found.split_once(' ').expect("two numbers");
    let head = changed.iter().find(|t| t["tensor"] == "policy.safetensors/head.weight");
    let head = head.expect("it was trained");
    // serde_json may read a number one unit in the last place off; and the norm is a sum of a few
    // hundred squares in another order.
    for (key, expected, tolerance) in [("max_abs", max, 4e-16), ("norm", norm, 1e-12)] {
        let expected: f64 = expected.parse().expect("a number");
        let ours = head[key].as_f64().expect("a number");
        assert!(expected > 0.0 && (ours - expected).abs() <= tolerance * expected, "{key}");
    }

    // A whole table fits into a closed pipe.
    let mut list = Command::new(program("octopus"))
        .args(["checkpoints", "list", &dir])
        .stdout(Stdio::piped())
        .spawn()
        .expect("starts");
    drop(list.stdout.take());
    assert!(list.wait().expect("own child").success());
}

#[test]
fn labels_protect_and_the_catalogue_follows() {
    let (_run, dir) = run(&[]);
    let query = "import sqlite3, sys\n\
                 db = sqlite3.connect(sys.argv[1] + '/checkpoints/catalogue.sqlite')\n\
                 assert db.execute('pragma user_version').fetchone() == (1,)\n\
                 rows = db.execute('''select c.iteration, c.pinned, c.bytes > 0, length(c.digest),\n\
                 (select group_concat(tag) from tags t where t.name = c.name)\n\
                 from checkpoints c order by c.iteration''')\n\
                 print('; '.join(' '.join(map(str, row)) for row in rows))";
    let rows = || ask_python(query, &[&dir]);
    assert_eq!(rows(), "2 0 1 32 None; 4 0 1 32 None; 6 0 1 32 None");

    let pinned = json(&["pin", &format!("{dir}:2")]);
    assert_eq!(pinned["labels"]["pinned"], true);
    text(&["tag", &format!("{dir}:2"), "first"]);
    assert!(text(&["tag", &format!("{dir}:4"), "first"]).contains("tagged first"));
    assert_eq!(rows(), "2 1 1 32 None; 4 0 1 32 first; 6 0 1 32 None");
    assert_eq!(json(&["show", &format!("{dir}:first")])["iteration"], 4);
    refused(&["tag", &format!("{dir}:4"), "latest"], 2, &["moves by itself"]);
    refused(&["tag", &format!("{dir}:4"), "a/b"], 2, &["cannot be a name"]);
    refused(&["tag", &format!("{dir}:4"), "17"], 2, &["look like an iteration"]);

    // A score as an evaluation would leave it: the smaller is the better.
    for (iteration, value) in [(2, 0.5), (4, 0.25), (6, 0.75)] {
        let dir = format!("{dir}/checkpoints/iteration-0000000{iteration}");
        let path = Path::new(&dir).join("labels.json");
        let before = std::fs::read_to_string(&path).unwrap_or_else(|_| "{}".to_owned());
        let mut labels: Value = serde_json::from_str(&before).expect("JSON");
        labels["score"] =
            serde_json::json!({ "value": value, "episodes": 30, "steps": 200, "seed": 0 });
        std::fs::write(path, labels.to_string()).expect("write");
    }
    assert!(text(&["rebuild", &dir]).contains("3 checkpoints"));
    assert_eq!(rows(), "2 1 1 32 None; 4 0 1 32 best,first; 6 0 1 32 None");
    assert_eq!(json(&["show", &format!("{dir}:best")])["iteration"], 4);
    assert!(text(&["list", &dir]).contains("0.2500"));

    // Damaged, the catalogue is written anew; so it is by hand.
    let catalogue = Path::new(&dir).join("checkpoints/catalogue.sqlite");
    std::fs::write(&catalogue, "no database").expect("write");
    let listed = octopus(&["checkpoints", "list", &dir]);
    assert!(listed.status.success());
    assert!(stderr(&listed).contains("rebuilt"), "{}", stderr(&listed));
    assert_eq!(rows().split("; ").count(), 3);
    std::fs::remove_file(&catalogue).expect("remove");
    assert_eq!(stderr(&octopus(&["checkpoints", "list", &dir])), "", "missing is no news");
    assert_eq!(json(&["rebuild", &dir])["checkpoints"], 3);

    // Pinned, tagged and best: nothing to remove, not even by name.
    let prune = ["prune", &dir, "--keep-latest", "1"];
    assert!(text(&[&prune[..], &["--dry-run"]].concat()).contains("nothing to remove"));
    refused(&["delete", &format!("{dir}:2")], 5, &["is pinned", "checkpoints unpin"]);
    refused(&["delete", &dir], 2, &["say which checkpoint"]);
    text(&["unpin", &format!("{dir}:2")]);
    assert_eq!(
        json(&[&prune[..], &["--dry-run"]].concat()),
        serde_json::json!({ "dry_run": true, "removed": ["iteration-00000002"] })
    );
    assert_eq!(names(&dir).len(), 3);
    assert!(text(&prune).contains("removed iteration-00000002"));
    text(&["untag", &dir, "first"]);
    refused(&["untag", &dir, "first"], 5, &["no checkpoint with the tag `first`"]);
    refused(&["untag", &dir, "best"], 2, &["follows the scores"]);
    text(&["delete", &format!("{dir}/checkpoints/iteration-00000004")]);
    assert_eq!(names(&dir), ["iteration-00000006"]);
    assert_eq!(rows(), "6 0 1 32 best", "of what is left");
    assert_eq!(temporary(&Path::new(&dir).join("checkpoints")), Vec::<PathBuf>::new());
}

#[test]
fn a_checkpoint_travels_as_one_file() {
    let (mut run, dir) = run(&[]);
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).to_str().expect("UTF-8").to_owned();
    let (archive, shared) = (at("best.tar"), at("shared"));
    text(&["export", &format!("{dir}:6"), "--out", &archive]);
    let piped = checkpoints(&["export", &format!("{dir}:6"), "--out", "-"], 0).stdout;
    assert_eq!(std::fs::read(&archive).expect("read"), piped, "the same bytes each time");
    let again = ["export", &format!("{dir}:2"), "--out", &archive];
    refused(&again, 5, &["is there already", "--force"]);
    assert_eq!(std::fs::read(&archive).expect("read"), piped);
    text(&["export", &format!("{dir}:6"), "--out", &archive, "--force"]);
    let script = "import sys, tarfile\n\
                  for m in tarfile.open(sys.argv[1]): print(m.name, m.isreg(), m.mtime, oct(m.mode))";
    let listed = ask_python(script, &[&archive]);
    let expected = ["manifest.json", "config.toml", "policy.safetensors", "robot.toml"];
    let expected: Vec<_> = expected
        .iter()
        .chain(&["state.safetensors"])
        .map(|file| format!("iteration-00000006/{file} True 0 0o644"))
        .collect();
    assert_eq!(listed.lines().collect::<Vec<_>>(), expected);

    let imported = json(&["import", &archive, "--store", &shared, "--name", "from-alice"]);
    assert_eq!(imported["name"], "from-alice");
    let original = json(&["show", &format!("{dir}:6")]);
    let copy = json(&["show", &format!("{shared}:from-alice")]);
    assert_eq!(copy["manifest"], original["manifest"], "provenance travels");
    text(&["verify", &shared]);
    text(&["diff", &format!("{dir}:6"), &format!("{shared}/from-alice")]);
    text(&["import", &archive, "--store", &shared, "--name", "from-alice"]);
    let other = checkpoints(&["export", &format!("{dir}:2"), "--out", &at("two.tar")], 0);
    assert!(other.status.success());
    let clash = ["import", &at("two.tar"), "--store", &shared, "--name", "from-alice"];
    refused(&clash, 5, &["another checkpoint already", "choose another name"]);
    refused(&["import", &archive, "--store", &shared, "--name", "../x"], 2, &["cannot be a name"]);

    // A run whose newest checkpoints were lost gets one back, and goes on as if nothing had been.
    let untouched = at("untouched");
    let copied = Command::new("cp").args(["-r", &dir, &untouched]).status().expect("cp starts");
    assert!(copied.success());
    refused(&["delete", &format!("{dir}:latest")], 5, &["newest whole", "resume", "--force"]);
    text(&["delete", &format!("{dir}:6"), "--force"]);
    text(&["delete", &format!("{dir}:4"), "--force"]);
    let mut import = Command::new(program("octopus"))
        .args(["checkpoints", "import", "-", "--store", &dir])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("starts");
    import.stdin.take().expect("a pipe").write_all(&piped).expect("it reads");
    assert!(import.wait().expect("own child").success());
    run.resume(&["--iterations=7"]);
    run.succeed();
    let resumed = octopus(&["resume", &untouched, "--no-eval", "--iterations=7"]);
    assert!(resumed.status.success(), "{}", stderr(&resumed));
    let lines = std::fs::read_to_string(Path::new(&untouched).join("metrics.jsonl"));
    let lines = lines.expect("metrics");
    let last: Value = serde_json::from_str(lines.lines().last().expect("a line")).expect("JSON");
    assert_eq!((&run.metrics()[6]["digest"], &last["iteration"]), (&last["digest"], &6.into()));

    refused(&["export", &format!("{dir}:6"), "--out", &at("no/such/dir.tar")], 1, &["dir.tar"]);
    let full = std::fs::File::options().write(true).open("/dev/full").expect("it is there");
    let output = Command::new(program("octopus"))
        .args(["checkpoints", "export", &dir, "--out", "-"])
        .stdout(full)
        .output()
        .expect("it starts");
    assert_eq!(output.status.code(), Some(1), "the checkpoint is whole");
    assert!(stderr(&output).contains("standard output cannot be written"), "{}", stderr(&output));
}

#[test]
fn damaged_archives_are_bad_input_and_nothing_of_them_stays() {
    let (_run, dir) = run(&[]);
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).to_str().expect("UTF-8").to_owned();
    let shared = at("shared");
    let bytes = checkpoints(&["export", &dir, "--out", "-"], 0).stdout;
    let broken = at("broken.tar");
    for (content, word) in [
        (&bytes[..bytes.len() / 2], "ends within"),
        (&bytes[..700], "ends within manifest.json"),
        (b"what is this".as_slice(), "not an archive"),
        (b"".as_slice(), "empty"),
    ] {
        std::fs::write(&broken, content).expect("write");
        refused(&["import", &broken, "--store", &shared], 3, &["broken.tar", word]);
    }
    std::fs::write(&broken, &bytes).expect("write");
    flip(Path::new(&broken));
    refused(&["import", &broken, "--store", &shared], 3, &["BLAKE3"]);
    refused(&["import", &at("none.tar"), "--store", &shared], 3, &["none.tar"]);
    assert!(!Path::new(&shared).exists());
}

#[test]
fn what_means_something_else_or_is_of_another_run_is_not_taken_in() {
    let (_run, dir) = run(&[]);
    let (_other, other) = run(&["--set=run.seed=8"]);
    let place = tempfile::tempdir().expect("tempdir");
    let archive = place.path().join("foreign.tar").to_str().expect("UTF-8").to_owned();
    text(&["export", &format!("{other}:6"), "--out", &archive]);
    for (name, word) in [
        ("best", "always selects"),
        ("17", "look like an iteration"),
        ("catalogue.sqlite", "files"),
    ] {
        let import = ["import", &archive, "--store", &dir, "--name", name];
        refused(&import, 3, &[word, "choose another name"]);
    }
    // Also where nothing is left to compare it with but the run itself.
    for iteration in [2, 4, 6] {
        let import = ["import", &archive, "--store", &dir];
        refused(&import, 3, &["of another run", "another name"]);
        text(&["delete", &format!("{dir}:{iteration}"), "--force"]);
    }
    refused(&["import", &archive, "--store", &dir], 3, &["of another run", "another name"]);
    text(&["import", &archive, "--store", &dir, "--name", "foreign"]);
    assert_eq!(names(&dir), ["foreign"]);
}

/// What is made inside a run would be taken for a part of it, and is no checkpoint of its.
#[test]
fn no_store_is_made_inside_a_run() {
    let (_run, dir) = run(&[]);
    let place = tempfile::tempdir().expect("tempdir");
    let archive = place.path().join("a.tar").to_str().expect("UTF-8").to_owned();
    text(&["export", &dir, "--out", &archive]);
    let inside = format!("{dir}/new");
    let arms = format!("1,2,3,4={dir}");
    for force in [&[][..], &["--force"]] {
        let import = ["import", &archive, "--store", &inside];
        refused(&[&import, force].concat(), 5, &["--store", "which is a run directory"]);
        let compose = ["compose", "--arm", &arms, "--out", &format!("{inside}/x")];
        refused(&[&compose, force].concat(), 5, &["--out", "which is a run directory"]);
    }
    assert!(!Path::new(&inside).exists());
    // The run's own store is one, also where it is named itself, and where it is still to be made.
    let own = format!("{dir}/checkpoints");
    text(&["import", &archive, "--store", &own, "--name", "mine"]);
    std::fs::remove_dir_all(&own).expect("removable");
    text(&["import", &archive, "--store", &own, "--name", "mine"]);
    assert_eq!(names(&dir), ["mine"]);
}

#[test]
fn an_import_that_is_killed_leaves_nothing_in_sight() {
    let (_run, dir) = run(&[]);
    let archive = checkpoints(&["export", &dir, "--out", "-"], 0).stdout;
    let store = Path::new(&dir).join("checkpoints");
    for part in [600, archive.len() / 3, archive.len() - 1100] {
        let mut import = Owned::spawn(
            Command::new(program("octopus"))
                .args(["checkpoints", "import", "-", "--store", &dir, "--name", "copy"])
                .stdin(Stdio::piped())
                .stdout(Stdio::null()),
        );
        let mut pipe = import.stdin().expect("a pipe");
        pipe.write_all(&archive[..part]).expect("it reads");
        let watchdog = Instant::now() + Duration::from_mins(1);
        while temporary(&store).is_empty() {
            let ended = import.ended();
            assert!(ended.is_none() && Instant::now() < watchdog, "it imports nothing: {ended:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
        // Others see nothing of it, and a sweep leaves a living one alone.
        assert_eq!(names(&dir).len(), 3);
        text(&["prune", &dir]);
        assert_eq!(temporary(&store).len(), 1);
        // Killed.
        drop(import);
        drop(pipe);
        assert_eq!(names(&dir).len(), 3);
        text(&["prune", &dir]);
        assert_eq!(temporary(&store), Vec::<PathBuf>::new());
    }
    text(&["verify", &dir]);
}

#[test]
fn arms_of_several_runs_are_put_together_and_evaluated() {
    let (_a, a) = run(&[]);
    let (_b, b) = run(&["--set=run.seed=8"]);
    let place = tempfile::tempdir().expect("tempdir");
    let at =
        |name: &str| place.path().join("shared").join(name).to_str().expect("UTF-8").to_owned();
    let evaluate = |target: &str| {
        let output =
            octopus(&["eval", target, "--episodes", "4", "--steps", "20", "--seed", "1", "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let mut report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        report.as_object_mut().expect("an object").retain(|key, _| key != "checkpoint");
        report
    };

    let arms =
        ["--arm", &format!("1,2={a}:4"), "--arm", &format!("3={b}"), "--arm", &format!("4={a}:4")];
    let mixed = json(&[&["compose"][..], &arms, &["--out", &at("mixed")]].concat());
    assert_eq!((&mixed["kind"], &mixed["iteration"]), (&"composed".into(), &6.into()));
    let digest = |target: &str| json(&["show", target])["digest"].clone();
    let (from_a, from_b) = (digest(&format!("{a}:4")), digest(&b));
    let origins = mixed["origins"].as_array().expect("eight");
    assert_eq!(origins.len(), 8);
    for (agent, origin) in origins.iter().enumerate() {
        let source = if [4, 5].contains(&agent) { &from_b } else { &from_a };
        assert_eq!((&origin["agent"], &origin["digest"]), (&agent.into(), source));
    }
    text(&["verify", &at("mixed")]);
    let shown = text(&["show", &at("mixed")]);
    assert!(shown.contains("actors of several checkpoints"), "{shown}");
    let origin = shown.lines().find(|line| line.starts_with("agent 4")).expect("its origin");
    assert!(origin.contains("agent 4 of"), "{origin}");
    assert!(text(&["list", &at("")]).contains("composed"));

    // Put together again from its own run, a policy acts as it did before.
    let whole = ["--arm", &format!("1,2,3,4={a}:4"), "--out", &at("same")];
    text(&[&["compose"][..], &whole].concat());
    assert_eq!(evaluate(&at("same")), evaluate(&format!("{a}:4")));
    let report = evaluate(&at("mixed"));
    assert_ne!(report["episodes"], evaluate(&at("same"))["episodes"], "another arm 3");
    // Read from Python: rows of the right runs.
    let script = "import sys, numpy as np, safetensors.numpy as st\n\
                  m, a, b = (st.load_file(p + '/policy.safetensors') for p in sys.argv[1:])\n\
                  for name in m:\n\
                  \x20   for agent in range(8):\n\
                  \x20       source = b if agent in (4, 5) else a\n\
                  \x20       assert np.array_equal(m[name][agent], source[name][agent]), (name, agent)\n\
                  print(len(m))";
    let in_a = format!("{a}/checkpoints/iteration-00000004");
    let in_b = format!("{b}/checkpoints/iteration-00000006");
    assert_ne!(ask_python(script, &[&at("mixed"), &in_a, &in_b]), "0");

    // It goes through an archive, and into another composition, but is not trained on.
    let archive = place.path().join("mixed.tar").to_str().expect("UTF-8").to_owned();
    text(&["export", &at("mixed"), "--out", &archive]);
    let copy = json(&["import", &archive, "--store", &a, "--name", "team"]);
    assert_eq!((&copy["origins"], &copy["digest"]), (&mixed["origins"], &mixed["digest"]));
    assert_eq!(evaluate(&format!("{a}:team")), report);
    assert_eq!(evaluate(&a)["iteration"], 6, "the run's own is still the newest");
    let again =
        ["--arm", &format!("1,2={a}:team"), "--arm", &format!("3,4={b}"), "--out", &at("again")];
    text(&[&["compose"][..], &again].concat());
    refused(
        &[&["compose"][..], &again[..2], &["--arm", &format!("3,4={a}")], &["--out", &at("again")]]
            .concat(),
        5,
        &["another checkpoint already"],
    );
}

#[test]
fn arms_that_do_not_go_together_are_not_put_together() {
    let (_a, a) = run(&[]);
    let (_b, b) = run(&["--set=run.seed=8"]);
    let place = tempfile::tempdir().expect("tempdir");
    let at =
        |name: &str| place.path().join("shared").join(name).to_str().expect("UTF-8").to_owned();
    let whole = ["--arm", &format!("1,2,3,4={a}:4")];
    let out = ["--out", &at("no")];
    let refuse = |arms: &[&str], code: i32, words: &[&str]| {
        refused(&[&["compose"], arms, &out[..]].concat(), code, words);
    };
    refuse(&["--arm", &format!("1,2={a}")], 2, &["no part has arm 3, 4"]);
    refuse(
        &["--arm", &format!("1,2,3,4={a}"), "--arm", &format!("4={b}")],
        2,
        &["arm 4 is given twice"],
    );
    refuse(&["--arm", &format!("1,2,3,4,5={a}")], 2, &["no arm 5"]);
    refuse(&["--arm", &format!("1,2,3,4={a}:99")], 5, &["no checkpoint of iteration 99"]);
    refuse(&["--arm", "nonsense"], 2, &["ARMS=CHECKPOINT"]);
    let (_wide, wide) = run(&["--set=network.hidden=[8]"]);
    let mixed = ["--arm", &format!("1,2={a}"), "--arm", &format!("3,4={wide}")];
    refuse(
        &mixed,
        3,
        &["network.hidden = [16]", "network.hidden = [8]", "arms 1,2 (", "must be equal"],
    );
    let task = place.path().join("task").to_str().expect("UTF-8").to_owned();
    let flags =
        [&["train", "reorientation", "--run-dir", &task, "--iterations=1"][..], SMALL].concat();
    let trained = octopus(&flags);
    assert!(trained.status.success(), "{}", stderr(&trained));
    let mixed = ["--arm", &format!("1,2={a}"), "--arm", &format!("3,4={task}")];
    refuse(&mixed, 3, &["`reorientation`", "cannot be mixed"]);
    assert!(!Path::new(&at("no")).exists());
    refused(
        &[&["compose"][..], &whole, &["--out", &at("iteration-00000001")]].concat(),
        2,
        &["a run's own"],
    );
    refused(
        &[&["compose"][..], &whole, &["--out", &at(".hidden")]].concat(),
        2,
        &["cannot be a name"],
    );
}

/// Its parent is there and holds other things, but nobody can make a file in it.
#[test]
fn a_place_that_cannot_be_written_is_named_as_it_was_given() {
    let arms = concat!("1,2,3,4=", env!("CARGO_MANIFEST_DIR"), "/../deploy/policies/trajectory");
    let compose = ["compose", "--arm", arms, "--out", "/proc/mixed"];
    refused(&compose, 1, &["--out /proc/mixed: cannot be written: /proc: "]);
}

#[test]
fn damage_is_found_named_and_stepped_over() {
    let (_run, dir) = run(&[]);
    let at = |iteration: u64, file: &str| {
        Path::new(&dir).join(format!("checkpoints/iteration-{iteration:08}/{file}"))
    };
    assert!(text(&["show", &dir]).contains("whole: training goes on"));
    flip(&at(6, "state.safetensors"));
    let shown = checkpoints(&["show", &format!("{dir}:6"), "--json"], 5);
    let shown: Value = serde_json::from_slice(&shown.stdout).expect("JSON");
    assert_eq!(shown["problems"].as_array().map(Vec::len), Some(1), "{shown}");
    let cure = ["copy it again, or take another one (`octopus checkpoints list"];
    refused(
        &["verify", &format!("{dir}:6")],
        5,
        &[&["the checkpoint is damaged"], &cure[..]].concat(),
    );
    let eval = octopus(&["eval", &format!("{dir}:6")]);
    assert_eq!(eval.status.code(), Some(5));
    assert!(
        stderr(&eval).contains("BLAKE3") && stderr(&eval).contains(cure[0]),
        "{}",
        stderr(&eval)
    );
    let found = checkpoints(&["verify", &dir, "--json"], 5);
    let found: Value = serde_json::from_slice(&found.stdout).expect("JSON");
    let problems = found[2]["problems"][0].as_str().expect("a problem");
    assert!(problems.contains("state.safetensors") && problems.contains("BLAKE3"), "{problems}");
    assert_eq!(
        (&found[0]["problems"], &found[1]["problems"]),
        (&Value::Array(Vec::new()), &Value::Array(Vec::new()))
    );
    refused(&["diff", &format!("{dir}:6"), &format!("{dir}:4")], 5, &["state.safetensors"]);
    refused(&["export", &format!("{dir}:6"), "--out", "-"], 5, &["state.safetensors"]);

    // The newest is damaged: an evaluation says so and takes the one before.
    let output = octopus(&["eval", &dir, "--episodes", "2", "--steps", "5", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("damaged"), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(report["iteration"], 4);
    let output = octopus(&["eval", &format!("{dir}:6"), "--episodes", "2"]);
    assert_eq!(output.status.code(), Some(5), "{}", stderr(&output));

    std::fs::write(at(4, "manifest.json"), "{}").expect("write");
    let list = checkpoints(&["list", &dir], 0);
    assert!(String::from_utf8_lossy(&list.stdout).contains("iteration-00000004: damaged:"));
    refused(&["show", &format!("{dir}:4")], 5, &["manifest.json"]);
    std::fs::write(at(2, "labels.json"), "[]").expect("write");
    refused(&["delete", &format!("{dir}:2")], 5, &["damaged labels", "unpin"]);
    text(&["unpin", &format!("{dir}:2")]);
    text(&["delete", &format!("{dir}:4")]);
    text(&["verify", &format!("{dir}:2")]);
    refused(&["delete", &format!("{dir}:2")], 5, &["newest whole", "--force"]);
    text(&["delete", &format!("{dir}:2"), "--force"]);
    let output = octopus(&["eval", &dir]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "all are damaged: {said}");
    assert!(!said.contains("passed over"), "there is no other: {said}");
    assert_eq!(said.matches("state.safetensors").count(), 1, "{said}");
}

#[test]
fn what_does_not_exist_is_answered_with_what_does() {
    let (_run, dir) = run(&[]);
    refused(
        &["show", &format!("{dir}:7")],
        5,
        &["no checkpoint of iteration 7", "iteration-00000006"],
    );
    refused(&["show", &format!("{dir}:stable")], 5, &["`stable`", "iteration-00000006"]);
    refused(&["show", &format!("{dir}:best")], 5, &["no checkpoint with a score"]);
    refused(&["show", &format!("{dir}:")], 2, &["cannot be a name"]);
    refused(&["list", &format!("{dir}/none")], 5, &["does not exist"]);
    refused(&["list", &format!("{dir}/config.toml")], 5, &["is no directory"]);
    refused(&["verify", &format!("{dir}/logs")], 5, &["no checkpoint"]);
    assert!(text(&["list", &format!("{dir}/logs")]).contains("no checkpoints"));
    assert!(!Path::new(&dir).join("logs/.lock").exists());
    let own = format!("{dir}/checkpoints/iteration-00000006");
    refused(&["list", &own], 5, &["is a checkpoint", "checkpoints show"]);
    assert!(!Path::new(&own).join(".lock").exists());
    let above = Path::new(&dir).parent().expect("it has one").to_str().expect("UTF-8");
    assert!(text(&["list", above]).contains("no checkpoints in"));
    refused(
        &["compose", "--arm", &format!("1,2,3,4={dir}"), "--out", "mixed"],
        2,
        &["STORE/NAME", "./mixed"],
    );
    refused(&["prune", &dir, "--keep-every", "0"], 2, &["keep-every"]);
    refused(&["prune", &dir, "--keep-latest", "0"], 2, &["keep-latest"]);
    let output = octopus(&["eval", &format!("{dir}:7")]);
    assert_eq!(output.status.code(), Some(5));
    assert!(stderr(&output).contains("iteration-00000006"), "{}", stderr(&output));
    for command in [
        "list", "show", "verify", "diff", "pin", "unpin", "tag", "untag", "prune", "rebuild",
        "import", "export", "compose", "delete", "commit",
    ] {
        let help = text(&[command, "--help"]);
        assert!(help.contains("--json"), "{command}: {help}");
    }
}

#[test]
fn several_programs_change_a_store_at_once() {
    let (_run, dir) = run(&[]);
    let place = tempfile::tempdir().expect("tempdir");
    let archive = place.path().join("a.tar").to_str().expect("UTF-8").to_owned();
    text(&["export", &dir, "--out", &archive]);
    let mut programs = Vec::new();
    for round in 0..4 {
        let name = format!("copy-{}", round % 2);
        let iteration = 2 * (round % 3 + 1);
        for args in [
            vec!["import", &archive, "--store", &dir, "--name", &name],
            vec!["tag", &format!("{dir}:{iteration}"), "contested"],
            vec!["pin", &format!("{dir}:{iteration}")],
            vec!["prune", &dir, "--keep-latest", "3"],
            vec!["list", &dir],
        ] {
            let mut command = Command::new(program("octopus"));
            command.arg("checkpoints").args(args).stdin(Stdio::null());
            programs.push(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn());
        }
    }
    // Waited for before any is judged, so that none outlives a failure.
    let ended: Vec<Output> = programs
        .into_iter()
        .map(|child| child.expect("starts").wait_with_output().expect("own child"))
        .collect();
    for output in ended {
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let list = json(&["list", &dir]);
    let entries = list["entries"].as_array().expect("entries");
    assert_eq!(entries.len(), 5);
    let tagged = |entry: &&Value| entry["labels"]["tags"] == serde_json::json!(["contested"]);
    assert_eq!(entries.iter().filter(tagged).count(), 1);
    let script = "import sqlite3, sys\n\
                  db = sqlite3.connect(sys.argv[1])\n\
                  print(db.execute('select count(*) from checkpoints').fetchone()[0],\n\
                  db.execute('select count(*) from tags').fetchone()[0],\n\
                  db.execute('pragma integrity_check').fetchone()[0])";
    let store = Path::new(&dir).join("checkpoints");
    let catalogue = store.join("catalogue.sqlite");
    assert_eq!(ask_python(script, &[catalogue.to_str().expect("UTF-8")]), "5 1 ok");
    text(&["verify", &dir]);
    assert_eq!(temporary(&store), Vec::<PathBuf>::new());
}
