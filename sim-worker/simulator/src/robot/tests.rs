use std::path::Path;

use super::*;

const PAPER: &str = include_str!("../../robots/paper.toml");

fn error_of(from: &str, to: &str) -> String {
    assert!(PAPER.contains(from), "the test's text {from:?}");
    Robot::from_toml(&PAPER.replacen(from, to, 1), Path::new("my-robot.toml"))
        .unwrap_err()
        .to_string()
}

#[test]
fn built_in_robots_load_and_return_from_their_text() {
    for name in Robot::builtin_names() {
        let robot = Robot::builtin(name).unwrap();
        assert_eq!(robot.name, name);
        assert_eq!((robot.n_arms, robot.n_joints()), (4, 24));
        assert_eq!(Robot::from_toml(&robot.to_toml(), Path::new("x")).unwrap(), robot);
    }
    let two = Robot::from_toml(include_str!("../../robots/two-arm.toml"), Path::new("x")).unwrap();
    assert_eq!((two.n_arms, two.n_joints()), (2, 12));
}

#[test]
fn mounts_sit_flush_on_the_cube() {
    for name in Robot::builtin_names() {
        let robot = Robot::builtin(name).unwrap();
        for arm in &robot.arms {
            let far = arm.mount.centre.abs().max();
            assert!((far - arm.mount.half.z - robot.boxes[0].half.x).abs() < 1e-12, "{name}");
        }
    }
    let edge = Robot::builtin("paper").unwrap().boxes[0].body.inertia[(0, 0)];
    assert!((edge - 400.0 * 0.8726_f64.powi(2) / 6.0).abs() < 1e-9);
}

#[test]
fn another_base_mass_scales_the_cube_alone() {
    let robot = Robot::builtin("release").unwrap();
    let heavy = robot.with_base_mass(800.0).unwrap();
    assert!((heavy.total_mass() - robot.total_mass() - 400.0).abs() < 1e-9);
    assert!((heavy.boxes[0].body.inertia[(1, 1)] - 2.0 * 59.5602).abs() < 1e-3);
    assert!(robot.with_base_mass(-1.0).is_err());
}

#[test]
fn bad_descriptions_name_file_key_and_expectation() {
    for (from, to, words) in [
        ("mass = 3.7", "mass = -3.7", &["links[0] (shoulder).mass", "-3.7", "above zero"][..]),
        ("mass = 3.7", "mass = nan", &["links[0] (shoulder).mass", "NaN"]),
        ("0.0067, 0.0064, 0.0067", "0.0067, -0.0064, 0.0067", &["inertia", "positive definite"]),
        ("0.0067, 0.0064, 0.0067", "0.0067, 0.0264, 0.0067", &["inertia", "triangle"]),
        ("0.0067, 0.0064, 0.0067", "0.0067, 0.0064", &["inertia"]),
        ("dh = { a = 0.0, d = 0.089159, alpha_deg = 90.0 }\n", "", &["there is no key `dh`"]),
        ("armature = 1.0", "amature = 1.0", &["amature", "unknown key"]),
        ("d = 0.089159", "d = inf", &["links[0] (shoulder).dh", "-1e36 to 1e36"]),
        ("d = 0.089159", "d = 1e300", &["links[0] (shoulder).dh", "-1e36 to 1e36"]),
        ("max_rate = 2.0942", "max_rate = 1e300", &["links[0] (shoulder).servo.max_rate", "1e36"]),
        ("max_torque = 150.0", "max_torque = 1e300", &["(shoulder).servo.max_torque", "1e36"]),
        ("armature = 1.0", "armature = 2e36", &["links[0] (shoulder).armature", "zero to 1e36"]),
        ("z = [-0.003, 0.021]", "z = [-0.003, 1e37]", &["pedestal.discs[0].z", "1e36"]),
        ("home = [3.14, -1.57", "home = [3.14, 1.0, -1.57", &["arms[0] (plus_y).home", "7 angles"]),
        ("gain = 100.0", "gain = 0.0", &["servo.gain"]),
        ("radius = 0.0595", "radius = -1.0", &["capsules[0].radius"]),
        ("joint = 2", "joint = 7", &["stops[0].joint", "1 to 6"]),
        ("\"upper_arm\"]", "\"elbow\"]", &["stops[0].pair", "elbow"]),
        ("name = \"forearm\"", "name = \"mount\"", &["links[2].name", "mount"]),
        ("name = \"forearm\"", "name = \"hand\"", &["links[2].name", "hand"]),
        ("name = \"minus_y\"", "name = \"plus_y\"", &["arms[1].name", "before it"]),
        ("name = \"minus_z\"", "name = \"minus<z\"", &["arms[3].name", "letters"]),
        (
            "0.3553, 0.0, 0.0, 0.0]\narmature = 1.0",
            "0.3553, 0.0, 0.0, 0.0]\narmature = 0.0",
            &["stops[0].push", "armature"],
        ),
        (
            "narrowing = 0.06\nnarrowing_joint = 1\npush = false",
            "narrowing = 0.06\nnarrowing_joint = 1\npush = true",
            &["stops[1].push", "as that of stops[0], for joint 2", "one stop a joint that pushes"],
        ),
        ("name = \"paper\"", "name = \"a\\u001b[2Jb\"", &["name is", "letters"]),
        ("name = \"cube\"", "name = \"cu\\\"be\"", &["base[0].name", "letters"]),
        ("name = \"cube\"", "name = \"<cube>\"", &["base[0].name", "letters"]),
        ("mass = 3.7", "mass = \"x\"", &["`mass = \"x\"`: string \"x\", expected a number"]),
        ("mass = 3.7", "mass = [3.7]", &["`mass = [3.7]`", "expected a number"]),
        ("joint = 2", "joint = -2", &["`joint = -2`", "a whole number that is not negative"]),
        ("size = [0.8726", "size = [0.0", &["base[0] (cube).size"]),
        ("[0.0, 0.0, 4.0]", "[1e5, 0.0, 4.0]", &["home_position", "100000.0", "-100 to 100"]),
        ("home = [3.14", "home = [2e4", &["arms[0] (plus_y).home", "-1000 to 1000"]),
    ] {
        let message = error_of(from, to);
        assert!(message.contains("my-robot.toml"), "{message}");
        for rust in ["f64", "usize", "field", "struct", "\u{1b}"] {
            assert!(!message.contains(rust), "{message}");
        }
        for word in words {
            assert!(message.contains(word), "{message:?} lacks {word:?}");
        }
    }
    let second = PAPER.find("[[links]]\nname = \"upper_arm\"").unwrap();
    let tool = PAPER.find("# The hand").unwrap();
    let text = format!("{}{}", &PAPER[..second], &PAPER[tool..]);
    let message = Robot::from_toml(&text, Path::new("my-robot.toml")).unwrap_err().to_string();
    assert!(message.contains("1 rows") && message.contains("2 to 7 [[links]]"), "{message}");
}

const SEVEN: &str = include_str!("../../robots/seven-joints.toml");

#[test]
fn arms_of_different_types_stand_on_one_base() {
    let robot = Robot::from_toml(SEVEN, Path::new("x")).unwrap();
    assert_eq!(robot.joints.by_arm().collect::<Vec<_>>(), [6, 6, 7, 7]);
    assert_eq!(Robot::from_toml(&robot.to_toml(), Path::new("x")).unwrap(), robot);
    assert_eq!(robot.link(6).name, robot.type_of(0).links[0].name);
    assert_eq!(robot.link(25).name, robot.type_of(3).links[6].name);
    let arms: f64 = robot.total_mass() - robot.base.mass;
    assert!((arms - 2.0 * robot.type_of(0).mass() - 2.0 * robot.type_of(2).mass()).abs() < 1e-9);
    let heavier = robot.with_arm_mass(2.0).unwrap();
    assert!((heavier.mass_of_arms() / robot.mass_of_arms() - 2.0).abs() < 1e-12);
    for (from, to, words) in [
        ("type = \"panda\"", "type = \"pandas\"", &["arms[2] (plus_z).type", "pandas", "panda"]),
        ("arm_types.panda", "arm_types.\"a b\"", &["a name in arm_types", "a b", "letters"]),
        (
            "mass = 0.735522",
            "mass = -1.0",
            &["arm_types.panda.links[6] (link7).mass", "-1", "zero"],
        ),
        (
            "home = [0.0, -0.785",
            "home = [-0.785",
            &["arms[2] (plus_z).home", "6 angles", "7 angles"],
        ),
    ] {
        assert!(SEVEN.contains(from), "{from}");
        let text = SEVEN.replace(from, to);
        let message = Robot::from_toml(&text, Path::new("mine.toml")).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{message:?} lacks {word:?}");
        }
    }
}

#[test]
fn names_that_are_the_same_with_the_arms_are_refused() {
    for (names, words) in [
        (
            // The names of two arms, and of two links.
            ["a", "a_wrist", "wrist_1", "1"],
            &["arms[1].name", "link `wrist_1` of arm `a`", "link `1` of arm `a_wrist`"][..],
        ),
        (["a", "a_x", "x_hand", "other"], &["arms[1].name", "the hand of arm `a_x`", "`a_x_hand`"]),
        (["cube", "other", "x", "y"], &[]),
        (["cub", "other", "x", "y"], &[]),
    ] {
        let [arm, other_arm, link, other_link] = names;
        let text = PAPER
            .replace("name = \"plus_y\"", &format!("name = \"{arm}\""))
            .replace("name = \"minus_y\"", &format!("name = \"{other_arm}\""))
            .replace("\"wrist_1\"", &format!("\"{link}\""))
            .replace("\"wrist_2\"", &format!("\"{other_link}\""));
        let found = Robot::from_toml(&text, Path::new("my-robot.toml"));
        assert_eq!(found.is_err(), !words.is_empty(), "{names:?}");
        let message = found.map_or_else(|error| error.to_string(), |_| String::new());
        for word in words {
            assert!(message.contains(word), "{message:?} lacks {word:?}");
        }
    }
    for cube in ["plus_y_mount", "plus_y_pedestal_0", "plus_y_shoulder_1"] {
        let message = error_of("name = \"cube\"", &format!("name = \"{cube}\""));
        assert!(message.contains(&format!("box `{cube}`")), "{message}");
        assert!(message.contains("of arm `plus_y`"), "{message}");
    }
}
