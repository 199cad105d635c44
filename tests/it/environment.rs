//! What a shell leaves to a run: variables, limits, and what a killed run left on the disk.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use rustix::process::{Signal, getuid};
use tests::{Run, SMALL, processes_with, program, stderr};

/// No library can read this, and no process of ours puts it there.
const GARBAGE: &str = "garbage-7f3a55d1e0c2";

#[test]
fn variables_of_others_change_no_bit_and_reach_no_child() {
    let names = [
        "ATEN_CPU_CAPABILITY",
        "C10_LOG_LEVEL",
        "CUBLAS_WORKSPACE_CONFIG",
        "DNNL_MAX_CPU_ISA",
        "DNNL_VERBOSE",
        "GLIBC_TUNABLES",
        "GOMP_SPINCOUNT",
        "IDEEP_CACHE_CAPACITY",
        "KMP_STACKSIZE",
        "LRU_CACHE_CAPACITY",
        "MKLDNN_VERBOSE",
        "MKL_CBWR",
        "MKL_NUM_THREADS",
        "NVIDIA_TF32_OVERRIDE",
        "OMP_CANCELLATION",
        "OMP_NUM_THREADS",
        "OMP_STACKSIZE",
        "ONEDNN_DEFAULT_FPMATH_MODE",
        "OPENBLAS_NUM_THREADS",
        "PYTORCH_NVML_BASED_CUDA_CHECK",
        "SPACEOCTOPUS_TOKEN",
        "TORCH_CPP_LOG_LEVEL",
    ];
    // The budget is that of the schedules, so it is the same for both.
    let flags = ["--workers=2", "--iterations=100000"];
    let mut calm = Run::train(&flags);
    calm.wait_for_iterations(4);
    calm.signal(Signal::INT);
    calm.succeed();

    let mut run = Run::with_variables(&names.map(|name| (name, GARBAGE)));
    run.start_training(&flags);
    run.wait_for_iterations(4);
    let domain = run.domain();
    let children = processes_with(&domain);
    let programs: Vec<&str> = children.iter().map(|(_, name)| name.as_str()).collect();
    for program in ["learner", "sim-worker", "octopus"] {
        assert!(programs.contains(&program), "{programs:?}");
    }
    for (pid, program) in &children {
        let environment = std::fs::read(format!("/proc/{pid}/environ")).expect("readable");
        let environment = String::from_utf8_lossy(&environment);
        let foreign: Vec<&str> =
            environment.split('\0').filter(|variable| variable.contains(GARBAGE)).collect();
        assert_eq!(foreign, Vec::<&str>::new(), "{program}");
    }
    run.signal(Signal::INT);
    run.succeed();
    assert_eq!(run.digests()[..4], calm.digests()[..4]);
}

/// Runs `octopus` from a shell that has set a limit.
fn limited(limit: &str, launcher: &[&str], args: &[&str]) -> Output {
    let script = format!("{limit} && exec \"$@\"");
    Command::new("bash")
        .args(["-c", &script, "bash"])
        .args(launcher)
        .arg(program("octopus"))
        .args(args)
        .stdin(Stdio::null())
        .output()
        .expect("bash is there")
}

fn train(dir: &tempfile::TempDir) -> Vec<String> {
    let run_dir = format!("--run-dir={}", dir.path().join("run").display());
    let own = [run_dir.as_str(), "--workers=1", "--iterations=2", "--quiet"];
    ["train", "trajectory"].iter().chain(SMALL).chain(&own).map(|arg| (*arg).to_owned()).collect()
}

#[test]
fn a_stack_that_is_too_small_is_raised_or_named() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let args = train(&dir);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    // The soft limit may be raised by everybody.
    let output = limited("ulimit -S -s 256", &[], &args);
    assert!(output.status.success(), "{}", stderr(&output));
    if !getuid().is_root() {
        eprintln!("not root: a hard limit, which root may raise, was not tried");
        return;
    }
    let without = ["setpriv", "--bounding-set=-sys_resource", "--inh-caps=-sys_resource"];
    let output = limited("ulimit -s 256", &without, &["doctor"]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(said.contains("stack") && said.contains("ulimit -s 8192"), "{said}");
}

#[test]
fn stacks_of_threads_that_are_too_small_are_named() {
    let output = Command::new(program("octopus"))
        .arg("doctor")
        .env("RUST_MIN_STACK", "1")
        .output()
        .expect("octopus can be started");
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(said.contains("RUST_MIN_STACK=1") && said.contains("2.0 MiB"), "{said}");
}

#[test]
fn a_file_that_may_not_become_large_enough_is_named() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let args = train(&dir);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let output = limited("ulimit -f 64", &[], &args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(said.contains("file size") && said.contains("ulimit -f unlimited"), "{said}");
    assert!(!dir.path().join("run").exists(), "nothing was begun");

    // Where nobody knows beforehand how large it will be.
    let out = dir.path().join("robot.xml");
    let output = limited(
        "ulimit -f 1",
        &[],
        &["mjcf", "--robot=paper", "--out", out.to_str().expect("UTF-8")],
    );
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(said.contains("robot.xml") && said.contains("ulimit -f unlimited"), "{said}");
    assert!(!out.exists(), "half a file is none");
}

/// Runs shell commands beside a disk of their own, `$disk`, that holds 200 files; `$octopus` is the program, `"$@"`
/// a small run's flags and `more`. `None` where nobody may mount one.
fn beside_a_small_disk(disk: &Path, commands: &str, more: &[&str]) -> Option<Output> {
    if !getuid().is_root() {
        return None;
    }
    std::fs::create_dir(disk).expect("a directory");
    let script = format!(
        "disk=$1 octopus=$2; shift 2
        mount -t tmpfs -o size=256M,nr_inodes=200 tmpfs \"$disk\" || exit 90
        {commands}"
    );
    let mut command = Command::new("unshare");
    command.args(["--mount", "bash", "-c", &script, "bash"]).args([disk, &program("octopus")]);
    command.args(SMALL).args(["--workers=1", "--quiet"]).args(more).stdin(Stdio::null());
    Some(command.output().expect("util-linux is there"))
}

/// No file can be made any more, though bytes are free, so that no check before finds it out.
#[test]
fn a_disk_that_is_full_when_a_run_is_resumed_names_what_goes_on() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let disk = dir.path().join("disk");
    let commands = "
        \"$octopus\" train trajectory --run-dir \"$disk/run\" --iterations=5 \"$@\" >&2 || exit 91
        i=0; while : > \"$disk/$i\"; do i=$((i + 1)); done 2>/dev/null
        exec \"$octopus\" resume \"$disk/run\" --iterations=10 --no-eval --quiet";
    let Some(output) = beside_a_small_disk(&disk, commands, &[]) else {
        eprintln!("not root, so that no other disk can be mounted: not tried");
        return;
    };
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "{said}");
    let cure = format!("make room, then `octopus resume {}` goes on", disk.join("run").display());
    assert!(said.contains("No space left on device") && said.contains(&cure), "{said}");
    assert_eq!(said.matches("make room").count(), 1, "{said}");
}

/// The training is whole then, and what was found is not lost.
#[test]
fn a_disk_that_is_full_when_the_evaluation_is_written_names_what_evaluates_again() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let disk = dir.path().join("disk");
    // A run lets its lock go when its iterations are over; then come the episodes.
    let commands = "
        (until [ -s \"$disk/run/run.lock\" ]; do kill -0 $$ || exit; sleep 0.01; done
         while [ -s \"$disk/run/run.lock\" ]; do kill -0 $$ || exit; sleep 0.01; done
         i=0; while : > \"$disk/$i\"; do i=$((i + 1)); done) >/dev/null 2>&1 &
        exec \"$octopus\" train trajectory --run-dir \"$disk/run\" --iterations=5 \"$@\"";
    let Some(output) = beside_a_small_disk(&disk, commands, &["--eval"]) else {
        eprintln!("not root, so that no other disk can be mounted: not tried");
        return;
    };
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "{said}");
    let run = disk.join("run");
    let cure =
        format!("make room, then `octopus eval {0} --json > {0}/evaluation.json`", run.display());
    assert!(said.contains("No space left on device") && said.contains(&cure), "{said}");
    let shown = String::from_utf8_lossy(&output.stdout);
    assert!(shown.contains("orientation") && shown.contains("\ncheckpoint  "), "{shown}");
    assert!(!shown.contains("\nevaluation  "), "it is not there: {shown}");
}

#[test]
fn a_shell_that_ignores_the_death_of_children_harms_no_run() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let args = train(&dir);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let output = limited("trap '' CHLD", &[], &args);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn what_a_killed_run_had_begun_to_write_goes_when_it_is_resumed() {
    let mut run = Run::train(&["--workers=1", "--iterations=5"]);
    run.succeed();
    let mut child = Command::new("true").spawn().expect("starts");
    child.wait().expect("own child");
    let dead = child.id();
    let begun = [
        run.path().join(format!(".config.toml.{dead}.tmp")),
        run.path().join(format!("checkpoints/iteration-00000005/.labels.json.{dead}.tmp")),
    ];
    for path in &begun {
        std::fs::write(path, "a part").expect("writable");
    }
    let notes = run.path().join(".notes.tmp");
    std::fs::write(&notes, "of a person").expect("writable");
    run.resume(&["--iterations=6"]);
    run.succeed();
    for path in &begun {
        assert!(!path.exists(), "{}", path.display());
    }
    assert!(notes.exists());
}
