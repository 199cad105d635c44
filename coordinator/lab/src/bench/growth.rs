//! How speed and size grow with environments, workers, arms and hidden width.

use std::path::Path;

use proto::layout::{ActorLayout, Dimensions};
use serde_json::{Map, Value, json};
use simulator::env::step_options;
use simulator::robot::description::RobotDescription;
use simulator::robot::{MAX_ARMS, Robot};
use simulator::step::StepOptions;

use super::context::Bench;
use super::figures::number;
use super::{learner, physics, rollout, train};

/// A quantity over another.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    /// Name of its file, and part of its keys.
    pub(super) name: &'static str,
    /// What runs along the abscissa.
    pub(super) over: &'static str,
    /// What is measured, with its unit.
    pub(super) unit: &'static str,
    /// Whether abscissa and ordinate are spaced by their logarithm.
    pub(super) logarithmic: [bool; 2],
    pub(super) series: Vec<Series>,
}

/// A line of a curve.
#[derive(Debug, Clone)]
pub(super) struct Series {
    /// Its key, less the curve's name.
    pub(super) name: &'static str,
    pub(super) points: Vec<(f64, f64)>,
}

const ROLLOUT_BY_ENVS: &str = "rollout_by_envs";
const PHYSICS_BY_ARMS: &str = "physics_by_arms";
const LEARNER_BY_HIDDEN: &str = "learner_by_hidden";
const CHECKPOINT_BY_HIDDEN: &str = "checkpoint_by_hidden";
const TRAIN_BY_WORKERS: &str = "train_by_workers";

/// What the curves are called.
pub(super) const NAMES: [&str; 5] =
    [ROLLOUT_BY_ENVS, PHYSICS_BY_ARMS, LEARNER_BY_HIDDEN, CHECKPOINT_BY_HIDDEN, TRAIN_BY_WORKERS];

const RATE: &str = "env-steps/s";
const RATE_PER_CORE: &str = "env-steps/s per core";
const COST: &str = "µs of a core per env-step";

/// Control steps of an episode, the same for any number of environments: bodies touch more often as an
/// episode goes on. Whole episodes of thousands of environments would take minutes.
const EPISODE_STEPS: usize = 16;

/// All curves.
pub(super) fn measure(bench: &Bench) -> anyhow::Result<Vec<Curve>> {
    let mut curves = vec![by_envs(bench)?, by_arms(bench)?];
    curves.extend(by_hidden(bench)?);
    curves.push(by_workers(bench)?);
    Ok(curves)
}

/// Rollout over the environments of a worker.
fn by_envs(bench: &Bench) -> anyhow::Result<Curve> {
    let steps = EPISODE_STEPS.min(bench.config.task.episode_steps);
    let mut points = Vec::new();
    for envs in [16, 64, 256, 1024, 4096] {
        bench.begin(&format!("rollout of {envs} environments"))?;
        let config = bench.config_with(&[
            "env.n_shards=1",
            &format!("env.n_envs={envs}"),
            &format!("task.episode_steps={steps}"),
            "algorithm.mini_batches=1",
        ])?;
        let rates = rollout::rates(bench, &config, &bench.robot, bench.seconds)?;
        points.push((f64::from(envs), rates.env_steps_per_s));
    }
    let series = vec![Series { name: "env_steps_per_s_per_core", points }];
    let logarithmic = [true, false];
    Ok(Curve {
        name: ROLLOUT_BY_ENVS,
        over: "environments",
        unit: RATE_PER_CORE,
        logarithmic,
        series,
    })
}

/// Cost of physics over the number of arms: a line without contacts; pairs that may touch grow with
/// its square.
fn by_arms(bench: &Bench) -> anyhow::Result<Curve> {
    let options = step_options(&bench.config);
    let (mut with, mut without) = (Vec::new(), Vec::new());
    let most = MAX_ARMS.min(2 * bench.robot.n_arms);
    for arms in 1..=most {
        bench.begin(&format!("physics of {arms} arms"))?;
        let robot = with_arms(&bench.robot, arms)?;
        for (points, contacts) in [(&mut with, true), (&mut without, false)] {
            let options = StepOptions { contacts, ..options };
            let (rate, _) = physics::rate(bench, &robot, options, bench.seconds)?;
            points.push((arms as f64, 1e6 / rate));
        }
    }
    let series = vec![
        Series { name: "us_per_env_step", points: with },
        Series { name: "without_contacts_us_per_env_step", points: without },
    ];
    let logarithmic = [false, false];
    Ok(Curve { name: PHYSICS_BY_ARMS, over: "arms", unit: COST, logarithmic, series })
}

/// The robot with `n` arms: its own first, then the same ones mirrored to the base's other end.
fn with_arms(robot: &Robot, n: usize) -> anyhow::Result<Robot> {
    let own = robot.description();
    let arms = (0..n)
        .map(|index| {
            let mut arm = own.arms[index % own.arms.len()].clone();
            if index >= own.arms.len() {
                arm.name = format!("{}_mirrored", arm.name);
                arm.mount_position[0] = -arm.mount_position[0];
            }
            arm
        })
        .collect();
    let description = RobotDescription { name: format!("{}_{n}", own.name), arms, ..own.clone() };
    Ok(Robot::from_description(description, Path::new("growth"))?)
}

/// Updates and checkpoints over the width of two hidden layers.
fn by_hidden(bench: &Bench) -> anyhow::Result<[Curve; 2]> {
    let (mut rates, mut bytes) = (Vec::new(), Vec::new());
    for width in [64, 128, 256, 512, 1024] {
        bench.begin(&format!("learner 2x{width}"))?;
        let config = bench.config_with(&[&format!("network.hidden=[{width},{width}]")])?;
        let update = learner::update(bench, &config, false)?;
        let dimensions = Dimensions::new(&config, bench.robot.joints);
        let policy = 4.0 * ActorLayout::new(&config, &dimensions).len as f64;
        rates.push((f64::from(width), update.env_steps_per_s));
        bytes.push((f64::from(width), update.state_bytes + policy));
    }
    let curve = |name, unit, series, points| Curve {
        name,
        over: "width of two hidden layers",
        unit,
        logarithmic: [true, true],
        series: vec![Series { name: series, points }],
    };
    Ok([
        curve(LEARNER_BY_HIDDEN, RATE, "env_steps_per_s", rates),
        curve(CHECKPOINT_BY_HIDDEN, "bytes", "bytes", bytes),
    ])
}

/// A whole training over the number of workers.
fn by_workers(bench: &Bench) -> anyhow::Result<Curve> {
    let mut points = Vec::new();
    for workers in [1, 2, 4, 8] {
        bench.begin(&format!("training with {workers} workers"))?;
        points.push((workers as f64, train::training(bench, workers)?.env_steps_per_s));
    }
    let series = vec![Series { name: "env_steps_per_s", points }];
    let logarithmic = [true, false];
    Ok(Curve { name: TRAIN_BY_WORKERS, over: "workers", unit: RATE, logarithmic, series })
}

/// One key a series: `growth.CURVE.SERIES`, a list of pairs.
pub(super) fn to_json(curves: &[Curve]) -> Value {
    let mut object = Map::new();
    for curve in curves {
        for series in &curve.series {
            let points: Vec<_> = series.points.iter().map(|(x, y)| json!([x, y])).collect();
            object.insert(format!("growth.{}.{}", curve.name, series.name), points.into());
        }
    }
    object.into()
}

/// For people.
pub(super) fn table(curves: &[Curve]) -> String {
    let rows = curves.iter().flat_map(|curve| {
        curve.series.iter().flat_map(move |series| {
            let first = series.points.first().map_or(1.0, |point| point.1);
            series.points.iter().map(move |(x, y)| {
                [
                    format!("{}.{}", curve.name, series.name),
                    format!("{x} {}", curve.over),
                    number(*y),
                    format!("{:.2}×", y / first),
                ]
            })
        })
    });
    output::table(["curve", "at", "measured", "to the first"], rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arms_beyond_the_robots_own_stand_at_the_other_end() {
        let robot = Robot::builtin("paper").expect("built in");
        for n in 1..=8 {
            assert_eq!(with_arms(&robot, n).expect("valid").n_arms, n);
        }
        let eight = with_arms(&robot, 8).expect("valid");
        let arms = &eight.description().arms;
        assert_eq!(arms[7].mount_position[0], -arms[3].mount_position[0]);
        assert_eq!(arms[7].mount_position[1..], arms[3].mount_position[1..]);
    }

    #[test]
    fn a_series_is_a_list_of_pairs() {
        let series = vec![Series { name: "rate", points: vec![(1.0, 10.0), (2.0, 15.0)] }];
        let logarithmic = [true, false];
        let curve = Curve { name: "by_x", over: "x", unit: "1/s", logarithmic, series };
        let expected = json!({ "growth.by_x.rate": [[1.0, 10.0], [2.0, 15.0]] });
        assert_eq!(to_json(std::slice::from_ref(&curve)), expected);
        assert!(table(&[curve]).contains("1.50×"));
    }
}
