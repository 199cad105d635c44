//! What our own exporter writes comes back as the same robot, and what is no robot of ours is refused in words.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use simulator::robot::urdf::urdf;
use simulator::robot::{Robot, Shape};
use simulator::simulate::{Precision, simulate};
use simulator::step::StepOptions;

use super::*;

const TWO_ARM: &str = include_str!("../../../../sim-worker/simulator/robots/two-arm.toml");

fn robots() -> Vec<Robot> {
    let skew = TWO_ARM
        .replace("alpha_deg = 90.0", "alpha_deg = 73.0")
        .replace("a = -0.425, d = 0.0", "a = -0.425, d = 0.05");
    // The hand's axis is not that of the last joint.
    let last = TWO_ARM.rfind("alpha_deg = 0.0").expect("the last row");
    let turned = format!(
        "{}alpha_deg = -90.0{}",
        &TWO_ARM[..last],
        &TWO_ARM[last + "alpha_deg = 0.0".len()..]
    );
    let of = |text: &str| Robot::from_toml(text, Path::new("test")).expect("a robot");
    vec![
        Robot::builtin("paper").expect("built in"),
        Robot::builtin("release").expect("built in"),
        of(TWO_ARM),
        of(&skew),
        of(&turned),
    ]
}

fn read(robot: &Robot) -> Imported {
    import(&urdf(robot), Some("_hand"), robot.home_position).expect("our own URDF")
}

/// With what URDF does not hold, and with the home of `robot`, whose angles the URDF's are.
fn completed(robot: &Robot, mut d: RobotDescription) -> Robot {
    for (link, own) in d.links.iter_mut().zip(&robot.types[0].links) {
        link.armature = own.armature;
        link.servo.gain = own.gain;
    }
    for (arm, own) in d.arms.iter_mut().zip(&robot.arms) {
        for (angle, own) in arm.home.iter_mut().zip(&own.home) {
            *angle += own;
        }
    }
    Robot::from_description(d, Path::new("imported")).expect("a robot")
}

#[test]
fn a_robot_that_was_exported_moves_as_it_did() {
    for robot in robots() {
        let Imported { description, notes, .. } = read(&robot);
        assert!(notes.iter().all(|note| !note.contains("frame of a hand")), "{notes:?}");
        let back = completed(&robot, description);
        shapes_are_where_they_were(&robot, &back);
        assert!((back.total_mass() / robot.total_mass() - 1.0).abs() < 1e-6);
        let commands: Vec<Vec<f64>> = (0..10)
            .map(|step| {
                let rate = |joint: usize| ((step * 7 + joint * 13) as f64).sin() * 0.8;
                (0..robot.n_joints()).map(rate).collect()
            })
            .collect();
        let options = StepOptions { contacts: false, ..StepOptions::default() };
        let [one, other] =
            [&robot, &back].map(|robot| simulate(robot, &commands, Precision::F64, &options));
        for (one, other) in one.iter().zip(&other) {
            for (a, b) in one.hands.iter().flatten().zip(other.hands.iter().flatten()) {
                assert!((a - b).abs() < 1e-5, "{}: {a} {b} after {} s", robot.name, one.t);
            }
            let base = one.state.base_position.iter().zip(&other.state.base_position);
            assert!(
                base.clone().all(|(a, b)| (a - b).abs() < 1e-6),
                "{:?}",
                base.collect::<Vec<_>>()
            );
        }
    }
}

/// Compares the shapes of each link by their places in the base's frame while the angles are those of home.
fn shapes_are_where_they_were(robot: &Robot, back: &Robot) {
    let places = |robot: &Robot| -> Vec<[f64; 7]> {
        let mut places = Vec::new();
        for arm in &robot.arms {
            let (mut turn, mut at) = (arm.rotation, arm.position);
            for (link, angle) in robot.types[arm.arm_type].links.iter().zip(&arm.home) {
                turn *= Rotation3::from_axis_angle(&Vector3::z_axis(), *angle).matrix();
                for shape in &link.shapes {
                    let (from, to, radius) = match shape {
                        Shape::Capsule { from, to, radius } => (*from, *to, *radius),
                        Shape::Disc { centre, axis, radius, half_height } => {
                            (centre - axis * *half_height, centre + axis * *half_height, *radius)
                        }
                    };
                    let [from, to] = [from, to].map(|end| at + turn * end);
                    places.push([from.x, from.y, from.z, to.x, to.y, to.z, radius]);
                }
                at += turn * link.shift;
                turn *= link.twist;
            }
        }
        // Shapes of a link may come in another order.
        places.sort_by(|a, b| {
            a.iter()
                .map(|x| (x * 1e5).round())
                .partial_cmp(b.iter().map(|x| (x * 1e5).round()))
                .expect("numbers")
        });
        places
    };
    let (one, other) = (places(robot), places(back));
    assert_eq!(one.len(), other.len());
    for (a, b) in one.iter().zip(&other) {
        let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-5, "{a:?} {b:?}");
    }
}

#[test]
fn names_and_shapes_come_back() {
    let robot = Robot::builtin("paper").expect("built in");
    let Imported { description: d, notes, .. } = read(&robot);
    let own = robot.description();
    let names = |d: &RobotDescription| -> Vec<String> {
        let links = d.links.iter().map(|link| link.name.clone());
        links.chain(d.arms.iter().map(|arm| arm.name.clone())).collect()
    };
    assert_eq!(names(&d), names(own));
    let counts = |d: &RobotDescription| -> Vec<[usize; 2]> {
        d.links.iter().map(|link| [link.capsules.len(), link.discs.len()]).collect()
    };
    assert_eq!(counts(&d), counts(own));
    assert!(notes.iter().any(|note| note.contains("armatures")), "{notes:?}");
    assert!(notes.iter().all(|note| !note.contains("frame of a hand")), "{notes:?}");
}

/// A base with one arm of `joints` joints, each of `kind`.
fn one_arm(joints: usize, kind: &str) -> String {
    let inertial =
        "<inertial><mass value=\"2\"/><inertia ixx=\"0.1\" iyy=\"0.1\" izz=\"0.1\"/></inertial>";
    let mut text = format!("<robot name=\"r\"><link name=\"base\">{inertial}</link>");
    for i in 1..=joints {
        let parent = if i == 1 { "base".to_owned() } else { format!("l{}", i - 1) };
        let axis = if i % 2 == 0 { "0 1 0" } else { "0 0 1" };
        write!(
            text,
            "<link name=\"l{i}\">{inertial}</link>\n<joint name=\"j{i}\" type=\"{kind}\"><origin xyz=\"0.1 0 0.3\"/>\
             <parent link=\"{parent}\"/><child link=\"l{i}\"/><axis xyz=\"{axis}\"/></joint>"
        ).expect("text");
    }
    text + "</robot>"
}

#[test]
fn values_that_no_robot_has_are_said_with_the_urdfs_link() {
    let text = one_arm(3, "revolute")
        .replace("\"l", "\"arm_l")
        .replacen("ixx=\"0.1\"", "ixx=\"0.9\"", 3)
        .replacen("ixx=\"0.9\"", "ixx=\"0.1\"", 2);
    let imported = import(&text, None, [0.0; 3]).expect("a robot in form");
    let message = imported.robot(Path::new("r.urdf")).expect_err("no body").to_string();
    for words in ["robot r.urdf: link `arm_l2`: links[1] (l2).inertia", "triangle"] {
        assert!(message.contains(words), "{message:?} lacks {words:?}");
    }
}

#[test]
fn links_are_not_called_as_the_hand_is() {
    for taken in ["hand", "goal", "mount"] {
        let text = one_arm(3, "revolute").replace("\"l3\"", &format!("\"{taken}\""));
        let d = import(&text, None, [0.0; 3]).expect("a robot").description;
        let names: Vec<&str> = d.links.iter().map(|link| link.name.as_str()).collect();
        assert_eq!(names, ["link_1", "link_2", "link_3"]);
        let robot = Robot::from_description(d, Path::new("x")).expect("names are free");
        let exported = urdf(&robot);
        assert_eq!(exported.matches("<link name=\"arm_1_hand\"").count(), 1, "{exported}");
    }
}

#[test]
fn inertia_without_a_mass_is_said_to_be_left_out() {
    let more = "<link name=\"frame\"><inertial><mass value=\"0\"/><inertia ixx=\"5\" iyy=\"5\" izz=\"5\"/></inertial></link>\
                <joint name=\"weld\" type=\"fixed\"><parent link=\"l1\"/><child link=\"frame\"/></joint></robot>";
    let plain = one_arm(3, "revolute");
    let notes = import(&plain.replace("</robot>", more), None, [0.0; 3]).expect("a robot").notes;
    let said = |notes: &[String]| notes.iter().any(|note| note.contains("inertia of link `frame`"));
    assert!(said(&notes), "{notes:?}");
    assert!(!said(&import(&plain, None, [0.0; 3]).expect("a robot").notes));
}

#[test]
fn what_is_no_robot_of_ours_is_refused_in_words() {
    let said = |text: &str| import(text, None, [0.0; 3]).expect_err("no robot").to_string();
    let six = one_arm(6, "revolute");
    for joints in 2..=7 {
        import(&one_arm(joints, "revolute"), None, [0.0; 3]).expect("joints that turn");
    }
    for (text, words) in [
        ("<robot".to_owned(), "no XML"),
        ("<sdf/>".to_owned(), "expected <robot"),
        (one_arm(8, "revolute"), "begins with joint `j1` has 8; an arm has 2 to 7 joints"),
        (one_arm(1, "continuous"), "has 1; an arm has 2 to 7"),
        (one_arm(0, "fixed"), "nothing moves on the base `base`"),
        (
            one_arm(6, "prismatic"),
            "line 2, <joint name=\"j1\">: type=\"prismatic\", expected `revolute`",
        ),
        (
            six.replace("<parent link=\"l3\"/>", "<parent link=\"l9\"/>"),
            "joint `j4` names the link `l9`",
        ),
        (
            six.replace("<parent link=\"l3\"/>", "<parent link=\"l6\"/>"),
            "hang on each other in a circle",
        ),
        (six.replace("<parent link=\"l3\"/>", "<parent link=\"l2\"/>"), "joints move on link `l2`"),
        (six.replace("<child link=\"l6\"/>", "<child link=\"l2\"/>"), "hangs on two joints"),
        (six.replace("name=\"j6\"", "name=\"j5\""), "two joints are called `j5`"),
        (six.replace("xyz=\"0.1 0 0.3\"", "xyz=\"0.1 0\""), "expected three numbers"),
        (six.replace("value=\"2\"", "value=\"nan\""), "expected a number between -1e9 and 1e9"),
        (six.replace("<mass value=\"2\"/>", ""), "no <mass>"),
        (six.replace("ixx=\"0.1\" ", ""), "no `ixx`"),
        (six.replace("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 0\"/>"), "an axis of no length"),
        (
            six.replacen("<mass value=\"2\"/>", "<mass value=\"0\"/>", 1),
            "the base, link `base`, has no mass",
        ),
    ] {
        let message = said(&text);
        assert!(message.contains(words), "{words:?} is not in {message:?}");
    }
    let message = import(&six, Some("claw"), [0.0; 3]).expect_err("no such hand").to_string();
    assert!(message.contains("no link at its end whose name ends in `claw`"), "{message}");
}

#[test]
fn arms_that_are_not_alike_are_of_different_types() {
    let robot = Robot::builtin("paper").expect("built in");
    let text = urdf(&robot);
    // The mass of one forearm.
    let place = text.find("link name=\"minus_z_forearm\"").expect("there");
    let (before, after) = text.split_at(place);
    let other =
        format!("{before}{}", after.replacen("mass value=\"2.275\"", "mass value=\"2.3\"", 1));
    let Imported { description: d, notes, .. } = import(&other, None, [0.0; 3]).expect("a robot");
    let types: Vec<Option<&str>> = d.arms.iter().map(|arm| arm.arm_type.as_deref()).collect();
    assert_eq!(types, [None, None, None, Some("minus_z")]);
    assert_eq!((d.links[2].mass, d.arm_types["minus_z"].links[2].mass), (2.275, 2.3));
    let said = notes.iter().any(|note| {
        note.contains("differs from arm `plus_y`: link 3 has 2.275 kg here and 2.3 kg there")
    });
    assert!(said, "{notes:?}");
    let robot = Robot::from_description(d, Path::new("imported")).expect("a robot");
    assert_eq!((robot.types.len(), robot.n_joints()), (2, 24));
}

#[test]
fn axes_that_are_almost_parallel_are_parallel() {
    // 1.5708 is 3.7e-6 more than a right angle, which many files write.
    let exact = one_arm(6, "revolute");
    let turned = |angle: &str| {
        exact.replace(
            "<origin xyz=\"0.1 0 0.3\"/>",
            &format!("<origin xyz=\"0.1 0 0.3\" rpy=\"{angle} 0 0\"/>"),
        )
    };
    for text in [turned("1.5708"), turned("1.57"), turned("-1.5707963267948966")] {
        let Imported { description: d, notes, .. } =
            import(&text, None, [0.0; 3]).expect("a robot");
        let longest =
            d.links.iter().map(|link| link.dh.a.abs().max(link.dh.d.abs())).fold(0.0, f64::max);
        let said = notes.iter().any(|note| note.contains("taken for parallel"));
        assert_eq!(said, text.contains("1.57 0 0"), "{notes:?}");
        assert!(
            longest < 10.0,
            "{longest} m: {:?}",
            d.links.iter().map(|link| link.dh).collect::<Vec<_>>()
        );
    }
}

/// Our own URDF has the zero of the rows; the robot has another home.
#[test]
#[expect(clippy::approx_constant, reason = "the angles of the robot's file")]
fn a_home_is_given_in_angles_of_the_urdf() {
    let robot = Robot::builtin("paper").expect("built in");
    let zeros: Vec<Vec<f64>> =
        read(&robot).description.arms.into_iter().map(|arm| arm.home).collect();
    let home = |angles: &[(&str, f64)]| {
        let angles: Vec<(String, f64)> =
            angles.iter().map(|(end, angle)| ((*end).to_owned(), *angle)).collect();
        read(&robot).at_home(&angles)
    };
    let angles = [
        ("upper_arm", -1.57),
        ("wrist_1", -1.57),
        ("_y_shoulder", 9.0),
        ("plus_y_shoulder", 3.14),
        ("_y_wrist_3", 3.14),
        ("minus_y_shoulder", 0.0),
        ("minus_y_wrist_3", 0.0),
        ("minus_z_shoulder", 3.14),
        ("minus_z_wrist_3", 3.14),
    ];
    let imported = home(&angles).expect("all there").description;
    for ((arm, own), zeros) in imported.arms.iter().zip(&robot.arms).zip(&zeros) {
        for ((home, own), zero) in arm.home.iter().zip(&own.home).zip(zeros) {
            let turns = (home - zero - own) / std::f64::consts::TAU;
            assert!((turns - turns.round()).abs() < 1e-12, "{home} is not {zero} and {own}");
            assert!(home.abs() <= std::f64::consts::PI, "{home}");
        }
    }
    assert_eq!(home(&[]).expect("the zero").description.arms[0].home, zeros[0]);
    for (angles, words) in [
        (&[("elbow", 1.0)][..], "no joint of an arm has a name that ends in `elbow`"),
        (&[("wrist_1", 1.0), ("wrist_1", 2.0)][..], "two angles"),
    ] {
        let message = home(angles).expect_err("no such home").to_string();
        assert!(message.contains(words), "{message}");
    }
}
