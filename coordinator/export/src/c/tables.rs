//! Constants and tables of numbers as C writes them.

use std::fmt::Write as _;
use std::ops::Range;

use crate::networks::{Layer, Networks, Stacked};
use crate::source::Source;

/// `#define OCTOPUS_NAME value`.
pub(super) fn define(out: &mut String, name: &str, value: &str) {
    let _ = writeln!(out, "#define OCTOPUS_{name} {value}");
}

/// The shortest number that is read back to the same bits.
pub(super) fn float(x: f32) -> String {
    format!("{x:?}f")
}

fn floats<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    let values: Vec<String> = values.into_iter().map(|&x| float(x as f32)).collect();
    format!("{{{}}}", values.join(", "))
}

pub(super) fn matrix(m: &[[f64; 3]; 3]) -> String {
    let rows: Vec<String> = m.iter().map(floats).collect();
    format!("{{{}}}", rows.join(", "))
}

/// Numbers in lines of some width.
pub(super) fn table(out: &mut String, declaration: &str, values: impl Iterator<Item = String>) {
    let _ = write!(out, "static const {declaration} = {{");
    let mut width = usize::MAX;
    for value in values {
        if width > 110 {
            out.push_str("\n    ");
            width = 4;
        }
        width += value.len() + 1;
        let _ = write!(out, "{value},");
    }
    out.push_str("\n};\n");
}

/// What the fixed text calls a tensor.
fn identifier(name: &str) -> String {
    name.replace('.', "_")
}

fn stacked(out: &mut String, tensor: &Stacked) {
    let name = identifier(&tensor.name);
    let (n, shape) = (tensor.rows.len(), &tensor.shape);
    // Rows of weights in bfloat16 are taken in pairs; an odd last one stands beside zeros.
    let missing = if tensor.half { shape[0] % 2 * shape[1] } else { 0 };
    let length = shape.iter().product::<usize>() + missing;
    let all = tensor.rows.iter().flat_map(|row| row.iter().copied().chain(vec![0.0; missing]));
    if tensor.half {
        let upper = all.map(|x| (x.to_bits() >> 16).to_string());
        table(out, &format!("uint16_t {name}[{}]", n * length), upper);
    } else {
        table(out, &format!("float {name}[{}]", n * length), all.map(float));
    }
    let rows = tensor.row_of.iter().map(ToString::to_string);
    table(out, &format!("unsigned char {name}_row[OCTOPUS_ACTORS]"), rows);
}

fn layer(layer: &Layer, with_norm: bool) -> String {
    let [inputs, outputs] = layer.sizes();
    let weight = identifier(&layer.weight.name);
    let bias = identifier(&layer.bias.name);
    let (single, half) =
        if layer.weight.half { ("NULL", weight.as_str()) } else { (weight.as_str(), "NULL") };
    let mut text =
        format!("{{{inputs}, {outputs}, {single}, {half}, {weight}_row, {bias}, {bias}_row");
    if with_norm {
        let names = layer.norm.as_ref().map(|norm| norm.each_ref().map(|t| identifier(&t.name)));
        let _ = match names {
            Some([gain, shift]) => write!(text, ", {gain}, {gain}_row, {shift}, {shift}_row"),
            None => write!(text, ", NULL, NULL, NULL, NULL"),
        };
    }
    text + "}"
}

/// The robot and the networks.
pub(super) fn tables(source: &Source<'_>, networks: &Networks) -> String {
    let mut out = String::new();
    robot(&mut out, source);
    for tensor in networks.input.iter().flatten() {
        stacked(&mut out, tensor);
    }
    for layer in &networks.layers {
        stacked(&mut out, &layer.weight);
        stacked(&mut out, &layer.bias);
        for tensor in layer.norm.iter().flatten() {
            stacked(&mut out, tensor);
        }
    }
    let with_norm = source.world.config.network.layer_norm;
    let layers = networks.layers.iter().map(|one| format!("\n    {}", layer(one, with_norm)));
    table(&mut out, "layer_type LAYERS[OCTOPUS_LAYERS]", layers);
    out
}

fn robot(out: &mut String, source: &Source<'_>) {
    let world = source.world;
    let (robot, task) = (&world.robot, &world.task);
    let home = &task.goals.home;
    out.push_str("#if OCTOPUS_NEEDS_ALGEBRA\n");
    let arms =
        robot.arms.iter().zip(source.reaches()).enumerate().map(|(index, (arm, reaches))| {
            let rows: [[f64; 3]; 3] = [0, 1, 2].map(|i| [0, 1, 2].map(|j| arm.rotation[(i, j)]));
            format!(
                "\n    {{{}, {{{}}}, {}, {}, {}, {}, {}}}",
                floats(arm.position.as_slice()),
                matrix(&rows),
                matrix(&task.arm_axes(index)),
                floats(&arm.home),
                i32::from(reaches),
                arm.arm_type,
                float(robot.type_of(index).reach() as f32)
            )
        });
    table(out, "arm_type ARMS[OCTOPUS_ARMS]", arms);
    let joints = robot.joints;
    let range = |of: Range<usize>| format!(" {{{}, {}}}", of.start, of.len());
    let of_arms = (0..joints.n_arms()).map(|arm| range(joints.of_arm(arm)));
    table(out, "joints_type ARM_JOINTS[OCTOPUS_ARMS]", of_arms);
    out.push_str("#endif\n");
    let of_agents = (0..joints.n_agents()).map(|agent| range(joints.of_agent(agent)));
    table(out, "joints_type AGENT_JOINTS[OCTOPUS_AGENTS]", of_agents);
    out.push_str(
        "#if OCTOPUS_NEEDS_HANDS\n/* Of all types of arms, one type after the other. */\n",
    );
    let links = robot.types.iter().flat_map(|kind| &kind.links).map(|link| {
        let (cosine, sine) = (link.twist[(1, 1)], link.twist[(2, 1)]);
        let twist = match (cosine, sine) {
            (1.0, 0.0) => 0,
            (0.0, 1.0) => 1,
            (0.0, -1.0) => -1,
            _ => 2,
        };
        let numbers = [link.shift.x, link.shift.z, cosine, sine].map(|x| float(x as f32));
        let has = |x: f64| i32::from(x != 0.0);
        let (has_a, has_d) = (has(link.shift.x), has(link.shift.z));
        format!("\n    {{{has_a}, {has_d}, {twist}, {}}}", numbers.join(", "))
    });
    table(out, "link_type LINKS[OCTOPUS_LINKS]", links);
    let mut first_link = 0;
    let kinds = robot.types.iter().map(|kind| {
        let tool: [[f64; 3]; 3] = [0, 1, 2].map(|i| [0, 1, 2].map(|j| kind.tool_rotation[(i, j)]));
        let position = floats(kind.tool_position.as_slice());
        let text = format!("\n    {{{first_link}, {position}, {{{}}}}}", matrix(&tool));
        first_link += kind.links.len();
        text
    });
    table(out, "kind_type KINDS[OCTOPUS_KINDS]", kinds);
    out.push_str("#endif\n");
    let limits = task.action_limit.iter().map(|&x| float(x as f32));
    table(out, "float ACTION_LIMITS[OCTOPUS_JOINTS]", limits);
    let exact = |values: &[f64]| {
        let values: Vec<String> = values.iter().map(|x| format!("{x:?}")).collect();
        format!("{{{}}}", values.join(", "))
    };
    let _ = writeln!(
        out,
        "static const octopus_state HOME = {{{}, {{1.0, 0.0, 0.0, 0.0}}, {{0.0}}, {{0.0}}, {}, {{0.0}}}};",
        exact(&home.base_position),
        exact(&robot.home_q())
    );
    let mut goals = Vec::new();
    if source.has_hand_goals() {
        let hands = home.arms.iter().map(|arm| exact(&[arm.position, arm.euler].concat()));
        goals.push(format!("{{{}}}", hands.collect::<Vec<_>>().join(", ")));
    }
    if source.has_moving_goals() {
        goals.push("{{0.0}}".to_owned());
    }
    if source.has_base_goal() {
        goals.push(exact(&home.base_euler));
    }
    let goals = goals.join(", ");
    let _ = writeln!(out, "static const octopus_goals HOME_GOALS = {{{goals}}};");
}
