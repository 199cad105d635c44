//! Exported policies: ONNX Runtime and compiled C do what the simulator does.

use std::path::{Path, PathBuf};
use std::process::Command;

use proto::config::{Preset, TaskName};
use simulator::evaluate::Course;
use simulator::robot::Robot;
use simulator::task::Aim;
use tests::controllers::{Compared, Controlled, OnnxDriver, compile};
use tests::guide::repository;
use tests::{Run, crosscheck, octopus, python, stderr};

/// Says that everything is to be tried at its full length: thirty episodes with every policy, of 200 steps with those that
/// are trained.
const WHOLE: &str = "SPACEOCTOPUS_CONTROLLERS";

fn whole() -> bool {
    std::env::var_os(WHOLE).is_some()
}

fn shipped(task: TaskName) -> Controlled {
    let dir = repository().join("deploy/policies").join(task.as_str());
    Controlled::of_checkpoint(&dir).expect("it ships")
}

/// A robot of a file that ships, whose text is changed.
fn robot(file: &str, change: impl FnOnce(&str) -> String) -> Robot {
    let path = repository().join("sim-worker/simulator/robots").join(file);
    let text = std::fs::read_to_string(&path).expect("it is there");
    Robot::from_toml(&change(&text), &path).expect("valid")
}

/// Takes the last link of all UR5 arms, which leaves them five joints: three at the shoulder, two at the wrist.
fn shortened(text: &str) -> String {
    let link = text.find("[[links]]\nname = \"wrist_3\"").expect("the last link");
    let behind = link + text[link..].find("[tool]").expect("the hand behind it");
    let text = text[..link].to_owned() + &text[behind..];
    let homes = ["-1.57, 0.0, 3.14]", "-1.57, 0.0, 0.0]"];
    assert!(homes.iter().all(|home| text.contains(home)), "homes");
    homes.iter().fold(text, |text, home| text.replace(home, "-1.57, 0.0]"))
}

/// Robots whose arms are of several types, or have other than six joints.
fn other_arms() -> [Robot; 3] {
    [
        robot("seven-joints.toml", str::to_owned),
        robot("seven-joints.toml", shortened),
        robot("two-arm.toml", shortened),
    ]
}

/// Whatever can be trained, in small: odd widths, so that pairs are left over, and all kinds of layouts, layers, tasks and robots.
fn untrained() -> Vec<Controlled> {
    let two_arms = robot("two-arm.toml", str::to_owned);
    let others = other_arms();
    let paper = Robot::builtin("paper").expect("built in");
    let release = Robot::builtin("release").expect("built in");
    let mut all = Vec::new();
    for (preset, robot) in
        [(Preset::Tuned, &paper), (Preset::Paper, &paper), (Preset::Release, &release)]
    {
        for task in [TaskName::Trajectory, TaskName::Reorientation] {
            for algorithm in ["mappo", "maddpg", "ppo"] {
                let name = format!("algorithm.name={algorithm}");
                all.push((preset, task, vec![name], robot));
            }
        }
    }
    for (settings, robot) in [
        (vec!["task.joint_angles=unwound", "network.activation=tanh"], &two_arms),
        (vec!["network.layer_norm=true", "network.input_norm=layer_norm"], &two_arms),
        (vec!["network.input_norm=none", "network.inference=f32"], &release),
        (vec!["network.squash_mean=false", "network.activation=relu"], &paper),
    ] {
        for preset in [Preset::Tuned, Preset::Release] {
            let settings = settings.iter().map(|&setting| setting.to_owned()).collect();
            all.push((preset, TaskName::Trajectory, settings, robot));
        }
    }
    // What moves, goals of hands and base side by side, and other arms.
    for (task, settings, robot) in [
        (TaskName::Capture, "algorithm.name=mappo", &paper),
        (TaskName::Mixed, "algorithm.name=mappo", &paper),
        (TaskName::Capture, "algorithm.name=ppo", &two_arms),
        (TaskName::Mixed, "task.joint_angles=unwound", &two_arms),
        (TaskName::Mixed, "algorithm.name=ppo", &others[0]),
        (TaskName::Capture, "algorithm.name=maddpg", &others[1]),
        (TaskName::Trajectory, "task.joint_angles=unwound", &others[2]),
        (TaskName::Reorientation, "algorithm.name=ippo", &others[1]),
    ] {
        all.push((Preset::Tuned, task, vec![settings.to_owned()], robot));
    }
    for (preset, robot) in [
        (Preset::Paper, &others[0]),
        (Preset::Release, &others[0]),
        (Preset::Release, &others[2]),
        (Preset::Paper, &others[1]),
    ] {
        for task in [TaskName::Trajectory, TaskName::Reorientation] {
            all.push((preset, task, Vec::new(), robot));
        }
    }
    let made = all.into_iter().map(|(preset, task, mut settings, robot)| {
        settings.push("network.hidden=[24, 17, 15]".to_owned());
        let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
        Controlled::untrained(preset, task, &settings, robot).expect("a policy")
    });
    made.collect()
}

/// Runs the directory's own `check.c`, compiled with these flags.
pub(crate) fn check_c(dir: &Path, flags: &[&str]) {
    let program = compile(dir, &dir.join("check.c"), flags).expect("it compiles");
    let output = Command::new(program).arg(dir.join("vectors.json")).output().expect("it starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
    assert!(output.status.success(), "{} {flags:?}: {said}", dir.display());
    assert!(said.starts_with("256 states, 0 with other bits"), "{said}");
}

/// A file that was cut off has not been checked.
fn refuse_part_of_vectors(dir: &Path) {
    let program = compile(dir, &dir.join("check.c"), &["-O1"]).expect("it compiles");
    let whole = std::fs::read(dir.join("vectors.json")).expect("vectors");
    let cut = dir.join("cut.json");
    std::fs::write(&cut, &whole[..whole.len() / 2]).expect("writable");
    let output = Command::new(program).arg(&cut).output().expect("it starts");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("of 256 states"), "{}", stderr(&output));
    std::fs::remove_file(cut).expect("it was there");
}

/// Has ONNX look at the directories' models, and runs their own `check.py`.
pub(crate) fn check_onnx(dirs: &[PathBuf]) {
    let output = Command::new(python())
        .arg(crosscheck("controllers.py"))
        .arg("check")
        .args(dirs)
        .output()
        .expect("Python can be started");
    assert!(output.status.success(), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(said.matches("256 states: ").count(), dirs.len(), "{said}");
}

/// Mean of the errors that the task is about: (position, orientation) of the hands, (base), or all three.
fn means(courses: &[Course], world: &simulator::rollout::World) -> Vec<f64> {
    let group = 2 * world.dimensions.n_arms + 1;
    let of = |choose: &dyn Fn(usize) -> bool| {
        let chosen = courses.iter().enumerate().filter(|(index, _)| choose(index % group));
        let tails: Vec<f64> = chosen.map(|(_, course)| f64::from(course.tail)).collect();
        tails.iter().sum::<f64>() / tails.len() as f64
    };
    let is_hand = |i: usize| i + 1 < group && world.task.aims[i / 2] == Aim::Hand;
    let mut means = Vec::new();
    if world.config.task.name.reaches() {
        means.extend([0, 1].map(|kind| of(&|i| is_hand(i) && i % 2 == kind)));
    }
    if world.config.task.name.turns() {
        means.push(of(&|i| i + 1 == group));
    }
    means
}

/// What ONNX Runtime may be off from the C code in a step of an episode (rad/s): what exports allow where networks infer in bfloat16.
const APART: f64 = 2e-3;

/// Held-out episodes go the same way by C, to the bit. ONNX Runtime commands the same in each of their steps, but for its sums.
fn drive(controlled: &Controlled, dir: &Path, episodes: usize, steps: usize) -> Vec<Course> {
    let name = format!("{} on {}", controlled.name, controlled.world.robot.name);
    let native = controlled.native_errors(episodes, steps).expect("episodes");
    let mut driver = Compared::new(dir, episodes).expect("drivers");
    let by_c = controlled.driven_errors(&mut driver, episodes, steps).expect("episodes");
    assert!(by_c == native, "{name}: C ends elsewhere");
    let Compared { apart, .. } = driver;
    assert!(apart <= APART, "{name}: ONNX Runtime is off by {apart} rad/s");
    native
}

/// [`drive`], and with ONNX Runtime at the wheel they end the same within 5 %.
fn drive_both(controlled: &Controlled, dir: &Path, episodes: usize, steps: usize) {
    let name = &controlled.name;
    let native = drive(controlled, dir, episodes, steps);
    let mut driver = OnnxDriver::new(dir, episodes).expect("a driver");
    let by_onnx = controlled.driven_errors(&mut driver, episodes, steps).expect("episodes");
    let (wanted, found) = (means(&native, &controlled.world), means(&by_onnx, &controlled.world));
    for (wanted, found) in wanted.iter().zip(&found) {
        assert!((wanted - found).abs() <= 0.05 * wanted, "{name}: {found}, natively {wanted}");
    }
}

#[test]
fn shipped_policies_do_outside_what_they_do_here() {
    let (episodes, steps) = if whole() { (30, 200) } else { (6, 100) };
    let place = tempfile::tempdir().expect("tempdir");
    let mut dirs = Vec::new();
    for task in [TaskName::Trajectory, TaskName::Reorientation] {
        let controlled = shipped(task);
        let dir = place.path().join(task.as_str());
        controlled.export(&dir).expect("an export");
        check_c(&dir, &["-O2"]);
        // As compilers do unless they are told otherwise: GCC contracts products and sums then.
        check_c(&dir, &["-std=gnu17", "-O3", "-march=native"]);
        refuse_part_of_vectors(&dir);
        drive_both(&controlled, &dir, episodes, steps);
        // Trained, it brings hands near: 20 mm on average after 40 s, from 300 mm.
        let errors =
            means(&controlled.native_errors(episodes, steps).expect("episodes"), &controlled.world);
        assert!(errors.iter().all(|error| *error < 0.05), "{errors:?}");
        dirs.push(dir);
    }
    check_onnx(&dirs);
}

#[test]
fn whatever_can_be_trained_can_be_exported() {
    // Policies that have learned nothing push the robot away from its goals, which the C code refuses in the end.
    let (episodes, steps) = if whole() { (30, 60) } else { (2, 12) };
    let place = tempfile::tempdir().expect("tempdir");
    let mut dirs = Vec::new();
    for (index, controlled) in untrained().iter().enumerate() {
        let dir = place.path().join(index.to_string());
        controlled.export(&dir).expect("an export");
        check_c(&dir, &["-O1"]);
        let Controlled { world, .. } = controlled;
        let is_plain = world.robot.joints.by_arm().all(|joints| joints == 6)
            && matches!(world.task.name, TaskName::Trajectory | TaskName::Reorientation);
        if whole() || !is_plain || index % 6 == 0 {
            drive_both(controlled, &dir, episodes, steps);
        }
        dirs.push(dir);
    }
    assert!(dirs.len() > 20);
    check_onnx(&dirs);
}

/// A run that has just trained, one of its checkpoints by selector, and arms of two runs that were put together.
#[test]
fn what_was_trained_or_put_together_is_exported() {
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    let train = |seed: &str| {
        let mut run =
            Run::train(&["--iterations=4", "--set=run.checkpoint_every=2", "--workers=1", seed]);
        run.succeed();
        run
    };
    let (first, second) = (train("--set=run.seed=1"), train("--set=run.seed=2"));
    let [a, b] = [&first, &second].map(|run| run.path().display().to_string());
    let team = at("team");
    let arms = [format!("1,2={a}"), format!("3,4={b}")];
    let words = ["checkpoints", "compose", "--arm", &arms[0], "--arm", &arms[1], "--out", &team];
    let composed = octopus(&words);
    assert!(composed.status.success(), "{}", stderr(&composed));
    let mut dirs = Vec::new();
    let mut digests = std::collections::BTreeSet::new();
    for (name, source) in [("run", &a), ("earlier", &format!("{a}:2")), ("composed", &team)] {
        let out = at(name);
        let made = octopus(&["export", source, "--out", &out, "--episodes=2", "--json"]);
        assert!(made.status.success(), "{source}: {}", stderr(&made));
        let report: serde_json::Value = serde_json::from_slice(&made.stdout).expect("JSON");
        digests.insert(report["policy"]["digest"].as_str().expect("a digest").to_owned());
        check_c(Path::new(&out), &["-O1"]);
        dirs.push(PathBuf::from(out));
    }
    assert_eq!(digests.len(), 3, "{digests:?}");
    check_onnx(&dirs);
    let (episodes, steps) = if whole() { (30, 60) } else { (2, 12) };
    let team = Controlled::of_checkpoint(Path::new(&team)).expect("read");
    drive_both(&team, &dirs[2], episodes, steps);
}

/// What is wrong with a state or a goal is said by a number, and the joints hold.
#[test]
fn the_c_code_refuses_what_it_cannot_act_on() {
    let place = tempfile::tempdir().expect("tempdir");
    let two_arms = robot("two-arm.toml", str::to_owned);
    let hidden = ["network.hidden=[24, 17, 15]"];
    let mixed = Controlled::untrained(Preset::Guided, TaskName::Mixed, &hidden, &two_arms);
    let all = [shipped(TaskName::Trajectory), mixed.expect("a policy")];
    let sanitized = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    for (index, controlled) in all.iter().enumerate() {
        let dir = place.path().join(index.to_string());
        controlled.export(&dir).expect("an export");
        check_c(&dir, &sanitized);
        for (program, said) in [
            (crosscheck("controller_refusals.c"), "all as it should be\n"),
            (dir.join("example.c"), "  0.0 s: fastest joint"),
        ] {
            let program = compile(&dir, &program, &sanitized).expect("it compiles");
            let output = Command::new(program).output().expect("it starts");
            let found = String::from_utf8_lossy(&output.stdout).into_owned();
            let as_wanted = output.status.success() && found.starts_with(said);
            assert!(as_wanted, "{}: {found}{}", controlled.name, stderr(&output));
        }
    }
}

#[test]
fn an_export_is_whole_or_absent_and_leaves_what_is_there() {
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    let policy = repository().join("deploy/policies/trajectory").display().to_string();
    let out = at("controller");
    let made = octopus(&["export", &policy, "--out", &out, "--episodes=2", "--json"]);
    assert!(made.status.success(), "{}", stderr(&made));
    let report: serde_json::Value = serde_json::from_slice(&made.stdout).expect("JSON");
    let digest = report["policy"]["digest"].as_str().expect("a digest");
    for file in report["files"].as_array().expect("files") {
        let name = file["name"].as_str().expect("a name");
        let there = place.path().join("controller").join(name).metadata().expect(name);
        assert_eq!(there.len(), file["bytes"].as_u64().expect("a size"), "{name}");
    }
    let contract = std::fs::read_to_string(place.path().join("controller/contract.toml"));
    let contract: toml::Table = contract.expect("there").parse().expect("TOML");
    assert_eq!(contract["trained"]["digest"].as_str(), Some(digest));
    assert_eq!(contract["controller"]["control_period_s"].as_float(), Some(0.4));
    assert_eq!(contract["input"].as_array().map(Vec::len), Some(9));
    assert_eq!(contract["held_out"]["episodes"].as_integer(), Some(2));
    let limits = contract["output"][0]["ranges"].as_array().expect("ranges");
    assert_eq!(limits[0][1].as_float(), Some(2.0942 * 0.8));

    // As long as the export of before stays, it stays as it is.
    let before = std::fs::read(place.path().join("controller/controller.c")).expect("there");
    for (args, code, said) in [
        (vec![policy.as_str(), "--out", &out], 5, "is there already"),
        (vec![&policy, "--out", &policy], 5, "is there already"),
        (vec![&policy, "--out", &format!("{policy}/inside")], 5, "which is a checkpoint"),
        (vec![&policy, "--out", &at("none/inside")], 1, "cannot be written"),
        (vec![&at("nothing"), "--out", &at("new")], 5, "nothing"),
        (vec![&policy], 2, "--out"),
        (vec![&policy, "--out", &at("new"), "--episodes", "0"], 2, "whole number"),
    ] {
        let args: Vec<&str> = std::iter::once("export").chain(args).collect();
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{args:?}: {}", stderr(&refused));
    }
    assert!(std::fs::read(place.path().join("controller/controller.c")).expect("there") == before);
    let left: Vec<_> = std::fs::read_dir(place.path()).expect("read").flatten().collect();
    assert_eq!(left.len(), 1, "{left:?}");
}

/// What is changed, by what, and what is said of it.
type Change<'a> = (&'a str, &'a dyn Fn(&Path), &'a str);

/// A checkpoint of another version, without a policy, damaged, or with a robot that its policy does not fit.
#[test]
fn a_checkpoint_that_is_no_whole_policy_is_refused_in_words() {
    let place = tempfile::tempdir().expect("tempdir");
    let shipped = repository().join("deploy/policies/trajectory");
    let two_arms = repository().join("sim-worker/simulator/robots/two-arm.toml");
    let two_arms = std::fs::read_to_string(two_arms).expect("it is there");
    let changes: [Change<'_>; 4] = [
        (
            "version",
            &|dir| {
                let path = dir.join("manifest.json");
                let text = std::fs::read_to_string(&path).expect("read");
                let mut manifest: serde_json::Value = serde_json::from_str(&text).expect("JSON");
                manifest["format"] = 99.into();
                std::fs::write(path, manifest.to_string()).expect("written");
            },
            "format 99",
        ),
        (
            "policy",
            &|dir| std::fs::remove_file(dir.join("policy.safetensors")).expect("gone"),
            "policy.safetensors",
        ),
        (
            "damage",
            &|dir| {
                let path = dir.join("policy.safetensors");
                let mut bytes = std::fs::read(&path).expect("read");
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
                std::fs::write(path, bytes).expect("written");
            },
            "differs from its BLAKE3 hash",
        ),
        (
            "robot",
            &|dir| {
                std::fs::write(dir.join("robot.toml"), &two_arms).expect("written");
                let path = dir.join("manifest.json");
                let text = std::fs::read_to_string(&path).expect("read");
                let mut manifest: serde_json::Value = serde_json::from_str(&text).expect("JSON");
                let entry = &mut manifest["files"]["robot.toml"];
                entry["len"] = two_arms.len().into();
                entry["blake3"] = blake3::hash(two_arms.as_bytes()).to_hex().to_string().into();
                std::fs::write(path, manifest.to_string()).expect("written");
            },
            "the configuration wants F32 [4, 62]",
        ),
    ];
    for (name, change, said) in changes {
        let dir = place.path().join(name);
        std::fs::create_dir(&dir).expect("made");
        for entry in std::fs::read_dir(&shipped).expect("read").flatten() {
            std::fs::copy(entry.path(), dir.join(entry.file_name())).expect("copied");
        }
        change(&dir);
        let out = place.path().join(format!("{name}-out"));
        let (dir, out) = (dir.display().to_string(), out.display().to_string());
        let refused = octopus(&["export", &dir, "--out", &out]);
        assert_eq!(refused.status.code(), Some(5), "{name}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{name}: {}", stderr(&refused));
        assert!(!Path::new(&out).exists(), "{name}");
    }
}

/// Goal postures are remembered from step to step, so a whole episode is what tells. Networks that have learned nothing add little to them.
#[test]
fn policies_that_act_beside_goal_postures_do_outside_what_they_do_here() {
    let (episodes, steps) = if whole() { (30, 200) } else { (2, 200) };
    let place = tempfile::tempdir().expect("tempdir");
    // Whose links and mounts are not at right angles.
    let skewed = |text: &str| {
        let mut text = text.to_owned();
        for (straight, other) in [
            ("a = 0.0, d = 0.089159, alpha_deg = 90.0", "a = 0.03, d = 0.089159, alpha_deg = 80.0"),
            ("a = -0.39225, d = 0.0, alpha_deg = 0.0", "a = -0.39225, d = 0.02, alpha_deg = 10.0"),
            ("mount_euler_deg = [-90.0, 0.0, 0.0]", "mount_euler_deg = [-80.0, 10.0, 5.0]"),
        ] {
            assert!(text.contains(straight), "{straight}");
            text = text.replace(straight, other);
        }
        text
    };
    let paper = Robot::builtin("paper").expect("built in");
    let [seven, five_and_seven, five] = other_arms();
    let (reach, catch) = (TaskName::Trajectory, TaskName::Capture);
    let all: [(_, _, &[&str]); 9] = [
        (reach, paper.clone(), &[]),
        (
            reach,
            Robot::builtin("release").expect("built in"),
            &["task.joint_angles=unwound", "task.posture.trust=0.3"],
        ),
        (
            reach,
            robot("two-arm.toml", str::to_owned),
            &["task.posture.gain=0.4", "task.posture.fade=0.3"],
        ),
        (reach, robot("two-arm.toml", skewed), &["task.posture.gain=0", "task.posture.trust=0.1"]),
        (catch, paper, &[]),
        (reach, seven.clone(), &[]),
        (catch, seven, &["task.posture.trust=0.3", "task.posture.fade=0.2"]),
        (reach, five_and_seven, &["task.joint_angles=unwound"]),
        (reach, five, &[]),
    ];
    let mut dirs = Vec::new();
    for (index, (task, robot, more)) in all.into_iter().enumerate() {
        let settings = [&["network.hidden=[24, 17, 15]"][..], more].concat();
        let controlled =
            Controlled::untrained(Preset::Guided, task, &settings, &robot).expect("a policy");
        let dir = place.path().join(index.to_string());
        controlled.export(&dir).expect("an export");
        check_c(&dir, &["-O3", "-march=native"]);
        // Over so many steps hands that nobody trained come to a fork, where all arms choose again or another way is looked for: with ONNX Runtime at the
        // wheel they end elsewhere.
        let _ = drive(&controlled, &dir, episodes, steps);
        dirs.push(dir);
    }
    check_onnx(&dirs);
    let sanitized = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    // One that reaches, one whose goals move, one whose arms differ.
    for dir in [&dirs[0], &dirs[4], &dirs[7]] {
        // Without FMA of the processor's own, four times as slow.
        check_c(dir, &["-O2"]);
        check_c(dir, &sanitized);
        for program in [crosscheck("controller_refusals.c"), dir.join("example.c")] {
            let program = compile(dir, &program, &sanitized).expect("it compiles");
            let output = Command::new(program).output().expect("it starts");
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
            assert!(output.status.success(), "{}: {said}", dir.display());
        }
    }
}
