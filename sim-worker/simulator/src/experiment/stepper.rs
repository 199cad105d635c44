//! Episodes on their way, environments in lanes: the parts of a control step, for whoever drives them.
//!
//! A whole trial is a loop around it (`trial_loop`), as is one episode that someone takes hold of
//! ([`Episode`](super::Episode)): [`Stepper::read`] what is, [`Stepper::think`], [`Stepper::advance`].

use super::chunk::Chunk;
use super::group::Group;
use super::intervention::Lanes;
use super::seat::{Seat, Seen};
use super::{Effect, FixedGoals, Player, SensorNoise};
use crate::env::{EpisodeError, Physics, check_state};
use crate::robot::{Joints, Robot};
use crate::scalar::Real;
use crate::state::State;
use crate::step::{Disturbance, StepOptions};
use crate::task::goal::GoalAddress;
use crate::task::{Errors, Goals, Readings};

/// Episodes on their way.
///
/// Players are lent to every part, because who plays may change between two steps. The robot's limits of joints and its home are the same for
/// every player.
pub(super) struct Stepper<S: Real> {
    pub(super) envs: Chunk,
    joints: Joints,
    pub(super) physics: Physics<S>,
    pub(super) groups: Vec<Group<S>>,
    seats: Vec<Seat<S>>,
    limits: Vec<S>,
    drawn: Vec<S>,
    /// What acted on the last group in the last step.
    pub(super) disturbance: Disturbance<S>,
    undisturbed: Disturbance<S>,
    /// What a diverged step began with, for the report.
    before: State<S>,
}

impl<S: Real> Stepper<S> {
    /// Episodes at home with their goals; lanes beyond the last one repeat it.
    #[inline(always)]
    pub(super) fn new(
        (robot, options): (&Robot, StepOptions),
        players: &[Player<'_>],
        envs: Chunk,
        goals: Aims<'_>,
        delay: usize,
    ) -> Self {
        let n_arms = robot.n_arms;
        let n_groups = envs.n_envs.div_ceil(S::LANES);
        let task = &players[0].world.task;
        let joints = vec![S::zero(); robot.n_joints()];
        let groups = (0..n_groups).map(|group| Group {
            state: State::home(robot),
            readings: Readings::new(&robot.joints),
            seen: Readings::new(&robot.joints),
            goals: draw_goals(players, goals, envs, group * S::LANES),
            errors: Errors::new(n_arms),
            seen_errors: Errors::new(n_arms),
            touching: None,
            action: joints.clone(),
            command: joints.clone(),
            waiting: vec![joints.clone(); delay],
        });
        let mut stepper = Self {
            envs,
            joints: robot.joints,
            physics: Physics::with_options(robot, options),
            groups: groups.collect(),
            seats: Vec::new(),
            limits: task.action_limit.iter().map(|&limit| S::splat(limit)).collect(),
            drawn: vec![S::zero(); SensorNoise::draws(&robot.joints)],
            disturbance: Disturbance::none(&robot.joints),
            undisturbed: Disturbance::none(&robot.joints),
            before: State::home(robot),
        };
        stepper.seat(players);
        stepper
    }

    /// Makes room for what other players see and say.
    pub(super) fn seat(&mut self, players: &[Player<'_>]) {
        let n_groups = self.groups.len();
        self.seats = players.iter().map(|player| Seat::new(player, n_groups)).collect();
    }

    /// Has the players of `arms`, an entry an arm, move them from now on. Goal postures are those of the robot that a player knows, which may not be the
    /// one that moves; of several players that move arms the last one that knows any says how they are gone to. Whether these are others than before: they
    /// have not been read then.
    pub(super) fn assign(&mut self, players: &[Player<'_>], arms: &[Option<usize>]) -> bool {
        let knows = |(number, player): &(usize, &Player<'_>)| {
            arms.contains(&Some(*number)) && player.world.task.knows_postures()
        };
        let teller = players.iter().enumerate().rfind(knows);
        let mut are_others = false;
        for group in &mut self.groups {
            for errors in [&mut group.errors, &mut group.seen_errors] {
                if let Some((_, player)) = teller {
                    are_others |= errors.tell(&player.world.task, &player.world.robot);
                }
                let go = |arm: &Option<usize>| arm.is_some_and(|p| players[p].goes_to_postures());
                errors.activate(arms.iter().map(go));
            }
        }
        are_others
    }

    /// Reads everything off the robot: readings, errors, what touches.
    #[inline(always)]
    pub(super) fn read(&mut self) {
        for group in &mut self.groups {
            group.touching = Some(self.physics.read(&group.state, &mut group.readings));
            group.readings.last_action.copy_from_slice(&group.action);
            group.errors.update(&group.readings, &group.goals);
        }
    }

    /// Has the players of `arms`, an entry an arm, decide on what was read: fills the actions, which are zero where nobody moves an arm.
    ///
    /// # Errors
    /// If an actor gives no number.
    #[inline(always)]
    pub(super) fn think(
        &mut self,
        players: &[Player<'_>],
        arms: &[Option<usize>],
        sensors: &SensorNoise,
        step: usize,
    ) -> Result<(), EpisodeError> {
        let Self { envs, groups, seats, limits, drawn, .. } = self;
        let Chunk { first, n_envs, .. } = *envs;
        let n_groups = groups.len();
        for (index, group) in groups.iter_mut().enumerate() {
            let (seen, errors) = if sensors.any() {
                let lanes = Lanes { envs: *envs, group: index * S::LANES };
                group.seen.clone_from(&group.readings);
                sensors.add_to(lanes, step, drawn, &mut group.seen);
                group.seen_errors.update(&group.seen, &group.goals);
                (&group.seen, &group.seen_errors)
            } else {
                (&group.readings, &group.errors)
            };
            let seen = Seen { readings: seen, errors, goals: &group.goals };
            let place = (index, n_groups, n_envs - index * S::LANES);
            for (player, seat) in seats.iter_mut().enumerate() {
                seat.look(&players[player], (player, arms), (seen, limits), place);
            }
        }

        for group in groups.iter_mut() {
            // Of arms that nobody moves.
            group.action.fill(S::zero());
        }
        for (player, seat) in seats.iter_mut().enumerate() {
            seat.decide(&players[player], (player, arms), groups, limits, (first, step))?;
        }
        Ok(())
    }

    /// Lets `effects` happen and holds the commands for a control period.
    ///
    /// # Errors
    /// If the simulation diverges.
    #[inline(always)]
    pub(super) fn advance<'e>(
        &mut self,
        players: &[Player<'_>],
        arms: &[Option<usize>],
        effects: &(impl Iterator<Item = &'e Effect> + Clone),
        step: usize,
    ) -> Result<(), EpisodeError> {
        let Self { envs, joints, physics, groups, drawn, disturbance, undisturbed, before, .. } =
            self;
        let Chunk { first, n_envs, .. } = *envs;
        for (index, group) in groups.iter_mut().enumerate() {
            let local = index * S::LANES;
            let n_joints = group.action.len();
            disturbance.clone_from(undisturbed);
            let mut disturbed = false;
            for effect in effects.clone() {
                effect.replace(&mut group.action);
                let lanes = Lanes { envs: *envs, group: local };
                disturbed |=
                    effect.disturb(joints, lanes, step, &mut drawn[..n_joints], disturbance);
            }
            for (arm, player) in arms.iter().enumerate() {
                let scale = S::splat(players[player.unwrap_or(0)].action_scale);
                for joint in joints.of_arm(arm) {
                    group.command[joint] = group.action[joint] * scale;
                }
            }
            if let Some(newest) = group.waiting.len().checked_sub(1) {
                // The oldest command is executed, the new one waits.
                group.waiting.rotate_left(1);
                std::mem::swap(&mut group.waiting[newest], &mut group.command);
            }
            before.clone_from(&group.state);
            if disturbed {
                physics.step_disturbed(&mut group.state, &group.command, disturbance);
            } else {
                physics.step(&mut group.state, &group.command);
            }
            if let Err(error) = check_state(joints, &group.state, first, local, n_envs, step) {
                let env = first + local as u32;
                return Err(error.keep(env, before, &group.goals, &group.command));
            }
            // By what was integrated: who sits in the first place may have learned with another period.
            group.goals.advance(physics.control_period());
        }
        Ok(())
    }
}

/// Where a chunk's goals come from.
#[derive(Clone, Copy)]
pub(super) struct Aims<'a> {
    /// Address of the first episode's.
    pub(super) drawn: GoalAddress,
    /// Instead of drawn ones, an entry an episode of the chunk, as far as there are.
    pub(super) given: &'a [FixedGoals],
    /// In every episode.
    pub(super) fixed: &'a FixedGoals,
}

/// The goals of the lane group that begins with local episode `local`.
pub(super) fn draw_goals<S: Real>(
    players: &[Player<'_>],
    aims: Aims<'_>,
    envs: Chunk,
    local: usize,
) -> Goals<S> {
    let mut goals = Goals::<S>::at_home(&players[0].world.task.goals);
    for lane in 0..S::LANES {
        // Lanes beyond the last episode repeat it.
        let env = (local + lane).min(envs.n_envs - 1) as u32;
        let address = GoalAddress { env: aims.drawn.env + env, ..aims.drawn };
        for player in players {
            goals.draw(&player.world.task, address, lane);
        }
        let given = aims.given.get(env as usize);
        for FixedGoals { hands, base } in given.into_iter().chain([aims.fixed]) {
            for (goal, fixed) in goals.hands.iter_mut().zip(hands) {
                for (slot, &value) in goal.iter_mut().zip(fixed.iter().flatten()) {
                    slot.set_lane(lane, value);
                }
            }
            for (slot, &value) in goals.base.iter_mut().zip(base.iter().flatten()) {
                slot.set_lane(lane, value);
            }
        }
    }
    goals.attach();
    goals
}
