//! Errors against noise, disturbing torques, delay and mass of the arms.

use std::ffi::OsString;

use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::evaluate::Evaluation;
use simulator::experiment::{Effect, Intervention, SensorNoise};

use super::command_line::{list_option, option, path_option};
use super::common::{Beside, Common};
use super::lab::{Lab, Needs};
use super::report::{Report, Words};
use super::{Experiment, Name};
use crate::contender::Contender;
use crate::evaluation::{ErrorSummary, Success, Summary};
use crate::statistics::{milli, percent};

/// Standard deviations of sensors of strength 1: 1 mm, 1 mrad, 1 mm/s, 1 mrad/s.
const UNIT: f64 = 1e-3;
/// Longest delay (control steps).
const MAX_DELAY: f64 = 100.0;

/// What is made worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Strength of the sensors' errors.
    Sensors,
    /// Standard deviation of torques at the joints (N m).
    JointTorque,
    /// Control steps that commands come late.
    Delay,
    /// Multiple of the arms' mass.
    ArmMass,
}

/// Errors at one strength.
#[derive(Debug, Serialize, Deserialize)]
pub struct Point {
    pub(crate) task: TaskName,
    /// Who, if it was none of the policies: see [`Study::beside`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) by: Option<String>,
    pub(crate) quantity: Quantity,
    pub(crate) strength: f64,
    /// All hands together, or the base.
    pub(crate) errors: Vec<ErrorSummary>,
    /// Each agent alone.
    agents: Vec<ErrorSummary>,
    success: Vec<Success>,
    contact_rate: f64,
}

/// What is made worse, and by how much.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    sensors: Sensors,
    joint_torque: Words,
    delay: Words,
    arm_mass: Words,
    strengths: Vec<Sweep>,
}

/// Errors of sensors of strength 1.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensors {
    position_m: f64,
    angle_rad: f64,
    velocity_m_s: f64,
    rate_rad_s: f64,
    meaning: Words,
}

/// The strengths of a quantity.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    quantity: Quantity,
    strengths: Vec<f64>,
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// Strengths of the sensors' errors.
    pub sensors: Vec<f64>,
    /// Standard deviations of the joints' torques (N m).
    pub torques: Vec<f64>,
    /// Control steps that commands come late.
    pub delays: Vec<f64>,
    /// Multiples of the arms' mass.
    pub arm_masses: Vec<f64>,
    /// Who is measured beside the policies.
    pub beside: Vec<Beside>,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self {
            common: Common::default(),
            sensors: vec![0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            torques: vec![0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            delays: vec![0.0, 1.0, 2.0],
            arm_masses: vec![0.5, 0.75, 1.0, 1.5, 2.0, 3.0],
            beside: Vec::new(),
        }
    }
}

impl Study {
    fn sweeps(&self) -> [(Quantity, &[f64]); 4] {
        [
            (Quantity::Sensors, &self.sensors[..]),
            (Quantity::JointTorque, &self.torques[..]),
            (Quantity::Delay, &self.delays[..]),
            (Quantity::ArmMass, &self.arm_masses[..]),
        ]
    }
}

impl Experiment for Study {
    const NAME: Name = Name::Noise;
    const NEEDS: Needs = Needs::Any;
    type Settings = Settings;
    type Result = Point;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        let mut options = vec![
            list_option("--sensors", &self.sensors),
            list_option("--torques", &self.torques),
            list_option("--delays", &self.delays),
            list_option("--arm-masses", &self.arm_masses),
        ];
        options.extend(self.beside.iter().map(|other| match other {
            Beside::Controller(name) => option("--beside", name.as_str()),
            Beside::Policy(path) => path_option("--beside", path),
        }));
        options
    }

    fn lab(&self) -> anyhow::Result<Lab> {
        Lab::new(&self.common, Self::NEEDS, Self::EPISODES)?.measure_beside(&self.beside)
    }

    #[cfg(test)]
    fn resting_lab(&self) -> Lab {
        let lab = Lab::resting(&self.common, Self::NEEDS, Self::EPISODES);
        lab.measure_beside(&self.beside).expect("controllers alone")
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        let usage = |message: String| Err(ExitError::new(ExitCode::Usage, message).into());
        let whole = |delay: &f64| delay.fract() == 0.0 && *delay <= MAX_DELAY;
        if let Some(delay) = self.delays.iter().find(|delay| !whole(delay)) {
            return usage(format!(
                "--delays: {delay} is no whole number of steps up to {MAX_DELAY}"
            ));
        }
        for &factor in &self.arm_masses {
            lab.check_fit(&lab.robot.with_arm_mass(factor)?, &format!("--arm-masses {factor:?}"))?;
        }
        let sweep = |(quantity, strengths): (Quantity, &[f64])| Sweep {
            quantity,
            strengths: strengths.to_vec(),
        };
        Ok(Settings {
            sensors: Sensors {
                position_m: UNIT,
                angle_rad: UNIT,
                velocity_m_s: UNIT,
                rate_rad_s: UNIT,
                meaning: "standard deviations at strength 1, each axis and control step".into(),
            },
            joint_torque: "standard deviation (N m) at every joint, drawn in each control step"
                .into(),
            delay: "control steps from an action to its execution".into(),
            arm_mass: "multiple of mass and inertia of all moving links; drives stay".into(),
            strengths: self.sweeps().map(sweep).into(),
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        let points: usize = self.sweeps().iter().map(|(_, strengths)| strengths.len()).sum();
        lab.work((lab.policies().len() + lab.beside().len()) * points, 0)
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Point>> {
        let mut results = Vec::new();
        let beside = lab.beside().iter().map(|(name, policy)| (Some(name.as_str()), policy));
        for (by, policy) in lab.policies().iter().map(|policy| (None, policy)).chain(beside) {
            for (quantity, strengths) in self.sweeps() {
                for &strength in strengths {
                    results.push(measure(lab, by, policy, quantity, strength)?);
                }
            }
        }
        Ok(results)
    }

    fn table(columns: usize, report: &Report<Settings, Point>) -> String {
        table(columns, &report.results, report.protocol.episodes)
    }
}

fn measure(
    lab: &Lab,
    by: Option<&str>,
    policy: &Contender,
    quantity: Quantity,
    strength: f64,
) -> anyhow::Result<Point> {
    let mut trial = lab.trial(policy);
    let robot;
    match quantity {
        Quantity::Sensors => {
            let std = UNIT * strength;
            trial.sensors = SensorNoise { position: std, angle: std, velocity: std, rate: std };
        }
        Quantity::JointTorque if strength > 0.0 => {
            let steps = 0..trial.steps;
            let effect = Effect::JointTorque { std: strength };
            trial.interventions.push(Intervention { steps, effect });
        }
        Quantity::JointTorque => {}
        Quantity::Delay => trial.delay = strength as usize,
        Quantity::ArmMass => {
            robot = lab.robot.with_arm_mass(strength)?;
            trial.robot = &robot;
        }
    }
    let what = trial_of(policy.task(), by, quantity, strength);
    let recording = match by {
        None => lab.play(&what, &trial)?,
        Some(_) => lab.play_beside(&what, &trial)?,
    };
    let summary = Summary::new(
        policy.identity(),
        lab.seed,
        lab.own_goals(),
        Evaluation::of(&recording),
        None,
    );
    Ok(Point {
        task: policy.task(),
        by: by.map(str::to_owned),
        quantity,
        strength,
        errors: summary.overall,
        agents: summary.agents,
        success: summary.success,
        contact_rate: summary.contact_rate,
    })
}

/// What a trial is called.
fn trial_of(task: TaskName, by: Option<&str>, quantity: Quantity, strength: f64) -> String {
    let who = by.map_or_else(String::new, |by| format!(" by {by}"));
    format!("noise, {}{who}, {} {strength}", task.as_str(), quantity.word())
}

impl Point {
    /// What its trial is called.
    pub(crate) fn trial(&self) -> String {
        trial_of(self.task, self.by.as_deref(), self.quantity, self.strength)
    }
}

impl Quantity {
    fn word(self) -> &'static str {
        match self {
            Self::Sensors => "sensors",
            Self::JointTorque => "torque",
            Self::Delay => "delay",
            Self::ArmMass => "arm mass",
        }
    }

    fn describe(self, strength: f64) -> String {
        match self {
            Self::Sensors => format!("sensors {strength} mm, mrad"),
            Self::JointTorque => format!("torque {strength} N m"),
            Self::Delay => format!("delay {strength}"),
            Self::ArmMass => format!("arm mass × {strength}"),
        }
    }
}

fn table(columns: usize, results: &[Point], episodes: usize) -> String {
    let rows = results.iter().flat_map(|point| {
        point.errors.iter().map(move |error| {
            let what = point.quantity.describe(point.strength);
            let who = point.by.as_ref().map_or_else(String::new, |by| format!("{by}: "));
            let name = format!("{who}{what}, {} (m{})", error.error, error.unit);
            let [mean, p50, p90] = [error.tail.mean, error.tail.p50, error.tail.p90].map(milli);
            let success = point.success.last().map_or(f64::NAN, |success| success.goals);
            [name, mean, p50, p90, percent(success)]
        })
    });
    let header = ["tail", "mean", "p50", "p90", "success"];
    format!(
        "{} each; success at the paper's 25 mm and 40 mrad, of the base 30 mrad\n{}",
        output::counted(episodes as u64, "episode"),
        output::table_within(columns, header, rows)
    )
}
