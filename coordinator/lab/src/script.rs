//! An episode that somebody took hold of, played again from what was written down of it.

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::experiment::{Episode, Member, Script};
use simulator::robot::Robot;
use simulator::simulate::SimulationRow;
use store::checkpoint::Checkpoint;
use store::regular_files;

use crate::trained::Trained;

/// Longest file that is read (bytes).
const MAX_BYTES: u64 = 64 << 20;
/// Most control steps that a script may have: those of a day and a half.
const MOST_STEPS: usize = 1_000_000;

/// What the page saves: an episode, and which policies took part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// In the order in which the script counts them.
    #[serde(default)]
    pub policies: Vec<TookPart>,
    /// The episode.
    pub script: Script,
}

/// A policy that took part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TookPart {
    /// What it was called.
    pub name: String,
    /// Digest of its checkpoint.
    #[serde(default)]
    pub digest: String,
}

impl Recording {
    /// As it stands in the fragment of an address of the page, after `play=`: JSON, deflated, in base64.
    pub fn fragment(&self) -> anyhow::Result<String> {
        let mut packed = DeflateEncoder::new(Vec::new(), Compression::best());
        packed.write_all(&serde_json::to_vec(self)?)?;
        Ok(URL_SAFE_NO_PAD.encode(packed.finish()?))
    }

    /// Refuses policies that are not those that took part.
    ///
    /// # Errors
    /// Which one is missing or another, in words.
    pub fn check(&self, policies: &[&Checkpoint]) -> Result<(), String> {
        for (number, TookPart { name, digest: wanted }) in self.policies.iter().enumerate() {
            let words = format!("wants policy {number}, `{name}` of digest {wanted}");
            let Some(given) = policies.get(number) else {
                return Err(format!("{words}; name it with --policy"));
            };
            let digest = given.manifest.digest;
            if !wanted.is_empty() && *wanted != digest.to_string() {
                return Err(format!("{words}; {} has the digest {digest}", given.dir.display()));
            }
        }
        Ok(())
    }
}

/// Reads a recording.
pub fn read(path: &Path) -> Result<Recording, ExitError> {
    let bad =
        |what: String| ExitError::new(ExitCode::BadInput, format!("{}: {what}", path.display()));
    let bytes = regular_files::read(path, MAX_BYTES)
        .map_err(|error| bad(format!("cannot be read: {error}")))?;
    parse(&bytes).map_err(bad)
}

/// The recording in the text of a file.
///
/// # Errors
/// What is wrong with it, in words.
pub fn parse(text: &[u8]) -> Result<Recording, String> {
    let wrong = |error: serde_json::Error| format!("is no recording of an episode: {error}");
    let value: serde_json::Value = serde_json::from_slice(text).map_err(wrong)?;
    // Of the two forms the one that it means tells what is wrong with it.
    let recording = if value.get("script").is_some() {
        serde_json::from_value(value).map_err(wrong)?
    } else {
        let script = serde_json::from_value(value).map_err(wrong)?;
        Recording { policies: Vec::new(), script }
    };
    let Recording { script: Script { steps, .. }, .. } = recording;
    if steps > MOST_STEPS {
        return Err(format!("has {steps} control steps; at most {MOST_STEPS} are played"));
    }
    Ok(recording)
}

/// An episode that was played.
#[derive(Debug, Serialize)]
pub struct Played {
    /// Control steps.
    pub steps: usize,
    /// BLAKE3 of all states, the start first: the numbers of each as little-endian f32 in the order of a script's `start.state`.
    pub states_blake3: String,
    /// Distance of each hand from its goal at the end (m).
    pub position_m: Vec<f32>,
    /// Likewise, norm of the Euler-angle difference (rad).
    pub orientation_rad: Vec<f32>,
    /// Norm of the base's Euler-angle difference at the end (rad).
    pub base_rad: f32,
    /// Control steps that end in a contact.
    pub contact_steps: usize,
    /// States after each control step.
    #[serde(skip)]
    pub rows: Vec<SimulationRow>,
    /// The robot.
    #[serde(skip)]
    pub robot: Robot,
}

/// Policies on one robot: this one, or that of the first, as the page puts those on it that come later.
///
/// # Errors
/// If a policy is none for that robot.
pub fn on_one_robot(
    checkpoints: Vec<Checkpoint>,
    robot: Option<&Robot>,
) -> anyhow::Result<Vec<Trained>> {
    let mut policies: Vec<Trained> = Vec::with_capacity(checkpoints.len());
    for checkpoint in checkpoints {
        let robot = robot.or_else(|| policies.first().map(|first| &first.world.robot));
        let policy = Trained::new(checkpoint, robot)?;
        policies.push(policy);
    }
    Ok(policies)
}

/// Plays a recording with these policies, which must be those that took part.
///
/// # Errors
/// If a policy is another, or the script asks for what cannot be.
pub fn play(
    recording: &Recording,
    policies: Vec<Trained>,
    shown: &Path,
) -> Result<Played, ExitError> {
    let bad =
        |what: String| ExitError::new(ExitCode::BadInput, format!("{}: {what}", shown.display()));
    let given: Vec<&Checkpoint> = policies.iter().map(|policy| &policy.checkpoint).collect();
    recording.check(&given).map_err(bad)?;
    let members: Vec<Arc<Member>> = policies
        .into_iter()
        .map(|Trained { world, policy, .. }| Arc::new(Member { world, policy }))
        .collect();
    let joints = members[0].world.dimensions.joints;
    if let Some(other) = members.iter().find(|member| member.world.dimensions.joints != joints) {
        let message = format!(
            "its policies are for robots with {joints} and with {}; all play on one robot",
            other.world.dimensions.joints
        );
        return Err(bad(message));
    }
    let mut episode = Episode::new(members, recording.script.start.clone())
        .map_err(|error| bad(format!("start: {error}")))?;
    let (mut hash, mut rows, mut contact_steps) = (blake3::Hasher::new(), Vec::new(), 0);
    let after = &mut |episode: &Episode| {
        let state = episode.state();
        for number in state.parts().into_iter().flatten() {
            hash.update(&number.to_le_bytes());
        }
        if episode.steps() > 0 {
            let contacts = episode.touching().pairs as u32;
            contact_steps += usize::from(contacts > 0);
            rows.push(SimulationRow {
                t: episode.steps() as f64 * episode.control_period(),
                state: state.lane(0),
                hands: episode.hands().iter().map(|hand| hand.position.map(f64::from)).collect(),
                contacts,
            });
        }
    };
    episode.play(&recording.script, after).map_err(|error| bad(error.to_string()))?;
    let errors = episode.errors();
    Ok(Played {
        steps: episode.steps(),
        states_blake3: hash.finalize().to_hex().to_string(),
        position_m: errors.position_norm.clone(),
        orientation_rad: errors.orientation_norm.clone(),
        base_rad: errors.base_norm,
        contact_steps,
        rows,
        robot: episode.robot().clone(),
    })
}

impl Played {
    /// As a person reads it.
    pub fn table(&self) -> String {
        let milli = |value: f32| crate::statistics::milli(f64::from(value));
        let hands = self.position_m.iter().zip(&self.orientation_rad).enumerate();
        let mut rows: Vec<[String; 2]> = hands
            .map(|(arm, (&position, &orientation))| {
                let left = format!("{} mm, {} mrad", milli(position), milli(orientation));
                [format!("hand {}, from its goal", arm + 1), left]
            })
            .collect();
        rows.extend([
            ["base, from its goal".to_owned(), format!("{} mrad", milli(self.base_rad))],
            ["control steps".to_owned(), output::grouped(self.steps as u64)],
            ["… in contact".to_owned(), output::grouped(self.contact_steps as u64)],
            ["BLAKE3 of all states".to_owned(), self.states_blake3.clone()],
        ]);
        output::table(["at the end", "value"], rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trained::open_checkpoint;

    /// As the page has it, which puts every policy on the robot that is there.
    #[test]
    fn later_policies_play_on_the_robot_of_the_first() {
        let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/policies");
        let first = open_checkpoint(&policies.join("trajectory")).expect("it is there");
        let release = Robot::builtin("release").expect("built in");
        let mut second = first.clone();
        second.robot_toml = release.to_toml();
        let robots = |robot: Option<&Robot>| -> Vec<Robot> {
            let policies = on_one_robot(vec![first.clone(), second.clone()], robot);
            policies.expect("as many arms").into_iter().map(|policy| policy.world.robot).collect()
        };
        let [one, other] = robots(None).try_into().expect("two");
        assert_eq!(one, other);
        assert_ne!(one, release);
        assert_eq!(robots(Some(&release)), [release.clone(), release.clone()]);
    }
}
