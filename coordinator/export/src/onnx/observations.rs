//! What agents see, from state and goals; see `simulator::task::observation`.

use proto::config::{JointAngles, Observation};
use simulator::task::observation::RELEASE_VELOCITY_SCALE;
use simulator::task::{ATTITUDE_WIDTHS, POSITION_WIDTHS};

use super::geometry::{
    Hands, Motion, euler, hands, mat_vec, rotation, rotation_difference, rotation_of_euler,
};
use super::graph::{Graph, Value};
use super::{joints, postures};
use crate::source::Source;

/// The inputs of a controller.
pub(super) struct Inputs {
    pub(super) base_position: Value,
    pub(super) base_attitude: Value,
    pub(super) base_velocity: Value,
    pub(super) base_angular_velocity: Value,
    pub(super) joint_angles: Value,
    pub(super) joint_rates: Value,
    pub(super) last_command: Value,
    /// `[batch, arms, 6]`, where hands have goals.
    pub(super) hand_goals: Option<Value>,
    /// `[batch, arms, 6]`, where these move.
    pub(super) hand_goal_velocities: Option<Value>,
    /// `[batch, 3]`, where the base has a goal.
    pub(super) base_goal: Option<Value>,
    /// `[batch, arms, 2 + longest]`, where there are goal postures.
    pub(super) postures: Option<Value>,
}

/// A controller's graph, with what several parts of it use.
struct Scene<'a> {
    source: &'a Source<'a>,
    inputs: &'a Inputs,
    arms: i64,
    /// Base to world, `[batch, 3, 3]`, and world to base.
    to_world: Value,
    to_base: Value,
}

/// Observations `[batch, A, O]`.
pub(super) fn observations(g: &mut Graph, source: &Source<'_>, inputs: &Inputs) -> Value {
    let to_world = rotation(g, &inputs.base_attitude);
    let to_base = g.transpose(&to_world, &[0, 2, 1]);
    let arms = source.world.dimensions.n_arms as i64;
    let scene = Scene { source, inputs, arms, to_world, to_base };
    match source.world.config.task.observation {
        Observation::Arm => scene.of_arms(g),
        Observation::Paper | Observation::Release => scene.of_agents(g),
    }
}

/// A matrix for each robot beside something for each arm: `[batch, 1, 3, 3]`.
fn beside_arms(g: &mut Graph, matrix: &Value) -> Value {
    let axes = g.ints(&[1]);
    g.op("Unsqueeze", &[matrix, &axes])
}

/// The same for each of `n`: `[batch, n, k]` of `[batch, k]`.
fn repeated(g: &mut Graph, value: &Value, n: i64) -> Value {
    let axes = g.ints(&[1]);
    let one = g.op("Unsqueeze", &[value, &axes]);
    let shape = g.ints(&[1, n, 1]);
    g.op("Expand", &[&one, &shape])
}

impl Scene<'_> {
    fn by_arm(&self, g: &mut Graph, joints: &Value) -> Value {
        joints::by_arm(g, &self.source.world.robot.joints, joints)
    }

    fn hands(&self, g: &mut Graph, with_velocities: bool) -> Hands {
        let robot = &self.source.world.robot;
        let angles = self.by_arm(g, &self.inputs.joint_angles);
        if !with_velocities {
            return hands(g, robot, &angles, None);
        }
        let rates = self.by_arm(g, &self.inputs.joint_rates);
        let linear = mat_vec(g, &self.to_base, &self.inputs.base_velocity);
        let axes = g.ints(&[1]);
        let linear = g.op("Unsqueeze", &[&linear, &axes]);
        let angular = g.op("Unsqueeze", &[&self.inputs.base_angular_velocity, &axes]);
        let motion = Motion { linear: &linear, angular: &angular, rates: &rates };
        hands(g, robot, &angles, Some(&motion))
    }

    /// Vectors `[batch, arms, 3]` in the base's axes, in the world's.
    fn world(&self, g: &mut Graph, vectors: &Value) -> Value {
        // Rows, so the matrix stands transposed.
        g.op("MatMul", &[vectors, &self.to_base])
    }

    /// Vectors `[batch, arms, 3]` in the base's axes, each as its arm sees it.
    fn seen(&self, g: &mut Graph, vectors: &Value) -> Value {
        let task = &self.source.world.task;
        let n = task.n_arms();
        let axes: Vec<f64> = (0..n).flat_map(|arm| task.arm_axes(arm)).flatten().collect();
        let axes = g.floats(&[1, n, 3, 3], &axes);
        mat_vec(g, &axes, vectors)
    }

    /// An error as it is and squashed at two widths, as arms see it.
    fn error(&self, g: &mut Graph, error: &Value, widths: [f64; 2]) -> [Value; 3] {
        let squashed = widths.map(|width| {
            let factor = g.float(1.0 / width);
            let scaled = g.op("Mul", &[error, &factor]);
            let squashed = g.op("Tanh", &[&scaled]);
            self.seen(g, &squashed)
        });
        let [wide, narrow] = squashed;
        [self.seen(g, error), wide, narrow]
    }

    fn of_arms(&self, g: &mut Graph) -> Value {
        let task = &self.source.world.task;
        let Inputs { base_velocity, base_angular_velocity, joint_angles, joint_rates, .. } =
            self.inputs;
        let linear = mat_vec(g, &self.to_base, base_velocity);
        let mut parts = Vec::new();
        for vector in [&linear, base_angular_velocity] {
            let for_all = repeated(g, vector, self.arms);
            parts.push(self.seen(g, &for_all));
        }
        let angles = self.by_arm(g, joint_angles);
        let home = self.source.by_arm(&self.source.world.robot.home_q(), 0.0);
        let home = g.floats(&[1, task.n_arms(), self.source.longest_arm()], &home);
        let turned = g.op("Sub", &[&angles, &home]);
        match task.joint_angles {
            JointAngles::Unwound => parts.push(turned),
            JointAngles::SinCos => {
                parts.push(g.op("Sin", &[&turned]));
                let cosines = g.op("Cos", &[&turned]);
                parts.push(joints::blanked(g, &self.source.world.robot.joints, &cosines));
            }
        }
        parts.push(self.by_arm(g, joint_rates));
        if let Some(goals) = &self.inputs.hand_goals {
            parts.extend(self.of_hands(g, goals));
            if let Some(postures) = &self.inputs.postures {
                parts.extend(postures::seen(g, self.source, postures));
            }
        }
        if let Some(goal) = &self.inputs.base_goal {
            let error = self.base_error(g, goal);
            let shape = g.ints(&[1, self.arms, 1]);
            let error = g.op("Expand", &[&error, &shape]);
            parts.extend(self.error(g, &error, ATTITUDE_WIDTHS));
        }
        let scale = g.float(task.action_scale);
        let last = g.op("Div", &[&self.inputs.last_command, &scale]);
        parts.push(self.by_arm(g, &last));
        let by_arm = g.concat(&parts);
        // Both agents of an arm see the same.
        let both: Vec<i64> = (0..self.arms).flat_map(|arm| [arm, arm]).collect();
        g.gather(&by_arm, 1, &both)
    }

    /// Errors of the hands, and how their goals move: `[batch, arms, n]` each, zeros for arms that turn the base.
    fn of_hands(&self, g: &mut Graph, goals: &Value) -> Vec<Value> {
        let [position, rotation] = self.hand_errors(g, goals);
        let [p, p_wide, p_narrow] = self.error(g, &position, POSITION_WIDTHS);
        let [r, r_wide, r_narrow] = self.error(g, &rotation, ATTITUDE_WIDTHS);
        let mut parts = vec![p, r, p_wide, p_narrow, r_wide, r_narrow];
        if let Some(velocities) = &self.inputs.hand_goal_velocities {
            for at in [[0, 1, 2], [3, 4, 5]] {
                let world = g.gather(velocities, -1, &at);
                let base = g.op("MatMul", &[&world, &self.to_world]);
                parts.push(self.seen(g, &base));
            }
        }
        let reaches: Vec<bool> = self.source.reaches().collect();
        if reaches.iter().all(|reaches| *reaches) {
            return parts;
        }
        let all = g.concat(&parts);
        vec![g.or_zero(&[1, reaches.len(), 1], &reaches, &all)]
    }

    /// Position and rotation, goal − actual, in the base's axes: `[batch, arms, 3]` each.
    fn hand_errors(&self, g: &mut Graph, goals: &Value) -> [Value; 2] {
        let Hands { position, rotation, .. } = self.hands(g, false);
        let world = self.world(g, &position);
        let base = beside_vectors(g, &self.inputs.base_position);
        let world = g.op("Add", &[&world, &base]);
        let goal = g.gather(goals, -1, &[0, 1, 2]);
        let error = g.op("Sub", &[&goal, &world]);
        let error = g.op("MatMul", &[&error, &self.to_world]);
        let attitude = g.gather(goals, -1, &[3, 4, 5]);
        let target = rotation_of_euler(g, &attitude);
        let to_base = beside_arms(g, &self.to_base);
        let target = g.op("MatMul", &[&to_base, &target]);
        [error, rotation_difference(g, &target, &rotation)]
    }

    /// Rotation of the base, goal − actual, in its axes: `[batch, 1, 3]`.
    fn base_error(&self, g: &mut Graph, goal: &Value) -> Value {
        let goal = beside_vectors(g, goal);
        let target = rotation_of_euler(g, &goal);
        let actual = beside_arms(g, &self.to_world);
        let difference = rotation_difference(g, &target, &actual);
        g.op("MatMul", &[&difference, &self.to_world])
    }

    fn of_agents(&self, g: &mut Graph) -> Value {
        let task = &self.source.world.task;
        let agents = self.source.world.dimensions.n_agents as i64;
        let Inputs {
            base_position,
            base_attitude,
            base_velocity,
            base_angular_velocity,
            joint_angles,
            joint_rates,
            hand_goals,
            base_goal,
            ..
        } = self.inputs;
        let own = |g: &mut Graph, joints: &Value| {
            joints::by_agent(g, &self.source.world.robot.joints, joints)
        };
        let mut parts =
            vec![repeated(g, base_position, agents), repeated(g, base_attitude, agents)];
        parts.push(own(g, joint_angles));
        parts.push(repeated(g, base_velocity, agents));
        parts.push(repeated(g, base_angular_velocity, agents));
        parts.push(own(g, joint_rates));
        // Hands or the base: with these layouts no task has goals for both.
        if let Some(goals) = hand_goals {
            let release = task.observation == Observation::Release;
            let hands = self.hands(g, release);
            let world = self.world(g, &hands.position);
            let base = beside_vectors(g, base_position);
            let position = g.op("Add", &[&world, &base]);
            let to_world = beside_arms(g, &self.to_world);
            let rotation = g.op("MatMul", &[&to_world, &hands.rotation]);
            let angles = euler(g, &rotation);
            parts.push(alternating(g, [&position, &angles], agents));
            if let Some(velocity) = &hands.velocity {
                let [linear, angular] = velocity.each_ref().map(|v| self.world(g, v));
                let both = alternating(g, [&linear, &angular], agents);
                let scale = g.float(RELEASE_VELOCITY_SCALE);
                parts.push(g.op("Mul", &[&both, &scale]));
            }
            let both: Vec<i64> = (0..self.arms).flat_map(|arm| [arm, arm]).collect();
            parts.push(g.gather(goals, 1, &both));
        }
        if let Some(goal) = base_goal {
            let angles = euler(g, &self.to_world);
            parts.push(repeated(g, &angles, agents));
            parts.push(repeated(g, goal, agents));
        }
        g.concat(&parts)
    }
}

/// `[batch, 1, k]` of `[batch, k]`.
fn beside_vectors(g: &mut Graph, value: &Value) -> Value {
    let axes = g.ints(&[1]);
    g.op("Unsqueeze", &[value, &axes])
}

/// `[batch, agents, 3]`: of each arm the first for its shoulder, the second for its wrist.
fn alternating(g: &mut Graph, [first, second]: [&Value; 2], agents: i64) -> Value {
    let pairs = g.concat(&[first.clone(), second.clone()]);
    g.reshape(&pairs, &[0, agents, 3])
}
