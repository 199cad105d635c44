//! Against the slow twin in double precision.

use proto::config::{Layers, Preset, TaskName};

use super::kinematic_rollout::KinematicRollout;
use super::search::Question;
use super::*;
use crate::env::readings;
use crate::experiment::EvaluationGoals;
use crate::inverse_kinematics::{self, candidates, pose, solvable};
use crate::rollout::World;
use crate::state::State;
use crate::task::{Goals, HandReading, Readings};

fn robot() -> Robot {
    Robot::builtin("paper").expect("built in")
}

/// A goal of arm 1 that is reached with its joints off home by `off`, the base at home.
fn goal(robot: &Robot, off: [f64; 6]) -> [f64; 6] {
    let mut state = State::<f64>::home(robot);
    for (q, off) in state.q[6..12].iter_mut().zip(off) {
        *q += off;
    }
    let hand = readings(robot, &state).hands[1];
    let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
    [x, y, z, a, b, c]
}

fn goals_at(robot: &Robot, hand: [f64; 6]) -> Goals<f64> {
    let at_home = readings(robot, &State::<f64>::home(robot));
    let own = at_home.hands.iter().map(|hand| {
        let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
        [x, y, z, a, b, c]
    });
    let mut goals = Goals::fixed(own.collect(), [0.0; 3]);
    goals.hands[1] = hand;
    goals
}

fn world(robot: &Robot) -> World {
    let config = Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).resolve();
    World::new(&config.expect("a preset"), robot)
}

/// No postures yet, of the paces of preset `tuned`.
fn none_yet<S: Real>(robot: &Robot) -> Postures<S> {
    let limit = |joint: usize| S::splat(0.8 * robot.link(joint).max_rate);
    let limits = (0..robot.n_joints()).map(limit).collect();
    Postures::new(robot, Pace { gain: 0.7, period: 0.4, limits }, 1.0)
}

fn look<S: Real>(postures: &mut Postures<S>, seen: &Readings<S>, goals: &Goals<S>) {
    postures.update((seen.base_position, seen.base_quaternion), &seen.q, &goals.hands);
}

fn left<S: Real>(postures: &Postures<S>) -> Vec<S> {
    postures.arms.iter().flat_map(|arm| arm.left().to_vec()).collect()
}

#[test]
fn the_posture_is_the_nearest_of_the_twins() {
    let robot = robot();
    let home = State::<f64>::home(&robot);
    for off in [[0.4, -0.3, 0.6, 0.2, 0.5, -0.4], [-0.3, 0.5, -0.6, 0.4, -0.7, 0.9]] {
        let hand = goal(&robot, off);
        let mut postures = none_yet(&robot);
        look(&mut postures, &readings(&robot, &home), &goals_at(&robot, hand));
        let mut target = pose(hand);
        for i in 0..3 {
            target.translation.vector[i] -= home.base_position[i];
        }
        let turn = |way: &inverse_kinematics::Angles| {
            let turns = way.iter().zip(&home.q[6..12]).map(|(way, home)| (way - home).abs());
            turns.fold(0.0, f64::max)
        };
        let exact = candidates(&robot, 1, &target).into_iter().filter(|way| {
            let (hand, _) = inverse_kinematics::forward(&robot, 1, way);
            inverse_kinematics::residual(&target, &hand).norm() < 1e-6
        });
        let nearest = exact.min_by(|a, b| turn(a).total_cmp(&turn(b))).expect("off home by `off`");
        for j in 0..6 {
            let way = postures.arms[1].left()[j];
            assert!((way - (nearest[j] - home.q[6 + j])).abs() < 1e-5, "joint {j}: {way}");
        }
        // Arms that are at their goals stay; at home they have a wrist that turns without moving the hand.
        for arm in [0, 2, 3] {
            let left = postures.arms[arm].left();
            assert!(left.iter().all(|left| left.abs() < 0.1), "arm {arm}: {left:?}");
        }
    }
}

/// An arm of seven joints has more ways to a pose than can be counted: some posture is found, and brings the hand there.
#[test]
fn a_posture_of_seven_joints_brings_the_hand_to_its_goal() {
    let text = include_str!("../../robots/seven-joints.toml");
    let robot = Robot::from_toml(text, std::path::Path::new("seven-joints.toml")).expect("valid");
    let home = State::<f64>::home(&robot);
    let arm = 2;
    let mut there = home.clone();
    let offsets = [0.4, -0.3, 0.5, 0.6, -0.4, 0.3, 0.7];
    for (q, off) in there.q[robot.joints.of_arm(arm)].iter_mut().zip(offsets) {
        *q += off;
    }
    let [at_home, wanted] = [&home, &there].map(|state| {
        let hands = readings(&robot, state).hands;
        let pose = |hand: &crate::task::HandReading<f64>| {
            let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
            [x, y, z, a, b, c]
        };
        hands.iter().map(pose).collect::<Vec<_>>()
    });
    let mut goals = Goals::fixed(at_home, [0.0; 3]);
    goals.hands[arm] = wanted[arm];
    let mut postures = none_yet(&robot);
    look(&mut postures, &readings(&robot, &home), &goals);
    let mut arrived = home.clone();
    assert_eq!(left(&postures).len(), robot.n_joints());
    for (q, left) in arrived.q.iter_mut().zip(left(&postures)) {
        *q += left;
    }
    let hand = readings(&robot, &arrived).hands[arm];
    for i in 0..3 {
        assert!((hand.position[i] - wanted[arm][i]).abs() < 1e-5, "{hand:?}");
        assert!((hand.euler[i] - wanted[arm][3 + i]).abs() < 1e-5, "{hand:?}");
    }
}

#[test]
fn a_posture_follows_the_base_and_who_looks_twice_sees_the_same() {
    let robot = robot();
    let mut state = State::<f64>::home(&robot);
    let goals = goals_at(&robot, goal(&robot, [0.4, -0.3, 0.6, 0.2, 0.5, -0.4]));
    let mut postures = none_yet(&robot);
    look(&mut postures, &readings(&robot, &state), &goals);
    let before = left(&postures);
    for step in 1..=20 {
        state.base_position[0] += 0.002;
        state.base_position[2] -= 0.001;
        let angle = 0.002 * f64::from(step);
        state.base_quaternion = crate::spatial::quaternion_exp([0.0, angle, -angle]);
        look(&mut postures, &readings(&robot, &state), &goals);
    }
    let followed = left(&postures);
    assert!(before.iter().zip(&followed).any(|(a, b)| (a - b).abs() > 0.02));
    look(&mut postures, &readings(&robot, &state), &goals);
    assert_eq!(left(&postures), followed, "nothing has moved since");
    for (joint, left) in followed.iter().enumerate() {
        state.q[joint] += left;
    }
    let arrived = readings(&robot, &state);
    // The other arms' goals are at home, from where a base that moves takes them out of reach.
    let (hand, goal) = (&arrived.hands[1], &goals.hands[1]);
    for i in 0..3 {
        assert!((hand.position[i] - goal[i]).abs() < 1e-6);
        assert!((hand.euler[i] - goal[3 + i]).abs() < 1e-6);
    }
}

#[test]
fn lanes_do_not_mix() {
    struct Both;
    impl crate::scalar::LaneFn for Both {
        type Output = Vec<Vec<f64>>;
        #[inline(always)]
        fn call<S: Real>(self) -> Self::Output {
            look_apart::<S>(0)
        }
    }
    /// What is left in each lane, which has a goal of its own; the first lane that of number `first`.
    #[inline(always)]
    fn look_apart<S: Real>(first: usize) -> Vec<Vec<f64>> {
        let robot = robot();
        let state = State::<S>::home(&robot);
        let mut goals = Goals::fixed(vec![[S::zero(); 6]; 4], [S::zero(); 3]);
        let at_home = goals_at(&robot, [0.0; 6]);
        for lane in 0..S::LANES {
            let turn = 0.1 * (first + lane) as f64 - 0.4;
            let hand = goal(&robot, [turn, -0.2, 0.3, 0.2, 0.5 - turn, -0.4]);
            for (arm, slots) in goals.hands.iter_mut().enumerate() {
                let hand = if arm == 1 { hand } else { at_home.hands[arm] };
                for (slot, x) in slots.iter_mut().zip(hand) {
                    slot.set_lane(lane, x);
                }
            }
        }
        let mut postures = none_yet(&robot);
        look(&mut postures, &readings(&robot, &state), &goals);
        // Every other lane gets another goal: postures are chosen anew there, and nowhere else.
        for lane in (0..S::LANES).filter(|lane| (first + lane) % 2 == 1) {
            let turn = 0.1 * (first + lane) as f64;
            let hand = goal(&robot, [turn, -0.6, 0.9, 0.2, turn - 0.5, 0.4]);
            for (slot, x) in goals.hands[1].iter_mut().zip(hand) {
                slot.set_lane(lane, x);
            }
        }
        look(&mut postures, &readings(&robot, &state), &goals);
        let lane = |lane: usize| left(&postures).iter().map(|x| x.lane(lane)).collect();
        (0..S::LANES).map(lane).collect()
    }
    let lanes = crate::scalar::dispatch(Both);
    for (number, lane) in lanes.iter().enumerate() {
        assert_eq!(&look_apart::<f32>(number)[0], lane, "lane {number}");
        assert!(number == 0 || lane[6..12] != lanes[0][6..12], "lane {number} has another goal");
    }
}

/// Of the goals that policies are evaluated on, with the base at home: as many as the slow twin has a solution for.
#[test]
fn every_goal_that_the_twin_solves_has_a_good_posture() {
    let robot = robot();
    let evaluated = world(&robot);
    let state = State::<f64>::home(&robot);
    let seen = readings(&robot, &state);
    let (mut good, mut solved) = (0, 0);
    for episode in 0..100 {
        let hand = |arm| EvaluationGoals::drawn(5).hand(&evaluated, episode, arm);
        let goals = Goals::fixed((0..4).map(hand).collect(), [0.0; 3]);
        let mut postures = none_yet(&robot);
        look(&mut postures, &seen, &goals);
        good += postures.arms.iter().filter(|arm| arm.good == 1.0).count();
        for arm in 0..4 {
            let mut target = pose(hand(arm));
            for i in 0..3 {
                target.translation.vector[i] -= state.base_position[i];
            }
            solved += usize::from(solvable(&robot, arm, &target));
        }
    }
    assert_eq!(good, solved);
}

/// Each lane has goals of its own.
#[test]
fn sets_that_are_given_up_are_not_missed() {
    struct Choices;
    impl crate::scalar::LaneFn for Choices {
        type Output = usize;
        #[inline(always)]
        fn call<S: Real>(self) -> usize {
            let mut others = 0;
            for first in (0..48).step_by(S::LANES) {
                others += n_others::<S>(first);
            }
            others
        }
    }
    /// How many choices differ from the nearest ways: an episode a lane, the first lane that of number `first`.
    #[inline(always)]
    fn n_others<S: Real>(first: usize) -> usize {
        let robot = robot();
        let evaluated = world(&robot);
        let state = State::<S>::home(&robot);
        let place = Place::of(&state, robot.joints);
        let goals = evaluation_goals::<S>(&evaluated, first);
        let Postures { arms: mut begun, active, pace, .. } = none_yet::<S>(&robot);
        for (index, (arm, goal)) in begun.iter_mut().zip(&goals).enumerate() {
            arm.begin(goal, &place, index);
        }
        let lanes = Trials::<S>::new(&robot, &pace);
        let register = Trials::<S::Register>::new(&robot, &pace);
        let choose = |to_the_end, wide| {
            let mut arms = begun.clone();
            let (goals, place) = (&goals, &place);
            let open = &[S::Mask::splat(true); 4];
            let (before, persistent, following) = (S::zero(), true, Following::CLOSE);
            let foresight =
                Foresight { goals, place, open, active, following, persistent, before, to_the_end };
            if wide {
                foresight.choose(&mut arms, &register);
            } else {
                foresight.choose(&mut arms, &lanes);
            }
            arms
        };
        let angles = |arms: &[Posture<S>], lane: usize| {
            arms.iter().flat_map(|arm| arm.angles).map(|x| x.lane(lane)).collect::<Vec<_>>()
        };
        let (chosen, to_the_end) = (choose(false, false), choose(true, false));
        let wide = choose(false, true);
        let mut others = 0;
        for lane in 0..S::LANES {
            let chosen = angles(&chosen, lane);
            assert_eq!(chosen, angles(&to_the_end, lane), "episode {}", first + lane);
            assert_eq!(chosen, angles(&wide, lane), "episode {}, in a register", first + lane);
            others += usize::from(chosen != angles(&begun, lane));
        }
        others
    }
    let backend = crate::scalar::Backend::detect();
    let others = crate::scalar::dispatch_on(backend, Choices);
    // With eight lanes in a register of sixteen, where there are.
    assert_eq!(crate::scalar::dispatch_for(1, backend, Choices), others);
    assert!(others > 12, "only {others} choices differ from the nearest ways");
}

/// Arms go to their postures without dynamics, for six reviews; with them more hands have a way to their goals at the end, and where hands are persistent
/// the others are nearer to theirs.
#[test]
fn choosing_anew_brings_goals_back_into_reach() {
    struct Ends {
        reviewed: bool,
        persistent: bool,
    }
    impl crate::scalar::LaneFn for Ends {
        /// How many hands have a way, and by how much all others miss their goals (m and rad).
        type Output = (usize, f64);
        #[inline(always)]
        fn call<S: Real>(self) -> (usize, f64) {
            let robot = robot();
            let evaluated = world(&robot);
            let (mut good, mut missed) = (0, 0.0);
            for first in (0..48).step_by(S::LANES) {
                let goals = evaluation_goals::<S>(&evaluated, first);
                let mut postures = none_yet::<S>(&robot);
                if !self.persistent {
                    postures.give_rest();
                }
                let home = State::<S>::home(&robot);
                let place = Place::of(&home, robot.joints);
                let chains: Vec<_> = postures.arms.iter().map(|arm| arm.chain.clone()).collect();
                let mut plant = KinematicRollout::new(
                    &postures.model,
                    &chains,
                    (postures.active, Following::CLOSE),
                );
                plant.state = place.at_rest();
                for _ in 0..60 {
                    if !self.reviewed {
                        postures.age = S::splat(REVIEW * (REVIEWS + 1.0));
                    }
                    let State { base_position, base_quaternion, q, .. } = &plant.state;
                    postures.update((*base_position, *base_quaternion), q, &goals);
                    plant.arms.clone_from(&postures.arms);
                    plant.advance(&postures.model, &postures.pace);
                }
                let place = Place::of(&plant.state, robot.joints);
                for (index, arm) in postures.arms.iter().enumerate() {
                    let (target, stands) = (place.seen(&goals[index]), place.stands(index));
                    let question = Question { chain: &arm.chain, target: &target, stands: &stands };
                    let miss = question.miss(&arm.angles);
                    for lane in 0..S::LANES {
                        let is_good = arm.good.lane(lane) == 1.0;
                        good += usize::from(is_good);
                        missed += if is_good { 0.0 } else { miss.lane(lane) };
                    }
                }
            }
            (good, missed)
        }
    }
    let ends = [(false, false), (true, false), (true, true)];
    let [once, rested, persistent] =
        ends.map(|(reviewed, persistent)| crate::scalar::dispatch(Ends { reviewed, persistent }));
    assert!(rested.0 > once.0 && rested.0 > 180, "of 192 hands {once:?}, and {rested:?}");
    assert!(persistent.1 < 0.7 * rested.1, "they miss by {rested:?}, and by {persistent:?}");
}

/// An arm that was led to where it touches something, its hand at the goal, takes another way with the first review, unless it does not go to its posture.
#[test]
fn arms_that_rest_at_something_choose_anew() {
    struct LedAstray {
        active: bool,
    }
    impl crate::scalar::LaneFn for LedAstray {
        /// In how many situations the arm touches, and in how many of them no more after the review.
        type Output = [usize; 2];
        #[inline(always)]
        fn call<S: Real>(self) -> [usize; 2] {
            let robot = robot();
            let home = State::<S>::home(&robot);
            let mut counts = [0; 2];
            for situation in 0..200 {
                let mut state = home.clone();
                for (joint, q) in state.q[6..12].iter_mut().enumerate() {
                    *q += S::splat(2.0 * (1.7 * joint as f64 + 0.9 * f64::from(situation)).sin());
                }
                let seen = readings(&robot, &state);
                let at = |hand: &HandReading<S>| {
                    let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
                    [x, y, z, a, b, c]
                };
                let goals: Vec<_> = seen.hands.iter().map(at).collect();
                let mut postures = none_yet::<S>(&robot);
                let touches = |postures: &mut Postures<S>, way: &[S]| {
                    let mut state = home.clone();
                    state.q[6..12].copy_from_slice(way);
                    touching(&postures.model, &mut postures.workspace, &state).pairs.lane(0) > 0.0
                };
                let (mut position, quaternion) = (seen.base_position, seen.base_quaternion);
                postures.update((position, quaternion), &seen.q, &goals);
                let chosen = postures.arms[1].angles;
                let finds_another =
                    postures.arms[1].good.lane(0) == 1.0 && !touches(&mut postures, &chosen[..6]);
                if !touches(&mut postures, &state.q[6..12]) || !finds_another {
                    continue;
                }
                postures.activate([true, self.active, true, true].into_iter());
                postures.arms[1].angles[..6].copy_from_slice(&state.q[6..12]);
                let mut steps = 0;
                let mut way = postures.arms[1].angles;
                while steps < REVIEW as usize && touches(&mut postures, &way[..6]) {
                    position[0] += S::splat(1e-6);
                    postures.update((position, quaternion), &seen.q, &goals);
                    steps += 1;
                    way = postures.arms[1].angles;
                }
                if steps < REVIEW as usize {
                    // A stop told it before.
                    continue;
                }
                counts[0] += 1;
                counts[1] += usize::from(!touches(&mut postures, &way[..6]));
                assert_eq!(postures.arms[1].good.lane(0), 1.0, "{situation}");
            }
            counts
        }
    }
    let [goes, stays] = [true, false].map(|active| crate::scalar::dispatch(LedAstray { active }));
    assert!(goes[0] > 2 && goes[1] == goes[0], "{goes:?}");
    assert!(stays[0] > 2 && stays[1] == 0, "{stays:?}");
}

/// What the others do hangs on an arm that goes to its posture, and not on one that does not.
#[test]
fn arms_that_do_not_go_are_not_chosen_for() {
    struct Others {
        active: bool,
    }
    impl crate::scalar::LaneFn for Others {
        type Output = usize;
        /// In how many of 48 episodes three arms choose otherwise when the fourth has another goal.
        #[inline(always)]
        fn call<S: Real>(self) -> usize {
            let robot = robot();
            let evaluated = world(&robot);
            let home = State::<S>::home(&robot);
            let mut differ = 0;
            for first in (0..48).step_by(S::LANES) {
                let goals = evaluation_goals::<S>(&evaluated, first);
                let mut others = goals;
                // Nobody reaches it.
                others[3][0] += S::splat(9.0);
                let chosen = [goals, others].map(|goals| {
                    let mut postures = none_yet::<S>(&robot);
                    postures.activate([true, true, true, self.active].into_iter());
                    let base = (home.base_position, home.base_quaternion);
                    postures.update(base, &home.q, &goals);
                    let (mut position, quaternion) = base;
                    // As far as the first review, which arms that miss their goals ask for.
                    for _ in 0..REVIEW as usize {
                        position[0] += S::splat(1e-6);
                        postures.update((position, quaternion), &home.q, &goals);
                    }
                    postures
                });
                for lane in 0..S::LANES {
                    let [one, other] = [0, 1].map(|at| {
                        let angles = chosen[at].arms[..3].iter().flat_map(|arm| arm.angles);
                        angles.map(|x| x.lane(lane)).collect::<Vec<_>>()
                    });
                    differ += usize::from(one != other);
                }
            }
            differ
        }
    }
    let [moves, stays] = [true, false].map(|active| crate::scalar::dispatch(Others { active }));
    assert_eq!(stays, 0, "arms choose for the sake of one that stays");
    assert!(moves > 12, "only {moves} of 48 teams choose for an arm that moves");
}

/// A lane for each episode of seed 5 from number `first` on.
#[inline(always)]
fn evaluation_goals<S: Real>(evaluated: &World, first: usize) -> [[S; 6]; 4] {
    let mut goals = [[S::zero(); 6]; 4];
    for lane in 0..S::LANES {
        for (arm, slots) in goals.iter_mut().enumerate() {
            let hand = EvaluationGoals::drawn(5).hand(evaluated, (first + lane) as u32, arm);
            for (slot, x) in slots.iter_mut().zip(hand) {
                slot.set_lane(lane, x);
            }
        }
    }
    goals
}

/// Along a circle of 0.05 m in small steps a hand keeps its way: back at the start, its joints are.
#[test]
fn a_goal_that_moves_is_followed() {
    let robot = robot();
    let state = State::<f64>::home(&robot);
    let seen = readings(&robot, &state);
    let mut goals = goals_at(&robot, goal(&robot, [0.4, -0.6, 1.2, 0.2, 0.6, -0.4]));
    let centre = goals.hands[1];
    let mut postures = none_yet(&robot);
    look(&mut postures, &seen, &goals);
    let first = left(&postures);
    for step in 1..=100 {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(step) / 100.0).sin_cos();
        goals.hands[1][0] = centre[0] + 0.05 * sin;
        goals.hands[1][1] = centre[1] + 0.05 * (1.0 - cos);
        goals.hands[1][5] = centre[5] + 0.1 * sin;
        look(&mut postures, &seen, &goals);
        assert_eq!(postures.arms[1].good, 1.0, "step {step}");
        if step == 50 {
            let moved = first.iter().zip(left(&postures)).map(|(a, b)| (a - b).abs());
            assert!(moved.fold(0.0, f64::max) > 0.05, "half way around nothing has moved");
        }
    }
    for (joint, (first, last)) in first.iter().zip(left(&postures)).enumerate() {
        assert!((first - last).abs() < 1e-3, "joint {joint}: {first}, then {last}");
    }
}

/// A robot rests at home, and its base is read a centimetre off, here and there with the other quaternion of its attitude.
#[test]
fn a_base_that_is_read_badly_is_averaged() {
    let robot = robot();
    let home = readings(&robot, &State::<f64>::home(&robot));
    let goals = goals_at(&robot, goal(&robot, [0.4, -0.3, 0.6, 0.2, 0.5, -0.4]));
    // Hands that come nearer take other ways now and then.
    let resting = || Postures { persistent: false, ..none_yet::<f64>(&robot) };
    let mut exact = resting();
    look(&mut exact, &home, &goals);
    // The other arms are at their goals, where a wrist turns without moving the hand.
    let left = |postures: &Postures<f64>| postures.arms[1].left().to_vec();
    let trembling = |trust: f64| {
        let mut postures = Postures { trust, ..resting() };
        look(&mut postures, &home, &goals);
        for (believed, exact) in left(&postures).iter().zip(left(&exact)) {
            assert!((believed - exact).abs() < 1e-6, "the first pose is believed");
        }
        let mut squares = 0.0;
        for step in 0..200 {
            let mut seen = home.clone();
            let [x, y, z] = [0.7548777, 0.5698403, 0.8191725].map(|share| {
                let drawn = f64::from(step + 1) * share;
                0.02 * (drawn - drawn.floor() - 0.5)
            });
            seen.base_position = [0, 1, 2].map(|i| seen.base_position[i] + [x, y, z][i]);
            if step % 3 == 1 {
                seen.base_quaternion = seen.base_quaternion.map(|part| -part);
            }
            look(&mut postures, &seen, &goals);
            let twice = left(&postures);
            look(&mut postures, &seen, &goals);
            assert_eq!(left(&postures), twice, "who looks twice sees the same");
            let off = left(&postures).into_iter().zip(left(&exact)).map(|(a, b)| (a - b).powi(2));
            squares += if step < 50 { 0.0 } else { off.sum::<f64>() };
        }
        squares.sqrt()
    };
    // An average with weight w keeps sqrt(w / (2 - w)) of what is drawn by itself: a third of a fifth's.
    let (all, fifth) = (trembling(1.0), trembling(0.2));
    assert!(fifth < 0.4 * all, "{fifth} of {all}");
    // And it comes to where the base stays.
    let mut postures = Postures { trust: 0.2, ..resting() };
    look(&mut postures, &home, &goals);
    let mut at_once = resting();
    look(&mut at_once, &home, &goals);
    let mut seen = home.clone();
    seen.base_position[0] += 0.05;
    for _ in 0..80 {
        seen.base_position[1] += 1e-9;
        look(&mut postures, &seen, &goals);
        look(&mut at_once, &seen, &goals);
    }
    for (slowly, at_once) in left(&postures).iter().zip(left(&at_once)) {
        assert!((slowly - at_once).abs() < 1e-3, "{slowly}, {at_once}");
    }
    postures.forget();
    look(&mut postures, &seen, &goals);
    let mut anew = Postures { trust: 0.2, ..resting() };
    look(&mut anew, &seen, &goals);
    assert_eq!(left(&postures), left(&anew), "nothing is left of an episode before");
}

/// The base moves away from a goal at the edge of the reach, by a centimetre.
#[test]
fn a_goal_hardly_out_of_reach_is_given_up_unless_it_trembles() {
    let robot = robot();
    let home = State::<f64>::home(&robot);
    let elbow = robot.home_q()[8];
    let goal = goal(&robot, [0.0, 0.0, 0.02 - elbow, 0.3, 0.4, 0.5]);
    let goals = goals_at(&robot, goal);
    let seen = readings(&robot, &home);
    let good = |trust: f64| {
        let mut postures = Postures { trust, persistent: false, ..none_yet::<f64>(&robot) };
        look(&mut postures, &seen, &goals);
        let before = postures.arms[1].good;
        let mut away = seen.clone();
        let length = goal[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
        for step in 0..8 {
            for axis in 0..3 {
                away.base_position[axis] = seen.base_position[axis]
                    - (0.01 + 1e-9 * f64::from(step)) * goal[axis] / length;
            }
            look(&mut postures, &away, &goals);
        }
        (before, postures.arms[1].good)
    };
    assert_eq!(good(1.0), (1.0, 0.0));
    assert_eq!(good(0.2), (1.0, 1.0));
}

/// What joints do where agents say 0.5 each: arm 2 has 0.06 rad and less to go, the others are at their goals.
fn acted(gain: f64, fade: f64) -> (Vec<f64>, Vec<f64>) {
    let robot = robot();
    let config = Layers::new(Preset::Guided, Some(TaskName::Trajectory)).resolve();
    let mut config = config.expect("a preset");
    config.task.posture.gain = gain;
    config.task.posture.fade = fade;
    let task = World::new(&config, &robot).task;

    let home = State::<f64>::home(&robot);
    let mut there = home.clone();
    for (joint, q) in there.q[6..12].iter_mut().enumerate() {
        *q += 0.06 - 0.01 * joint as f64;
    }
    let pose = |hand: &HandReading<f64>| {
        let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
        [x, y, z, a, b, c]
    };
    let goals: Vec<_> = readings(&robot, &there).hands.iter().map(pose).collect();
    let pace = Pace { gain: 0.7, period: task.control_period, limits: vec![2.0; 24] };
    let mut postures = Postures::new(&robot, pace, 1.0);
    postures.update((home.base_position, home.base_quaternion), &home.q, &goals);
    let left = postures.arms.iter().flat_map(|arm| arm.left().to_vec()).collect();

    let mut guidance = Guidance::none(24);
    guidance.look(&postures.arms, &task, task.action_scale, &[1.0; 24]);
    (left, (0..24).map(|joint| guidance.act(joint, 0.5)).collect())
}

#[test]
fn what_agents_say_counts_less_near_their_goals() {
    let (left, all) = acted(0.7, 0.0);
    assert!((left[6] - 0.06).abs() < 1e-4 && left[0].abs() < 1e-4, "{left:?}");
    let task_factor = 0.7 / (0.4 * 0.8);
    for (acted, left) in all.iter().zip(&left) {
        assert!((acted - (0.5 + task_factor * left)).abs() < 1e-9, "{acted}, {left} left");
    }
    for (fade, share) in [(0.1, 0.6), (0.05, 1.0)] {
        let (_, faded) = acted(0.7, fade);
        for joint in 0..24 {
            let said = if (6..12).contains(&joint) { share * 0.5 } else { 0.0 };
            let wanted = said + task_factor * left[joint];
            assert!((faded[joint] - wanted).abs() < 1e-3, "joint {joint}: {}", faded[joint]);
        }
    }
    // Nobody else goes there.
    assert_eq!(acted(0.0, 0.1).1, [0.5; 24]);
}
