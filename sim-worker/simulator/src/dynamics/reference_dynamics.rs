//! The dynamics once more, as a textbook writes them: `f64`, nalgebra, world axes, Newton–Euler. Slow, readable, and sharing no line with the
//! articulated-body algorithm, so that each can be held against the other.

use nalgebra::{DMatrix, DVector, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::aba::Acceleration;
use crate::robot::{RigidBody, Robot};
use crate::state::State;

/// First column of the joints among the generalised velocities.
const JOINTS: usize = 6;

/// Total momentum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Momentum {
    /// Linear (kg m/s), world axes.
    pub linear: Vector3<f64>,
    /// Angular about the centre of mass of everything (kg m²/s), world axes.
    pub angular: Vector3<f64>,
    /// Centre of mass of everything, world (m).
    pub com: Vector3<f64>,
    /// Σ |m v| over the bodies: what rounding of the linear momentum is measured against.
    pub linear_scale: f64,
    /// Σ |I ω + r × m v| over the bodies, about the centre of mass of everything.
    pub angular_scale: f64,
}

/// A body where it is: pose in the world, and the joint that carries it.
struct Placed<'a> {
    body: &'a RigidBody,
    /// Body axes to world axes.
    r: Matrix3<f64>,
    /// Origin of the body's frame (m).
    o: Vector3<f64>,
    /// Index of the joint, none for the base.
    joint: Option<usize>,
    /// The body before, none for the base.
    parent: Option<usize>,
}

impl Placed<'_> {
    fn com(&self) -> Vector3<f64> {
        self.r * self.body.com + self.o
    }

    fn inertia(&self) -> Matrix3<f64> {
        self.r * self.body.inertia * self.r.transpose()
    }

    /// Axis of the joint in the world.
    fn axis(&self) -> Vector3<f64> {
        self.r.column(2).into_owned()
    }
}

/// Base first, then the links, arm-major.
fn place<'a>(robot: &'a Robot, state: &State<f64>) -> Vec<Placed<'a>> {
    let [w, x, y, z] = state.base_quaternion;
    let r =
        *UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix().matrix();
    let o = Vector3::from(state.base_position);
    let mut bodies = vec![Placed { body: &robot.base, r, o, joint: None, parent: None }];
    for (a, arm) in robot.arms.iter().enumerate() {
        let (mut r, mut o) = (r * arm.rotation, o + r * arm.position);
        let mut parent = 0;
        for (joint, link) in robot.joints.of_arm(a).zip(&robot.type_of(a).links) {
            r *= Rotation3::from_axis_angle(&Vector3::z_axis(), state.q[joint]).matrix();
            bodies.push(Placed {
                body: &link.body,
                r,
                o,
                joint: Some(joint),
                parent: Some(parent),
            });
            parent = bodies.len() - 1;
            o += r * link.shift;
            r *= link.twist;
        }
    }
    bodies
}

/// Inertia matrix: Σ m Jᵥᵀ Jᵥ + J_ωᵀ I J_ω over the bodies' Jacobians, plus the armatures.
///
/// Shape: (6 + `n_joints`)². Rows: base linear (world), base angular (base axes), joints.
/// [Featherstone 2008, eq. 6.1 with the Jacobians of the centres of mass].
pub fn inertia_matrix(robot: &Robot, state: &State<f64>) -> DMatrix<f64> {
    let bodies = place(robot, state);
    let n = JOINTS + robot.n_joints();
    let mut m = DMatrix::zeros(n, n);
    for (i, body) in bodies.iter().enumerate() {
        let mut jv = DMatrix::zeros(3, n);
        let mut jw = DMatrix::zeros(3, n);
        let com = body.com();
        for axis in 0..3 {
            jv[(axis, axis)] = 1.0;
            let w = bodies[0].r.column(axis).into_owned();
            jv.fixed_view_mut::<3, 1>(0, 3 + axis).copy_from(&w.cross(&(com - bodies[0].o)));
            jw.fixed_view_mut::<3, 1>(0, 3 + axis).copy_from(&w);
        }
        let mut at = i;
        while let (Some(joint), Some(parent)) = (bodies[at].joint, bodies[at].parent) {
            let axis = bodies[at].axis();
            let lever = axis.cross(&(com - bodies[at].o));
            jv.fixed_view_mut::<3, 1>(0, JOINTS + joint).copy_from(&lever);
            jw.fixed_view_mut::<3, 1>(0, JOINTS + joint).copy_from(&axis);
            at = parent;
        }
        m += jv.transpose() * &jv * body.body.mass + jw.transpose() * body.inertia() * &jw;
    }
    for j in 0..robot.n_joints() {
        m[(JOINTS + j, JOINTS + j)] += robot.link(j).armature;
    }
    m
}

/// Angular velocity, its derivative, velocity and acceleration of the origin, world axes.
#[derive(Clone, Copy)]
struct Moving {
    w: Vector3<f64>,
    dw: Vector3<f64>,
    v: Vector3<f64>,
    a: Vector3<f64>,
}

fn moving(
    bodies: &[Placed<'_>],
    state: &State<f64>,
    acceleration: &Acceleration<f64>,
) -> Vec<Moving> {
    let base = &bodies[0];
    let mut out = vec![Moving {
        w: base.r * Vector3::from(state.base_angular_velocity),
        dw: base.r * Vector3::from(acceleration.base_angular),
        v: state.base_linear_velocity.into(),
        a: acceleration.base_linear.into(),
    }];
    for body in &bodies[1..] {
        let (parent, joint) = (body.parent.expect("a link"), body.joint.expect("a link"));
        let p: Moving = out[parent];
        let (r, axis) = (body.o - bodies[parent].o, body.axis());
        out.push(Moving {
            w: p.w + axis * state.qd[joint],
            dw: p.dw + axis * acceleration.joints[joint] + p.w.cross(&axis) * state.qd[joint],
            v: p.v + p.w.cross(&r),
            a: p.a + p.dw.cross(&r) + p.w.cross(&p.w.cross(&r)),
        });
    }
    out
}

/// Inverse dynamics, recursive Newton–Euler: the generalised force that causes `acceleration`.
///
/// Shape: 6 + `n_joints`: force on the base (world axes), moment about its origin (base axes), joint torques.
/// [Featherstone 2008, Table 5.1].
pub fn rnea(robot: &Robot, state: &State<f64>, acceleration: &Acceleration<f64>) -> DVector<f64> {
    let bodies = place(robot, state);
    let motion = moving(&bodies, state, acceleration);
    let mut force = vec![Vector3::zeros(); bodies.len()];
    let mut moment = vec![Vector3::zeros(); bodies.len()];
    let mut tau = DVector::zeros(JOINTS + robot.n_joints());
    for i in (0..bodies.len()).rev() {
        let (b, m) = (&bodies[i], motion[i]);
        let c = b.com() - b.o;
        let a_com = m.a + m.dw.cross(&c) + m.w.cross(&m.w.cross(&c));
        let f = b.body.mass * a_com;
        let n = b.inertia() * m.dw + m.w.cross(&(b.inertia() * m.w));
        force[i] += f;
        moment[i] += n + c.cross(&f);
        if let (Some(joint), Some(parent)) = (b.joint, b.parent) {
            let armature = robot.link(joint).armature;
            tau[JOINTS + joint] = b.axis().dot(&moment[i]) + armature * acceleration.joints[joint];
            let (f, n) = (force[i], moment[i] + (b.o - bodies[parent].o).cross(&force[i]));
            force[parent] += f;
            moment[parent] += n;
        }
    }
    tau.fixed_rows_mut::<3>(0).copy_from(&force[0]);
    tau.fixed_rows_mut::<3>(3).copy_from(&(bodies[0].r.transpose() * moment[0]));
    tau
}

/// Momentum of the links' and the base's masses; the armatures carry none, they react on nothing.
pub fn momentum(robot: &Robot, state: &State<f64>) -> Momentum {
    let bodies = place(robot, state);
    let rest = Acceleration {
        base_linear: [0.0; 3],
        base_angular: [0.0; 3],
        joints: vec![0.0; robot.n_joints()],
    };
    let motion = moving(&bodies, state, &rest);
    let mass: f64 = bodies.iter().map(|b| b.body.mass).sum();
    let com = bodies.iter().map(|b| b.com() * b.body.mass).sum::<Vector3<f64>>() / mass;
    let mut out = Momentum {
        linear: Vector3::zeros(),
        angular: Vector3::zeros(),
        com,
        linear_scale: 0.0,
        angular_scale: 0.0,
    };
    for (b, m) in bodies.iter().zip(&motion) {
        let p = (m.v + m.w.cross(&(b.com() - b.o))) * b.body.mass;
        let l = b.inertia() * m.w + (b.com() - com).cross(&p);
        out.linear += p;
        out.angular += l;
        out.linear_scale += p.norm();
        out.angular_scale += l.norm();
    }
    out
}

/// Kinetic energy, armatures included (J): ½ q̇ᵀ M q̇.
pub fn kinetic_energy(robot: &Robot, state: &State<f64>) -> f64 {
    let v = generalised_velocity(state);
    0.5 * v.dot(&(inertia_matrix(robot, state) * &v))
}

/// Base linear, base angular, joint rates.
pub fn generalised_velocity(state: &State<f64>) -> DVector<f64> {
    let base = state.base_linear_velocity.iter().chain(&state.base_angular_velocity);
    DVector::from_iterator(JOINTS + state.qd.len(), base.chain(&state.qd).copied())
}
