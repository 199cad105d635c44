//! The other algorithms keep the promises, too.

use rustix::process::Signal;
use tests::{Run, assert_nothing_left, octopus, stderr};

/// Flags of a run with `algorithm`, and `more` of them.
fn flags(algorithm: &str, workers: &str, overlap: &str, more: &[&str]) -> Vec<String> {
    ["--iterations=40".to_owned()]
        .into_iter()
        .chain([format!("--algorithm={algorithm}"), format!("--workers={workers}")])
        .chain([format!("--overlap={overlap}")])
        .chain(more.iter().map(|&flag| flag.to_owned()))
        .collect()
}

fn start(flags: &[String]) -> Run {
    Run::train(&flags.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Learns what it learns with any number of workers and through a stop; its policy can be evaluated,
/// and what it did can be repeated.
fn keeps_the_promises(algorithm: &str, more: &[&str]) {
    for overlap in ["0", "1"] {
        let mut calm = start(&flags(algorithm, "1", overlap, more));
        calm.succeed();
        let expected = calm.digests();
        assert_eq!(expected.len(), 40);
        assert_ne!(expected[38], expected[39], "training moves the parameters");
        let metrics = calm.metrics();
        let returns = metrics[0]["returns"].as_array().map(Vec::len);
        assert_eq!(returns, Some(8), "one return an agent, whatever the number of actors");
        let norm = metrics[39]["actor_grad_norm"].as_f64();
        assert!(norm.is_some_and(|norm| norm > 0.0), "{norm:?}: actors learn");
        let path = calm.path();
        let config = std::fs::read_to_string(path.join("config.toml")).expect("a configuration");
        assert!(config.contains(&format!("name = \"{algorithm}\"")), "{config}");

        let mut run = start(&flags(algorithm, "3", overlap, more));
        run.wait_for_iterations(4);
        let domain = run.domain();
        run.signal(Signal::INT);
        run.succeed();
        assert_nothing_left(&domain);
        let done = run.digests().len();
        assert!((4..40).contains(&done), "stopped after {done} iterations");
        run.resume(&["--workers=2"]);
        run.succeed();
        assert_eq!(run.digests(), expected, "{algorithm}, overlap {overlap}, stopped after {done}");

        let path = path.to_str().expect("UTF-8");
        let commands: [&[&str]; 3] = [
            &["eval", path, "--episodes=4", "--steps=8"],
            &["verify", path, "--replay", "2"],
            &["checkpoints", "verify", path],
        ];
        for command in commands {
            let output = octopus(command);
            assert!(output.status.success(), "{command:?}: {}", stderr(&output));
        }
    }
}

#[test]
fn centralised_ppo() {
    keeps_the_promises("ppo", &[]);
}

#[test]
fn independent_ppo() {
    keeps_the_promises("ippo", &[]);
}

/// Of 128 env-steps an iteration come six updates, from the second one on; the ring of fifty episodes
/// goes round several times.
#[test]
fn deterministic_actors_with_a_replay() {
    keeps_the_promises(
        "maddpg",
        &[
            "--set=algorithm.maddpg.learning_starts=128",
            "--set=algorithm.maddpg.updates_per_step=0.05",
            "--set=algorithm.maddpg.batch_size=64",
            "--set=algorithm.maddpg.replay_steps=400",
        ],
    );
}
