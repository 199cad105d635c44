//! An episode in somebody's hands is a trial's, goes back in time, and refuses what cannot be.

use proto::config::{Preset, TaskName};

use super::*;
use crate::executor::InOrder;
use crate::experiment::event::TimedEvent;
use crate::experiment::tests::{paper, policy, world, world_of};
use crate::experiment::{Intervention, Phase, Recording, Trial, play};

fn member(task: TaskName) -> Arc<Member> {
    let world = world(task, &paper());
    let policy = policy(&world);
    Arc::new(Member { world, policy })
}

fn both() -> Vec<Arc<Member>> {
    vec![member(TaskName::Trajectory), member(TaskName::Reorientation)]
}

/// What a recording holds of a step.
fn row(episode: &Episode) -> Vec<u32> {
    let (state, errors) = (episode.state(), episode.errors());
    let parts: [&[f32]; 7] = [
        errors.hands.as_flattened(),
        &errors.base,
        &state.base_angular_velocity,
        &episode.touching().by_kind,
        &state.base_position,
        &state.base_quaternion,
        &state.q,
    ];
    parts.into_iter().flatten().map(|x| x.to_bits()).collect()
}

fn row_of(recording: &Recording, episode: usize, step: usize) -> Vec<u32> {
    recording.row(episode, step).iter().map(|x| x.to_bits()).collect()
}

/// Another index than the first, so that addresses count.
const INDEX: u32 = 3;

fn start() -> Start {
    Start { seed: 5, episode: INDEX, ..Start::default() }
}

fn timed(step: usize, event: Event) -> TimedEvent {
    TimedEvent { step, event }
}

/// Everything that can happen, as a script and as a trial on every lane.
#[test]
fn an_episode_is_that_of_a_trial_to_the_bit() {
    let members = both();
    let sensors = SensorNoise { position: 0.01, angle: 0.02, velocity: 0.01, rate: 0.01 };
    let noise = Effect::JointTorque { std: 5.0 };
    let stuck = Effect::Action { joints: 7..8, value: 0.4 };
    let pull = Effect::HandForce { arm: 2, force: [5.0, -7.0, 3.0] };
    let turn = Effect::BaseTorque([3.0, 0.0, -2.0]);
    let wrench = Effect::Wrench {
        body: 16,
        point: [0.1, 0.0, 0.05],
        force: [0.0, 20.0, 10.0],
        torque: [1.0, -2.0, 3.0],
    };
    let script = Script {
        start: start(),
        steps: 7,
        events: vec![
            timed(0, Event::BaseMass { mass: 300.0 }),
            timed(0, Event::Delay { steps: 2 }),
            timed(0, Event::Sensors(sensors)),
            timed(0, Event::Effect { effect: noise.clone(), steps: None }),
            timed(1, Event::Effect { effect: stuck.clone(), steps: Some(2) }),
            timed(1, Event::Effect { effect: pull.clone(), steps: Some(3) }),
            timed(2, Event::Arm { arm: 1, control: Control::Hold }),
            timed(2, Event::Arm { arm: 0, control: Control::Policy(1) }),
            timed(3, Event::Effect { effect: turn.clone(), steps: Some(1) }),
            timed(4, Event::Effect { effect: wrench.clone(), steps: Some(1) }),
            timed(5, Event::ClearEffects),
            timed(5, Event::Effect { effect: noise.clone(), steps: None }),
            timed(5, Event::Arm { arm: 3, control: Control::Limp }),
        ],
    };
    let mut episode = Episode::new(members.clone(), Start::default()).expect("an episode");
    let mut rows = Vec::new();
    episode.play(&script, &mut |episode| rows.push(row(episode))).expect("it plays");

    let heavy = paper().with_base_mass(300.0).expect("a robot");
    let mut trial = Trial::new(members[0].player(), 5, 5, 7);
    trial.robot = &heavy;
    trial.players = members.iter().map(|member| member.player()).collect();
    let arms = |arms: [Option<usize>; 4]| arms.to_vec();
    trial.phases = vec![
        Phase { from: 0, arms: arms([Some(0); 4]) },
        Phase { from: 2, arms: arms([Some(1), None, Some(0), Some(0)]) },
        Phase { from: 5, arms: arms([Some(1), None, Some(0), None]) },
    ];
    let happens = |steps, effect| Intervention { steps, effect };
    trial.interventions = vec![
        happens(0..7, noise),
        happens(1..3, stuck),
        happens(1..4, pull),
        happens(3..4, turn),
        happens(4..5, wrench),
        happens(5..7, Effect::Limp { arm: 3 }),
    ];
    (trial.sensors, trial.delay) = (sensors, 2);
    let recording = play(&trial, &InOrder, &|| {}).expect("a recording");
    assert_eq!(rows.len(), 8, "the start and seven steps");
    for step in 0..7 {
        assert_eq!(rows[step + 1], row_of(&recording, INDEX as usize, step), "step {step}");
    }
    assert_eq!((episode.steps(), episode.delay(), episode.effects()), (7, 2, 1));

    // What the trial says of itself plays the same.
    let of_trial = trial.script(INDEX).expect("a script can say it");
    let mut rows_of_trial = Vec::new();
    episode.play(&of_trial, &mut |episode| rows_of_trial.push(row(episode))).expect("it plays");
    assert_eq!(rows_of_trial, rows);
    let heavy_arms = paper().with_arm_mass(2.0).expect("a robot");
    trial.robot = &heavy_arms;
    assert_eq!(trial.script(INDEX), None, "no script says that arms are heavier");

    // As a text and back it is the same.
    let text = toml::to_string(&script).expect("a script is plain data");
    let again: Script = toml::from_str(&text).expect("a script");
    assert_eq!(again, script);
}

/// Who moves which arm, from the start and from the step of a review on, as a script and as a trial: arms that no policy with goal postures moves are not
/// looked ahead for.
#[test]
fn arms_that_others_move_count_for_an_episode_as_for_a_trial() {
    let guided = world_of(Preset::Guided, TaskName::Trajectory, &paper());
    let first = Arc::new(Member { policy: policy(&guided), world: guided });
    let members = vec![first, member(TaskName::Reorientation)];
    let sensors = SensorNoise { position: 0.002, angle: 0.004, velocity: 0.0, rate: 0.0 };
    let mut trial = Trial::new(members[0].player(), 5, 5, 24);
    trial.players = members.iter().map(|member| member.player()).collect();
    for sensors in [SensorNoise::NONE, sensors] {
        trial.sensors = sensors;
        let recordings = [Some(1), Some(0)].map(|other| {
            trial.phases = vec![
                Phase { from: 0, arms: vec![None, other, Some(0), other] },
                Phase { from: 10, arms: vec![None, Some(0), Some(0), other] },
                Phase { from: 20, arms: vec![Some(0); 4] },
            ];
            let recording = play(&trial, &InOrder, &|| {}).expect("a recording");
            let script = trial.script(INDEX).expect("a script can say it");
            let mut episode = Episode::new(members.clone(), start()).expect("an episode");
            let mut rows = Vec::new();
            episode.play(&script, &mut |episode| rows.push(row(episode))).expect("it plays");
            for step in 0..24 {
                assert_eq!(rows[step + 1], row_of(&recording, INDEX as usize, step), "step {step}");
            }
            rows
        });
        assert_ne!(recordings[0][1], recordings[1][1]);
    }
}

/// Goal postures are told as the policy wants them that sits there: at its pace, and after an average of the base's pose or not.
#[test]
fn who_is_seated_later_plays_as_if_it_had_been_alone() {
    let of = |preset| {
        let world = world_of(preset, TaskName::Trajectory, &paper());
        let policy = policy(&world);
        Arc::new(Member { world, policy })
    };
    let [guided, robust] = [Preset::Guided, Preset::Robust].map(of);
    let sensors = SensorNoise { position: 0.01, angle: 0.02, velocity: 0.01, rate: 0.01 };
    let rows = |members: Vec<Arc<Member>>, seated: usize| {
        let mut episode = Episode::new(members, start()).expect("an episode");
        episode.apply(&Event::Sensors(sensors)).expect("sensors");
        for arm in 0..4 {
            let control = Control::Policy(seated);
            episode.apply(&Event::Arm { arm, control }).expect("a seat");
        }
        let step = |_| {
            episode.step().expect("a step");
            row(&episode)
        };
        (0..5).map(step).collect::<Vec<_>>()
    };
    let alone = rows(vec![Arc::clone(&robust)], 0);
    assert_eq!(rows(vec![guided.clone(), robust], 1), alone);
    assert_ne!(rows(vec![guided], 0), alone);
}

/// Live it is seated when it comes; in a replay and in a trial it sits there from the start. Goal postures are told when it moves an arm, and no sooner.
#[test]
fn who_comes_later_plays_as_in_a_replay_where_it_sits_from_the_start() {
    let guided = world_of(Preset::Guided, TaskName::Trajectory, &paper());
    let guided = Arc::new(Member { policy: policy(&guided), world: guided });
    let (first, steps, late) = (member(TaskName::Reorientation), 30, 4);
    let poses = {
        let both = Episode::new(vec![first.clone(), guided.clone()], start()).expect("an episode");
        both.goals().hands.iter().map(|goal| goal.map(f64::from)).collect::<Vec<_>>()
    };
    let goals = poses.iter().enumerate().map(|(arm, &pose)| Event::HandGoal { arm, pose });
    let arms = (0..4).map(|arm| Event::Arm { arm, control: Control::Policy(1) });
    let events: Vec<_> = goals.chain(arms).collect();

    let mut live = Episode::new(vec![first.clone()], start()).expect("an episode");
    let mut lived = vec![row(&live)];
    for step in 0..steps {
        if step == late {
            assert_eq!(live.seat(None, guided.clone()), Ok(1));
            for event in &events {
                live.apply(event).expect("it may happen");
            }
        }
        live.step().expect("a step");
        lived.push(row(&live));
    }
    // An episode in which it had played before begins anew as well.
    let members = vec![first, guided];
    let script = Script {
        start: start(),
        steps,
        events: events.iter().map(|event| timed(late, event.clone())).collect(),
    };
    let mut again = Episode::new(members.clone(), start()).expect("an episode");
    for _ in 0..2 {
        let mut rows = Vec::new();
        again.play(&script, &mut |episode| rows.push(row(episode))).expect("it plays");
        for step in late..=steps {
            assert_eq!(rows[step][24..], lived[step][24..], "the state after {step} steps");
        }
    }
    let mut trial = Trial::new(members[0].player(), 5, 5, steps);
    trial.players = members.iter().map(|member| member.player()).collect();
    trial.phases = vec![
        Phase { from: 0, arms: vec![Some(0); 4] },
        Phase { from: late, arms: vec![Some(1); 4] },
    ];
    let recording = play(&trial, &InOrder, &|| {}).expect("a recording");
    for step in late..steps {
        assert_eq!(row_of(&recording, INDEX as usize, step), lived[step + 1], "step {step}");
    }
}

#[test]
fn time_goes_back_and_comes_again_the_same() {
    let mut episode = Episode::new(both(), start()).expect("an episode");
    let ahead = |episode: &mut Episode| {
        let mut rows = vec![row(episode)];
        for step in 0..3 {
            if step == 1 {
                let goal = Event::HandGoal { arm: 2, pose: [0.3, 0.2, 5.2, 0.6, 0.0, 0.1] };
                episode.apply(&goal).expect("a goal");
            }
            episode.step().expect("a step");
            rows.push(row(episode));
        }
        rows
    };
    episode.apply(&Event::Delay { steps: 1 }).expect("a delay");
    let base = Event::BaseGoal { attitude: [0.1, 0.0, -0.1] };
    episode.apply(&base).expect("a goal");
    episode.step().expect("a step");
    let kept = episode.snapshot();
    let rows = ahead(&mut episode);
    assert_ne!(rows[1], rows[3]);

    // Whatever happens in between, another policy in the place of the first one, too.
    let other = world(TaskName::Trajectory, &paper());
    let flat = crate::policy::tests::parameters(&other.config, &other.dimensions, 77);
    let policy = other.policy(&flat).expect("a policy");
    let member = Arc::new(Member { world: other, policy });
    assert_eq!(episode.seat(Some(0), member), Ok(0));
    for event in [
        Event::Delay { steps: 3 },
        Event::BaseMass { mass: 900.0 },
        Event::Arm { arm: 0, control: Control::Limp },
        Event::Effect { effect: Effect::BaseTorque([9.0; 3]), steps: None },
        Event::Sensors(SensorNoise { position: 0.1, ..SensorNoise::NONE }),
    ] {
        episode.apply(&event).expect("it may happen");
    }
    episode.step().expect("a step");
    assert_ne!(row(&episode), rows[1]);
    episode.restore(&kept).expect("a moment of this episode");
    assert_eq!(ahead(&mut episode), rows);
    // Who came after that moment may take part from there on.
    let late = episode.seat(None, both().remove(0)).expect("a place");
    episode.restore(&kept).expect("a moment of this episode");
    let control = Control::Policy(late);
    episode.apply(&Event::Arm { arm: 0, control }).expect("it is there");
    episode.restore(&kept).expect("a moment of this episode");
    assert_eq!(ahead(&mut episode), rows, "its presence alone changes nothing");
    // And from the start.
    episode.reset(start()).expect("a start");
    assert_eq!((episode.steps(), episode.delay(), episode.effects()), (0, 0, 0));
    episode.apply(&Event::Delay { steps: 1 }).expect("a delay");
    episode.apply(&base).expect("a goal");
    episode.step().expect("a step");
    assert_eq!(ahead(&mut episode), rows);
}

#[test]
fn an_episode_begins_where_another_one_was() {
    let mut one = Episode::new(both(), start()).expect("an episode");
    for _ in 0..2 {
        one.step().expect("a step");
    }
    let State { base_position, base_quaternion, base_linear_velocity, .. } = one.state();
    let State { base_angular_velocity, q, qd, .. } = one.state();
    let parts: [&[f32]; 6] =
        [base_position, base_quaternion, base_linear_velocity, base_angular_velocity, q, qd];
    let numbers: Vec<f64> = parts.into_iter().flatten().map(|&x| f64::from(x)).collect();
    let there = Start { state: Some(numbers.clone()), ..start() };
    let other = Episode::new(both(), there.clone()).expect("an episode");
    assert_eq!(other.state(), one.state());
    let refused = |change: &dyn Fn(&mut Vec<f64>), word: &str| {
        let mut numbers = numbers.clone();
        change(&mut numbers);
        let start = Start { state: Some(numbers), ..start() };
        let error = Episode::new(both(), start).expect_err("refused").to_string();
        assert!(error.contains(word), "{error}");
    };
    refused(&|numbers| _ = numbers.pop(), "there are 61");
    refused(&|numbers| numbers[20] = f64::NAN, "number 20 of the state, joint angle (rad), is NaN");
    refused(
        &|numbers| numbers[0] = 5000.0,
        "number 0 of the state, base position (m), is 5000; a number from -1000 to 1000 is wanted",
    );
    refused(&|numbers| numbers[60] = -2e3, "number 60 of the state, joint rate (rad/s), is -2000");
    refused(&|numbers| numbers[3] = 0.0, "quaternion");
}

#[test]
fn a_delay_that_changes_loses_no_command_and_a_shorter_one_the_oldest() {
    let mut episode = Episode::new(both(), start()).expect("an episode");
    let mut step = |delay: Option<usize>, action: f64| {
        if let Some(steps) = delay {
            episode.apply(&Event::Delay { steps }).expect("a delay");
        }
        let effect = Effect::Action { joints: 0..24, value: action };
        episode.apply(&Event::Effect { effect, steps: Some(1) }).expect("an effect");
        episode.step().expect("a step");
        // The scale of the actions is the same for all.
        episode.commands()[0] / episode.members()[0].world.task.action_scale as f32
    };
    let executed = [
        step(None, 0.1),
        // Nothing new comes for two steps: the last command holds.
        step(Some(2), 0.2),
        step(None, 0.3),
        step(None, 0.4),
        step(Some(1), 0.5),
        step(Some(0), 0.6),
    ];
    let expected = [0.1, 0.1, 0.1, 0.2, 0.4, 0.6];
    for (executed, expected) in executed.iter().zip(expected) {
        assert!((executed - expected).abs() < 1e-6, "{executed} {expected}");
    }
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut episode = Episode::new(both(), start()).expect("an episode");
    episode.step().expect("a step");
    let before = format!("{:?} {:?}", episode, row(&episode));
    let nan = f64::NAN;
    let effect = |effect| Event::Effect { effect, steps: None };
    for (event, word) in [
        (Event::HandGoal { arm: 4, pose: [0.0; 6] }, "arm 4: there are 4"),
        (Event::HandGoal { arm: 0, pose: [nan; 6] }, "NaN"),
        (Event::BaseGoal { attitude: [f64::INFINITY; 3] }, "inf"),
        (Event::Arm { arm: 0, control: Control::Policy(2) }, "policy 2"),
        (Event::Arm { arm: 9, control: Control::Hold }, "arm 9"),
        (Event::BaseMass { mass: -1.0 }, "mass"),
        (Event::Delay { steps: 26 }, "a delay of 26 control steps: at most 25"),
        (Event::Sensors(SensorNoise { rate: nan, ..SensorNoise::NONE }), "NaN"),
        (effect(Effect::Action { joints: 20..25, value: 0.0 }), "joints up to 25: there are 24"),
        (effect(Effect::Action { joints: std::ops::Range { start: 3, end: 2 }, value: 0.0 }), "3"),
        (effect(Effect::HandForce { arm: 4, force: [0.0; 3] }), "arm 4"),
        (effect(Effect::BaseTorque([0.0, nan, 0.0])), "NaN"),
        (effect(Effect::JointTorque { std: nan }), "NaN"),
        (effect(Effect::Limp { arm: 4 }), "arm 4"),
        (
            effect(Effect::Wrench { body: 25, point: [0.0; 3], force: [0.0; 3], torque: [0.0; 3] }),
            "body 25: there are 25",
        ),
    ] {
        let error = episode.apply(&event).expect_err("refused").to_string();
        assert!(error.contains(word), "{event:?}: {error}");
        assert_eq!(format!("{:?} {:?}", episode, row(&episode)), before, "{event:?}");
    }
}

/// What a page may do: another policy takes the first place, which had learned with commands half as long.
#[test]
fn goals_move_by_the_clock_of_the_physics_whoever_sits_in_the_first_place() {
    let of_period = |period| {
        let mut config = world(TaskName::Capture, &paper()).config;
        config.env.control_period = period;
        let world = World::new(&config, &paper());
        let policy = policy(&world);
        Arc::new(Member { world, policy })
    };
    let goals = |episode: &Episode| episode.goals().hands[0].map(f32::to_bits);
    let mut alone = Episode::new(vec![of_period(0.4)], start()).expect("an episode");
    let mut changed = Episode::new(vec![of_period(0.4)], start()).expect("an episode");
    let begun = goals(&alone);
    assert_eq!(changed.seat(Some(0), of_period(0.2)), Ok(0));
    for step in 0..5 {
        for episode in [&mut alone, &mut changed] {
            episode.step().expect("a step");
        }
        assert_eq!(goals(&changed), goals(&alone), "step {step}");
    }
    assert_ne!(goals(&alone), begun, "the body does not move");
}
