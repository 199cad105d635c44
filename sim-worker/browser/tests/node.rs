//! The module, run by Node, against the native program: every state of whole episodes, to the bit.
//!
//! It needs a module (`cargo build --release -p browser --target wasm32-unknown-unknown`) and a Node: `SPACEOCTOPUS_NODE`, that of
//! `deploy/setup.py page`, or `node`. Where one of them is missing the test says so and ends; with `SPACEOCTOPUS_WASM` it must run.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use proto::config::Config;
use proto::layout::ActorLayout;
use simulator::experiment::{
    Control, Effect, Episode, Event, Member, Script, SensorNoise, Start, TimedEvent,
};
use simulator::policy::{file, initial_parameters};
use simulator::robot::Robot;
use simulator::rollout::World;

/// Control steps of an episode, as evaluations have.
const STEPS: usize = 200;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn module() -> Option<PathBuf> {
    if let Some(given) = env::var_os("SPACEOCTOPUS_WASM") {
        let given = PathBuf::from(given);
        assert!(given.is_file(), "{} is no file", given.display());
        return Some(given);
    }
    let target =
        env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    let path = target.join("wasm32-unknown-unknown/release/browser.wasm");
    path.is_file().then_some(path)
}

fn node() -> Option<PathBuf> {
    let starts = |node: &Path| Command::new(node).arg("--version").output().is_ok();
    let own = root().join(".node/bin/node");
    let given = env::var_os("SPACEOCTOPUS_NODE").map(PathBuf::from);
    given.into_iter().chain([own, PathBuf::from("node")]).find(|node| starts(node))
}

/// A policy in a directory of its own, for both sides.
struct Files {
    directory: PathBuf,
    member: Arc<Member>,
}

/// The directory that the tests write to.
fn scratch(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&path).expect("a directory of this test");
    path
}

/// What comes with the program.
fn delivered(task: &str) -> Files {
    let directory = root().join("deploy/policies").join(task);
    read(directory)
}

/// An untrained policy of large actions on the configuration of a delivered one, in the small form.
fn untrained(task: &str, seed: u64) -> Files {
    let of = root().join("deploy/policies").join(task);
    let text = |name: &str| fs::read_to_string(of.join(name)).expect("a delivered policy");
    let mut config =
        Config::from_resolved_toml(&text("config.toml"), "config.toml").expect("valid");
    // Large actions, so that arms touch.
    config.network.head_gain = 3.0;
    config.run.seed = seed;
    let robot = Robot::from_toml(&text("robot.toml"), Path::new("robot.toml")).expect("valid");
    let world = World::new(&config, &robot);
    let parameters = initial_parameters(&config, &world.dimensions, seed);
    let directory = scratch(&format!("untrained-{task}-{seed}"));
    let write = |name: &str, bytes: &[u8]| fs::write(directory.join(name), bytes).expect("written");
    write("config.toml", config.to_toml().as_bytes());
    write("robot.toml", robot.to_toml().as_bytes());
    write("policy.safetensors", &file::compact(&config, &world.dimensions, &parameters));
    read(directory)
}

fn read(directory: PathBuf) -> Files {
    let text = |name: &str| fs::read_to_string(directory.join(name)).expect("a policy");
    let config = Config::from_resolved_toml(&text("config.toml"), "config.toml").expect("valid");
    let robot = Robot::from_toml(&text("robot.toml"), Path::new("robot.toml")).expect("valid");
    let world = World::new(&config, &robot);
    let bytes = fs::read(directory.join("policy.safetensors")).expect("a policy");
    let layout = ActorLayout::new(&config, &world.dimensions);
    let policy = world.policy(&file::read(&bytes, &layout).expect("actors")).expect("a policy");
    Files { directory, member: Arc::new(Member { world, policy }) }
}

/// Every state of a script, native, and milliseconds a step.
fn natively(files: &[Files], script: &Script) -> (Vec<u32>, f64) {
    let members = files.iter().map(|files| Arc::clone(&files.member)).collect();
    let mut episode = Episode::new(members, Start::default()).expect("an episode");
    let mut states = Vec::new();
    let since = Instant::now();
    episode
        .play(script, &mut |episode| {
            states.extend(episode.state().parts().into_iter().flatten().map(|x| x.to_bits()));
        })
        .expect("it plays");
    (states, since.elapsed().as_secs_f64() * 1e3 / script.steps as f64)
}

/// Plays a script on both sides and compares; `what` is for messages.
#[expect(clippy::print_stderr, reason = "a test says what it does not try, and what a step takes")]
fn compare(what: &str, files: &[Files], script: &Script) {
    let (Some(module), Some(node)) = (module(), node()) else {
        eprintln!("{what}: not compared, there is no module or no Node");
        return;
    };
    let path = scratch("scripts").join(format!("{}.json", what.replace(' ', "-")));
    fs::write(&path, serde_json::to_vec(script).expect("plain data")).expect("written");
    let directories: Vec<&str> =
        files.iter().map(|files| files.directory.to_str().expect("UTF-8")).collect();
    let output = Command::new(node)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/module.mjs"))
        .args([&module, Path::new(&directories.join(",")), &path])
        .output()
        .expect("Node starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what}: {said}");
    let bits = output.stdout.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes));
    let theirs: Vec<u32> = bits.collect();
    let (ours, native_ms) = natively(files, script);
    assert_eq!(theirs.len(), ours.len(), "{what}");
    let width = ours.len() / (script.steps + 1);
    let first = ours.iter().zip(&theirs).position(|(a, b)| a != b);
    assert_eq!(first.map(|at| (at / width, at % width)), None, "{what}: step, number of the state");
    assert_ne!(ours[..width], ours[width * script.steps..], "{what}: the robot moves");
    eprintln!("{what}: native {native_ms:.2} ms a step; {}", said.trim());
}

fn plain(episode: u32) -> Script {
    let start = Start { seed: 11, episode, ..Start::default() };
    Script { start, steps: STEPS, events: Vec::new() }
}

#[test]
fn whole_episodes_of_three_policies_of_both_tasks_have_the_native_bits() {
    for task in ["trajectory", "reorientation"] {
        let policies = [delivered(task), untrained(task, 1), untrained(task, 2)];
        for (index, files) in policies.into_iter().enumerate() {
            compare(&format!("{task} {index}"), &[files], &plain(index as u32));
        }
    }
}

#[test]
fn an_episode_that_someone_takes_hold_of_has_the_native_bits() {
    let files = [delivered("trajectory"), delivered("reorientation")];
    let timed = |step, event| TimedEvent { step, event };
    let push = |body, steps| Event::Effect {
        effect: Effect::Wrench {
            body,
            point: [0.05, 0.02, -0.1],
            force: [31.7, -12.9, 8.3],
            torque: [0.3, 1.7, -2.1],
        },
        steps: Some(steps),
    };
    let noise = SensorNoise { position: 0.003, angle: 0.004, velocity: 0.01, rate: 0.01 };
    let events = vec![
        timed(10, Event::HandGoal { arm: 0, pose: [0.31, 1.27, 4.3, 0.1, 0.2, -0.1] }),
        timed(20, push(0, 3)),
        timed(30, push(9, 5)),
        timed(40, Event::Arm { arm: 1, control: Control::Limp }),
        timed(60, Event::Arm { arm: 1, control: Control::Policy(1) }),
        timed(70, Event::Arm { arm: 2, control: Control::Hold }),
        timed(80, Event::BaseMass { mass: 271.3 }),
        timed(90, Event::Delay { steps: 1 }),
        timed(100, Event::Sensors(noise)),
        timed(110, Event::Effect { effect: Effect::JointTorque { std: 3.1 }, steps: Some(20) }),
        timed(120, Event::BaseGoal { attitude: [0.07, -0.05, 0.11] }),
        timed(150, Event::Delay { steps: 0 }),
    ];
    compare("taken hold of", &files, &Script { events, ..plain(4) });
}
