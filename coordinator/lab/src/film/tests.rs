use rendering::{Vector, View};
use simulator::experiment::Pose;
use simulator::robot::Robot;

use super::bodies::{Kind, Posed};
use super::episode::{MomentErrors, check_arm};
use super::*;

fn look() -> Look {
    Look {
        size: [160, 120],
        fps: 10,
        speed: 8.0,
        view: View { azimuth: 0.6, elevation: 0.35 },
        orbit: 0.0,
        zoom: 1.0,
        caption: true,
    }
}

#[test]
fn the_first_and_the_last_picture_are_those_of_home_and_of_the_end() {
    // 80 s of an episode, eight times as fast, ten pictures a second.
    let times = Times::new(80.0, &look()).expect("short");
    assert_eq!((times.pictures, times.passed(0), times.passed(100)), (101, 0.0, 1.0));
    assert!((times.passed(50) - 0.5).abs() < 1e-12);
    // The whole takes its ten seconds, one picture more, and the pauses.
    assert_eq!(times.until(100), 10_100 + FIRST + LAST);
    assert!((1..=100).all(|picture| times.until(picture) - times.until(picture - 1) >= 100));
    // 12 control steps of 0.4 s are a little more than 4.8 s, and no picture more.
    let times = Times::new(12.0 * 0.4, &Look { speed: 4.0, ..look() }).expect("short");
    assert_eq!((times.pictures, times.passed(12)), (13, 1.0));
    // An episode that is no whole number of pictures ends with its end, too.
    let times = Times::new(80.3, &look()).expect("short");
    assert_eq!((times.pictures, times.passed(times.pictures - 1)), (102, 1.0));
}

#[test]
fn a_film_without_end_is_refused() {
    let error = Times::new(1e6, &look()).expect_err("too long");
    assert_eq!(error.code, ExitCode::Usage);
    assert!(error.message.contains("1,250,001 pictures") && error.message.contains("--speed"));
}

#[test]
fn arms_that_are_not_there_have_no_goals() {
    let robot = Robot::builtin("paper").expect("built in");
    assert!(check_arm(&robot, 4).is_ok());
    for arm in [0, 5] {
        assert_eq!(check_arm(&robot, arm).expect_err("no such arm").code, ExitCode::BadInput);
    }
}

/// An episode of two steps in which the base moves along y.
fn episode(robot: &Robot) -> Episode {
    let pose = |step: usize| Pose {
        base_position: [0.0, 0.4 * step as f32, 4.0],
        base_quaternion: [1.0, 0.0, 0.0, 0.0],
        joints: robot.home_q().iter().map(|q| *q as f32).collect(),
    };
    Episode {
        poses: (0..3).map(pose).collect(),
        errors: vec![MomentErrors::default(); 2],
        contacts: vec![[0; 4]; 3],
        hands: Vec::new(),
        base: None,
        control_period: 0.4,
    }
}

/// Pixels at the places to which the middles of bodies are projected are of a body, and of the colour of the one that is nearest there.
#[test]
fn the_robot_is_drawn_where_it_stands() {
    let robot = Robot::builtin("paper").expect("built in");
    let (episode, look) = (episode(&robot), Look { caption: false, ..look() });
    let stage = Stage::new(&robot, &episode, &look);
    let ground = stage.picture(0.0).pixel(0, 0);
    let mut middles = Vec::new();
    for (passed, pose) in [(0.0, 0), (1.0, 2)] {
        let image = stage.picture(passed);
        let at = |point: &Vector| {
            let (place, _) = stage.camera().project(point);
            image.pixel(place[0] as usize, place[1] as usize)
        };
        let posed = Posed::new(&robot, &episode.poses[pose]);
        let mut seen = 0;
        for part in &posed.parts {
            for solid in &part.solids {
                let balls = solid.balls();
                let middle = balls.iter().map(|(at, _)| at).sum::<Vector>() / balls.len() as f64;
                assert_ne!(at(&middle), ground, "{:?} {middle:?}", part.kind);
                seen += 1;
            }
        }
        assert!(seen > 60, "{seen}");
        // Above the cube's upper face, beside the arm on it: nothing is nearer than the cube.
        let top = posed.base.origin + Vector::new(-0.2, 0.25, 0.4363);
        let [red, green, blue] = at(&top);
        assert!(blue > red && red > 20 && blue < 240, "the cube's: {red} {green} {blue}");
        assert!(matches!(posed.parts[1].kind, Kind::Foot { arm: 0 }));
        // The middle of all its pixels, and where the cube's middle is projected to.
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        for y in 0..image.height {
            for x in 0..image.width {
                if image.pixel(x, y) != ground {
                    sum = [sum[0] + x as f64, sum[1] + y as f64];
                    count += 1.0;
                }
            }
        }
        middles.push((sum.map(|sum| sum / count), stage.camera().project(&posed.base.origin).0));
    }
    // From the first picture to the last all of it goes where the cube goes.
    let [(from, cube_from), (to, cube_to)] = middles[..] else { unreachable!("two pictures") };
    for axis in 0..2 {
        let (gone, cube_gone) = (to[axis] - from[axis], cube_to[axis] - cube_from[axis]);
        assert!(
            (gone - cube_gone).abs() < 0.2 * cube_gone.abs() + 3.0,
            "{gone} {cube_gone} pixels"
        );
    }
    let far = f64::hypot(to[0] - from[0], to[1] - from[1]);
    assert!(far > 20.0, "{far} pixels");
}

/// The bodies between whom a contact is drawn are marked, in a colour that nothing else has.
#[test]
fn contacts_are_marked() {
    let robot = Robot::builtin("paper").expect("built in");
    let mut episode = episode(&robot);
    let look = Look { caption: false, ..look() };
    let marked = |episode: &Episode| {
        let image = Stage::new(&robot, episode, &look).picture(0.5);
        image.pixels.iter().filter(|[r, g, b]| *r > 200 && *g < 90 && (60..160).contains(b)).count()
    };
    assert_eq!(marked(&episode), 0);
    episode.contacts[1] = [1, 0, 1, 0];
    let pose = &mut episode.poses[1];
    pose.joints[2] = 3.0;
    assert!(marked(&episode) > 0);
}
