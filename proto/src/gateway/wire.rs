//! What hub and host say to each other beside orders and blocks.
//!
//! The first words of a host and the answer to them are JSON, so that programs of any two versions can tell that they
//! do not fit; all else is the encoding of [`message`](crate::message), between programs of one build.

use serde::{Deserialize, Serialize};

use crate::layout::layout_hash;
use crate::message::{HostId, RunEnd};

/// What a host says of itself when it wants to join.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// What the machine calls itself.
    pub name: String,
    /// How many workers it has.
    pub workers: u32,
    /// Which programs it has.
    pub build: Build,
    /// The type of its processor: name and vector instructions.
    #[serde(default)]
    pub processor: String,
}

/// What must be the same on both ends, so that they understand each other and make the same bits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// Version of the programs.
    pub version: String,
    /// [`layout_hash`] of blocks and messages.
    pub layout: String,
    /// BLAKE3 of the program `sim-worker`.
    pub sim_worker: String,
}

impl Build {
    /// Of this program and a `sim-worker`, which is read to its end.
    pub fn of(mut sim_worker: impl std::io::Read) -> std::io::Result<Self> {
        let mut hasher = blake3::Hasher::new();
        std::io::copy(&mut sim_worker, &mut hasher)?;
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            layout: layout_hash(),
            sim_worker: hasher.finalize().to_hex().to_string(),
        })
    }

    /// What differs in `other`, for its owner to read.
    pub fn difference(&self, other: &Self) -> Option<String> {
        let differs = |what: &str, here: &str, there: &str| {
            (here != there).then(|| format!("{what} is {here} at the run and {there} here"))
        };
        let short = |digest: &str| digest.chars().take(16).collect::<String>();
        differs("the version of the programs", &self.version, &other.version)
            .or_else(|| differs("the layout of blocks and messages", &self.layout, &other.layout))
            .or_else(|| {
                let (here, there) = (short(&self.sim_worker), short(&other.sim_worker));
                differs("the digest of the program sim-worker", &here, &there)
            })
    }
}

/// What the hub answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// The host is taken in.
    Welcome(Welcome),
    /// It is not; here is why and what to do.
    Refused(String),
}

/// What a host needs to know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// Name of the hub's life, part of all keys.
    pub session: String,
    /// The host's number, never given twice in a session.
    pub host: HostId,
    /// The run's `config.toml`.
    pub config: String,
    /// The run's `robot.toml`.
    pub robot: String,
    /// BLAKE3 of both texts, one after the other.
    pub digest: String,
}

impl Welcome {
    /// [`Self::digest`] of two texts.
    pub fn digest_of(config: &str, robot: &str) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(config.as_bytes()).update(robot.as_bytes());
        hasher.finalize().to_hex().to_string()
    }
}

/// What the hub says twice a second and whenever there is a new policy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HubBeat {
    /// Name of its life.
    pub session: String,
    /// Policies that can be had, oldest first.
    pub policies: Vec<u64>,
    /// Hosts that it knows, and how many workers each is to have; one that finds itself forgotten has to join again.
    pub hosts: Vec<(HostId, u32)>,
    /// Whether the run has come to its end, and to which.
    pub end: Option<RunEnd>,
}

/// What a host says twice a second and whenever it changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostBeat {
    /// Numbers of its workers that have been ready, from 0.
    pub workers: Vec<u32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_named() {
        let one = Build { version: "1".into(), layout: "ab".into(), sim_worker: "0".repeat(64) };
        assert_eq!(one.difference(&one), None);
        let told = |other: Build| one.difference(&other).expect("differs");
        let version = told(Build { version: "2".into(), layout: "cd".into(), ..one.clone() });
        assert_eq!(version, "the version of the programs is 1 at the run and 2 here");
        let program = told(Build { sim_worker: "1".repeat(64), ..one.clone() });
        assert!(program.contains("sim-worker is 0000000000000000 at the run"), "{program}");
    }

    /// Another version must be able to read them.
    #[test]
    fn the_first_words_are_json() {
        let build = Build { version: "1".into(), layout: "ab".into(), sim_worker: "c".into() };
        let hello = Hello { name: "n".into(), workers: 2, build, processor: "p".into() };
        let text = serde_json::to_string(&hello).expect("JSON");
        assert_eq!(
            text,
            r#"{"name":"n","workers":2,"build":{"version":"1","layout":"ab","sim_worker":"c"},"processor":"p"}"#
        );
        let refused = serde_json::to_string(&Answer::Refused("why".into())).expect("JSON");
        assert_eq!(refused, r#"{"refused":"why"}"#);
    }
}
