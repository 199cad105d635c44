//! What an instance of the module holds: an episode, snapshots of it, and the arrays that a page reads.

use std::path::Path;
use std::sync::Arc;

use proto::config::Config;
use proto::layout::ActorLayout;
use serde::de::DeserializeOwned;
use simulator::experiment::{Episode, Event, Member, Snapshot, Start};
use simulator::policy::file;
use simulator::robot::Robot;
use simulator::rollout::World;

use crate::arrays::Arrays;
use crate::{blocks, description};

/// The simulation of this instance; without an episode before the first policy.
#[derive(Debug, Default)]
pub(crate) struct Simulation {
    playing: Option<Playing>,
}

#[derive(Debug)]
struct Playing {
    episode: Episode,
    arrays: Arrays,
    snapshots: Vec<Snapshot>,
}

impl Simulation {
    fn playing(&mut self) -> Result<&mut Playing, String> {
        self.playing.as_mut().ok_or_else(|| "no policy is loaded yet".to_owned())
    }

    pub(crate) fn policy(
        &mut self,
        slot: Option<usize>,
        input: &[u8],
        config_len: usize,
        robot_len: usize,
    ) -> Result<usize, String> {
        let robot_end = config_len.checked_add(robot_len).filter(|&end| end <= input.len());
        let end = robot_end.ok_or("the input is shorter than configuration and robot")?;
        let config = utf8(&input[..config_len], "config.toml")?;
        let config = Config::from_resolved_toml(config, "config.toml").map_err(words)?;
        let own = utf8(&input[config_len..end], "robot.toml")?;
        let own = Robot::from_toml(own, Path::new("robot.toml")).map_err(words)?;
        let robot = match &self.playing {
            Some(playing) if own.joints == playing.episode.robot().joints => {
                playing.episode.robot().clone()
            }
            Some(playing) => {
                let joints = playing.episode.robot().joints;
                return Err(format!("the policy moves {}, the robot has {joints}", own.joints));
            }
            None => own,
        };
        let world = World::new(&config, &robot);
        let layout = ActorLayout::new(&config, &world.dimensions);
        let parameters = file::read(&input[end..], &layout).map_err(words)?;
        let policy = world.policy(&parameters).map_err(words)?;
        let member = Arc::new(Member { world, policy });
        if let Some(playing) = &mut self.playing {
            return playing.episode.seat(slot, member).map_err(words);
        }
        if slot.is_some_and(|slot| slot > 0) {
            return Err("the first policy has slot 0".to_owned());
        }
        let episode = Episode::new(vec![member], Start::default()).map_err(words)?;
        let mut arrays = Arrays::new(episode.robot());
        arrays.fill(&episode);
        self.playing = Some(Playing { episode, arrays, snapshots: Vec::new() });
        Ok(0)
    }

    pub(crate) fn retire(&mut self, slot: usize, successor: usize) -> Result<(), String> {
        let Playing { episode, snapshots, .. } = self.playing()?;
        episode.retire(slot, successor, snapshots).map_err(words)
    }

    pub(crate) fn reset(&mut self, json: &[u8]) -> Result<(), String> {
        let start: Start = parsed(json, "the start")?;
        self.change(|playing| playing.episode.reset(start).map_err(words))
    }

    pub(crate) fn event(&mut self, json: &[u8]) -> Result<(), String> {
        let event: Event = parsed(json, "the event")?;
        self.change(|playing| playing.episode.apply(&event).map_err(words))
    }

    pub(crate) fn step(&mut self) -> Result<(), String> {
        self.change(|playing| playing.episode.step().map_err(words))
    }

    pub(crate) fn restore(&mut self, number: usize) -> Result<(), String> {
        self.change(|playing| {
            let kept = playing.snapshots.len();
            let snapshot = playing.snapshots.get(number);
            let snapshot = snapshot.ok_or_else(|| format!("snapshot {number} of {kept}"))?;
            playing.episode.restore(snapshot).map_err(words)
        })
    }

    pub(crate) fn snapshot(&mut self) -> Result<usize, String> {
        let Playing { episode, snapshots, .. } = self.playing()?;
        snapshots.push(episode.snapshot());
        Ok(snapshots.len() - 1)
    }

    pub(crate) fn forget(&mut self, number: usize) {
        if let Some(playing) = &mut self.playing {
            playing.snapshots.truncate(number);
        }
    }

    pub(crate) fn describe(&mut self) -> Result<String, String> {
        let Playing { episode, arrays, .. } = self.playing()?;
        description::json(episode, arrays)
    }

    pub(crate) fn block(&mut self, json: &[u8]) -> Result<String, String> {
        let wanted = parsed(json, "the block")?;
        let Playing { episode, .. } = self.playing()?;
        blocks::make(&episode.members()[0], wanted)
    }

    /// Changes the episode and then fills the arrays.
    fn change(
        &mut self,
        work: impl FnOnce(&mut Playing) -> Result<(), String>,
    ) -> Result<(), String> {
        let playing = self.playing()?;
        work(playing)?;
        playing.arrays.fill(&playing.episode);
        Ok(())
    }
}

fn words(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn utf8<'a>(bytes: &'a [u8], what: &str) -> Result<&'a str, String> {
    std::str::from_utf8(bytes).map_err(|error| format!("{what}: {error}"))
}

fn parsed<T: DeserializeOwned>(json: &[u8], what: &str) -> Result<T, String> {
    // A list would be taken for the fields in their order.
    if json.trim_ascii_start().first() == Some(&b'[') {
        return Err(format!("{what}: a list, where an object or a word is expected"));
    }
    serde_json::from_slice(json).map_err(|error| format!("{what}: {error}"))
}

#[cfg(test)]
mod tests;
