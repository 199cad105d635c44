//! Recordings for robot viewers, of whomever: whatever they hold, nothing panics, and ours say what they are.

#![no_main]

use export::{RecordedEpisode, Recording};
use libfuzzer_sys::fuzz_target;
use simulator::experiment::{Member, Start};
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::World;

fn seeds() -> Vec<Vec<u8>> {
    let config = fuzz::small_config();
    let world = World::new(&config, &Robot::builtin("paper").expect("built in"));
    let parameters = initial_parameters(&config, &world.dimensions, 1);
    let policy = world.policy(&parameters).expect("a policy");
    let origin = [("checkpoint", "runs/a".to_owned()), ("digest", "0".repeat(32))];
    let start = Start { seed: 4, episode: 2, ..Start::default() };
    let recording = Recording::play(Member { world, policy }, start, 1, &origin);
    let file = recording.and_then(|recording| recording.mcap()).expect("a recording");
    let episode = RecordedEpisode::of(&file).expect("one of ours");
    assert_eq!((episode.seed, episode.episode, episode.steps), (4, 2, 1));
    assert_eq!(episode.checkpoint, "runs/a");
    vec![file]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let _ = RecordedEpisode::of(bytes);
    }
);
