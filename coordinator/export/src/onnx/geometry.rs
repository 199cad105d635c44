//! Rotations, and where the hands are. Shapes: `[batch, …, 3]` of vectors, `[batch, …, 3, 3]` of matrices.

use simulator::robot::Robot;

use super::graph::{Attribute, Graph, Value};

/// Sum of products of constants and values, without what is zero; `None` if all are.
fn combination(g: &mut Graph, terms: &[(f64, &Value)]) -> Option<Value> {
    let mut sum: Option<Value> = None;
    for (factor, value) in terms {
        if *factor == 0.0 {
            continue;
        }
        let term = if *factor == 1.0 {
            (*value).clone()
        } else {
            let factor = g.float(*factor);
            g.op("Mul", &[value, &factor])
        };
        sum = Some(match sum {
            None => term,
            Some(sum) => g.op("Add", &[&sum, &term]),
        });
    }
    sum
}

/// a × b along the last axis.
pub(super) fn cross(g: &mut Graph, a: &Value, b: &Value) -> Value {
    let mut product = |i: [i64; 3], j: [i64; 3]| {
        let (a, b) = (g.gather(a, -1, &i), g.gather(b, -1, &j));
        g.op("Mul", &[&a, &b])
    };
    let (plus, minus) = (product([1, 2, 0], [2, 0, 1]), product([2, 0, 1], [1, 2, 0]));
    g.op("Sub", &[&plus, &minus])
}

/// m v of `[…, 3, 3]` and `[…, 3]`.
pub(super) fn mat_vec(g: &mut Graph, m: &Value, v: &Value) -> Value {
    let axes = g.ints(&[-1]);
    let column = g.op("Unsqueeze", &[v, &axes]);
    let product = g.op("MatMul", &[m, &column]);
    g.op("Squeeze", &[&product, &axes])
}

/// Entry `[…, i, j]` of a matrix as `[…, 1]`.
fn entry(g: &mut Graph, m: &Value, i: i64, j: i64) -> Value {
    let row = g.gather(m, -2, &[i]);
    let entry = g.gather(&row, -1, &[j]);
    let axes = g.ints(&[-1]);
    g.op("Squeeze", &[&entry, &axes])
}

/// `[batch, 3, 3]` of unit quaternions (w, x, y, z), `[batch, 4]`.
pub(super) fn rotation(g: &mut Graph, quaternion: &Value) -> Value {
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| g.gather(quaternion, -1, &[i]));
    let two = g.float(2.0);
    let one = g.float(1.0);
    let mut twice = |a: &Value, b: &Value| {
        let product = g.op("Mul", &[a, b]);
        g.op("Mul", &[&product, &two])
    };
    let (xx, yy, zz) = (twice(&x, &x), twice(&y, &y), twice(&z, &z));
    let (xy, xz, yz) = (twice(&x, &y), twice(&x, &z), twice(&y, &z));
    let (wx, wy, wz) = (twice(&w, &x), twice(&w, &y), twice(&w, &z));
    let mut diagonal = |a: &Value, b: &Value| {
        let sum = g.op("Add", &[a, b]);
        g.op("Sub", &[&one, &sum])
    };
    let [d0, d1, d2] = [diagonal(&yy, &zz), diagonal(&xx, &zz), diagonal(&xx, &yy)];
    let plus = |g: &mut Graph, a: &Value, b: &Value| g.op("Add", &[a, b]);
    let minus = |g: &mut Graph, a: &Value, b: &Value| g.op("Sub", &[a, b]);
    let entries = [
        d0,
        minus(g, &xy, &wz),
        plus(g, &xz, &wy),
        plus(g, &xy, &wz),
        d1,
        minus(g, &yz, &wx),
        minus(g, &xz, &wy),
        plus(g, &yz, &wx),
        d2,
    ];
    let flat = g.concat(&entries);
    g.reshape(&flat, &[0, 3, 3])
}

/// Rx(a) Ry(b) Rz(c) of angles `[batch, n, 3]`: `[batch, n, 3, 3]`.
pub(super) fn rotation_of_euler(g: &mut Graph, angles: &Value) -> Value {
    let (sin, cos) = (g.op("Sin", &[angles]), g.op("Cos", &[angles]));
    let [sa, sb, sc] = [0, 1, 2].map(|i| g.gather(&sin, -1, &[i]));
    let [ca, cb, cc] = [0, 1, 2].map(|i| g.gather(&cos, -1, &[i]));
    let mut times = |a: &Value, b: &Value| g.op("Mul", &[a, b]);
    let (sa_sb, ca_sb) = (times(&sa, &sb), times(&ca, &sb));
    let products = [
        times(&cb, &cc),
        times(&cb, &sc),
        times(&sa_sb, &cc),
        times(&ca, &sc),
        times(&ca, &cc),
        times(&sa_sb, &sc),
        times(&sa, &cb),
        times(&sa, &sc),
        times(&ca_sb, &cc),
        times(&ca_sb, &sc),
        times(&sa, &cc),
        times(&ca, &cb),
    ];
    let [
        cb_cc,
        cb_sc,
        sa_sb_cc,
        ca_sc,
        ca_cc,
        sa_sb_sc,
        sa_cb,
        sa_sc,
        ca_sb_cc,
        ca_sb_sc,
        sa_cc,
        ca_cb,
    ] = products;
    let entries = [
        cb_cc,
        g.op("Neg", &[&cb_sc]),
        sb,
        g.op("Add", &[&sa_sb_cc, &ca_sc]),
        g.op("Sub", &[&ca_cc, &sa_sb_sc]),
        g.op("Neg", &[&sa_cb]),
        g.op("Sub", &[&sa_sc, &ca_sb_cc]),
        g.op("Add", &[&ca_sb_sc, &sa_cc]),
        ca_cb,
    ];
    let flat = g.concat(&entries);
    g.reshape(&flat, &[0, 0, 3, 3])
}

/// Axis of the rotation from one matrix to another, times twice the sine of half its angle: `[…, 3]`.
pub(super) fn rotation_difference(g: &mut Graph, to: &Value, from: &Value) -> Value {
    let back = g.transpose(from, &[0, 1, 3, 2]);
    let d = g.op("MatMul", &[to, &back]);
    let [d0, d1, d2] = [0, 1, 2].map(|i| entry(g, &d, i, i));
    let sum = g.op("Add", &[&d0, &d1]);
    let trace = g.op("Add", &[&sum, &d2]);
    let quarter = g.float(0.25);
    let scaled = g.op("Mul", &[&trace, &quarter]);
    let cos2 = g.op("Add", &[&scaled, &quarter]);
    let least = g.float(0.01);
    let cos2 = g.op("Max", &[&cos2, &least]);
    let root = g.op("Sqrt", &[&cos2]);
    let half = g.float(0.5);
    let k = g.op("Div", &[&half, &root]);
    let parts = [(2, 1), (0, 2), (1, 0)].map(|(i, j)| {
        let (a, b) = (entry(g, &d, i, j), entry(g, &d, j, i));
        g.op("Sub", &[&a, &b])
    });
    let axis = g.concat(&parts);
    g.op("Mul", &[&k, &axis])
}

/// Angle of the point (x, y) in (−π, π].
fn atan2(g: &mut Graph, y: &Value, x: &Value) -> Value {
    let (ax, ay) = (g.op("Abs", &[x]), g.op("Abs", &[y]));
    // atan of the smaller over the larger, so that nothing is divided by zero but where both are.
    let steep = g.op("Greater", &[&ay, &ax]);
    let (high, low) = (g.op("Max", &[&ax, &ay]), g.op("Min", &[&ax, &ay]));
    let tiny = g.float(1e-30);
    let high = g.op("Max", &[&high, &tiny]);
    let ratio = g.op("Div", &[&low, &high]);
    let angle = g.op("Atan", &[&ratio]);
    let quarter = g.float(std::f64::consts::FRAC_PI_2);
    let other = g.op("Sub", &[&quarter, &angle]);
    let angle = g.op("Where", &[&steep, &other, &angle]);
    let zero = g.float(0.0);
    let left = g.op("Less", &[x, &zero]);
    let half = g.float(std::f64::consts::PI);
    let other = g.op("Sub", &[&half, &angle]);
    let angle = g.op("Where", &[&left, &other, &angle]);
    let below = g.op("Less", &[y, &zero]);
    let other = g.op("Neg", &[&angle]);
    g.op("Where", &[&below, &other, &angle])
}

/// Angles (a, b, c) of Rx(a) Ry(b) Rz(c): `[…, 3]` of `[…, 3, 3]`.
pub(super) fn euler(g: &mut Graph, r: &Value) -> Value {
    let [r12, r22, r02, r01, r00] =
        [(1, 2), (2, 2), (0, 2), (0, 1), (0, 0)].map(|(i, j)| entry(g, r, i, j));
    let (p, q) = (g.op("Mul", &[&r22, &r22]), g.op("Mul", &[&r12, &r12]));
    let sum = g.op("Add", &[&p, &q]);
    let cos_b = g.op("Sqrt", &[&sum]);
    let a = atan2(g, &r12, &r22);
    let minus = g.op("Neg", &[&r02]);
    let b = atan2(g, &minus, &cos_b);
    let c = atan2(g, &r01, &r00);
    let angles = g.concat(&[a, b, c]);
    g.op("Neg", &[&angles])
}

/// The hands in the base's frame, `[batch, arms, …]`.
pub(super) struct Hands {
    pub(super) position: Value,
    pub(super) rotation: Value,
    /// Linear and angular velocity, if they were asked for.
    pub(super) velocity: Option<[Value; 2]>,
}

/// What the hands' velocities follow from: velocity and angular velocity of the base in its own axes, `[batch, 1, 3]`,
/// and joint rates, `[batch, arms, longest]`.
pub(super) struct Motion<'a> {
    pub(super) linear: &'a Value,
    pub(super) angular: &'a Value,
    pub(super) rates: &'a Value,
}

/// Forward kinematics of all arms at joint angles `[batch, arms, longest]`.
pub(super) fn hands(
    g: &mut Graph,
    robot: &Robot,
    joint_angles: &Value,
    motion: Option<&Motion<'_>>,
) -> Hands {
    let of_kind = |kind: usize| {
        let arms = (0..robot.n_arms).filter(|&arm| robot.arms[arm].arm_type == kind);
        arms.collect::<Vec<usize>>()
    };
    let kinds = (0..robot.types.len()).map(of_kind).filter(|arms| !arms.is_empty());
    let kinds: Vec<Vec<usize>> = kinds.collect();
    if let [all] = &kinds[..] {
        return hands_of(g, robot, all, joint_angles, motion);
    }
    // The arms of one type side by side, then all in their order.
    let parts: Vec<Hands> = kinds
        .iter()
        .map(|arms| {
            let rows: Vec<i64> = arms.iter().map(|&arm| arm as i64).collect();
            let angles = g.gather(joint_angles, 1, &rows);
            let rates = motion.map(|motion| g.gather(motion.rates, 1, &rows));
            let motion = motion.zip(rates.as_ref());
            let motion = motion.map(|(motion, rates)| Motion { rates, ..*motion });
            hands_of(g, robot, arms, &angles, motion.as_ref())
        })
        .collect();
    let order: Vec<usize> = kinds.concat();
    let place = |arm| order.iter().position(|&other| other == arm).expect("every arm is of a type");
    let places: Vec<i64> = (0..robot.n_arms).map(|arm| place(arm) as i64).collect();
    let mut together = |values: &[&Value]| {
        let all = g.with("Concat", values, vec![Attribute::Int("axis", 1)]);
        g.gather(&all, 1, &places)
    };
    let velocities: Option<Vec<&[Value; 2]>> =
        parts.iter().map(|part| part.velocity.as_ref()).collect();
    Hands {
        position: together(&parts.iter().map(|part| &part.position).collect::<Vec<_>>()),
        rotation: together(&parts.iter().map(|part| &part.rotation).collect::<Vec<_>>()),
        velocity: velocities.map(|of_parts| {
            [0, 1].map(|i| together(&of_parts.iter().map(|part| &part[i]).collect::<Vec<_>>()))
        }),
    }
}

/// [`hands`] of `arms`, which are of one type, at their joint angles.
fn hands_of(
    g: &mut Graph,
    robot: &Robot,
    arms: &[usize],
    joint_angles: &Value,
    motion: Option<&Motion<'_>>,
) -> Hands {
    let of_arms = |g: &mut Graph, get: &dyn Fn(usize, usize) -> f64| {
        let all: Vec<f64> = arms
            .iter()
            .flat_map(|&arm| (0..3).map(move |i| (arm, i)))
            .map(|(arm, i)| get(arm, i))
            .collect();
        g.floats(&[1, arms.len(), 3], &all)
    };
    let (sin, cos) = (g.op("Sin", &[joint_angles]), g.op("Cos", &[joint_angles]));
    // The axes of the frame that moves along the arm.
    let mut axes = [0, 1, 2].map(|k| of_arms(g, &|arm, i| robot.arms[arm].rotation[(i, k)]));
    let mut origin = of_arms(g, &|arm, i| robot.arms[arm].position[i]);
    let mut velocity = motion.map(|motion| {
        let turned = cross(g, motion.angular, &origin);
        [g.op("Add", &[motion.linear, &turned]), motion.angular.clone()]
    });
    let kind = robot.type_of(arms[0]);
    for (joint, link) in kind.links.iter().enumerate() {
        let at = joint as i64;
        let (s, c) = (g.gather(&sin, -1, &[at]), g.gather(&cos, -1, &[at]));
        let [x, y, z] = axes;
        let mut times = |a: &Value, b: &Value| g.op("Mul", &[a, b]);
        let [cx, sy, cy, sx] = [times(&c, &x), times(&s, &y), times(&c, &y), times(&s, &x)];
        let mut x = g.op("Add", &[&cx, &sy]);
        let mut y = g.op("Sub", &[&cy, &sx]);
        let mut z = z;
        if let (Some([_, angular]), Some(motion)) = (&mut velocity, motion) {
            let rate = g.gather(motion.rates, -1, &[at]);
            let turn = g.op("Mul", &[&rate, &z]);
            *angular = g.op("Add", &[angular, &turn]);
        }
        let last = joint + 1 == kind.links.len();
        let (a, d) = (link.shift.x, link.shift.z);
        let t = kind.tool_position;
        let step = if last {
            combination(g, &[(t.x, &x), (t.y, &y), (t.z, &z)])
        } else {
            combination(g, &[(a, &x), (d, &z)])
        };
        if let Some(step) = step {
            origin = g.op("Add", &[&origin, &step]);
            if let Some([linear, angular]) = &mut velocity {
                let turned = cross(g, angular, &step);
                *linear = g.op("Add", &[linear, &turned]);
            }
        }
        if last {
            let m = kind.tool_rotation;
            let columns = [0, 1, 2].map(|k| {
                combination(g, &[(m[(0, k)], &x), (m[(1, k)], &y), (m[(2, k)], &z)])
                    .expect("a rotation has no column of zeros")
            });
            [x, y, z] = columns;
        } else {
            let (cosine, sine) = (link.twist[(1, 1)], link.twist[(2, 1)]);
            let twisted = combination(g, &[(cosine, &y), (sine, &z)]);
            let other = combination(g, &[(-sine, &y), (cosine, &z)]);
            y = twisted.expect("a rotation");
            z = other.expect("a rotation");
        }
        axes = [x, y, z];
    }
    let last = g.ints(&[-1]);
    let columns = axes.map(|axis| g.op("Unsqueeze", &[&axis, &last]));
    let columns: Vec<&Value> = columns.iter().collect();
    let rotation = g.with("Concat", &columns, vec![Attribute::Int("axis", -1)]);
    Hands { position: origin, rotation, velocity }
}
