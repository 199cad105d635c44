//! The loop that plays a trial's episodes, environments in lanes.

use proto::layout::JOINTS_PER_AGENT;

use super::intervention::Lanes;
use super::recording::record;
use super::{Player, SensorNoise, Trial};
use crate::env::{EpisodeError, Physics, check_means, check_state};
use crate::policy::Scratch;
use crate::robot::JOINTS_PER_ARM;
use crate::rollout::World;
use crate::scalar::{LaneFn, Real};
use crate::state::State;
use crate::step::Disturbance;
use crate::task::goal::GoalAddress;
use crate::task::observation::observe;
use crate::task::{Errors, Goals, Readings};

/// Episodes `first..first + n_envs` of a trial, and where they are recorded.
pub(super) struct Play<'t, 'a> {
    pub(super) trial: &'t Trial<'a>,
    pub(super) first: u32,
    pub(super) n_envs: usize,
    pub(super) series: &'t mut [f32],
    pub(super) on_step: &'t mut dyn FnMut(),
}

/// One lane group.
struct Group<S: Real> {
    state: State<S>,
    /// What is, and what the policies see of it.
    readings: Readings<S>,
    seen: Readings<S>,
    goals: Goals<S>,
    /// Of what is, and of what is seen.
    errors: Errors<S>,
    seen_errors: Errors<S>,
    /// Clipped actions, one a joint.
    action: Vec<S>,
    command: Vec<S>,
    /// Commands that wait, the oldest first.
    waiting: Vec<Vec<S>>,
}

/// What a player sees and says, and room for its networks.
struct PlayerScratch<S: Real> {
    /// Shape: `[P][group][agent of the actor][O]`.
    observations: Vec<S>,
    /// Shape: `[group][agent of the actor][U]`.
    means: Vec<S>,
    inference: Scratch<S>,
}

impl<S: Real> PlayerScratch<S> {
    fn new(player: &Player<'_>, n_groups: usize) -> Self {
        let dimensions = &player.world.dimensions;
        let input = dimensions.n_actors * n_groups * dimensions.actor_input();
        Self {
            observations: vec![S::zero(); input],
            means: vec![S::zero(); n_groups * dimensions.actor_output()],
            inference: Scratch::new(player.policy, n_groups),
        }
    }
}

impl LaneFn for Play<'_, '_> {
    type Output = Result<(), EpisodeError>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let Self { trial, first, n_envs, series, on_step } = self;
        let Trial { players, interventions, steps, .. } = trial;
        let (n_arms, steps) = (trial.n_arms(), *steps);
        let n_joints = n_arms * JOINTS_PER_ARM;
        let n_groups = n_envs.div_ceil(S::LANES);
        // Limits of joints and home are the robot's: the same for every player.
        let task = &players[0].world.task;

        let mut physics = Physics::<S>::with_options(trial.robot, trial.options);
        let mut groups: Vec<Group<S>> = (0..n_groups)
            .map(|group| {
                let mut goals = task.goals.at_home();
                for lane in 0..S::LANES {
                    // Lanes beyond the last episode repeat it.
                    let env = (group * S::LANES + lane).min(n_envs - 1) as u32;
                    let address = GoalAddress { env: trial.goals.env + first + env, ..trial.goals };
                    for player in players {
                        let task = &player.world.task;
                        task.goals.draw(task.name, address, lane, &mut goals);
                    }
                }
                for (goal, fixed) in goals.hands.iter_mut().zip(&trial.fixed.hands) {
                    if let Some(pose) = fixed {
                        *goal = pose.map(S::splat);
                    }
                }
                if let Some(attitude) = trial.fixed.base {
                    goals.base = attitude.map(S::splat);
                }
                let joints = vec![S::zero(); n_joints];
                Group {
                    state: State::home(trial.robot),
                    readings: Readings::new(n_arms),
                    seen: Readings::new(n_arms),
                    goals,
                    errors: Errors::new(n_arms),
                    seen_errors: Errors::new(n_arms),
                    action: joints.clone(),
                    command: joints.clone(),
                    waiting: vec![joints; trial.delay],
                }
            })
            .collect();
        let limits: Vec<S> = task.action_limit.iter().map(|&limit| S::splat(limit)).collect();
        let mut scratches: Vec<PlayerScratch<S>> =
            players.iter().map(|player| PlayerScratch::new(player, n_groups)).collect();
        let mut drawn = vec![S::zero(); SensorNoise::draws(n_arms)];
        let mut disturbance = Disturbance::none(n_arms);
        let undisturbed = disturbance.clone();
        // What a diverged step began with, for the report.
        let mut before = State::<S>::home(trial.robot);

        for step in 0..=steps {
            let phase = trial.phase(step);
            for (index, group) in groups.iter_mut().enumerate() {
                let local = index * S::LANES;
                let touching = physics.read(&group.state, &mut group.readings);
                group.readings.last_action.copy_from_slice(&group.action);
                group.errors.update(&group.readings, &group.goals);
                if step > 0 {
                    record(
                        series,
                        (local, n_envs),
                        (step - 1, steps),
                        &group.errors,
                        &group.state,
                        &touching.by_kind,
                    );
                }
                if step == steps {
                    continue;
                }
                let (seen, errors) = if trial.sensors.any() {
                    let lanes = Lanes { seed: trial.goals.seed, first, group: local, n_envs };
                    group.seen.clone_from(&group.readings);
                    trial.sensors.add_to(lanes, step, &mut drawn, &mut group.seen);
                    group.seen_errors.update(&group.seen, &group.goals);
                    (&group.seen, &group.seen_errors)
                } else {
                    (&group.readings, &group.errors)
                };
                for (player, scratch) in scratches.iter_mut().enumerate() {
                    let World { task, dimensions, .. } = players[player].world;
                    let (o, agents_per_actor) =
                        (dimensions.observation, dimensions.agents_per_actor());
                    for actor in phase.actors(player, dimensions) {
                        for part in 0..agents_per_actor {
                            let agent = actor * agents_per_actor + part;
                            let at = ((actor * n_groups + index) * agents_per_actor + part) * o;
                            let out = &mut scratch.observations[at..at + o];
                            observe(task, seen, &group.goals, errors, agent, out);
                        }
                    }
                }
            }
            if step == steps {
                break;
            }

            for group in &mut groups {
                // Of arms that nobody moves.
                group.action.fill(S::zero());
            }
            for (player, scratch) in scratches.iter_mut().enumerate() {
                let Player { world: World { dimensions, .. }, policy, .. } = players[player];
                let agents_per_actor = dimensions.agents_per_actor();
                let (input, output) = (dimensions.actor_input(), dimensions.actor_output());
                for actor in phase.actors(player, dimensions) {
                    let of_actor = actor * n_groups * input..(actor + 1) * n_groups * input;
                    let seen = &scratch.observations[of_actor];
                    policy.mean(actor, seen, &mut scratch.inference, &mut scratch.means);
                    for part in 0..agents_per_actor {
                        let agent = actor * agents_per_actor + part;
                        if !phase.moves(player, agent) {
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

            for (index, group) in groups.iter_mut().enumerate() {
                let local = index * S::LANES;
                disturbance.clone_from(&undisturbed);
                let mut disturbed = false;
                for intervention in interventions {
                    if !intervention.steps.contains(&step) {
                        continue;
                    }
                    intervention.replace(&mut group.action);
                    let lanes = Lanes { seed: trial.goals.seed, first, group: local, n_envs };
                    disturbed |=
                        intervention.disturb(lanes, step, &mut drawn[..n_joints], &mut disturbance);
                }
                for arm in 0..n_arms {
                    let player = &players[phase.arms[arm].unwrap_or(0)];
                    let scale = S::splat(player.action_scale);
                    for joint in arm * JOINTS_PER_ARM..(arm + 1) * JOINTS_PER_ARM {
                        group.command[joint] = group.action[joint] * scale;
                    }
                }
                if trial.delay > 0 {
                    // The oldest command is executed, the new one waits.
                    group.waiting.rotate_left(1);
                    std::mem::swap(&mut group.waiting[trial.delay - 1], &mut group.command);
                }
                before.clone_from(&group.state);
                if disturbed {
                    physics.step_disturbed(&mut group.state, &group.command, &disturbance);
                } else {
                    physics.step(&mut group.state, &group.command);
                }
                if let Err(error) = check_state(&group.state, first, local, n_envs, step) {
                    let env = first + local as u32;
                    return Err(error.keep(env, &before, &group.goals, &group.command));
                }
            }
            on_step();
        }
        Ok(())
    }
}
