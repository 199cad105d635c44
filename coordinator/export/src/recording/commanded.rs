//! What a motion follows from: a robot, where it begins, and commands.

use std::path::Path;
use std::sync::Arc;

use proto::config::TaskName;
use proto::tasks::Aim;
use serde::{Deserialize, Serialize};
use simulator::env::step_options;
use simulator::experiment::{Episode, FixedGoals, Member, Motion, Start};
use simulator::robot::Robot;
use simulator::rollout::World;
use simulator::state::State;
use simulator::step::{Integrator, StepOptions};

use crate::error::ExportError;
use crate::replay::BlockStart;

/// What a motion follows from, to the bit.
#[derive(Debug, Clone)]
pub struct Commanded {
    /// The robot.
    pub robot: Robot,
    /// How it is integrated.
    pub options: StepOptions,
    /// Where it begins.
    pub start: State<f32>,
    /// Goals, which the motion does not depend on; where they move, at the beginning.
    pub goals: FixedGoals,
    /// Where the hands' goals are after every control step; empty where they stay.
    pub moved_goals: Vec<Vec<Option<[f64; 6]>>>,
    /// Factors on what bodies weigh, of the base first, then of the links of all types of arms; none where they weigh what is described.
    pub mass_factors: Vec<f32>,
    /// Joint rates (rad/s), arm-major, a row a control step.
    pub commands: Vec<Vec<f32>>,
}

impl Commanded {
    /// What a policy commands in an episode of so many control steps.
    ///
    /// # Errors
    /// If the policy gives no number or the simulation diverges.
    pub fn by_policy(member: Member, start: Start, steps: usize) -> Result<Self, ExportError> {
        let failed = |error: &dyn std::fmt::Display| ExportError::Episode(error.to_string());
        let (task, options) = (member.world.task.name, step_options(&member.world.config));
        let mut episode =
            Episode::new(vec![Arc::new(member)], start).map_err(|error| failed(&error))?;
        let goals = episode.goals();
        let goals =
            FixedGoals { hands: of_hands(task, &goals.hands), base: of_base(task, goals.base) };
        let (robot, start) = (episode.robot().clone(), episode.state().clone());
        let mut commands = Vec::with_capacity(steps);
        let mut moved_goals = Vec::new();
        for _ in 0..steps {
            episode.step().map_err(|error| failed(&error))?;
            commands.push(episode.commands().to_vec());
            if task.moves() {
                moved_goals.push(of_hands(task, &episode.goals().hands));
            }
        }
        let mass_factors = Vec::new();
        Ok(Self { robot, options, start, goals, moved_goals, mass_factors, commands })
    }

    /// What was commanded in an environment of a run: where it began, and its actions before clipping and scaling, arm-major, a row a control step.
    /// Where drives err, the rates are those that they make of the actions.
    ///
    /// # Panics
    /// Without goals at the beginning.
    pub fn by_actions<'a>(
        world: &World,
        start: BlockStart,
        actions: impl Iterator<Item = &'a [f32]>,
    ) -> Self {
        let BlockStart { robot, hands, base, mut erring } = start;
        let task = world.task.name;
        let mut hands = hands.iter().map(|hands| of_hands(task, hands));
        let at_first = hands.next().expect("goals at the beginning");
        let limits: Vec<f32> = world.task.action_limit.iter().map(|&limit| limit as f32).collect();
        let scale = world.task.action_scale as f32;
        let commanded = |(&action, &limit): (&f32, &f32)| action.clamp(-limit, limit) * scale;
        let mass_factors = erring.as_ref().map(|erring| erring.mass_factors().to_vec());
        let executed = |row: &[f32]| {
            let commands: Vec<f32> = row.iter().zip(&limits).map(commanded).collect();
            match &mut erring {
                Some(erring) => erring.drive(&commands).to_vec(),
                None => commands,
            }
        };
        Self {
            robot: world.robot.clone(),
            options: step_options(&world.config),
            start: state_of(&world.robot, &robot),
            goals: FixedGoals { hands: at_first, base: of_base(task, base) },
            moved_goals: hands.collect(),
            mass_factors: mass_factors.unwrap_or_default(),
            commands: actions.map(executed).collect(),
        }
    }

    /// The robot at its beginning.
    pub(crate) fn begin(&self) -> Motion {
        Motion::new(&self.robot, self.options, self.start.clone(), &self.goals)
            .weighing(&self.mass_factors)
    }

    /// Takes control step `step`, counted from 0.
    ///
    /// # Errors
    /// If the simulation diverges.
    pub(crate) fn step(&self, step: usize, motion: &mut Motion) -> Result<(), ExportError> {
        motion
            .step_towards(&self.commands[step], self.hand_goals(step + 1))
            .map_err(|error| ExportError::Episode(error.to_string()))
    }

    /// Goals of the hands after so many control steps.
    pub(super) fn hand_goals(&self, steps: usize) -> &[Option<[f64; 6]>] {
        let moved = steps.checked_sub(1).and_then(|step| self.moved_goals.get(step));
        moved.unwrap_or(&self.goals.hands)
    }
}

/// The goals that a task has for hands.
fn of_hands(task: TaskName, hands: &[[f32; 6]]) -> Vec<Option<[f64; 6]>> {
    let hand = |(arm, goal): (usize, &[f32; 6])| {
        (task.aim(arm, hands.len()) == Aim::Hand).then(|| goal.map(f64::from))
    };
    let reaching = if task.reaches() { hands } else { &[] };
    reaching.iter().enumerate().map(hand).collect()
}

/// The goal that a task has for the base.
fn of_base(task: TaskName, base: [f32; 3]) -> Option<[f64; 3]> {
    task.turns().then(|| base.map(f64::from))
}

/// A motion as a recording keeps it, number by number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotionFile {
    /// Of this description.
    format: u32,
    control_period_s: f64,
    substep_s: f64,
    integrator: proto::config::Integrator,
    contacts: bool,
    /// Position (m) and Euler angles (rad), world.
    hand_goals: Vec<Option<[f64; 6]>>,
    /// Those after every control step, where they move.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    moved_hand_goals: Vec<Vec<Option<[f64; 6]>>>,
    /// Euler angles (rad).
    base_goal: Option<[f64; 3]>,
    /// Factors on what bodies weigh, where they weigh something else than is described.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    mass_factors: Vec<f32>,
    /// Joint rates (rad/s), a row a control step.
    commands: Vec<Vec<f32>>,
    /// At the beginning and after every control step: base position (m), quaternion (w, x, y, z), velocity (m/s, world), angular velocity (rad/s,
    /// base axes), joint angles (rad), joint rates (rad/s).
    states: Vec<Vec<f32>>,
}

const FORMAT: u32 = 1;

/// Substeps of a control period, at most.
const MOST_SUBSTEPS: f64 = 10_000.0;

/// A recorded motion: what it follows from, and every state as it was.
#[derive(Debug, Clone)]
pub struct Recorded {
    /// What it follows from.
    pub commanded: Commanded,
    /// Numbers of the state after every control step.
    pub(crate) states: Vec<Vec<f32>>,
}

impl MotionFile {
    pub(super) fn new(commanded: &Commanded, states: Vec<Vec<f32>>) -> Self {
        let Commanded { options, goals, moved_goals, mass_factors, commands, .. } = commanded;
        Self {
            format: FORMAT,
            control_period_s: options.control_period,
            substep_s: options.substep,
            integrator: match options.integrator {
                Integrator::Rk4 => proto::config::Integrator::Rk4,
                Integrator::Rk3 => proto::config::Integrator::Rk3,
                Integrator::Euler => proto::config::Integrator::Euler,
            },
            contacts: options.contacts,
            hand_goals: goals.hands.clone(),
            moved_hand_goals: moved_goals.clone(),
            base_goal: goals.base,
            mass_factors: mass_factors.clone(),
            commands: commands.clone(),
            states,
        }
    }

    /// The motion that a recording keeps; `robot` is the text of its robot.
    pub(super) fn read(text: &[u8], robot: &str) -> Result<Recorded, String> {
        let file: Self =
            serde_json::from_slice(text).map_err(|error| format!("{MOTION}: {error}"))?;
        let bad = |what: String| format!("{MOTION}: {what}");
        if file.format != FORMAT {
            return Err(bad(format!("is of format {}, expected {FORMAT}", file.format)));
        }
        let robot = Robot::from_toml(robot, Path::new(ROBOT)).map_err(|error| error.to_string())?;
        let options = StepOptions {
            control_period: file.control_period_s,
            substep: file.substep_s,
            integrator: match file.integrator {
                proto::config::Integrator::Rk4 => Integrator::Rk4,
                proto::config::Integrator::Rk3 => Integrator::Rk3,
                proto::config::Integrator::Euler => Integrator::Euler,
            },
            contacts: file.contacts,
        };
        let (period, substep) = (options.control_period, options.substep);
        if !(1e-4..=10.0).contains(&period)
            || !(1e-5..=period).contains(&substep)
            || period / substep > MOST_SUBSTEPS
        {
            return Err(bad(format!(
                "a control period of {period} s in substeps of {substep} s; expected 0.0001 to 10 s, in \
                 substeps of 0.00001 s at least, {MOST_SUBSTEPS} at most"
            )));
        }
        let (n_joints, n_steps) = (robot.n_joints(), file.commands.len());
        let width = 13 + 2 * n_joints;
        for (what, rows, wide) in
            [("commands", &file.commands, n_joints), ("states", &file.states, width)]
        {
            for (row, numbers) in rows.iter().enumerate() {
                if numbers.len() != wide || !numbers.iter().all(|x| x.is_finite()) {
                    let n = numbers.len();
                    return Err(bad(format!(
                        "row {row} of the {what} has {n} numbers, expected {wide} finite ones"
                    )));
                }
            }
        }
        let of_hands = || [&file.hand_goals].into_iter().chain(&file.moved_hand_goals);
        let goals = of_hands().flatten().flatten().flatten();
        if !goals.chain(file.base_goal.iter().flatten()).all(|x| x.is_finite())
            || of_hands().any(|hands| hands.len() > robot.n_arms)
        {
            return Err(bad(
                "goals that are no numbers, or of more hands than there are".to_owned()
            ));
        }
        let n_bodies = 1 + robot.types.iter().map(|kind| kind.links.len()).sum::<usize>();
        let factors = &file.mass_factors;
        if !(factors.is_empty() || factors.len() == n_bodies)
            || !factors.iter().all(|factor| (1e-3..=1e3).contains(factor))
        {
            return Err(bad(format!(
                "mass_factors: expected none, or one of 0.001 to 1000 for each of {n_bodies} bodies"
            )));
        }
        let n = file.moved_hand_goals.len();
        if n > 0 && n != n_steps {
            return Err(bad(format!("goals after {n} control steps, expected {n_steps}")));
        }
        let mut states = file.states;
        if states.len() != n_steps + 1 {
            let n = states.len();
            return Err(bad(format!(
                "{n} states, expected {}: one more than commands",
                n_steps + 1
            )));
        }
        let first = states.remove(0);
        let square: f32 = first[3..7].iter().map(|x| x * x).sum();
        if (square - 1.0).abs() > 1e-3 {
            return Err(bad(format!(
                "the first quaternion has the length {}, expected 1",
                square.sqrt()
            )));
        }
        let goals = FixedGoals { hands: file.hand_goals, base: file.base_goal };
        let start = state_of(&robot, &first);
        let (moved_goals, commands) = (file.moved_hand_goals, file.commands);
        let mass_factors = file.mass_factors;
        let commanded =
            Commanded { robot, options, start, goals, moved_goals, mass_factors, commands };
        Ok(Recorded { commanded, states })
    }
}

/// What recordings call the robot.
pub(super) const ROBOT: &str = "robot.toml";
/// What they call the motion.
pub(super) const MOTION: &str = "motion.json";

/// The numbers of a state, in their order.
pub(crate) fn numbers_of(state: &State<f32>) -> Vec<f32> {
    state.parts().concat()
}

/// The state of these numbers.
fn state_of(robot: &Robot, numbers: &[f32]) -> State<f32> {
    let mut state = State::<f32>::home(robot);
    for (slot, &number) in state.parts_mut().into_iter().flatten().zip(numbers) {
        *slot = number;
    }
    state
}
