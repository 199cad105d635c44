//! The dynamics against MuJoCo itself, on the model files that we export.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use std::path::Path;
use std::process::Command;

use proto::statistics::{mean, median, percentile};
use serde_json::{Value, json};
use simulator::collision::count_contacts;
use simulator::dynamics::reference_dynamics::inertia_matrix;
use simulator::dynamics::{Hand, forward_dynamics, hands};
use simulator::model::Model;
use simulator::robot::{MjcfOptions, Robot, mjcf::mjcf};
use simulator::scalar::{LaneFn, Real, dispatch};
use simulator::simulate::{Precision, simulate};
use simulator::state::State;
use simulator::step::{Disturbance, Integrator, StepOptions, step, step_disturbed};
use simulator::workspace::Workspace;

/// Uniform numbers in ±1, the same on every machine.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Normal with standard deviation one (Box and Muller).
    fn normal(&mut self) -> f64 {
        let u = self.next().midpoint(1.0).max(1e-300);
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::PI * self.next()).cos()
    }
}

fn robots() -> Vec<Robot> {
    let of = |text| Robot::from_toml(text, Path::new("robot.toml")).unwrap();
    let two_arm = of(include_str!("../../sim-worker/simulator/robots/two-arm.toml"));
    let seven = of(include_str!("../../sim-worker/simulator/robots/seven-joints.toml"));
    let [release, paper] = ["release", "paper"].map(|name| Robot::builtin(name).unwrap());
    vec![release, paper, two_arm, seven]
}

fn ask(input: &Value) -> Value {
    let dir = tempfile::tempdir().unwrap();
    let (question, answer) = (dir.path().join("question.json"), dir.path().join("answer.json"));
    std::fs::write(&question, input.to_string()).unwrap();
    let output = Command::new(tests::python())
        .arg(tests::crosscheck("mujoco_dynamics.py"))
        .args([&question, &answer] as [&Path; 2])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&std::fs::read(answer).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn qpos(s: &State<f64>) -> Vec<f64> {
    s.base_position.iter().chain(&s.base_quaternion).chain(&s.q).copied().collect()
}

fn qvel(s: &State<f64>) -> Vec<f64> {
    s.base_linear_velocity.iter().chain(&s.base_angular_velocity).chain(&s.qd).copied().collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

fn largest(a: &[f64]) -> f64 {
    a.iter().fold(0.0, |m, x| m.max(x.abs()))
}

fn hand_names(robot: &Robot) -> Vec<String> {
    robot.arms.iter().map(|a| format!("{}_hand", a.name)).collect()
}

fn random_commands(robot: &Robot, steps: usize, noise: &mut Noise) -> Vec<Vec<f64>> {
    (0..steps).map(|_| (0..robot.n_joints()).map(|_| 0.8 * noise.next()).collect()).collect()
}

/// To the rounding of products of a dozen rotations.
#[test]
fn the_home_keyframe_is_the_robot_at_home() {
    for robot in robots() {
        let answer = ask(&json!({
            "model": mjcf(&robot, MjcfOptions::default()),
            "hands": hand_names(&robot),
            "keyframe": "home",
        }));
        let home = State::<f64>::home(&robot);
        assert_eq!(numbers(&answer["keyframe"]["qpos"]), qpos(&home), "{}", robot.name);
        let model = Model::<f64>::new(&robot);
        let mut ours = vec![Hand::default(); robot.n_arms];
        hands(&model, &mut Workspace::new(&model), &home, &mut ours);
        let ours: Vec<f64> = ours.iter().flat_map(|hand| hand.position).collect();
        let worst = largest_difference(&ours, &numbers(&answer["keyframe"]["hands"]));
        assert!(worst < 1e-12, "{}: {worst:e}", robot.name);
    }
}

/// Inertia matrices and accelerations at random states, to 1e-9 of their largest element.
#[test]
fn inertia_and_accelerations_agree_with_mujoco() {
    let mut noise = Noise(1);
    for robot in robots() {
        let mut states = Vec::new();
        for _ in 0..50 {
            let mut s = State::<f64>::home(&robot);
            for x in s.base_position.iter_mut().chain(&mut s.base_linear_velocity) {
                *x += noise.next();
            }
            s.base_angular_velocity = [noise.next(), noise.next(), noise.next()];
            let q = [noise.normal(), noise.normal(), noise.normal(), noise.normal()];
            let n = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            s.base_quaternion = q.map(|x| x / n);
            s.q.iter_mut().for_each(|x| *x = 3.0 * noise.next());
            s.qd.iter_mut().for_each(|x| *x = 2.0 * noise.next());
            let tau: Vec<f64> = (0..robot.n_joints()).map(|_| 50.0 * noise.next()).collect();
            states.push((s, tau));
        }
        let asked: Vec<Value> = states
            .iter()
            .map(|(s, tau)| json!({"qpos": qpos(s), "qvel": qvel(s), "tau": tau}))
            .collect();
        let answer = ask(&json!({"model": mjcf(&robot, MjcfOptions::default()), "states": asked}));
        assert!((answer["mass"].as_f64().unwrap() - robot.total_mass()).abs() < 1e-9);
        let model = Model::<f64>::new(&robot);
        let mut ws = Workspace::new(&model);
        let (mut worst_m, mut worst_a) = (0.0_f64, 0.0_f64);
        for ((s, tau), theirs) in states.iter().zip(answer["states"].as_array().unwrap()) {
            let m = inertia_matrix(&robot, s);
            let theirs_m = numbers(&theirs["inertia"]);
            worst_m = worst_m.max(largest_difference(m.as_slice(), &theirs_m) / m.amax());
            let a = forward_dynamics(&model, &mut ws, s, tau);
            let ours: Vec<f64> =
                a.base_linear.iter().chain(&a.base_angular).chain(&a.joints).copied().collect();
            let difference = largest_difference(&ours, &numbers(&theirs["qacc"]));
            worst_a = worst_a.max(difference / largest(&ours));
        }
        eprintln!("{}: inertia {worst_m:e}, acceleration {worst_a:e} relative", robot.name);
        assert!(worst_m < 1e-9 && worst_a < 1e-9, "{}: {worst_m:e} {worst_a:e}", robot.name);
    }
}

/// 20 s of random commands, MuJoCo's integrator and step: states and hands within 1e-6.
#[test]
fn a_random_episode_agrees_with_mujoco() {
    let mut noise = Noise(2);
    for robot in robots() {
        let commands = random_commands(&robot, 50, &mut noise);
        let home = State::<f64>::home(&robot);
        let answer = ask(&json!({
            "model": mjcf(&robot, MjcfOptions::default()),
            "hands": hand_names(&robot),
            "episode": {"qpos": qpos(&home), "commands": commands, "steps_per_command": 400},
        }));
        let rows = simulate(&robot, &commands, Precision::F64, &authors());
        let moved = largest_difference(&rows[49].state.q, &home.q);
        assert!(moved > 0.5, "the arms hardly moved: {moved} rad");
        let mut worst = [0.0_f64; 3];
        for (row, theirs) in rows.iter().zip(answer["episode"].as_array().unwrap()) {
            let hands = row.hands.concat();
            let pairs = [(qpos(&row.state), "qpos"), (qvel(&row.state), "qvel"), (hands, "hands")];
            for (w, (ours, key)) in worst.iter_mut().zip(pairs) {
                *w = w.max(largest_difference(&ours, &numbers(&theirs[key])));
            }
        }
        eprintln!(
            "{}: position {:e}, velocity {:e}, hands {:e}",
            robot.name, worst[0], worst[1], worst[2]
        );
        assert!(worst.iter().all(|w| *w < 1e-6), "{}: {worst:?}", robot.name);
    }
}

/// Forces on hands, torques on base and joints, limp arms: 4 s of random ones, MuJoCo's integrator and step.
#[test]
fn disturbed_episodes_agree_with_mujoco() {
    let mut noise = Noise(5);
    for robot in robots() {
        let n = robot.n_joints();
        let commands = random_commands(&robot, 10, &mut noise);
        let disturbances: Vec<Disturbance<f64>> = (0..commands.len())
            .map(|step| {
                let mut disturbance = Disturbance::none(&robot.joints);
                // A single hand is pulled at, then all; the first arm is limp in every third step.
                for force in disturbance.hand_force.iter_mut().take(1 + step) {
                    *force = [0; 3].map(|_| 30.0 * noise.next());
                }
                disturbance.base_torque = [0; 3].map(|_| 20.0 * noise.next());
                disturbance.joint_torque.fill_with(|| 5.0 * noise.next());
                if step % 3 == 2 {
                    disturbance.servo[..6].fill(0.0);
                }
                disturbance
            })
            .collect();
        let asked: Vec<Value> = disturbances
            .iter()
            .map(|d| {
                let limp: Vec<usize> = (0..n).filter(|&joint| d.servo[joint] == 0.0).collect();
                json!({
                    "hand_force": d.hand_force, "base_torque": d.base_torque,
                    "joint_torque": d.joint_torque, "limp": limp,
                })
            })
            .collect();
        let mut state = State::<f64>::home(&robot);
        let answer = ask(&json!({
            "model": mjcf(&robot, MjcfOptions::default()),
            "hands": hand_names(&robot),
            "episode": {
                "qpos": qpos(&state), "commands": commands, "steps_per_command": 400,
                "disturbances": asked,
            },
        }));
        let model = Model::<f64>::new(&robot);
        let mut ws = Workspace::new(&model);
        let mut worst = [0.0_f64; 2];
        let theirs = answer["episode"].as_array().unwrap();
        for ((command, disturbance), theirs) in commands.iter().zip(&disturbances).zip(theirs) {
            step_disturbed(&model, &mut ws, &mut state, command, &authors(), disturbance);
            for (w, (ours, key)) in
                worst.iter_mut().zip([(qpos(&state), "qpos"), (qvel(&state), "qvel")])
            {
                *w = w.max(largest_difference(&ours, &numbers(&theirs[key])));
            }
        }
        let drift = largest(&state.base_linear_velocity);
        eprintln!(
            "{}: position {:e}, velocity {:e}; drifts at {drift} m/s",
            robot.name, worst[0], worst[1]
        );
        assert!(drift > 1e-3, "it was pushed");
        assert!(worst.iter().all(|w| *w < 1e-6), "{}: {worst:?}", robot.name);
    }
}

/// Touching pairs around home, against MuJoCo's own tests of the same capsules, cylinders and boxes.
#[test]
fn touching_pairs_agree_with_mujoco() {
    let robot = Robot::builtin("release").unwrap();
    let mut noise = Noise(3);
    let poses: Vec<Vec<f64>> = (0..3000)
        .map(|_| robot.home_q().iter().map(|q| q + 0.8 * noise.normal()).collect())
        .collect();
    let stops: Vec<Value> = robot
        .description()
        .angle_contacts
        .iter()
        .map(|s| {
            json!({
                "pair": s.pair, "joint": s.joint, "interval": s.interval,
                "narrowing": s.narrowing, "narrowing_joint": s.narrowing_joint,
            })
        })
        .collect();
    let names: Vec<&str> = robot.arms.iter().map(|a| a.name.as_str()).collect();
    let answer = ask(&json!({
        "model": mjcf(&robot, MjcfOptions::default()),
        "touching": {
            "model": mjcf(&robot, MjcfOptions { contacts: true }),
            "poses": poses, "stops": stops, "arms": names,
        },
    }));
    let model = Model::<f64>::new(&robot);
    let mut ws = Workspace::new(&model);
    let mut state = State::<f64>::home(&robot);
    let (mut any, mut exact, mut ours_sum, mut theirs_sum) = (0, 0, 0.0, 0.0);
    for (pose, theirs) in poses.iter().zip(numbers(&answer["touching"])) {
        state.q.copy_from_slice(pose);
        let ours = count_contacts(&model, &mut ws, &state);
        any += usize::from((ours > 0.0) == (theirs > 0.0));
        exact += usize::from(ours == theirs);
        ours_sum += ours;
        theirs_sum += theirs;
    }
    let n = poses.len() as f64;
    eprintln!(
        "any contact agrees at {:.2} %, the number of pairs at {:.2} %; mean pairs {:.3} and {:.3}",
        100.0 * any as f64 / n,
        100.0 * exact as f64 / n,
        ours_sum / n,
        theirs_sum / n
    );
    assert!(theirs_sum > 0.3 * n, "too few contacts to compare");
    assert!(any as f64 >= 0.98 * n && exact as f64 >= 0.96 * n);
}

/// The authors' scheme.
fn authors() -> StepOptions {
    StepOptions {
        substep: 0.001,
        integrator: Integrator::Euler,
        contacts: false,
        ..StepOptions::default()
    }
}

/// Episodes in lanes: base and hands after each control step, `[episode][step][3 · (1 + arms)]`.
struct Episodes<'a> {
    robot: &'a Robot,
    commands: &'a [Vec<Vec<f64>>],
}

impl LaneFn for Episodes<'_> {
    type Output = Vec<Vec<Vec<f64>>>;
    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let robot = self.robot;
        let options = StepOptions { contacts: false, ..StepOptions::default() };
        let model = Model::<S>::new(robot);
        let mut ws = Workspace::new(&model);
        let mut hand = vec![Hand::default(); robot.n_arms];
        let mut out = vec![Vec::new(); self.commands.len()];
        for (group, commands) in self.commands.chunks(S::LANES).enumerate() {
            let mut state = State::<S>::home(robot);
            let mut command = vec![S::zero(); robot.n_joints()];
            for t in 0..commands[0].len() {
                for (j, c) in command.iter_mut().enumerate() {
                    for (i, episode) in commands.iter().enumerate() {
                        c.set_lane(i, episode[t][j]);
                    }
                }
                step(&model, &mut ws, &mut state, &command, &options);
                hands(&model, &mut ws, &state, &mut hand);
                for i in 0..commands.len() {
                    let points = std::iter::once(&state.base_position)
                        .chain(hand.iter().map(|h| &h.position));
                    out[group * S::LANES + i].push(points.flatten().map(|x| x.lane(i)).collect());
                }
            }
        }
        out
    }
}

fn points(robot: &Robot, commands: &[Vec<f64>], options: &StepOptions) -> Vec<Vec<f64>> {
    simulate(robot, commands, Precision::F64, options)
        .iter()
        .map(|row| row.state.base_position.iter().copied().chain(row.hands.concat()).collect())
        .collect()
}

/// Mean and 99th percentile of a sample.
fn summary(mut errors: Vec<f64>) -> (f64, f64) {
    errors.sort_by(f64::total_cmp);
    (mean(&errors), percentile(&errors, 0.99))
}

/// What training integrates (single precision, lanes, 16 ms) is nearer to the converged solution than the authors' own scheme: at base and
/// hands, mean and 99th percentile, over 64 episodes of 20 s with random commands.
#[test]
fn training_is_nearer_to_the_converged_solution_than_the_authors_scheme() {
    let robot = Robot::builtin("paper").unwrap();
    let mut noise = Noise(4);
    let commands: Vec<Vec<Vec<f64>>> =
        (0..64).map(|_| random_commands(&robot, 50, &mut noise)).collect();
    let training = dispatch(Episodes { robot: &robot, commands: &commands });
    // Fourth order: at 0.5 ms the error is below 1e-7 m, two thousand times less than what is compared.
    let converged = StepOptions { substep: 0.0005, contacts: false, ..StepOptions::default() };
    let solve = |options: StepOptions| -> Vec<Vec<Vec<f64>>> {
        // Two halves on two threads.
        std::thread::scope(|scope| {
            let halves: Vec<_> = commands
                .chunks(32)
                .map(|half| {
                    let robot = &robot;
                    scope.spawn(move || {
                        half.iter().map(|c| points(robot, c, &options)).collect::<Vec<_>>()
                    })
                })
                .collect();
            halves.into_iter().flat_map(|h| h.join().unwrap()).collect()
        })
    };
    let (truth, euler) = (solve(converged), solve(authors()));
    let errors = |runs: &[Vec<Vec<f64>>], part: std::ops::Range<usize>| {
        let mut out = Vec::new();
        for (run, truth) in runs.iter().zip(&truth) {
            for (row, exact) in run.iter().zip(truth) {
                for point in part.clone() {
                    let at = 3 * point..3 * point + 3;
                    let d: f64 =
                        row[at.clone()].iter().zip(&exact[at]).map(|(x, y)| (x - y).powi(2)).sum();
                    out.push(d.sqrt());
                }
            }
        }
        summary(out)
    };
    for (what, part) in [("base", 0..1), ("hands", 1..1 + robot.n_arms)] {
        let (ours, theirs) = (errors(&training, part.clone()), errors(&euler, part));
        eprintln!(
            "{what}: training {:.2e} m mean, {:.2e} m at 99 %; Euler 1 ms {:.2e}, {:.2e}",
            ours.0, ours.1, theirs.0, theirs.1
        );
        assert!(ours.0 <= theirs.0 && ours.1 <= theirs.1, "{what}: {ours:?} {theirs:?}");
    }
}

/// A policy of ours on MuJoCo's dynamics, fed by observations that were written from the guide: goal by goal it ends where it ends here. It acts beside goal
/// postures, which the exported C code finds.
#[test]
fn a_policy_with_goal_postures_ends_at_each_goal_in_mujoco_as_it_does_here() {
    let (n, worst) = ends_as_here(&tests::guide::repository().join("deploy/policies/trajectory"));
    assert_eq!(n, 8);
    eprintln!("{n} goals differ by at most {:.3} mm, {:.3} mrad", 1e3 * worst[0], 1e3 * worst[1]);
}

/// Holds 12 goals to what is the same; how many of them can be reached, and how far these are apart at most (m, rad).
fn ends_as_here(checkpoint: &Path) -> (usize, [f64; 2]) {
    let dir = tempfile::tempdir().unwrap();
    let [goals, model, controller] =
        ["goals.json", "robot.xml", "controller"].map(|name| dir.path().join(name));
    let octopus = |arguments: &[&str], files: &[&Path]| {
        let output =
            Command::new(tests::program("octopus")).args(arguments).args(files).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    let save = ["eval", "--episodes", "3", "--seed", "5", "--json", "--save-goals"];
    let ours = octopus(&save, &[&goals, checkpoint]);
    octopus(&["export", "--episodes", "1"], &[checkpoint, Path::new("--out"), &controller]);
    let robot = checkpoint.join("robot.toml");
    octopus(&["mjcf", "--contacts", "off", "--robot"], &[&robot, Path::new("--out"), &model]);
    let output = Command::new(tests::python())
        .arg(tests::crosscheck("mujoco_policy.py"))
        .args([checkpoint, &model, &goals, Path::new("--controller"), &controller])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let ours: Value = serde_json::from_slice(&ours).unwrap();
    let theirs: Value = serde_json::from_slice(&output.stdout).unwrap();
    let episodes = ours["episodes"].as_array().unwrap().iter().zip(theirs.as_array().unwrap());
    let reachable = ours["reachable"]["controller"].as_array().unwrap();
    let (mut differences, mut reached) = (Vec::new(), Vec::new());
    for ((ours, theirs), reachable) in episodes.zip(reachable) {
        assert_eq!(ours["contact_steps"], 0, "without contacts there is nothing to tell apart");
        let hands = ours["hands"].as_array().unwrap().iter().zip(theirs.as_array().unwrap());
        for ((ours, theirs), reachable) in hands.zip(reachable.as_array().unwrap()) {
            let tail = |error: &str| ours[error]["tail"].as_f64().unwrap();
            let difference = |error: &str| {
                let course = numbers(&theirs[error]);
                assert_eq!(course.len(), 200);
                mean(&course[180..]) - tail(error)
            };
            let both = [difference("position"), difference("orientation")];
            differences.push(both);
            // Hands that reach for what is out of their reach take the base along, here or there more.
            if reachable["reached"].as_bool().unwrap() {
                reached.push(both);
            }
        }
    }
    let of = |all: &[[f64; 2]], error: usize| -> Vec<f64> {
        all.iter().map(|both| both[error]).collect()
    };
    let [position, orientation] = [of(&differences, 0), of(&differences, 1)];
    assert_eq!(position.len(), 12);
    let worst = [largest(&of(&reached, 0)), largest(&of(&reached, 1))];
    // Time steps are 2 ms there and 16 ms here, which only tells where a hand is far from its goal and still moves.
    let typical = |differences: &[f64]| median(differences.iter().map(|d| d.abs()).collect());
    assert!(typical(&position) < 2e-4 && typical(&orientation) < 1e-3, "{differences:?}");
    assert!(worst[0] < 8e-3 && worst[1] < 25e-3, "{differences:?}");
    (reached.len(), worst)
}
