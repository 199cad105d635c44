//! Robots whose drives and sensors err and whose masses are others, other ones in each episode (domain randomization).
//!
//! J. Tobin et al., "Domain randomization for transferring deep neural networks from simulation to the real world", IROS 2017;
//! X. B. Peng et al., "Sim-to-real transfer of robotic control with dynamics randomization", ICRA 2018.
//!
//! Drives are servos of rates, fast against a control period, so what errs in them is told by the rates that they hold:
//!
//! * **late** by a share d of a period: what joints go in it is d times the last command and 1 − d times the new one;
//! * **dry friction** of f N m: a servo of gain k (N m s/rad) stands still below a rate of f/k, and loses as much above;
//! * **gain**: a factor on the rate.
//!
//! **Masses**: each link of a type of arm, and the base, is so many times as heavy as described, and has as many times the inertia.
//!
//! Drives are late, stick, or are scaled, masses are others, and sensors err, each in its own share of the episodes: together they would teach what only
//! helps against all of them. A policy that never meets a robot without friction shakes one.
//!
//! Rewards and critic states are made from the truth, which training knows; only actors see what sensors say (L. Pinto et al.,
//! "Asymmetric actor critic for image-based robot learning", RSS 2018).

use proto::config::Randomization;
use proto::rng::{Address, Purpose};

use crate::env::{Deviations, draw_normals};
use crate::model::Masses;
use crate::robot::Robot;
use crate::scalar::Real;
use crate::task::goal::GoalAddress;
use crate::task::{Errors, Goals, Readings, Task};

/// What errs in the episodes of a lane group.
pub(crate) struct Randomized<S: Real> {
    /// Where each lane's sensors draw their errors; none where they do not err.
    addresses: Vec<Option<Address>>,
    deviations: Deviations<S>,
    sensors_err: bool,
    /// Share of a control period by which commands are late.
    late: S,
    /// Rates that dry friction takes, one a joint (rad/s).
    lost: Vec<S>,
    /// Factors on rates, one a joint.
    factor: Vec<S>,
    /// Factors on what bodies weigh, of the base first, then of the links of all types; none if they are not drawn.
    pub(super) mass_factors: Vec<S>,
    /// What bodies weigh, if that is drawn.
    pub(super) masses: Option<Masses<S>>,
    /// Commands of the step before, and what drives make of those of this one, one a joint (rad/s).
    before: Vec<S>,
    executed: Vec<S>,
    normals: Vec<S>,
    readings: Readings<S>,
    errors: Errors<S>,
}

impl<S: Real> Randomized<S> {
    /// What errs where `goals` and `env_of` address the episodes' environments, if anything can.
    #[inline(always)]
    pub(super) fn draw(
        ranges: &Randomization,
        (robot, task): (&Robot, &Task),
        (goals, env_of): (GoalAddress, impl Fn(usize) -> u32),
    ) -> Option<Self> {
        if ranges.share == 0.0 {
            return None;
        }
        let GoalAddress { seed, iteration, .. } = goals;
        let n_joints = robot.n_joints();
        let mut errors = Errors::of(task, robot);
        // Only robots that policies learn with err.
        errors.give_rest();
        let joints = vec![S::zero(); n_joints];
        let zero = S::zero();
        let Randomization { position, angle, velocity, rate, .. } = *ranges;
        let mut drawn = Self {
            addresses: vec![None; S::LANES],
            deviations: Deviations { position: zero, angle: zero, velocity: zero, rate: zero },
            sensors_err: [position, angle, velocity, rate].iter().any(|&most| most > 0.0),
            late: zero,
            lost: joints.clone(),
            factor: vec![S::one(); n_joints],
            mass_factors: Vec::new(),
            masses: None,
            before: joints.clone(),
            executed: joints,
            normals: vec![zero; Deviations::<S>::draws(&robot.joints)],
            readings: Readings::new(&robot.joints),
            errors,
        };
        let described = (ranges.mass > 0.0).then(|| Masses::of(robot));
        let n_bodies = described.as_ref().map_or(0, |masses| 1 + masses.links.len());
        drawn.mass_factors = vec![S::one(); n_bodies];
        for lane in 0..S::LANES {
            let purpose = Purpose::Randomization;
            let first = Address { seed, purpose, iteration, env: env_of(lane), step: 0, index: 0 };
            let uniforms = |index| Address { index, ..first }.uniforms().map(f64::from);
            let errs = uniforms(0).map(|chosen| chosen < ranges.share);
            let [is_late, sticks, is_scaled, is_misled] = errs;
            // The square root makes large ones more frequent: small ones need no learning.
            let [late, misled, weighs_other, _] = uniforms(1);
            let [late, misled] = [late, misled].map(libm::sqrt);
            if is_late {
                drawn.late.set_lane(lane, late * ranges.delay);
            }
            if is_misled {
                // Sensors are good or bad together.
                drawn.addresses[lane] = Some(Address { purpose: Purpose::SensorNoise, ..first });
                drawn.deviations.position.set_lane(lane, misled * position);
                drawn.deviations.angle.set_lane(lane, misled * angle);
                drawn.deviations.velocity.set_lane(lane, misled * velocity);
                drawn.deviations.rate.set_lane(lane, misled * rate);
            }
            if weighs_other < ranges.share {
                for (index, factor) in drawn.mass_factors.iter_mut().enumerate() {
                    let [heavier, ..] = uniforms((2 + n_joints + index) as u32);
                    factor.set_lane(lane, 1.0 + ranges.mass * (2.0 * heavier - 1.0));
                }
            }
            for joint in 0..n_joints {
                let [friction, faster, ..] = uniforms(2 + joint as u32);
                if sticks {
                    let gain = robot.link(joint).gain;
                    drawn.lost[joint].set_lane(lane, friction * ranges.friction / gain);
                }
                if is_scaled {
                    drawn.factor[joint].set_lane(lane, 1.0 + ranges.gain * (2.0 * faster - 1.0));
                }
            }
        }
        drawn.masses = described.map(|masses| masses.times(&drawn.mass_factors));
        Some(drawn)
    }

    /// What sensors say of `readings` after `step` steps, and the errors that follow, if any sensor errs.
    #[inline(always)]
    pub(super) fn sense(
        &mut self,
        readings: &Readings<S>,
        goals: &Goals<S>,
        step: usize,
    ) -> Option<(&Readings<S>, &Errors<S>)> {
        if !self.sensors_err {
            return None;
        }
        let addresses = &self.addresses;
        let address_of =
            |lane: usize| addresses[lane].map(|first| Address { step: step as u32, ..first });
        draw_normals(address_of, &mut self.normals);
        self.readings.clone_from(readings);
        self.deviations.add_to(&self.normals, &mut self.readings);
        self.errors.update(&self.readings, goals);
        Some((&self.readings, &self.errors))
    }

    /// The rates that joints have where `commands` are given (rad/s, one a joint).
    #[inline(always)]
    pub(super) fn drive(&mut self, commands: &[S]) -> &[S] {
        for joint in 0..commands.len() {
            let (new, before) = (commands[joint], self.before[joint]);
            let wanted = self.late.mul_add(before - new, new) * self.factor[joint];
            let lost = self.lost[joint];
            self.executed[joint] = wanted - wanted.clamp(-lost, lost);
        }
        self.before.copy_from_slice(commands);
        &self.executed
    }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;
    use crate::env::Physics;
    use crate::state::State;
    use crate::step::StepOptions;

    const RANGES: Randomization = Randomization {
        share: 1.0,
        delay: 1.0,
        friction: 5.0,
        gain: 0.2,
        mass: 0.5,
        position: 0.01,
        angle: 0.02,
        velocity: 0.03,
        rate: 0.04,
    };

    fn robot() -> Robot {
        Robot::builtin("paper").expect("built in")
    }

    /// What errs in environment `env`, alone in its group.
    fn drawn(ranges: Randomization, env: u32) -> Option<Randomized<f64>> {
        let goals = GoalAddress { seed: 3, purpose: Purpose::Goal, iteration: 4, env: 0 };
        let config = Layers::new(Preset::Tuned, None).resolve().expect("a preset");
        let task = Task::new(&config, crate::env::home(&robot()));
        Randomized::draw(&ranges, (&robot(), &task), (goals, |_| env))
    }

    /// Twice as heavy arms, by masses and by description.
    #[test]
    fn a_robot_that_was_given_masses_moves_as_one_that_is_described_with_them() {
        let robot = robot();
        let heavy = robot.with_arm_mass(2.0).expect("a robot");
        let mut masses = Masses::<f64>::of(&robot);
        for link in &mut masses.links {
            *link = *link * 2.0;
        }
        assert_eq!(masses, Masses::of(&heavy));
        let mut given = Physics::with_options(&robot, StepOptions::default());
        given.weigh(&masses);
        let mut described = Physics::with_options(&heavy, StepOptions::default());
        let mut as_it_is = Physics::with_options(&robot, StepOptions::default());
        let mut states = [&robot; 3].map(State::home);
        for step in 0..20 {
            let command = [0.02 * f64::from(step % 7) - 0.05; 24];
            for (physics, state) in
                [&mut given, &mut described, &mut as_it_is].into_iter().zip(&mut states)
            {
                physics.step(state, &command);
            }
        }
        assert_eq!(states[0], states[1]);
        assert_ne!(states[0], states[2]);
    }

    /// By hand: of the first command (0.5 rad/s) joints get what is not late of it, of the second (−0.02) the late part of the
    /// first, too; then the factor; then what friction takes, which is all below f/k.
    #[test]
    fn drives_are_late_and_scaled_and_stick() {
        let mut erring = drawn(RANGES, 0).expect("something errs");
        erring.late = 0.25;
        erring.factor.fill(1.2);
        // 5 N m at a gain of 100 and of 50 N m s/rad.
        for (joint, lost) in erring.lost.iter_mut().enumerate() {
            *lost = if joint % 6 < 3 { 0.05 } else { 0.1 };
        }
        let first = erring.drive(&[0.5; 24]).to_vec();
        let second = erring.drive(&[-0.02; 24]).to_vec();
        let third = erring.drive(&[-0.02; 24]).to_vec();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        // 0.75 · 0.5 · 1.2 = 0.45; (0.25 · 0.5 − 0.75 · 0.02) · 1.2 = 0.132; −0.024.
        for joint in 0..24 {
            let lost = if joint % 6 < 3 { 0.05 } else { 0.1 };
            assert!(close(first[joint], 0.45 - lost), "{}", first[joint]);
            assert!(close(second[joint], 0.132 - lost), "{}", second[joint]);
            assert_eq!(third[joint], 0.0, "it sticks");
        }
    }

    #[test]
    fn what_errs_stays_within_its_ranges_and_reaches_their_ends() {
        let robot = robot();
        let (mut late, mut lost, mut factor, mut position) =
            (0.0_f64, 0.0_f64, [1.0_f64; 2], 0.0_f64);
        let mut factor_of_mass = [1.0_f64; 2];
        let Masses { base, links } = Masses::<f64>::of(&robot);
        let described: Vec<_> = std::iter::once(base).chain(links).collect();
        for env in 0..400 {
            let erring = drawn(RANGES, env).expect("something errs");
            late = late.max(erring.late);
            for (joint, &rate) in erring.lost.iter().enumerate() {
                lost = lost.max(rate * robot.link(joint).gain);
            }
            for &f in &erring.factor {
                factor = [factor[0].min(f), factor[1].max(f)];
            }
            let masses = erring.masses.as_ref().expect("they are drawn");
            let bodies = std::iter::once(&masses.base).chain(&masses.links);
            for (body, described) in bodies.zip(&described) {
                let f = body.mass / described.mass;
                factor_of_mass = [factor_of_mass[0].min(f), factor_of_mass[1].max(f)];
                for (inertia, of_described) in body.inertia.iter().zip(described.inertia) {
                    assert!((inertia - f * of_described).abs() < 1e-12, "no such body");
                }
            }
            let Deviations { position: p, angle, velocity, rate } = erring.deviations;
            position = position.max(p);
            for (other, most) in [(angle, 0.02), (velocity, 0.03), (rate, 0.04)] {
                assert!((other / most - p / 0.01).abs() < 1e-12, "good or bad together");
            }
        }
        assert!(late > 0.98 && late < 1.0, "{late}");
        assert!(lost > 4.98 && lost < 5.0, "{lost}");
        assert!(factor[0] > 0.8 && factor[0] < 0.802 && factor[1] > 1.198 && factor[1] < 1.2);
        let [least, most] = factor_of_mass;
        assert!(least > 0.5 && least < 0.51 && most > 1.49 && most < 1.5, "{least} to {most}");
        assert!(position > 0.0098 && position < 0.01, "{position}");
    }

    #[test]
    fn a_share_of_the_episodes_errs_and_the_others_are_exact() {
        assert!(drawn(Randomization { share: 0.0, ..RANGES }, 0).is_none());
        let commands: Vec<f64> = (0..24).map(|joint| 0.03 * f64::from(joint) - 0.3).collect();
        let described = Masses::<f64>::of(&robot());
        let mut n = [0; 3];
        for env in 0..400 {
            let mut erring = drawn(Randomization { share: 0.25, ..RANGES }, env).expect("some err");
            let exact = erring.drive(&commands) == commands;
            n[0] += usize::from(!exact);
            n[1] += usize::from(erring.addresses[0].is_some());
            n[2] += usize::from(erring.masses.expect("they are drawn") != described);
        }
        // Drives err in 1 − 0.75³ = 58 % of 400, sensors and masses in 25 %; ± 3.5 standard deviations.
        assert!((197..=266).contains(&n[0]), "{n:?}");
        assert!((70..=130).contains(&n[1]) && (70..=130).contains(&n[2]), "{n:?}");
    }

    #[test]
    fn sensors_err_anew_in_each_step_around_the_truth() {
        let mut erring = drawn(RANGES, 7).expect("something errs");
        let deviation = erring.deviations.position;
        let truth = Readings::<f64>::new(&robot().joints);
        let task_goals = Goals::fixed(vec![[0.1; 6]; 4], [0.0; 3]);
        let (mut sum, mut squares, mut n) = (0.0, 0.0, 0.0);
        let mut before = f64::NAN;
        for step in 0..400 {
            let (seen, errors) = erring.sense(&truth, &task_goals, step).expect("sensors err");
            for hand in 0..4 {
                for axis in 0..3 {
                    let x = seen.hands[hand].position[axis];
                    (sum, squares, n) = (sum + x, squares + x * x, n + 1.0);
                    assert!((errors.hands[hand][axis] - (0.1 - x)).abs() < 1e-12, "errors follow");
                }
            }
            assert_ne!(seen.q[0], before, "the same error twice");
            before = seen.q[0];
        }
        // 4,800 numbers: the mean is good to 1/√4800 = 1.4 % of a deviation, the deviation to 1 %; four of each.
        assert!((sum / n).abs() < 0.06 * deviation, "{}", sum / n);
        assert!(((squares / n).sqrt() / deviation - 1.0).abs() < 0.04);
        let exact = Randomization { position: 0.0, angle: 0.0, velocity: 0.0, rate: 0.0, ..RANGES };
        let mut erring = drawn(exact, 7).expect("drives err");
        assert!(erring.sense(&truth, &task_goals, 0).is_none(), "they tell the truth");
    }
}
