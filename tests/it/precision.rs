//! `run.precision = "auto"` is decided once, by the processor, and stands in the run from then on.

use std::path::Path;

use rustix::process::Signal;
use tests::{Run, SMALL, assert_nothing_left, octopus, stderr};

/// What a configuration file says.
fn precision(config: &Path) -> String {
    let text = std::fs::read_to_string(config).expect("a configuration");
    let table: toml::Table = text.parse().expect("TOML");
    table["run"]["precision"].as_str().expect("a name").to_owned()
}

/// Makes a run one of an earlier version, which left `auto` in its configuration.
fn undecide(config: &Path) {
    let text = std::fs::read_to_string(config).expect("a configuration");
    let decided = format!("precision = \"{}\"", precision(config));
    assert_eq!(text.matches(&decided).count(), 1, "{text}");
    std::fs::write(config, text.replace(&decided, "precision = \"auto\"")).expect("writable");
}

/// What a learner of this machine is given if nothing is asked for.
fn by_the_processor() -> String {
    let args: Vec<&str> =
        ["train", "trajectory", "--dry-run"].iter().chain(SMALL).copied().collect();
    let output = octopus(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let plan: toml::Table = String::from_utf8_lossy(&output.stdout).parse().expect("TOML");
    plan["run"]["precision"].as_str().expect("a name").to_owned()
}

#[test]
fn a_run_says_which_arithmetic_it_began_with_and_never_auto() {
    let decided = by_the_processor();
    assert!(["f32", "bf16"].contains(&decided.as_str()), "{decided}");
    let mut run = Run::train(&["--workers=1", "--iterations=5", "--set=run.precision=auto"]);
    run.succeed();
    let config = run.path().join("config.toml");
    assert_eq!(precision(&config), decided);
    let checkpoint = run.path().join("checkpoints/iteration-00000005/config.toml");
    assert_eq!(precision(&checkpoint), decided);
    let log = std::fs::read_to_string(run.path().join("logs/learner.log")).expect("a log");
    assert!(log.contains(&format!("precision=\"{decided}\"")), "{log}");
    assert!(!log.contains("µs in f32"), "nothing was measured: {log}");
}

#[test]
fn a_run_that_is_killed_before_its_first_checkpoint_goes_on_with_its_arithmetic() {
    // Also with the one that this processor would not choose.
    for wanted in ["auto", "f32", "bf16"] {
        let expected = if wanted == "auto" { by_the_processor() } else { wanted.to_owned() };
        let flags = ["--workers=1", "--iterations=40", "--set=run.checkpoint_every=0"];
        let precise = format!("--set=run.precision={wanted}");
        let flags: Vec<&str> = flags.into_iter().chain([precise.as_str()]).collect();
        let mut calm = Run::train(&flags);
        calm.succeed();
        let mut run = Run::train(&flags);
        run.wait_for_iterations(2);
        let domain = run.domain();
        run.signal(Signal::KILL);
        assert_eq!(run.wait(), None);
        assert_nothing_left(&domain);
        let config = run.path().join("config.toml");
        assert_eq!(precision(&config), expected, "it stands there from the beginning");
        run.resume(&[]);
        run.succeed();
        assert_eq!(run.digests(), calm.digests(), "{wanted}");
        assert_eq!(precision(&config), expected);
    }
}

#[test]
fn a_run_of_an_earlier_version_goes_on_with_what_it_was_trained_in() {
    for wanted in ["f32", "bf16"] {
        // Rates that do not fall over the budget: another one changes no bit.
        let precise = format!("--set=run.precision={wanted}");
        let flags = ["--workers=1", "--set=optimizer.schedule=constant", precise.as_str()];
        let mut calm = Run::train(&[&flags[..], &["--iterations=8"]].concat());
        calm.succeed();
        let mut run = Run::train(&[&flags[..], &["--iterations=5"]].concat());
        run.succeed();
        let config = run.path().join("config.toml");
        undecide(&config);
        run.resume(&["--iterations=8"]);
        run.succeed();
        assert_eq!(precision(&config), wanted);
        let said = format!("run.precision is now {wanted}");
        assert_eq!(run.log().matches(&said).count(), 1, "{}", run.log());
        assert_eq!(run.digests(), calm.digests(), "{wanted}");
    }
}

#[test]
fn an_earlier_run_without_a_checkpoint_starts_anew_as_the_processor_says_and_is_no_defect() {
    let other = if by_the_processor() == "f32" { "bf16" } else { "f32" };
    let flags = ["--workers=1", "--iterations=40", "--set=run.checkpoint_every=0"];
    let mut calm = Run::train(&flags);
    calm.succeed();
    let mut run = Run::train(&[&flags[..], &[&*format!("--set=run.precision={other}")]].concat());
    run.wait_for_iterations(2);
    run.signal(Signal::KILL);
    assert_eq!(run.wait(), None);
    let config = run.path().join("config.toml");
    undecide(&config);
    // Two runs of which nobody knows what they computed in: other digests are allowed.
    let paths = [run.path(), calm.path()].map(|path| path.display().to_string());
    let output = octopus(&["verify", &paths[0], &paths[1]]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("run.precision") && said.contains("not promised"), "{said}");
    assert!(!said.contains("defect"), "{said}");
    // It is not held to digests of another arithmetic.
    run.resume(&[]);
    run.succeed();
    assert!(run.log().contains("what it computed in before is not recorded"), "{}", run.log());
    assert_eq!(run.digests(), calm.digests());
    assert_eq!(precision(&config), by_the_processor());
}
