//! Recordings for robot viewers, of whomever: whatever they hold, nothing panics, ours say what they are, and what is taken can be played again.

#![no_main]

use export::{Commanded, Recorded, RecordedEpisode, Recording, replay_motion};
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
    let start = Start { seed: 4, episode: 2, ..Start::default() };
    let commanded = Commanded::by_policy(Member { world, policy }, start, 1).expect("an episode");
    let origin = [
        ("seed", "4".to_owned()),
        ("episode", "2".to_owned()),
        ("checkpoint", "runs/a".to_owned()),
        ("digest", "0".repeat(32)),
    ];
    let recording = Recording::of(commanded, &origin);
    let file = recording.and_then(|recording| recording.mcap()).expect("a recording");
    let episode = RecordedEpisode::of(&file).expect("one of ours");
    assert_eq!((episode.seed, episode.episode, episode.steps), (4, 2, 1));
    assert_eq!(episode.checkpoint, "runs/a");
    let replay = replay_motion(&Recorded::read(&file).expect("one of ours")).expect("stable");
    assert_eq!(replay.first, None);
    vec![file]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let _ = RecordedEpisode::of(bytes);
        let Ok(mut recorded) = Recorded::read(bytes) else { return };
        // Longer ones take long, and say no more.
        recorded.commanded.commands.truncate(1);
        // It may diverge, which is told.
        let _ = replay_motion(&recorded);
    }
);
