//! README and guide: their commands run, what is made from the code is current, links lead somewhere.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use tests::guide::{BUDGET, Block, Budget, Clone, blocks, documents, repository, run};
use tests::worked_example::{self, Example};
use tests::{crosscheck, python, reference, stderr};

/// Documents whose commands run, each in a test of its own; the others must have none.
macro_rules! commands_run {
    ($($test:ident: $document:literal,)*) => {
        $(#[test]
        fn $test() {
            run($document).expect("every command of the document works");
        })*

        const WITH_COMMANDS: &[&str] = &[$($document),*];
    };
}

commands_run! {
    the_readme_runs: "README.md",
    the_introduction_runs: "deploy/guide/src/README.md",
    first_training_runs: "deploy/guide/src/first-training.md",
    watching_runs: "deploy/guide/src/watching.md",
    experiments_run: "deploy/guide/src/experiments.md",
    configuration_runs: "deploy/guide/src/configuration.md",
    sweeps_run: "deploy/guide/src/sweeps.md",
    jobs_run: "deploy/guide/src/jobs.md",
    machines_run: "deploy/guide/src/machines.md",
    plans_run: "deploy/guide/src/plans.md",
    tasks_run: "deploy/guide/src/tasks.md",
    robots_run: "deploy/guide/src/robots.md",
    the_environment_runs: "deploy/guide/src/environment.md",
    a_policy_on_a_robot_runs: "deploy/guide/src/robot-controller.md",
    checkpoints_run: "deploy/guide/src/checkpoints.md",
    a_bucket_runs: "deploy/guide/src/bucket.md",
    exactness_runs: "deploy/guide/src/exactness.md",
    failures_run: "deploy/guide/src/failures.md",
    python_runs: "deploy/guide/src/python.md",
    speed_runs: "deploy/guide/src/speed.md",
}

#[test]
fn no_document_has_commands_that_are_not_run() {
    for document in documents().expect("a summary") {
        let text = std::fs::read_to_string(repository().join(&document)).expect(&document);
        let found = blocks(&text);
        let known = ["sh", "python", "text", "toml", "c", "rust"];
        for block in &found {
            assert!(known.contains(&block.language.as_str()), "{document}:{}", block.line);
        }
        let runs = found.iter().any(|block| ["sh", "python"].contains(&block.language.as_str()));
        assert_eq!(WITH_COMMANDS.contains(&document.as_str()), runs, "{document}");
    }
}

/// The check itself: a command that fails is found, with its place.
#[test]
fn a_document_with_a_wrong_command_fails() {
    let text = "Text.\n\n```sh\ntrue\n```\n\n```sh\noctopus train --no-such-flag\n```\n";
    let found = blocks(text);
    assert_eq!(found.iter().map(|block| block.line).collect::<Vec<_>>(), [3, 7]);
    let clone = Clone::new().expect("a directory");
    let path = "export PATH=\"$PWD/target/release:$PATH\"\n".to_owned();
    let first = Block { text: path, ..found[0].clone() };
    let output = clone.run(&[first, found[1].clone()]).expect("bash");
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("the block of line 7 failed"), "{}", stderr(&output));
}

/// A misspelt budget is refused: otherwise a short run would pass as a full one.
#[test]
fn a_budget_of_the_documents_that_is_not_known_is_refused() {
    assert_eq!(Budget::named("small").expect("known"), Budget::Small);
    assert_eq!(Budget::named("whole").expect("known"), Budget::Whole);
    let refused = Budget::named("all").expect_err("unknown").to_string();
    assert!(refused.contains(BUDGET) && refused.contains("small or whole"), "{refused}");
}

#[test]
fn the_reference_of_the_configuration_is_current() {
    let made = reference::page().expect("every key is documented");
    let path = reference::path();
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(made == found, "{} is not current: run `make guide`", path.display());
    // Spot checks, lest an empty page agrees with itself.
    for row in [
        "| `env.substep` | `0.016` |",
        "| 1e-5 to 0.4 |",
        "| `algorithm.dual_clip` | `0.0` |",
        "| `network.hidden` | `[256, 256, 256]`; `reorientation` `[128, 128]` |",
        "* `sin-cos`: Its sine and cosine",
    ] {
        assert!(found.contains(row), "{row} is not in\n{found}");
    }
}

#[test]
fn the_worked_example_is_current() {
    let (made, recorded) = (Example::compute().expect("computed"), Example::read().expect("read"));
    let distance = made.distance(&recorded).expect("the same numbers");
    assert!(distance < 2e-6, "off by {distance}: run `make guide`");
    let page = std::fs::read_to_string(worked_example::page_path()).expect("the page");
    assert!(page == recorded.page().expect("a page"), "the page is not current: run `make guide`");
    assert_eq!(made.observations[0], made.observations[1], "both agents of an arm see the same");
    assert_ne!(made.observations[0][..6], made.observations[2][..6], "arms see from their side");
}

/// Another implementation, in NumPy and written by what the guide says, finds what the program finds.
#[test]
fn the_guide_describes_what_agents_see() {
    let output = Command::new(python())
        .arg(crosscheck("environment.py"))
        .arg(repository())
        .output()
        .expect("Python can be started");
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn a_policy_in_numpy_takes_lists_and_batches_and_refuses_the_rest() {
    let output = Command::new(python())
        .arg(crosscheck("actor_inputs.py"))
        .arg(repository())
        .output()
        .expect("Python can be started");
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn readme_and_architecture_are_short() {
    for (document, most) in [("README.md", 900), ("ARCHITECTURE.md", 2000)] {
        let text = std::fs::read_to_string(repository().join(document)).expect(document);
        let words = text.split_whitespace().count();
        assert!(words <= most, "{document} has {words} words, at most {most} are wanted");
    }
}

/// Links between documents lead to files that are there, and to headings in them.
#[test]
fn links_lead_somewhere() {
    let mut all: BTreeSet<String> = documents().expect("a summary").into_iter().collect();
    let others = [
        "ARCHITECTURE.md",
        "BENCHMARKS.md",
        "CONTRIBUTING.md",
        "EXPERIMENTS.md",
        "deploy/README.md",
        "deploy/SERVICE.md",
        "deploy/policies/README.md",
        "deploy/guide/src/SUMMARY.md",
    ];
    all.extend(others.map(str::to_owned));
    let mut looked_at = 0;
    for document in all {
        let path = repository().join(&document);
        let text = std::fs::read_to_string(&path).expect(&document);
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if target.starts_with("http") {
                continue;
            }
            let (file, heading) = target.split_once('#').unwrap_or((target, ""));
            let to = if file.is_empty() {
                path.clone()
            } else {
                path.parent().unwrap_or(Path::new("/")).join(file)
            };
            assert!(to.exists(), "{document} links to {target}, which is not there");
            if !heading.is_empty() {
                let text = std::fs::read_to_string(&to).expect("a document");
                let found = text
                    .lines()
                    .filter(|line| line.starts_with('#'))
                    .any(|line| slug(line) == heading);
                assert!(found, "{document} links to {target}, which has no such heading");
            }
            looked_at += 1;
        }
    }
    assert!(looked_at > 50, "only {looked_at} links");
}

/// What a heading is called in a link.
fn slug(heading: &str) -> String {
    let title = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = title.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}
