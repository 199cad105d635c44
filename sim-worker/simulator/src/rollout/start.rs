//! Where training episodes begin.
//!
//! From home alone a policy sees little but its own ways to the goals, and is lost wherever something
//! else has brought the robot. (Starts from many states: Kakade and Langford 2002, "Approximately
//! optimal approximate reinforcement learning", section 4, there called restart distribution.)
//!
//! Half of the episodes of preset `tuned` begin away from home: joints scattered, base turned, a fifth
//! of the arms at any angles at all, at rest (unless `task.start.turning` says otherwise), nothing touching. What gains is an arm that has to reach after it
//! has held the base, or after a push, and arms that turn the base after they were driven elsewhere. Only arms that touch something are drawn again: an arm at any angles often
//! does, and with the whole robot drawn again most of them were lost.

use std::f64::consts::PI;

use proto::config::Start;
use proto::rng::{Address, Purpose};

use crate::env::Physics;
use crate::robot::Robot;
use crate::scalar::Real;
use crate::spatial::quaternion_exp;
use crate::state::State;
use crate::task::Readings;
use crate::task::goal::GoalAddress;

/// How often arms that touch something are drawn again; after that the episode begins at home.
const MOST_DRAWS: u32 = 16;

/// Puts lanes of `state`, which is at home, where `start` lets their episodes begin.
///
/// `goals` tells the run and the iteration, `env_of` a lane's environment. A number that is uniform in
/// [0, 1) scales the ranges of a draw, so that poses near home are frequent; arms that stand anywhere are
/// drawn from all poses alike.
#[inline(always)]
pub(super) fn scatter<S: Real>(
    start: &Start,
    robot: &Robot,
    physics: &mut Physics<S>,
    readings: &mut Readings<S>,
    (goals, env_of): (GoalAddress, impl Fn(usize) -> u32),
    state: &mut State<S>,
) {
    if start.share == 0.0 {
        return;
    }
    let GoalAddress { seed, iteration, .. } = goals;
    let home = State::<f64>::home(robot);
    let purpose = Purpose::InitialState;
    let uniforms = |lane: usize, draw: u32, index: u32| {
        let address = Address { seed, purpose, iteration, env: env_of(lane), step: draw, index };
        address.uniforms().map(f64::from)
    };
    // Lanes that begin away from home, and which of their arms are yet to be drawn.
    let away = (0..S::LANES).filter(|&lane| uniforms(lane, 0, 0)[1] < start.share);
    let mut open: Vec<(usize, Vec<bool>)> =
        away.map(|lane| (lane, vec![true; robot.n_arms])).collect();
    for draw in 0..MOST_DRAWS {
        if open.is_empty() {
            break;
        }
        for (lane, arms) in &open {
            let lane = *lane;
            let scale = uniforms(lane, draw, 0)[0];
            let offset = |range: f64, u: f64| scale * range * (2.0 * u - 1.0);
            let mut pose = state.lane(lane);
            if draw == 0 {
                let [x, y, z, _] = uniforms(lane, draw, 1).map(|u| offset(start.attitude, u));
                pose.base_quaternion = quaternion_exp([x, y, z]);
            }
            // Two groups of four words an arm: three of the first and those of the second tell the angles, the first one's last
            // word whether the arm stands anywhere.
            for arm in (0..robot.n_arms).filter(|&arm| arms[arm]) {
                let joints = robot.joints.of_arm(arm);
                let (q, home) = (&mut pose.q[joints.clone()], &home.q[joints]);
                let words = [0, 1].map(|half| uniforms(lane, draw, 2 + (2 * arm + half) as u32));
                // It stays so when it is drawn again.
                let anywhere = uniforms(lane, 0, 2 + 2 * arm as u32)[3] < start.anywhere;
                let angles = words[0][..3].iter().chain(&words[1]);
                for ((q, home), &u) in q.iter_mut().zip(home).zip(angles) {
                    *q = home
                        + if anywhere { PI * (2.0 * u - 1.0) } else { offset(start.joints, u) };
                }
            }
            if draw == 0 && start.turning > 0.0 {
                let [x, y, z, _] = uniforms(lane, draw, 2 + 2 * robot.n_arms as u32)
                    .map(|u| offset(start.turning, u));
                pose.base_angular_velocity = [x, y, z];
            }
            state.set_lane(lane, &pose);
        }
        let touching = physics.read(state, readings);
        for (lane, arms) in &mut open {
            for (arm, touches) in arms.iter_mut().enumerate() {
                *touches = touching.by_arm[arm].lane(*lane) > 0.0;
            }
        }
        open.retain(|(_, arms)| arms.contains(&true));
    }
    for (lane, _) in open {
        state.set_lane(lane, &home);
    }
    if start.turning > 0.0 {
        physics.rest_centre_of_mass(state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::{quaternion_to_rotation, sub};
    use crate::step::StepOptions;

    const START: Start =
        Start { share: 0.5, joints: 1.0, attitude: 0.4, anywhere: 0.0, turning: 0.0 };

    /// Starts of 400 environments, one a lane.
    fn starts(start: Start) -> Vec<State<f64>> {
        let robot = Robot::builtin("paper").expect("built in");
        let mut physics = Physics::with_options(&robot, StepOptions::default());
        let mut readings = Readings::new(&robot.joints);
        let goals = GoalAddress { seed: 7, purpose: Purpose::Goal, iteration: 3, env: 0 };
        let states = (0..400).map(|env| {
            let mut state = State::home(&robot);
            scatter(&start, &robot, &mut physics, &mut readings, (goals, |_| env), &mut state);
            state
        });
        states.collect()
    }

    #[test]
    fn a_share_of_the_episodes_begins_away_from_home_within_the_ranges() {
        let robot = Robot::builtin("paper").expect("built in");
        let home = State::<f64>::home(&robot);
        let mut physics = Physics::with_options(&robot, StepOptions::default());
        let mut readings = Readings::new(&robot.joints);
        let states = starts(START);
        let away: Vec<_> = states.iter().filter(|state| **state != home).collect();
        // 200 ± 3 standard deviations.
        assert!((170..=230).contains(&away.len()), "{}", away.len());
        let (mut joints, mut attitude) = (0.0_f64, 0.0_f64);
        for state in &away {
            assert_eq!(physics.read(state, &mut readings).pairs, 0.0, "nothing touches");
            for (q, home) in state.q.iter().zip(&home.q) {
                joints = joints.max((q - home).abs());
            }
            let [w, x, y, z] = state.base_quaternion;
            let half = f64::hypot(x, f64::hypot(y, z)).atan2(w);
            attitude = attitude.max(2.0 * half);
            let still = State {
                base_quaternion: home.base_quaternion,
                q: home.q.clone(),
                ..(*state).clone()
            };
            assert_eq!(still, home, "only joints and attitude differ");
            let rotation = quaternion_to_rotation(&state.base_quaternion);
            assert!(rotation.iter().flatten().all(|x| x.is_finite()));
        }
        assert!(joints > 0.9 && joints <= START.joints, "{joints}");
        assert!(attitude > 0.4 && attitude <= 3.0_f64.sqrt() * START.attitude, "{attitude}");
    }

    #[test]
    fn a_share_of_the_arms_stands_anywhere() {
        let robot = Robot::builtin("paper").expect("built in");
        let home = State::<f64>::home(&robot);
        let start = Start { share: 1.0, joints: 0.1, attitude: 0.0, anywhere: 0.25, turning: 0.0 };
        let mut far = 0;
        let mut largest = [0.0_f64; 6];
        for state in starts(start) {
            let arms = state.q.chunks_exact(6);
            for (q, home) in arms.zip(home.q.chunks_exact(6)) {
                let offset: Vec<f64> =
                    q.iter().zip(home).map(|(q, home)| (q - home).abs()).collect();
                if offset.iter().any(|&offset| offset > start.joints) {
                    far += 1;
                    for (largest, offset) in largest.iter_mut().zip(offset) {
                        *largest = largest.max(offset);
                    }
                }
            }
        }
        // A quarter of the 1,600 arms, 400 ± 4 standard deviations.
        assert!((330..=470).contains(&far), "{far}");
        // The second and fourth joint soon bring the arm into the base or itself.
        for (largest, least) in largest.into_iter().zip([3.0, 1.7, 2.7, 1.7, 3.0, 3.0]) {
            assert!(largest > least && largest <= PI, "{largest}");
        }
    }

    #[test]
    fn those_away_from_home_turn_about_a_centre_of_mass_that_rests() {
        let robot = Robot::builtin("paper").expect("built in");
        let options = StepOptions { contacts: false, ..StepOptions::default() };
        let mut physics = Physics::with_options(&robot, options);
        let mut readings = Readings::new(&robot.joints);
        let turning = Start { turning: 0.02, ..START };
        let mut fastest = 0.0_f64;
        for (mut state, still) in starts(turning).into_iter().zip(starts(START)) {
            assert_eq!((&state.q, state.base_quaternion), (&still.q, still.base_quaternion));
            let rates = state.base_angular_velocity;
            fastest = rates.into_iter().fold(fastest, |fastest, rate| fastest.max(rate.abs()));
            if still == State::home(&robot) {
                assert_eq!(state, still, "who begins at home is at rest");
                continue;
            }
            // Free flight: after eight steps with all joints held the centre of mass is where it was.
            let centre = physics.centre_of_mass(&state);
            for _ in 0..8 {
                physics.step(&mut state, &[0.0; 24]);
            }
            physics.read(&state, &mut readings);
            let moved = sub(physics.centre_of_mass(&state), centre);
            assert!(moved.iter().all(|x| x.abs() < 1e-9), "{moved:?} m");
        }
        assert!(fastest > 0.018 && fastest <= turning.turning, "{fastest} rad/s");
    }

    #[test]
    fn without_a_share_all_begin_at_home() {
        let robot = Robot::builtin("paper").expect("built in");
        let home = State::<f64>::home(&robot);
        assert!(starts(Start { share: 0.0, ..START }).iter().all(|state| *state == home));
        assert!(starts(Start { share: 1.0, ..START }).iter().all(|state| *state != home));
    }
}
