//! Recordings of episodes, as the page saves them and people pass them on: whatever they say, nothing panics, and what is taken reads back.

#![no_main]

use std::cell::RefCell;
use std::sync::Arc;

use lab::script::{Recording, parse};
use libfuzzer_sys::fuzz_target;
use simulator::experiment::{Episode, Member, Start};
use simulator::policy::initial_parameters;
use simulator::robot::Robot;
use simulator::rollout::World;

fn seeds() -> Vec<Vec<u8>> {
    let events = [
        r#"{"hand_goal": {"arm": 1, "pose": [0.4, -1.1, 4.2, 1.6, 0.0, 1.5]}}"#,
        r#"{"base_goal": {"attitude": [0.1, 0.2, -0.3]}}"#,
        r#"{"arm": {"arm": 0, "control": "limp"}}"#,
        r#"{"arm": {"arm": 2, "control": {"policy": 1}}}"#,
        r#"{"effect": {"steps": 4, "effect": {"wrench": {"body": 3, "point": [0, 0, 0], "force": [0, 30, 0], "torque": [0, 0, 0]}}}}"#,
        r#"{"effect": {"effect": {"action": {"joints": {"start": 7, "end": 8}, "value": 0.4}}}}"#,
        r#"{"base_mass": {"mass": 250.0}}"#,
        r#"{"delay": {"steps": 2}}"#,
        r#"{"sensors": {"position": 0.01, "angle": 0.01, "velocity": 0, "rate": 0}}"#,
        r#""clear_effects""#,
    ];
    let script = |event: &str| {
        format!(
            r#"{{"start": {{"seed": 4, "episode": 2}}, "steps": 2, "events": [{{"step": 0, "event": {event}}}]}}"#
        )
    };
    let mut seeds: Vec<String> = events.into_iter().map(script).collect();
    let whole = r#"{"policies": [{"name": "best", "digest": "00"}], "script": {"steps": 1}}"#;
    seeds.push(whole.to_owned());
    seeds.into_iter().map(String::into_bytes).collect()
}

fn episode() -> Episode {
    let config = fuzz::small_config();
    let world = World::new(&config, &Robot::builtin("paper").expect("built in"));
    let parameters = initial_parameters(&config, &world.dimensions, 1);
    let policy = world.policy(&parameters).expect("a policy");
    let member = Arc::new(Member { world, policy });
    Episode::new(vec![Arc::clone(&member), member], Start::default()).expect("an episode")
}

thread_local! {
    static EPISODE: RefCell<Episode> = RefCell::new(episode());
}

fn play(episode: &mut Episode, Recording { script, .. }: Recording) {
    if episode.reset(script.start).is_err() {
        return;
    }
    for timed in &script.events {
        // Refused or not: the episode goes on.
        let _ = episode.apply(&timed.event);
    }
    // It may diverge, which is told.
    let _ = episode.step();
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let Ok(recording) = parse(bytes) else { return };
        let text = serde_json::to_vec(&recording).expect("plain data");
        assert_eq!(parse(&text).as_ref(), Ok(&recording));
        EPISODE.with_borrow_mut(|episode| play(episode, recording));
    }
);
