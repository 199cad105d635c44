//! One control step worked through, for the guide: from a state and goals to observations and commands.
//!
//! Whoever writes an environment or a controller of their own compares with it. The state is no special one:
//! everything moves and everything is turned, so that a wrong axis, sign or order shows.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use proto::config::{Config, Inference};
use proto::layout::Dimensions;
use proto::rng::Purpose;
use serde::{Deserialize, Serialize};
use simulator::env::readings;
use simulator::policy::Scratch;
use simulator::robot::Robot;
use simulator::rollout::World;
use simulator::spatial::quaternion_exp;
use simulator::state::State;
use simulator::task::goal::GoalAddress;
use simulator::task::observation::observe;
use simulator::task::{Errors, Goals};

/// A pose: position in the world (m) and Euler angles (rad).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Pose {
    /// Position (m).
    pub position: [f64; 3],
    /// Euler angles (rad).
    pub euler: [f64; 3],
}

/// The robot at one moment, as sensors would tell it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Moment {
    /// The base's origin, the centre of the cube, in the world (m).
    pub base_position: [f64; 3],
    /// Attitude of the base, unit quaternion (w, x, y, z).
    pub base_quaternion: [f64; 4],
    /// Velocity of the base's origin, world axes (m/s).
    pub base_velocity: [f64; 3],
    /// Angular velocity of the base, its own axes (rad/s).
    pub base_angular_velocity: [f64; 3],
    /// Joint angles, arm after arm (rad).
    pub q: Vec<f64>,
    /// Joint rates, arm after arm (rad/s).
    pub qd: Vec<f64>,
    /// Last action of every joint: clipped, not scaled.
    pub last_action: Vec<f64>,
}

/// The example.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Example {
    /// Where the checkpoint lies, from the repository's root.
    pub policy: String,
    /// Name of its robot.
    pub robot: String,
    /// Joint angles at home, arm after arm (rad).
    pub home_q: Vec<f64>,
    /// Hands at home, one an arm.
    pub home_hands: Vec<Pose>,
    /// Where the robot is and how it moves.
    pub state: Moment,
    /// Where its hands are then.
    pub hands: Vec<Pose>,
    /// Where they shall go.
    pub goals: Vec<Pose>,
    /// Goal postures, an arm each: whether they bring the hand to its goal (1 or 0), whether they are free of stops, what is left to each joint (rad).
    pub postures: Vec<Vec<f64>>,
    /// What each agent sees, by agent and place.
    pub observations: Vec<Vec<f64>>,
    /// What the policy says, clipped, joint after joint.
    pub actions: Vec<f64>,
    /// The joint rates that it commands (rad/s).
    pub commands: Vec<f64>,
}

const POLICY: &str = "deploy/policies/trajectory";

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Where the example's numbers lie.
pub fn path() -> PathBuf {
    repository().join("deploy/policies/example.json")
}

/// Where the page about it lies.
pub fn page_path() -> PathBuf {
    repository().join("deploy/guide/src/environment-example.md")
}

impl Example {
    /// Works it out.
    pub fn compute() -> Result<Self> {
        let checkpoint = repository().join(POLICY);
        let read = |name: &str| {
            let path = checkpoint.join(name);
            std::fs::read_to_string(&path).with_context(|| path.display().to_string())
        };
        let robot = Robot::from_toml(&read("robot.toml")?, &checkpoint.join("robot.toml"))?;
        let mut config = Config::from_resolved_toml(&read("config.toml")?, POLICY)?;
        // Workers multiply bfloat16. Elsewhere single precision is what one has.
        config.network.inference = Inference::F32;
        let dimensions = Dimensions::new(&config, robot.joints);
        let layout = proto::layout::ActorLayout::new(&config, &dimensions);
        let parameters =
            store::checkpoint::read_policy(&checkpoint.join("policy.safetensors"), &layout)?;
        let world = World::new(&config, &robot);
        let policy = world.policy(&parameters)?;

        let home = &world.task.goals.home;
        let state = moving(&robot);
        let mut found = readings(&robot, &state);
        let limits = &world.task.action_limit;
        found.last_action = (0..limits.len()).map(|joint| wave(joint, 0.9, 0.6)).collect();

        let address =
            GoalAddress { seed: 0, purpose: Purpose::EvaluationGoal, iteration: 0, env: 0 };
        let mut goals = Goals::<f64>::at_home(&world.task.goals);
        for (arm, goal) in goals.hands.iter_mut().enumerate() {
            *goal = world.task.goals.hand(arm, address);
        }
        let mut errors = Errors::of(&world.task, &robot);
        errors.update(&found, &goals);

        let mut observations = Vec::new();
        let mut actions = Vec::new();
        let mut scratch = Scratch::new(&policy, 1);
        for agent in 0..dimensions.n_agents {
            let mut seen = vec![0.0; dimensions.observation];
            observe(&world.task, &found, &goals, &errors, agent, &mut seen);
            let mut mean = [0.0; 3];
            policy.mean(&[agent], &seen, &mut scratch, &mut mean);
            actions.extend(mean);
            observations.push(seen);
        }
        let actions = errors.acted(&world.task, &actions);
        let pose = |p: [f64; 6]| Pose { position: [p[0], p[1], p[2]], euler: [p[3], p[4], p[5]] };
        Ok(Self {
            policy: POLICY.to_owned(),
            robot: robot.name.clone(),
            home_q: robot.home_q(),
            home_hands: home
                .arms
                .iter()
                .map(|arm| Pose { position: arm.position, euler: arm.euler })
                .collect(),
            hands: found
                .hands
                .iter()
                .map(|hand| Pose { position: hand.position, euler: hand.euler })
                .collect(),
            goals: goals.hands.into_iter().map(pose).collect(),
            commands: actions.iter().map(|action| world.task.action_scale * action).collect(),
            actions,
            observations,
            postures: errors.postures().context("the policy knows goal postures")?,
            state: Moment {
                base_position: found.base_position,
                base_quaternion: found.base_quaternion,
                base_velocity: found.base_linear,
                base_angular_velocity: found.base_angular,
                q: found.q,
                qd: found.qd,
                last_action: found.last_action,
            },
        }
        .rounded())
    }

    /// The recorded one.
    pub fn read() -> Result<Self> {
        let text = std::fs::read_to_string(path()).context("run `make guide`")?;
        Ok(serde_json::from_str(&text)?)
    }

    /// Writes numbers and page.
    pub fn write(&self) -> Result<()> {
        std::fs::write(path(), serde_json::to_string_pretty(self)? + "\n")?;
        std::fs::write(page_path(), self.page()?)?;
        Ok(())
    }

    /// To nine digits after the point, far finer than single precision.
    fn rounded(mut self) -> Self {
        let round = |x: &mut f64| *x = (*x * 1e9).round() / 1e9 + 0.0;
        let Moment {
            base_position,
            base_quaternion,
            base_velocity,
            base_angular_velocity,
            q,
            qd,
            last_action,
        } = &mut self.state;
        let poses = [&mut self.home_hands, &mut self.hands, &mut self.goals];
        for pose in poses.into_iter().flatten() {
            pose.position.iter_mut().chain(&mut pose.euler).for_each(round);
        }
        let state: [&mut [f64]; 7] = [
            base_position,
            base_quaternion,
            base_velocity,
            base_angular_velocity,
            q,
            qd,
            last_action,
        ];
        state.into_iter().flatten().for_each(round);
        self.observations.iter_mut().flatten().for_each(round);
        self.postures.iter_mut().flatten().for_each(round);
        self.actions.iter_mut().chain(&mut self.commands).for_each(round);
        self
    }

    /// Largest difference to another one, over all numbers.
    pub fn distance(&self, other: &Self) -> Result<f64> {
        let (mine, others) =
            (numbers(&serde_json::to_value(self)?), numbers(&serde_json::to_value(other)?));
        ensure!(mine.len() == others.len(), "{} numbers and {}", mine.len(), others.len());
        Ok(mine.iter().zip(&others).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max))
    }

    /// The page of the guide.
    pub fn page(&self) -> Result<String> {
        let mut page = PAGE_HEAD.to_owned();
        let s = &self.state;
        let _ = writeln!(page, "## The state\n\n| | |\n|---|---|");
        for (what, numbers) in [
            ("position of the base, world (m)", list(&s.base_position)),
            ("attitude of the base, quaternion w x y z", list(&s.base_quaternion)),
            ("velocity of the base's origin, world axes (m/s)", list(&s.base_velocity)),
            ("angular velocity of the base, its own axes (rad/s)", list(&s.base_angular_velocity)),
        ] {
            let _ = writeln!(page, "| {what} | {numbers} |");
        }
        let _ = writeln!(
            page,
            "\n| arm | joint angles (rad) | joint rates (rad/s) | last action |\n|---|---|---|---|"
        );
        for arm in 0..self.hands.len() {
            let of = 6 * arm..6 * (arm + 1);
            let [q, qd, last] = [&s.q, &s.qd, &s.last_action].map(|all| list(&all[of.clone()]));
            let _ = writeln!(page, "| {} | {q} | {qd} | {last} |", arm + 1);
        }
        let _ = writeln!(
            page,
            "\n## Hands and goals\n\nPositions in the world (m), Euler angles (rad).\n\n\
             | arm | hand at home | hand now | goal |\n|---|---|---|---|"
        );
        for arm in 0..self.hands.len() {
            let [home, now, goal] = [&self.home_hands, &self.hands, &self.goals].map(|poses| {
                format!("{}; {}", list(&poses[arm].position), list(&poses[arm].euler))
            });
            let _ = writeln!(page, "| {} | {home} | {now} | {goal} |", arm + 1);
        }
        let _ = writeln!(
            page,
            "\n## Goal postures\n\nThey follow from joint angles, base and goals alone. `octopus_postures` of an exported controller and \
             `spaceoctopus.Postures` find them in single precision.\n\n\
             | arm | good | free | what is left to each joint (rad) |\n|---|---|---|---|"
        );
        for (arm, posture) in self.postures.iter().enumerate() {
            let [good, free, left @ ..] = posture.as_slice() else { continue };
            let _ = writeln!(page, "| {} | {good} | {free} | {} |", arm + 1, list(left));
        }
        let _ = writeln!(page, "\n## What the agents of arms 1 and 2 see\n");
        let _ = writeln!(
            page,
            "Both agents of an arm see the same. Arm 1's first axis is reversed, arm 2's is not.\n\n\
             | numbers | arm 1 | arm 2 |\n|---|---|---|"
        );
        for (what, from, to) in PARTS {
            let [one, two] = [0, 2].map(|agent| list(&self.observations[agent][from..to]));
            let _ = writeln!(page, "| {from}–{}: {what} | {one} | {two} |", to - 1);
        }
        let _ = writeln!(
            page,
            "\n## What the policy answers\n\n\
             | arm | actions, clipped | commands (rad/s): 0.8 × the actions |\n|---|---|---|"
        );
        for arm in 0..self.hands.len() {
            let of = 6 * arm..6 * (arm + 1);
            let (actions, commands) = (&self.actions[of.clone()], &self.commands[of]);
            let _ = writeln!(page, "| {} | {} | {} |", arm + 1, list(actions), list(commands));
        }
        Ok(page)
    }
}

const PAGE_HEAD: &str = "\
# A worked example

This page is made by our program with `make guide`, and a test keeps it current. Compare your own environment or controller with it:
take the state and the goals, and see whether you get the observations and the commands.

All numbers, for all four arms and to nine digits, are in
[`deploy/policies/example.json`](../../policies/example.json). The robot is `paper`, and the policy is `deploy/policies/trajectory`.
[The environment](environment.md) says what each number is.

The commands are those of single precision, as `actor.py` computes. Workers multiply in bfloat16, which moves an action by up to 0.02.

";

/// Parts of an observation: what, from where, to where.
const PARTS: [(&str, usize, usize); 16] = [
    ("velocity of the base", 0, 3),
    ("angular velocity of the base", 3, 6),
    ("sines of the joint angles less home", 6, 12),
    ("cosines of these", 12, 18),
    ("joint rates", 18, 24),
    ("position error of the hand", 24, 27),
    ("rotation error of the hand", 27, 30),
    ("tanh(position error / 0.05 m)", 30, 33),
    ("tanh(position error / 0.015 m)", 33, 36),
    ("tanh(rotation error / 0.08 rad)", 36, 39),
    ("tanh(rotation error / 0.025 rad)", 39, 42),
    ("goal posture: good, free", 42, 44),
    ("what is left to each joint", 44, 50),
    ("tanh(what is left / 0.1 rad)", 50, 56),
    ("last action, joints 1 to 3", 56, 59),
    ("last action, joints 4 to 6", 59, 62),
];

fn list(numbers: &[f64]) -> String {
    let numbers: Vec<String> = numbers.iter().map(|x| format!("{:.4}", x + 0.0)).collect();
    numbers.join(", ")
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Number(number) => number.as_f64().into_iter().collect(),
        serde_json::Value::Array(items) => items.iter().flat_map(numbers).collect(),
        serde_json::Value::Object(fields) => fields.values().flat_map(numbers).collect(),
        _ => Vec::new(),
    }
}

/// Numbers that look like none in particular, the same everywhere: hundredths from −`size` to `size`.
fn wave(index: usize, size: f64, phase: f64) -> f64 {
    let turns = (0.37 * index as f64 + phase).fract();
    ((2.0 * turns - 1.0) * size * 100.0).round() / 100.0
}

/// The robot on its way.
fn moving(robot: &Robot) -> State<f64> {
    let mut state = State::home(robot);
    state.base_position = [0.03, -0.02, 4.01];
    state.base_quaternion = quaternion_exp([0.06, -0.05, 0.08]);
    state.base_linear_velocity = [0.004, -0.006, 0.005];
    state.base_angular_velocity = [0.01, 0.02, -0.015];
    for (joint, (q, qd)) in state.q.iter_mut().zip(&mut state.qd).enumerate() {
        *q += wave(joint, 0.4, 0.1);
        *qd = wave(joint, 0.3, 0.3);
    }
    state
}
