//! Turning bases of other masses.

use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use serde_json::json;

use super::lab::{Lab, Needs};
use super::report::{ErrorOfMany, milli, share};
use crate::cli::experiment::BaseMassArgs;
use crate::output;

/// Episodes for each mass, as in the released protocol.
const EPISODES: u32 = 50;

/// How well a base of some mass turns.
#[derive(Debug, Serialize)]
struct Weighed {
    /// Of the cube (kg).
    mass: f64,
    /// Of the whole robot (kg).
    total_mass: f64,
    error: ErrorOfMany,
    /// Shares of episodes whose last error is below each threshold, in their order.
    success: Vec<f64>,
}

/// Measures and prints.
pub(super) fn run(args: &BaseMassArgs) -> anyhow::Result<()> {
    let lab = Lab::new(&args.common, Needs::Reorientation, Some(EPISODES))?;
    let usage = |message: String| ExitError::new(ExitCode::Usage, message);
    if args.masses.0.contains(&0.0) {
        return Err(
            usage("--masses: a base without mass has no inertia; leave 0 out".to_owned()).into()
        );
    }
    if args.thresholds.0.contains(&0.0) {
        return Err(usage("--thresholds: no error is below 0; leave it out".to_owned()).into());
    }
    let thresholds = &args.thresholds.0;
    let mut results = Vec::new();
    for &mass in &args.masses.0 {
        let robot = lab.robot.with_base_mass(mass)?;
        let mut trial = lab.trial(lab.policy(TaskName::Reorientation));
        trial.robot = &robot;
        let recording = lab.play(&format!("base mass, {mass} kg"), &trial)?;
        let last = recording.steps() - 1;
        let reached = |threshold: &f64| {
            share(recording.episodes(), |e| f64::from(recording.attitude(e, last)) < *threshold)
        };
        results.push(Weighed {
            mass,
            total_mass: robot.total_mass(),
            error: ErrorOfMany::base(&recording),
            success: thresholds.iter().map(reached).collect(),
        });
    }
    let table = format!(
        "{} each; success is judged after the last step\n{}",
        output::counted(lab.episodes as u64, "episode"),
        table(&results, thresholds)
    );
    let settings = json!({
        "thresholds_rad": thresholds, "masses_kg": args.masses.0,
        "mass": "of the base's first box; its inertia scales along",
    });
    lab.print("base-mass", settings, &results, &table)
}

/// A row a mass and threshold would be long, so thresholds share a column.
fn table(results: &[Weighed], thresholds: &[f64]) -> String {
    let within: Vec<String> = thresholds.iter().map(|t| format!("{:.0}", 1e3 * t)).collect();
    let success = format!("% within {} mrad", within.join(" / "));
    let rows = results.iter().map(|result| {
        let ErrorOfMany { last, .. } = &result.error;
        let shares: Vec<String> =
            result.success.iter().map(|share| format!("{:.0}", 100.0 * share)).collect();
        let [mean, p50, p90] = [last.mean, last.p50, last.p90].map(milli);
        [format!("{} kg", result.mass), mean, p50, p90, shares.join(" / ")]
    });
    output::table(["base", "final (mrad)", "p50", "p90", &success], rows)
}
