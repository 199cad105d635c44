//! Episodes on their way, environments in lanes: the parts of a control step, for whoever drives them.
//!
//! A whole trial is a loop around it (`trial_loop`), as is one episode that someone takes hold of
//! ([`Episode`](super::Episode)): [`Stepper::read`] what is, [`Stepper::think`], [`Stepper::advance`].

use proto::layout::JOINTS_PER_AGENT;

use super::chunk::Chunk;
use super::intervention::Lanes;
use super::trial::{actors, moves};
use super::{Driver, Effect, FixedGoals, Player, SensorNoise};
use crate::collision::Touching;
use crate::controller::{JacobianController, Memory};
use crate::env::{EpisodeError, Physics, check_means, check_state};
use crate::policy::Scratch;
use crate::robot::{JOINTS_PER_ARM, Robot};
use crate::rollout::World;
use crate::scalar::Real;
use crate::state::State;
use crate::step::{Disturbance, StepOptions};
use crate::task::goal::GoalAddress;
use crate::task::observation::observe;
use crate::task::{Errors, Goals, Readings};

/// One lane group.
#[derive(Clone)]
pub(super) struct Group<S: Real> {
    pub(super) state: State<S>,
    /// What is, and what the policies see of it.
    pub(super) readings: Readings<S>,
    seen: Readings<S>,
    pub(super) goals: Goals<S>,
    /// Of what is, and of what is seen.
    pub(super) errors: Errors<S>,
    seen_errors: Errors<S>,
    /// What touched when it was last read.
    pub(super) touching: Option<Touching<S>>,
    /// Clipped actions, one a joint.
    pub(super) action: Vec<S>,
    /// What is executed (rad/s).
    pub(super) command: Vec<S>,
    /// Commands that wait, the oldest first: as many as control steps lie between an action and its execution.
    pub(super) waiting: Vec<Vec<S>>,
}

impl<S: Real> Group<S> {
    /// Has commands wait for so many control steps. What waits still arrives; where the delay grows, the last of it holds until something new arrives.
    pub(super) fn delay(&mut self, steps: usize) {
        let surplus = self.waiting.len().saturating_sub(steps);
        self.waiting.drain(..surplus);
        let last = self.waiting.last().unwrap_or(&self.command).clone();
        self.waiting.resize(steps, last);
    }
}

/// What a player sees and says, and room for its networks.
struct PlayerScratch<S: Real> {
    /// Shape: `[P][group][agent of the actor][O]`.
    observations: Vec<S>,
    /// Shape: `[group][agent of the actor][U]`.
    means: Vec<S>,
    /// None of a controller.
    inference: Option<Scratch<S>>,
    /// Of a controller, shape: `[group][lane]`.
    memories: Vec<Memory>,
    /// What a controller wants (rad/s), shape: `[group][joint]`.
    rates: Vec<S>,
}

impl<S: Real> PlayerScratch<S> {
    fn new(player: &Player<'_>, n_groups: usize) -> Self {
        let dimensions = &player.world.dimensions;
        let zeros = |n: usize| vec![S::zero(); n];
        match player.driver {
            Driver::Policy(policy) => Self {
                observations: zeros(dimensions.n_actors * n_groups * dimensions.actor_input()),
                means: zeros(n_groups * dimensions.actor_output()),
                inference: Some(Scratch::new(policy, n_groups)),
                memories: Vec::new(),
                rates: Vec::new(),
            },
            Driver::Jacobian(_) => Self {
                observations: Vec::new(),
                means: Vec::new(),
                inference: None,
                memories: vec![Memory::default(); n_groups * S::LANES],
                rates: zeros(n_groups * dimensions.n_arms * JOINTS_PER_ARM),
            },
        }
    }
}

/// Episodes on their way.
///
/// Players are lent to every part, because who plays may change between two steps. The robot's limits of joints and its home are the same for
/// every player.
pub(super) struct Stepper<S: Real> {
    pub(super) envs: Chunk,
    pub(super) physics: Physics<S>,
    pub(super) groups: Vec<Group<S>>,
    scratches: Vec<PlayerScratch<S>>,
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
        let joints = vec![S::zero(); n_arms * JOINTS_PER_ARM];
        let groups = (0..n_groups).map(|group| Group {
            state: State::home(robot),
            readings: Readings::new(n_arms),
            seen: Readings::new(n_arms),
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
            physics: Physics::with_options(robot, options),
            groups: groups.collect(),
            scratches: Vec::new(),
            limits: task.action_limit.iter().map(|&limit| S::splat(limit)).collect(),
            drawn: vec![S::zero(); SensorNoise::draws(n_arms)],
            disturbance: Disturbance::none(n_arms),
            undisturbed: Disturbance::none(n_arms),
            before: State::home(robot),
        };
        stepper.seat(players);
        stepper
    }

    /// Makes room for what other players see and say.
    pub(super) fn seat(&mut self, players: &[Player<'_>]) {
        let n_groups = self.groups.len();
        self.scratches =
            players.iter().map(|player| PlayerScratch::new(player, n_groups)).collect();
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
        let Self { envs, groups, scratches, limits, drawn, .. } = self;
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
            for (player, scratch) in scratches.iter_mut().enumerate() {
                let World { task, dimensions, .. } = players[player].world;
                if let Driver::Jacobian(controller) = players[player].driver {
                    let moves: Vec<bool> = arms.iter().map(|arm| *arm == Some(player)).collect();
                    let lanes = index * S::LANES..(index + 1) * S::LANES;
                    let joints = index * group.action.len()..(index + 1) * group.action.len();
                    control(
                        (controller, &moves),
                        (seen, &group.goals),
                        n_envs - index * S::LANES,
                        &mut scratch.memories[lanes],
                        &mut scratch.rates[joints],
                    );
                    continue;
                }
                let (o, agents_per_actor) = (dimensions.observation, dimensions.agents_per_actor());
                for actor in actors(arms, player, dimensions) {
                    for part in 0..agents_per_actor {
                        let agent = actor * agents_per_actor + part;
                        let at = ((actor * n_groups + index) * agents_per_actor + part) * o;
                        let out = &mut scratch.observations[at..at + o];
                        observe(task, seen, &group.goals, errors, agent, out);
                    }
                }
            }
        }

        for group in groups.iter_mut() {
            // Of arms that nobody moves.
            group.action.fill(S::zero());
        }
        for (player, scratch) in scratches.iter_mut().enumerate() {
            let Player { world: World { dimensions, .. }, driver, action_scale } = players[player];
            let policy = match driver {
                Driver::Policy(policy) => policy,
                Driver::Jacobian(_) => {
                    let per_action = S::splat(1.0 / action_scale);
                    for (index, group) in groups.iter_mut().enumerate() {
                        let n_joints = group.action.len();
                        let rates = &scratch.rates[index * n_joints..(index + 1) * n_joints];
                        let env = first + (index * S::LANES) as u32;
                        for (joint, rate) in rates.iter().enumerate() {
                            if arms[joint / JOINTS_PER_ARM] != Some(player) {
                                continue;
                            }
                            let agent = joint / JOINTS_PER_AGENT;
                            let mean = [*rate * per_action];
                            if let Err(error) = check_means(&mean, env, step, agent) {
                                let Group { state, goals, command, .. } = group;
                                return Err(error.keep(env, state, goals, command));
                            }
                            group.action[joint] = mean[0].clamp(-limits[joint], limits[joint]);
                        }
                    }
                    continue;
                }
            };
            let inference = scratch.inference.as_mut().expect("a policy has room for inference");
            let agents_per_actor = dimensions.agents_per_actor();
            let (input, output) = (dimensions.actor_input(), dimensions.actor_output());
            for actor in actors(arms, player, dimensions) {
                let of_actor = actor * n_groups * input..(actor + 1) * n_groups * input;
                let seen = &scratch.observations[of_actor];
                policy.mean(actor, seen, inference, &mut scratch.means);
                for part in 0..agents_per_actor {
                    let agent = actor * agents_per_actor + part;
                    if !moves(arms, player, agent) {
                        continue;
                    }
                    for (index, group) in groups.iter_mut().enumerate() {
                        let at = index * output + part * JOINTS_PER_AGENT;
                        let mean = &scratch.means[at..at + JOINTS_PER_AGENT];
                        let env = first + (index * S::LANES) as u32;
                        if let Err(error) = check_means(mean, env, step, agent) {
                            let Group { state, goals, command, .. } = group;
                            return Err(error.keep(env, state, goals, command));
                        }
                        for (u, &mean) in mean.iter().enumerate() {
                            let joint = agent * JOINTS_PER_AGENT + u;
                            group.action[joint] = mean.clamp(-limits[joint], limits[joint]);
                        }
                    }
                }
            }
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
        let Self { envs, physics, groups, drawn, disturbance, undisturbed, before, .. } = self;
        let Chunk { first, n_envs, .. } = *envs;
        for (index, group) in groups.iter_mut().enumerate() {
            let local = index * S::LANES;
            let n_joints = group.action.len();
            disturbance.clone_from(undisturbed);
            let mut disturbed = false;
            for effect in effects.clone() {
                effect.replace(&mut group.action);
                let lanes = Lanes { envs: *envs, group: local };
                disturbed |= effect.disturb(lanes, step, &mut drawn[..n_joints], disturbance);
            }
            for (arm, player) in arms.iter().enumerate() {
                let scale = S::splat(players[player.unwrap_or(0)].action_scale);
                for joint in arm * JOINTS_PER_ARM..(arm + 1) * JOINTS_PER_ARM {
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
            if let Err(error) = check_state(&group.state, first, local, n_envs, step) {
                let env = first + local as u32;
                return Err(error.keep(env, before, &group.goals, &group.command));
            }
        }
        Ok(())
    }
}

/// Has a controller decide, lane by lane, on what sensors see; lanes beyond the last of `n` episodes repeat it.
fn control<S: Real>(
    (controller, moves): (&JacobianController, &[bool]),
    (seen, goals): (&Readings<S>, &Goals<S>),
    n: usize,
    memories: &mut [Memory],
    rates: &mut [S],
) {
    for (lane, memory) in memories.iter_mut().enumerate().take(n) {
        let of = |values: &[S]| values.iter().map(|x| x.lane(lane)).collect::<Vec<f64>>();
        let state = State {
            base_position: seen.base_position.map(|x| x.lane(lane)),
            base_quaternion: seen.base_quaternion.map(|x| x.lane(lane)),
            base_linear_velocity: seen.base_linear.map(|x| x.lane(lane)),
            base_angular_velocity: seen.base_angular.map(|x| x.lane(lane)),
            q: of(&seen.q),
            qd: of(&seen.qd),
        };
        let goals = Goals {
            hands: goals.hands.iter().map(|goal| goal.map(|x| x.lane(lane))).collect(),
            base: goals.base.map(|x| x.lane(lane)),
        };
        let found = controller.rates(&state, &goals, moves, memory);
        for lane in lane..if lane + 1 == n { S::LANES } else { lane + 1 } {
            for (slot, rate) in rates.iter_mut().zip(&found) {
                slot.set_lane(lane, *rate);
            }
        }
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
    let mut goals: Goals<S> = players[0].world.task.goals.at_home();
    for lane in 0..S::LANES {
        // Lanes beyond the last episode repeat it.
        let env = (local + lane).min(envs.n_envs - 1) as u32;
        let address = GoalAddress { env: aims.drawn.env + env, ..aims.drawn };
        for player in players {
            let task = &player.world.task;
            task.goals.draw(task.name, address, lane, &mut goals);
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
    goals
}
