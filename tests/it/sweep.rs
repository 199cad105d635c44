//! `octopus sweep`: grids with seeds, successive halving, kills, Ctrl-C, and what it refuses.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;
use tests::guide::repository;
use tests::{Owned, SMALL, assert_nothing_left, kill, octopus, processes_with, program, stderr};

use crate::reproduce::stands_alone;

/// What makes trials small, as a sweep's file says it.
fn small() -> String {
    let sets = SMALL.iter().filter_map(|flag| flag.strip_prefix("--set="));
    let more = ["run.evaluation_episodes=4", "run.evaluation_steps=8", "run.workers=1"];
    let sets: String = sets.chain(more).map(|set| set.replacen('=', " = ", 1) + "\n").collect();
    format!("[evaluation]\nepisodes = 4\nsteps = 30\n[set]\n{sets}")
}

/// A sweep in a directory that goes away with it.
struct Sweep {
    dir: TempDir,
}

impl Sweep {
    fn new(text: &str) -> Self {
        let sweep = Self { dir: tempfile::tempdir().expect("tempdir") };
        sweep.write(text);
        sweep
    }

    fn write(&self, text: &str) {
        std::fs::write(self.file(), format!("{text}\n{}", small())).expect("written");
    }

    fn file(&self) -> PathBuf {
        self.dir.path().join("tried.toml")
    }

    fn out(&self) -> PathBuf {
        self.dir.path().join("out")
    }

    fn args(&self, more: &[&str]) -> Vec<String> {
        let own = ["sweep".to_owned(), self.file().display().to_string()];
        let out = format!("--out={}", self.out().display());
        own.into_iter().chain([out]).chain(more.iter().map(ToString::to_string)).collect()
    }

    fn call(&self, more: &[&str]) -> Output {
        let args = self.args(more);
        octopus(&args.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Calls it, expects that it ends well, and returns its JSON.
    fn succeed(&self, more: &[&str]) -> Value {
        let output = self.call(&[more, &["--json"]].concat());
        assert!(output.status.success(), "{}\n{}", stderr(&output), self.logs());
        serde_json::from_slice(&output.stdout).expect("JSON")
    }

    fn start(&self, more: &[&str]) -> Owned {
        let log = std::fs::File::create(self.log()).expect("written");
        Owned::spawn(
            Command::new(program("octopus"))
                .args(self.args(more))
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(log),
        )
    }

    fn log(&self) -> PathBuf {
        self.dir.path().join("log")
    }

    fn said(&self) -> String {
        std::fs::read_to_string(self.log()).unwrap_or_default()
    }

    /// What the trials said, for a test that fails.
    fn logs(&self) -> String {
        let records = std::fs::read_dir(self.out().join("records")).into_iter().flatten().flatten();
        let logs = records
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|end| end == "log"));
        logs.map(|path| std::fs::read_to_string(path).unwrap_or_default()).collect()
    }

    fn trial(&self, name: &str) -> PathBuf {
        self.out().join("trials").join(name)
    }

    /// Digests of a trial's iterations.
    fn digests(&self, name: &str) -> Vec<String> {
        digests(&self.trial(name))
    }

    /// Waits until a trial has come so far, or the sweep has ended.
    fn wait_for(&self, name: &str, iterations: usize, process: &mut Owned) {
        let patience = Instant::now() + Duration::from_mins(2);
        while digests(&self.trial(name)).len() < iterations {
            assert!(
                process.ended().is_none(),
                "it ended before:\n{}\n{}",
                self.said(),
                self.logs()
            );
            assert!(Instant::now() < patience, "no {iterations} iterations:\n{}", self.said());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Names of the shared memory of trials that are under way.
    fn domains(&self) -> Vec<String> {
        let trials = std::fs::read_dir(self.out().join("trials")).into_iter().flatten().flatten();
        let holders = trials.filter_map(|trial| {
            let text = std::fs::read(trial.path().join("run.lock")).ok()?;
            let holder: Value = serde_json::from_slice(&text).ok()?;
            Some(holder["domain"].as_str()?.to_owned())
        });
        holders.collect()
    }
}

fn digests(run: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    let lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    lines.map(|line| line["digest"].as_str().expect("a digest").to_owned()).collect()
}

fn trial<'a>(outcome: &'a Value, name: &str) -> &'a Value {
    let trials = outcome["trials"].as_array().expect("trials");
    trials.iter().find(|trial| trial["name"] == name).unwrap_or_else(|| panic!("{name}: {outcome}"))
}

/// Expects the exit code and the words on standard error.
fn refused(output: &Output, code: i32, words: &[&str]) {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{message}");
}

const GRID: &str = "iterations = 4\nseeds = [1, 2]\n[grid]\nalgorithm.gamma = [0.9, 0.95]\n";

#[test]
fn a_grid_is_trained_with_all_seeds_once() {
    let sweep = Sweep::new(GRID);
    let output = sweep.call(&["--dry-run"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let plan = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(plan.contains("4 trials of 2 configurations; 2,048 env-steps if all go"), "{plan}");
    assert!(plan.lines().all(|line| line.chars().count() <= 80), "{plan}");
    assert!(!sweep.out().exists(), "nothing is written");

    let outcome = sweep.succeed(&["--jobs=2"]);
    for gamma in ["0.9", "0.95"] {
        for seed in [1, 2] {
            let name = format!("gamma={gamma},seed={seed}");
            let trial = trial(&outcome, &name);
            assert_eq!((&trial["state"], &trial["iterations"]), (&"done".into(), &4.into()));
            assert_eq!(trial["configuration"], format!("gamma={gamma}"));
            assert_eq!(trial["scored"]["iteration"], 4);
            assert!(trial["scored"]["score"].as_f64().expect("a score") > 0.0, "{trial}");
            assert!(trial["cpu_s"].as_f64().expect("a time") > 0.0, "{trial}");
            assert!(trial["scored"]["reachable"]["goals"].as_u64().expect("some") > 0, "{trial}");
        }
    }
    // What the evaluation of the same policy says.
    let first = sweep.trial("gamma=0.9,seed=1");
    let eval = ["eval", first.to_str().expect("UTF-8"), "--episodes=4", "--steps=30", "--json"];
    let eval: Value = serde_json::from_slice(&octopus(&eval).stdout).expect("JSON");
    let scored = &trial(&outcome, "gamma=0.9,seed=1")["scored"];
    let tail = |kind: usize| eval["overall"][kind]["tail"]["mean"].as_f64().expect("an error");
    assert_eq!(scored["position_m"].as_f64(), Some(tail(0)));
    assert_eq!(scored["angle_rad"].as_f64(), Some(tail(1)));
    let score = scored["score"].as_f64().expect("a score");
    assert!((score - 0.5 * (tail(0) / 0.025 + tail(1) / 0.04)).abs() < 1e-6 * score, "{scored}");
    let of_reachable = &eval["reachable"]["overall"][0]["tail"]["mean"];
    assert_eq!(scored["reachable"]["position_m"], *of_reachable);
    // The mean over seeds lies between them.
    let both = [1, 2].map(|seed| {
        let name = format!("gamma=0.9,seed={seed}");
        trial(&outcome, &name)["scored"]["score"].as_f64().expect("a score")
    });
    let configurations = outcome["configurations"].as_array().expect("a list");
    let one = configurations.iter().find(|of| of["name"] == "gamma=0.9").expect("it is there");
    let mean = one["score"][1].as_f64().expect("a mean");
    assert!((mean - 0.5 * (both[0] + both[1])).abs() < 1e-12, "{one}");
    let better = |at: usize| configurations[at]["score"][1].as_f64().expect("a mean");
    assert!(better(0) <= better(1), "the best first");

    let table = std::fs::read_to_string(sweep.out().join("table.csv")).expect("a table");
    assert_eq!(table.lines().count(), 5, "{table}");
    let digest = sweep.digests("gamma=0.95,seed=2").pop().expect("digests");
    assert!(table.contains(&digest), "{table}");
    let page = std::fs::read_to_string(sweep.out().join("report.html")).expect("a page");
    for part in ["<svg", "mappo, gamma=0.9", "mappo, gamma=0.95", &digest, "[grid]"] {
        assert!(page.contains(part), "{part}");
    }
    stands_alone(&page);

    // A second call trains nothing; a trial more is trained alone.
    let before = sweep.logs();
    let again = sweep.call(&[]);
    assert!(again.status.success(), "{}", stderr(&again));
    assert_eq!((stderr(&again), sweep.logs()), (String::new(), before));
    let shown = String::from_utf8(again.stdout).expect("UTF-8");
    assert_eq!(sweep.call(&["--table"]).stdout, shown.as_bytes());
    let out = sweep.out().display().to_string();
    for line in shown.lines().filter(|line| !line.contains(&out)) {
        assert!(line.chars().count() <= 80, "{line}\nis too long in\n{shown}");
    }
    sweep.write(&format!("{GRID}[[trials]]\nalgorithm.clip = 0.1\n"));
    let more = sweep.call(&[]);
    assert!(more.status.success(), "{}", stderr(&more));
    let said = stderr(&more);
    assert_eq!(said.matches("trains to").count(), 2, "{said}");
    assert!(said.contains("5 of 6, clip=0.1,seed=1: trains to iteration 4, 0 are done"), "{said}");
}

/// Four configurations; two go on from the first rung, one from the second.
const HALVED: &str = "iterations = 12\nseeds = [1, 2]\n\
    [grid]\noptimizer.actor_lr = [1e-3, 1e-4, 1e-5, 1e-2]\n\
    [halving]\nrungs = [0.25, 0.5]\n";

#[test]
fn halving_stops_the_worse_and_winners_end_as_if_they_had_never_paused() {
    let sweep = Sweep::new(HALVED);
    let outcome = sweep.succeed(&["--jobs=2"]);
    let trials = outcome["trials"].as_array().expect("trials");
    let done =
        |iterations: u64| trials.iter().filter(|trial| trial["iterations"] == iterations).count();
    assert_eq!([done(3), done(6), done(12)], [4, 2, 2], "{outcome}");
    // Who went on was better at the rung, in the mean over the seeds.
    let records = |name: &Value| -> Value {
        let path = sweep.out().join(format!("records/{}.json", name.as_str().expect("a name")));
        serde_json::from_slice(&std::fs::read(path).expect("a record")).expect("JSON")
    };
    let mean_at = |rung: usize, iterations: u64| -> Vec<f64> {
        let of = trials.iter().filter(|trial| trial["iterations"] == iterations);
        let scores: Vec<f64> = of
            .map(|trial| {
                records(&trial["name"])["scores"][rung]["score"].as_f64().expect("a score")
            })
            .collect();
        scores.chunks(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
    };
    let best = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
    let worst = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
    let (left, on) = (mean_at(0, 3), [mean_at(0, 6), mean_at(0, 12)].concat());
    assert!(worst(&on) <= best(&left), "{on:?} and {left:?}");
    assert!(mean_at(1, 12)[0] <= mean_at(1, 6)[0]);

    // The bits of a plain training of the whole budget with the same words.
    let plan = sweep.succeed(&["--dry-run"]);
    for trial in trials.iter().filter(|trial| trial["iterations"] == 12) {
        let planned = plan["trials"].as_array().expect("trials");
        let planned = planned.iter().find(|of| of["name"] == trial["name"]).expect("planned");
        assert_eq!(planned["rungs"], serde_json::json!([3, 6, 12]));
        let plain = tempfile::tempdir().expect("tempdir");
        let run_dir = plain.path().join("run").display().to_string();
        let words = planned["arguments"].as_array().expect("words").iter();
        let words = words.map(|word| word.as_str().expect("a word"));
        let args: Vec<&str> =
            ["train", "--no-eval", "--quiet", "--listen=off", "--run-dir", &run_dir]
                .into_iter()
                .chain(words)
                .collect();
        let output = octopus(&args);
        assert!(output.status.success(), "{}", stderr(&output));
        let expected = digests(Path::new(&run_dir));
        assert_eq!(expected.len(), 12);
        assert_eq!(sweep.digests(trial["name"].as_str().expect("a name")), expected);
    }
}

#[test]
fn a_sweep_that_is_killed_again_and_again_ends_with_the_same_bits_and_scores() {
    let text = HALVED.replace("iterations = 12", "iterations = 60").replace(", 1e-5, 1e-2", "");
    let calm = Sweep::new(&text);
    let expected = calm.succeed(&["--jobs=2"]);
    let sweep = Sweep::new(&text);
    let first = "actor_lr=0.001,seed=1";
    for iterations in [3, 12, 22] {
        let mut process = sweep.start(&["--jobs=2"]);
        sweep.wait_for(first, iterations, &mut process);
        let domains = sweep.domains();
        kill(process.id(), Signal::KILL);
        assert!(!process.succeeded());
        // The trials die with it, and leave nothing.
        for domain in &domains {
            assert_nothing_left(domain);
        }
        let left = processes_with(&sweep.out().display().to_string());
        assert!(left.iter().all(|(_, name)| name != "octopus"), "{left:?}");
    }
    let outcome = sweep.succeed(&["--jobs=1"]);
    let expected_trials = expected["trials"].as_array().expect("trials");
    for wanted in expected_trials {
        let name = wanted["name"].as_str().expect("a name");
        let found = trial(&outcome, name);
        for key in ["state", "iterations", "digest", "scored"] {
            assert_eq!(found[key], wanted[key], "{name}: {key}");
        }
        assert_eq!(sweep.digests(name), calm.digests(name), "{name}");
    }
}

#[test]
fn ctrl_c_lets_trials_commit_and_the_same_command_goes_on() {
    let sweep = Sweep::new(&GRID.replace("iterations = 4", "iterations = 400"));
    let early = sweep.call(&["--table"]);
    assert_eq!(early.status.code(), Some(5), "{}", stderr(&early));
    assert!(stderr(&early).contains("no sweep has begun there"), "{}", stderr(&early));
    let mut process = sweep.start(&["--jobs=2"]);
    let names = ["gamma=0.9,seed=1", "gamma=0.9,seed=2"];
    for name in names {
        sweep.wait_for(name, 2, &mut process);
    }
    // A batch system tells all processes.
    let domains = sweep.domains();
    for (pid, _) in processes_with(&sweep.out().display().to_string()) {
        kill(pid, Signal::TERM);
    }
    let patience = Instant::now() + Duration::from_mins(1);
    let ended = loop {
        if let Some(ended) = process.ended() {
            break ended;
        }
        assert!(Instant::now() < patience, "it hangs:\n{}", sweep.said());
        std::thread::sleep(Duration::from_millis(10));
    };
    assert_eq!(ended.code(), Some(130), "{}", sweep.said());
    let said = sweep.said();
    assert!(said.contains("stopping: every trial finishes its iteration"), "{said}");
    assert!(said.contains("stopped; `octopus sweep ") && said.contains(" goes on"), "{said}");
    for domain in &domains {
        assert_nothing_left(domain);
    }
    for name in names {
        let done = sweep.digests(name).len();
        let checkpoint = format!("checkpoints/iteration-{done:08}");
        assert!(
            sweep.trial(name).join(&checkpoint).is_dir(),
            "{name}: {checkpoint}\n{}",
            sweep.logs()
        );
    }
    let table = sweep.succeed(&["--table"]);
    assert_eq!(trial(&table, names[0])["state"], "unfinished");
    assert!(sweep.out().join("report.html").is_file(), "what there is is worth a look");
}

/// As the tasks of a batch array do it: each trial by itself, several times, and then the table.
#[test]
fn trials_one_by_one_come_to_the_same() {
    let text = HALVED.replace("seeds = [1, 2]", "seeds = [1]").replace(", 1e-5, 1e-2", "");
    let whole = Sweep::new(&text);
    let expected = whole.succeed(&[]);
    let sweep = Sweep::new(&text);
    let first = sweep.succeed(&["--trial=1"]);
    assert_eq!(
        (&first["iterations"], &first["state"]),
        (&3.into(), &"unfinished".into()),
        "{first}"
    );
    refused(&sweep.call(&["--trial=3"]), 2, &["--trial 3", "has 2 trials"]);
    for call in ["--trial=2", "--trial=1", "--trial=2", "--trial=1"] {
        sweep.succeed(&[call]);
    }
    let outcome = sweep.succeed(&["--table"]);
    for (found, wanted) in [(&outcome, &expected)] {
        for index in [0, 1] {
            let (found, wanted) = (&found["trials"][index], &wanted["trials"][index]);
            for key in ["name", "state", "iterations", "digest", "scored"] {
                assert_eq!(found[key], wanted[key], "{key}");
            }
        }
    }
    assert!(!sweep.out().join("report.html").exists(), "it is for the whole");
}

/// The script of the job array, called as Slurm calls it.
#[test]
fn a_task_of_a_job_array_does_its_trial() {
    let sweep = Sweep::new(GRID);
    let script = repository().join("deploy/sweeps/slurm-array.sh");
    let path = std::env::var("PATH").expect("a path");
    let beside = program("octopus").parent().expect("a directory").display().to_string();
    let call = |task: &[(&str, &str)]| {
        Command::new("sh")
            .arg(&script)
            .arg(sweep.file())
            .current_dir(sweep.dir.path())
            .env("PATH", format!("{beside}:{path}"))
            .env_remove("SLURM_ARRAY_TASK_ID")
            .envs(task.iter().copied())
            .stdin(Stdio::null())
            .output()
            .expect("sh")
    };
    let output = call(&[("SLURM_ARRAY_TASK_ID", "3")]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("gamma=0.95,seed=1"));
    let trials = std::fs::read_dir(sweep.dir.path().join("sweeps/tried/trials")).expect("trials");
    let trials: Vec<_> = trials.flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(trials, ["gamma=0.95,seed=1"]);
    assert!(stderr(&call(&[])).contains("is for a task of a job array"));
}

#[test]
fn the_sweeps_of_the_repository_are_sweeps() {
    let dir = repository().join("deploy/sweeps");
    let files = std::fs::read_dir(dir).expect("a directory").flatten().map(|entry| entry.path());
    let sweeps: Vec<_> =
        files.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    assert!(sweeps.len() >= 2, "{sweeps:?}");
    for sweep in sweeps {
        let output = octopus(&["sweep", sweep.to_str().expect("UTF-8"), "--dry-run"]);
        assert!(output.status.success(), "{}", stderr(&output));
    }
}

#[test]
fn a_trial_that_fails_is_recorded_and_the_others_go_on() {
    // No test machine has eight GPUs; that is found out when the run starts.
    let sweep = Sweep::new(
        "iterations = 2\nseeds = [1]\n[[trials]]\nrun.device = \"cuda:7\"\n[[trials]]\nalgorithm.gamma = 0.9\n",
    );
    let output = sweep.call(&[]);
    refused(&output, 1, &["1 of 2 trials failed", "device=cuda-7", "tries them again"]);
    let table = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(table.contains("failed") && table.contains("done"), "{table}");
    let shown = sweep.succeed(&["--table"]);
    let trials = shown["trials"].as_array().expect("trials");
    assert_eq!((&trials[0]["state"], &trials[1]["state"]), (&"failed".into(), &"done".into()));
    assert!(trials[0]["failure"].as_str().expect("a reason").contains("cuda"), "{shown}");
}

/// Nobody waits at a rung for a trial that cannot be scored there.
#[test]
fn a_trial_that_cannot_be_begun_leaves_its_place_to_others() {
    let sweep =
        Sweep::new(&HALVED.replace("seeds = [1, 2]", "seeds = [1]").replace(", 1e-5, 1e-2", ""));
    for call in ["--trial=1", "--trial=2"] {
        sweep.succeed(&[call]);
    }
    let names = ["actor_lr=0.001,seed=1", "actor_lr=0.0001,seed=1"];
    std::fs::remove_file(sweep.out().join(format!("records/{}.json", names[0]))).expect("removed");
    let checkpoint = sweep.trial(names[0]).join("checkpoints/iteration-00000003");
    let files = std::fs::read_dir(checkpoint).expect("a checkpoint").flatten();
    let largest = files.max_by_key(|file| file.metadata().map_or(0, |file| file.len()));
    let largest = largest.expect("files").path();
    let mut bytes = std::fs::read(&largest).expect("a file");
    *bytes.last_mut().expect("a byte") ^= 1;
    std::fs::write(&largest, bytes).expect("written");
    let output = sweep.call(&["--json"]);
    refused(&output, 1, &["1 of 2 trials failed", names[0]]);
    let outcome: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(trial(&outcome, names[0])["state"], "failed", "{outcome}");
    let other = trial(&outcome, names[1]);
    assert_eq!((&other["state"], &other["iterations"]), (&"done".into(), &12.into()), "{other}");
    // What rungs compare is the same in all trials, also in those that are added.
    let text = std::fs::read_to_string(sweep.file()).expect("a file");
    let longer = text.replace("run.evaluation_steps = 8", "run.evaluation_steps = 9");
    assert_ne!(longer, text);
    std::fs::write(sweep.file(), longer).expect("written");
    refused(&sweep.call(&[]), 5, &["is a run already", "run.evaluation_steps"]);
}

/// Scores lie beside the runs. Those of a run that is gone say nothing of the one that takes its place.
#[test]
fn a_trial_whose_run_was_removed_is_trained_and_scored_anew() {
    let text = "iterations = 2\n[grid]\nalgorithm.gamma = [0.9]\n";
    let sweep = Sweep::new(text);
    let before = sweep.succeed(&[]);
    sweep.write(&format!("algorithm = \"ippo\"\n{text}"));
    refused(&sweep.call(&[]), 5, &["is a run already", "as algorithm.", "move it away"]);
    std::fs::remove_dir_all(sweep.trial("gamma=0.9,seed=1")).expect("removed");
    let table = sweep.succeed(&["--table"]);
    assert_eq!(table["trials"][0]["state"], "unfinished", "{table}");
    let after = sweep.succeed(&[]);
    let [before, after] = [&before, &after].map(|of| &of["trials"][0]);
    assert_eq!((&after["state"], &after["iterations"]), (&"done".into(), &2.into()), "{after}");
    assert_eq!(after["scored"]["digest"], after["digest"]);
    assert_ne!(after["scored"], before["scored"]);
}

#[test]
fn sweeps_that_cannot_be() {
    let sweep = Sweep::new(GRID);
    for (text, code, words) in [
        ("[grid]\nalgorithm.gama = [0.9]", 3, "did you mean `algorithm.gamma`?"),
        ("iterations = 0", 3, "key `iterations` wants a whole number, 1 or more, got 0"),
        ("[grid]\n", 3, "[grid] has no keys"),
        ("iterations = 2\n[halving]\nrungs = [2.0]", 3, "above 0 and below 1"),
        ("sedes = [1]", 3, "did you mean `seeds`?"),
        ("[grid]\nalgorithm.gamma = [0.9, 0.9]", 3, "is there twice"),
    ] {
        sweep.write(text);
        refused(&sweep.call(&[]), code, &["tried.toml: ", words]);
        assert!(!sweep.out().exists(), "{text}: nothing is left of what was refused");
    }
    refused(&octopus(&["sweep", "/no/such.toml"]), 3, &["/no/such.toml: cannot be read"]);

    // As `octopus train --dry-run`.
    sweep.write("iterations = 1\n[grid]\nrun.device = [\"cuda:77\"]");
    refused(&sweep.call(&["--dry-run"]), 4, &["trial device=cuda-77,seed=1", "cuda:77"]);
    assert!(!sweep.out().exists());

    // A directory of others is left as it is.
    sweep.write(GRID);
    std::fs::create_dir(sweep.out()).expect("made");
    std::fs::write(sweep.out().join("mine"), "mine").expect("written");
    refused(&sweep.call(&[]), 5, &["--out", "holds \"mine\""]);
    std::fs::rename(sweep.out().join("mine"), sweep.out().join("sweep.toml")).expect("renamed");
    refused(&sweep.call(&[]), 5, &["sweep.toml: was not made by this command"]);
    std::fs::remove_file(sweep.out().join("sweep.toml")).expect("removed");

    // What has begun may not change.
    sweep.write(&GRID.replace("iterations = 4", "iterations = 2"));
    sweep.succeed(&[]);
    sweep.write(GRID);
    refused(&sweep.call(&[]), 5, &["gamma=0.9,seed=1: is a run already", "run.env_steps", "--out"]);
    let two = GRID.replace("iterations = 4", "iterations = 2");
    sweep.write(&two.replace("[1, 2]", "[1]"));
    refused(&sweep.call(&[]), 5, &["trial gamma=0.9,seed=2 of", "is not in it any more"]);
    sweep.write(&format!("{two}[halving]\nrungs = [0.5]"));
    refused(&sweep.call(&[]), 5, &["[halving] is another than that of"]);
    let record = sweep.out().join("records/gamma=0.9,seed=1.json");
    std::fs::write(&record, "{").expect("written");
    sweep.write(&two);
    // A damaged file is the failure of its trial, hides no other, and stays as it is.
    let shown = sweep.succeed(&["--table"]);
    let damaged = trial(&shown, "gamma=0.9,seed=1");
    let reason = damaged["failure"].as_str().expect("a reason");
    assert!(reason.contains("seed=1.json: is no record of a trial"), "{reason}");
    assert_eq!(damaged["state"], "failed");
    assert_eq!(trial(&shown, "gamma=0.9,seed=2")["state"], "done");
    refused(&sweep.call(&[]), 1, &["1 of 4 trials failed", "is no record of a trial"]);
    assert_eq!(std::fs::read_to_string(&record).expect("it is there"), "{");
}
