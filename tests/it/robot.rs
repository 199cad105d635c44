//! Robots of other programs: brought from URDF, and what MuJoCo reads in the same file.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use simulator::robot::Robot;
use tests::{crosscheck, octopus, python, stderr};

use crate::mujoco::Noise;

/// Three numbers as URDF writes them.
fn three(noise: &mut Noise, scale: f64) -> String {
    let [x, y, z] = [noise.next(), noise.next(), noise.next()].map(|x| scale * x);
    format!("{x} {y} {z}")
}

/// A body whose moments are those of a box.
fn inertial(noise: &mut Noise) -> String {
    let mass = 3.0 + 2.0 * noise.next();
    let [x, y, z] = [0.3 + 0.2 * noise.next(), 0.2, 0.1].map(|edge: f64| edge * edge);
    let moment = |a: f64, b: f64| mass / 12.0 * (a + b);
    format!(
        "<inertial><origin xyz=\"{}\" rpy=\"{}\"/><mass value=\"{mass}\"/>\
         <inertia ixx=\"{}\" iyy=\"{}\" izz=\"{}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
        three(noise, 0.1),
        three(noise, 3.0),
        moment(y, z),
        moment(x, z),
        moment(x, y)
    )
}

/// Arms in which nothing is parallel and nothing meets, on a base with a box fixed to it; tools are fixed to their ends.
fn random_urdf(seed: u64, arms: usize) -> String {
    let mut noise = Noise(seed);
    let mut text = "<robot name=\"random robot\">\n".to_owned();
    let base = inertial(&mut noise).replace("mass value=\"", "mass value=\"4");
    writeln!(text, "<link name=\"body\">{base}</link>").expect("text");
    let panel = inertial(&mut noise);
    writeln!(
        text,
        "<link name=\"panel\">{panel}</link>\n<joint name=\"panel\" type=\"fixed\"><origin xyz=\"{}\" rpy=\"{}\"/>\
         <parent link=\"body\"/><child link=\"panel\"/></joint>",
        three(&mut noise, 0.3),
        three(&mut noise, 3.0)
    )
    .expect("text");
    // Alike, but for where they stand.
    let links: Vec<String> = (0..7).map(|_| inertial(&mut noise)).collect();
    let places: Vec<[String; 3]> = (0..7)
        .map(|_| [three(&mut noise, 0.4), three(&mut noise, 3.0), three(&mut noise, 1.0)])
        .collect();
    for arm in 0..arms {
        let mut parent = "body".to_owned();
        for (i, (inertial, [xyz, rpy, axis])) in links.iter().zip(&places).enumerate() {
            let (name, kind) = match i {
                6 => (format!("arm{arm}_tool"), "fixed"),
                _ => (format!("arm{arm}_link{i}"), "revolute"),
            };
            let [xyz, rpy] = match i {
                0 => [three(&mut noise, 0.5), three(&mut noise, 3.0)],
                _ => [xyz.clone(), rpy.clone()],
            };
            writeln!(
                text,
                "<link name=\"{name}\">{inertial}<collision><geometry><cylinder radius=\"0.04\" length=\"0.2\"/></geometry>\
                 </collision></link>\n<joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>\
                 <parent link=\"{parent}\"/><child link=\"{name}\"/><axis xyz=\"{axis}\"/>\
                 <limit lower=\"-3\" upper=\"3\" effort=\"90\" velocity=\"1.5\"/></joint>"
            )
            .expect("text");
            parent = name;
        }
    }
    text + "</robot>\n"
}

/// How far a robot file is from what MuJoCo reads in the URDF that it was made of; files are the URDF, a model to be written, the robot file.
fn beside_mujoco([urdf, mjcf, toml]: &[&str; 3]) -> Value {
    let made = octopus(&["mjcf", "--robot", toml, "--contacts=off", "--out", mjcf]);
    assert!(made.status.success(), "{}", stderr(&made));
    let output = Command::new(python())
        .arg(crosscheck("urdf.py"))
        .args([urdf, mjcf, toml, "7"])
        .output()
        .expect("Python starts");
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

#[test]
fn what_is_brought_from_urdf_is_what_mujoco_reads_in_it() {
    let dir = tempfile::tempdir().expect("a directory");
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let ours = octopus(&["urdf", "--robot=paper", "--out", &at("paper.urdf")]);
    assert!(ours.status.success(), "{}", stderr(&ours));
    let random: Vec<String> = (1..=4)
        .map(|arms| {
            let name = format!("random-{arms}.urdf");
            std::fs::write(at(&name), random_urdf(arms as u64, arms)).expect("written");
            name
        })
        .collect();
    for name in ["paper.urdf".to_owned()].into_iter().chain(random) {
        let [urdf, toml, mjcf] =
            ["urdf", "toml", "xml"].map(|end| at(&name).replace(".urdf", &format!(".{end}")));
        let imported = octopus(&["robot", "import", &urdf, "--out", &toml]);
        assert!(imported.status.success(), "{}", stderr(&imported));
        let answer = beside_mujoco(&[&urdf, &mjcf, &toml]);
        let number = |key: &str| answer[key].as_f64().expect("a number");
        // What stands for mount and pedestal is a milligram; files have sixteen digits, angles of rows nine.
        assert!(number("inertia") < 1e-6, "{name}: {answer}");
        assert!(number("masses") < 1e-6, "{name}: {answer}");
    }
}

/// Files of the package example-robot-data, and the links where their arms begin: those of Universal Robots (UR10) and Kinova (Jaco 2) have six joints, those of
/// Franka (Panda), UFactory (xArm 7), Unitree (Z1 with its gripper) and Rethink Robotics (Baxter) seven.
const ARMS: [&str; 6] = [
    "ur_description/urdf/ur10_robot.urdf:base_link",
    "panda_description/urdf/panda_collision.urdf:panda_link0",
    "xarm_description/urdf/xarm7.urdf:link_base",
    "kinova_description/robots/kinova.urdf:j2s6s200_link_base",
    "z1_description/urdf/z1.urdf:link00",
    "baxter_description/urdf/baxter.urdf:right_arm_mount",
];

/// A satellite with these arms of other people, as URDF.
fn satellite(out: &str, arms: &[&str]) {
    let output = Command::new(python())
        .arg(crosscheck("satellite.py"))
        .arg(out)
        .args(arms)
        .output()
        .expect("Python starts");
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Each alone, and different ones on one base: what they weigh and how they move is what MuJoCo reads in the same URDF.
#[test]
fn arms_of_other_people_are_what_mujoco_reads_also_different_ones_on_one_base() {
    let dir = tempfile::tempdir().expect("a directory");
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let alone = ARMS.iter().map(|arm| vec![*arm]);
    let together = [ARMS[..4].to_vec(), vec![ARMS[1], ARMS[5], ARMS[1]]];
    for (number, arms) in alone.chain(together).enumerate() {
        let [urdf, toml, mjcf] = ["urdf", "toml", "xml"].map(|end| at(&format!("{number}.{end}")));
        satellite(&urdf, &arms);
        let imported = octopus(&["robot", "import", &urdf, "--out", &toml]);
        assert!(imported.status.success(), "{arms:?}: {}", stderr(&imported));
        let robot =
            Robot::from_toml(&std::fs::read_to_string(&toml).expect("written"), Path::new(&toml))
                .unwrap_or_else(|error| panic!("{arms:?}: {error}"));
        let expected: Vec<usize> = arms
            .iter()
            .map(|arm| if arm.starts_with("ur") || arm.starts_with("kinova") { 6 } else { 7 })
            .collect();
        assert_eq!(robot.joints.by_arm().collect::<Vec<_>>(), expected);
        let types: BTreeSet<&str> = arms.iter().copied().collect();
        assert_eq!(robot.types.len(), types.len(), "arms that are alike are of one type");
        let answer = beside_mujoco(&[&urdf, &mjcf, &toml]);
        assert!(answer["inertia"].as_f64() < Some(1e-6), "{arms:?}: {answer}");
        assert!(answer["masses"].as_f64() < Some(1e-6), "{arms:?}: {answer}");
    }
}

#[test]
fn a_robot_of_ones_own_is_checked() {
    let check = |robot: &str, more: &[&str]| {
        octopus(&[&["robot", "check", robot, "--episodes=4"], more].concat())
    };
    let paper = check("paper", &["--json"]);
    assert!(paper.status.success(), "{}", stderr(&paper));
    let answer: Value = serde_json::from_slice(&paper.stdout).expect("JSON");
    assert_eq!(
        (&answer["arms"], &answer["joints"], &answer["goals"]),
        (&4.into(), &24.into(), &16.into())
    );
    assert!(answer["reachable"].as_u64() > Some(8), "{answer}");
    let dir = tempfile::tempdir().expect("a directory");
    let inside = dir.path().join("inside.toml");
    let text = include_str!("../../sim-worker/simulator/robots/two-arm.toml");
    let at = text.find("mount_position").expect("an arm");
    let end = text[at..].find('\n').expect("a line");
    let moved = format!("{}mount_position = [0.0, 0.0, 0.0]{}", &text[..at], &text[at + end..]);
    std::fs::write(&inside, moved).expect("written");
    let refused = check(inside.to_str().expect("UTF-8"), &[]);
    assert_eq!(refused.status.code(), Some(3), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("touches the base (`cube`) at home"), "{}", stderr(&refused));
}

#[test]
fn what_an_import_leaves_out_is_said_and_stands_in_the_file() {
    let dir = tempfile::tempdir().expect("a directory");
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(at("r.urdf"), random_urdf(3, 2)).expect("written");
    let imported = octopus(&["robot", "import", &at("r.urdf"), "--out", &at("r.toml")]);
    assert!(imported.status.success(), "{}", stderr(&imported));
    let (said, file) = (stderr(&imported), std::fs::read_to_string(at("r.toml")).expect("written"));
    for words in ["position limits", "armatures", "taken for a capsule", "the hand of arm"] {
        assert!(said.contains(words) && file.contains(words), "{words}: {said}\n{file}");
    }
    assert!(file.starts_with("# Made by `octopus robot import` from r.urdf"), "{file}");
    // What it made is completed by hand, and written over by force only.
    let again = ["robot", "import", &at("r.urdf"), "--out", &at("r.toml")];
    let refused = octopus(&again);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("is there already; --force writes over it"));
    assert!(octopus(&[&again[..], &["--force"]].concat()).status.success());
    let over = octopus(&["robot", "import", &at("r.urdf"), "--out", &at("r.urdf")]);
    assert_eq!(over.status.code(), Some(2), "{}", stderr(&over));
    std::fs::write(at("broken.urdf"), "<robot name=\"x\"><link/></robot>").expect("written");
    let broken = octopus(&["robot", "import", &at("broken.urdf")]);
    assert_eq!(broken.status.code(), Some(3));
    let said = stderr(&broken);
    assert!(said.contains("broken.urdf: line 1, <link>") && said.contains("no `name`"), "{said}");
    assert!(!Path::new(&at("broken.toml")).exists());
}
