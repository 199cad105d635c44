//! The module for Python, as its wheel installs it: against blocks of workers, `octopus` itself, the checkers of PettingZoo and
//! Gymnasium, and what a person may do wrong.

use std::process::Command;

use proto::config::{Layers, Preset, TaskName};
use proto::layout::{BlockLayout, Dimensions};
use serde_json::{Value, json};
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout};
use tests::guide::repository;
use tests::wheel::{self, succeeds};

/// Python with the wheel, and with nothing of this process's surroundings.
fn python() -> Command {
    let mut command = Command::new(wheel::python());
    command.env_remove("PYTHONPATH").arg("-I");
    command
}

/// Runs a script of `tests/crosscheck` with the wheel.
fn script(name: &str) -> Command {
    let mut command = python();
    command.args(["-W", "error"]).arg(tests::crosscheck(name));
    command
}

#[test]
fn the_wheel_needs_neither_libtorch_nor_pythons_own_library() {
    let place = "import spaceoctopus._native as native; print(native.__file__)";
    let output = succeeds(python().args(["-c", place]));
    let file = String::from_utf8(output.stdout).expect("a path");
    let needed = succeeds(Command::new("readelf").args(["--dynamic", file.trim()]));
    let needed = String::from_utf8_lossy(&needed.stdout).into_owned();
    let libraries = needed.lines().filter(|line| line.contains("(NEEDED)"));
    let foreign: Vec<&str> = libraries
        .filter(|line| {
            !["libc.", "libm.", "libgcc_s.", "libpthread.", "ld-linux"]
                .iter()
                .any(|name| line.contains(name))
        })
        .collect();
    assert!(foreign.is_empty(), "{foreign:?}");
}

/// Steps of the blocks that are compared.
const STEPS: usize = 6;

#[test]
fn the_same_seed_and_address_make_the_bits_of_a_workers_block() {
    for (preset, task, n_envs, n_shards) in [
        (Preset::Tuned, TaskName::Trajectory, 80, 2),
        (Preset::Release, TaskName::Trajectory, 7, 1),
        (Preset::Paper, TaskName::Reorientation, 40, 2),
    ] {
        let layers = Layers::new(preset, Some(task));
        let sets = [
            format!("env.n_envs={n_envs}"),
            format!("env.n_shards={n_shards}"),
            format!("task.episode_steps={STEPS}"),
            "network.hidden=[16]".to_owned(),
        ];
        let layers = sets.iter().fold(layers, |layers, set| layers.set(set).expect("a setting"));
        let config = layers.resolve().expect("a configuration");
        let world = World::new(&config, &Robot::builtin("paper").expect("built in"));
        let parameters = initial_parameters(&config, &world.dimensions, 3);
        let policy = world.policy(&parameters).expect("a policy");
        let (seed, iteration, shard) = (11, 4, n_shards as u32 - 1);
        let spec = RolloutSpec { seed, iteration, shard, policy: &policy };
        let layout = BlockLayout::new(&world.dimensions);
        let mut block = vec![0.0_f32; layout.len];
        rollout(&world, &spec, &mut block, &mut |_| {}).expect("a block");

        let dir = tempfile::tempdir().expect("a directory");
        let bytes: Vec<u8> = block.iter().flat_map(|x| x.to_le_bytes()).collect();
        std::fs::write(dir.path().join("block"), bytes).expect("written");
        std::fs::write(dir.path().join("config.toml"), config.to_toml()).expect("written");
        let Dimensions { n_agents, n_steps, n_envs, observation, state, .. } = world.dimensions;
        let question = json!({
            "seed": seed, "iteration": iteration, "first": shard as usize * n_envs,
            "agents": n_agents, "steps": n_steps, "envs": n_envs, "observation": observation, "state": state,
            "at": {
                "observation": layout.observation.start, "state": layout.state.start,
                "action": layout.action.start, "reward": layout.reward.start,
                "truncated": layout.truncated.start,
            },
        });
        succeeds(script("python_block.py").arg(dir.path()).arg(question.to_string()));
    }
}

#[test]
fn the_checkers_of_pettingzoo_and_gymnasium_pass() {
    succeeds(&mut script("python_checkers.py"));
}

#[test]
fn a_policy_plays_as_octopus_eval_does() {
    for task in ["trajectory", "reorientation"] {
        let checkpoint = repository().join("deploy/policies").join(task);
        let given = checkpoint.to_str().expect("a path");
        let options = ["--episodes=35", "--steps=12", "--seed=5", "--json"];
        let output = tests::octopus(&[&["eval", given], &options[..]].concat());
        assert!(output.status.success(), "{}", tests::stderr(&output));
        let expected: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("expected.json");
        std::fs::write(&path, &output.stdout).expect("written");
        succeeds(script("python_policy.py").arg(&checkpoint).arg(&path));
        assert_eq!(expected["episodes"].as_array().map(Vec::len), Some(35));
    }
}

#[test]
fn commands_in_open_loop_lead_where_octopus_simulate_does() {
    let dir = tempfile::tempdir().expect("a directory");
    let rows = (0..20).map(|row| {
        let numbers = (0..24).map(|joint| format!("{:.6}", 0.5 * f64::from(row * 7 + joint).sin()));
        numbers.collect::<Vec<_>>().join(",")
    });
    let (actions, out) = (dir.path().join("in.csv"), dir.path().join("out.csv"));
    std::fs::write(&actions, rows.collect::<Vec<_>>().join("\n")).expect("written");
    let [from, to] = [&actions, &out].map(|path| path.to_str().expect("a path"));
    for precision in ["f32", "f64"] {
        let output = tests::octopus(&[
            "simulate",
            "--robot=release",
            "--force",
            "--precision",
            precision,
            "--actions",
            from,
            "--out",
            to,
        ]);
        assert!(output.status.success(), "{}", tests::stderr(&output));
        succeeds(script("python_simulate.py").args([from, to, precision]));
    }
}

#[test]
fn what_a_person_may_do_wrong_is_told_and_nothing_is_lost() {
    succeeds(script("python_bad_input.py").arg(repository()));
}

/// The words are those of the command line.
#[test]
fn configurations_are_refused_in_the_words_of_octopus_train() {
    for set in [
        "algorithm.gama=0.9",
        "env.n_envs=-1",
        "network.hidden=oops",
        "task.name=walk",
        "nonsense",
        "env.substep=0.3",
    ] {
        let train = tests::octopus(&["train", "--dry-run", "--set", set]);
        let said = tests::stderr(&train);
        let code = "import spaceoctopus, sys\ntry: spaceoctopus.Config(set=[sys.argv[1]])\nexcept ValueError as error: print(error)";
        let output = succeeds(python().args(["-c", code, set]));
        let ours = String::from_utf8(output.stdout).expect("text");
        let flat = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(!ours.trim().is_empty(), "--set {set} is refused");
        // An assignment without `=` is refused by the command line's reader, with the same reason.
        let ours = flat(&ours);
        let reason =
            ours.rsplit_once("--set nonsense: ").map_or(ours.as_str(), |(_, reason)| reason);
        assert!(flat(&said).contains(reason), "--set {set}\noctopus: {said}\nspaceoctopus: {ours}");
    }
}

#[test]
fn stubs_say_what_the_module_has() {
    let mut command = python();
    command.args(["-m", "mypy.stubtest", "spaceoctopus"]);
    let dir = tempfile::tempdir().expect("a directory");
    succeeds(command.current_dir(dir.path()));
    let example = dir.path().join("example.py");
    std::fs::copy(tests::crosscheck("python_typed.py"), &example).expect("copied");
    let mut command = python();
    command.args(["-m", "mypy", "--strict", "--cache-dir"]).arg(dir.path().join("cache"));
    succeeds(command.arg(&example).current_dir(dir.path()));
    succeeds(python().arg(&example).current_dir(dir.path()));
}
