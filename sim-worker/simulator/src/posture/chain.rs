//! One arm's kinematics in lanes: a step of damped least squares towards a pose.
//!
//! The lanes' twin of [`inverse_kinematics`](crate::inverse_kinematics), which is slow, readable and tests it.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use crate::model::Twist;
use crate::robot::{Arm, ArmType, Link, MAX_JOINTS_PER_ARM, Robot};
use crate::scalar::{Kernel, Mask, Real};
use crate::spatial::{Mat3, Vec3, add, cross, dot, mat_mat, mat_vec, rotation_difference, sub};

/// Joint angles of an arm (rad); zero behind its last joint.
pub(super) type Angles<S> = [S; MAX_JOINTS_PER_ARM];

/// Where a hand is or shall be, axes of the base.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<S> {
    pub(super) rotation: Mat3<S>,
    pub(super) position: Vec3<S>,
}

impl<S: Real> Frame<S> {
    /// What is missing from `hand` to here (m and rad), and its square.
    #[inline(always)]
    fn residual(&self, hand: &Self) -> ([S; 6], S) {
        let l = sub(self.position, hand.position);
        let a = rotation_difference(&self.rotation, &hand.rotation);
        ([l[0], l[1], l[2], a[0], a[1], a[2]], dot(l, l) + dot(a, a))
    }

    /// Puts lane `from` of another frame into lane `to`.
    #[inline(always)]
    pub(super) fn put_lane(&mut self, to: usize, other: &Self, from: usize) {
        for (row, other) in self.rotation.iter_mut().zip(&other.rotation) {
            put_lane(row, to, other, from);
        }
        put_lane(&mut self.position, to, &other.position, from);
    }
}

/// Puts lane `from` of other numbers into lane `to` of these.
#[inline(always)]
pub(super) fn put_lane<S: Real>(these: &mut [S], to: usize, others: &[S], from: usize) {
    for (this, other) in these.iter_mut().zip(others) {
        this.set_lane(to, other.lane(from));
    }
}

/// Lane `lane` in all lanes, of the same kind or another.
#[inline(always)]
pub(super) fn everywhere<S: Real, T: Real>(x: S, lane: usize) -> T {
    T::splat(x.lane(lane))
}

/// Puts `these` in where the mask is set.
#[inline(always)]
pub(super) fn choose<S: Real>(mask: S::Mask, these: Angles<S>, angles: &mut Angles<S>) {
    for (angle, this) in angles.iter_mut().zip(these) {
        *angle = S::select(mask, this, *angle);
    }
}

/// Longest change of a joint in a step (rad).
const LONGEST: f64 = 0.5;
/// Damping in parts of the square of the error (m and rad, together).
const DAMPING: f64 = 1e-2;
/// What remains of it at the goal: in single precision less would drown near singular poses.
pub(super) const LEAST_DAMPING: f64 = 1e-6;

/// One row: from a joint to the next.
#[derive(Debug, Clone)]
struct Step<S> {
    shift: Vec3<S>,
    rotation: Mat3<S>,
    /// Which rotation that is.
    twist: Twist,
}

impl<S: Real> Step<S> {
    /// The axes `r` behind the twist. By right angles columns change places.
    ///
    /// The product has the same bits but for the signs of zeros, and those reach no angle: sums of products begin at +0, which no zero changes.
    #[inline(always)]
    fn twisted(&self, r: &Mat3<S>) -> Mat3<S> {
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *r;
        match self.twist {
            Twist::None => *r,
            Twist::Quarter => [[xx, xz, -xy], [yx, yz, -yy], [zx, zz, -zy]],
            Twist::MinusQuarter => [[xx, -xz, xy], [yx, -yz, yy], [zx, -zz, zy]],
            Twist::General => mat_mat(r, &self.rotation),
        }
    }
}

/// A column a joint: how the hand's pose changes with its angle, linear (m/rad) and angular (rad/rad), axes of the base.
type Jacobian<S> = [[S; 6]; MAX_JOINTS_PER_ARM];

/// An arm as its hand's pose depends on it.
#[derive(Debug, Clone)]
pub(super) struct Chain<S> {
    pub(super) mount: Frame<S>,
    pub(super) home: Angles<S>,
    arm_type: Arc<ChainType<S>>,
}

/// What arms of one type have in common.
#[derive(Debug)]
struct ChainType<S> {
    steps: Vec<Step<S>>,
    tool: Frame<S>,
    /// Of joints that stop because two bodies touch: where, and half of the interval in which they do (rad).
    stops: [Option<[S; 2]>; MAX_JOINTS_PER_ARM],
}

impl<S: Real> ChainType<S> {
    fn new(arm_type: &ArmType) -> Self {
        let mut stops = [None; MAX_JOINTS_PER_ARM];
        for stop in arm_type.angle_contacts.iter().filter(|stop| stop.push) {
            stops[stop.joint] = Some([stop.centre, stop.half].map(S::splat));
        }
        let step = |link: &Link| Step {
            shift: vector(link.shift),
            rotation: matrix(link.twist),
            twist: Twist::of(&link.twist),
        };
        let tool = Frame {
            rotation: matrix(arm_type.tool_rotation),
            position: vector(arm_type.tool_position),
        };
        Self { steps: arm_type.links.iter().map(step).collect(), tool, stops }
    }
}

fn vector<S: Real>(v: nalgebra::Vector3<f64>) -> Vec3<S> {
    [0, 1, 2].map(|i| S::splat(v[i]))
}

fn matrix<S: Real>(m: nalgebra::Matrix3<f64>) -> Mat3<S> {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| S::splat(m[(i, j)])))
}

impl<S: Real> Chain<S> {
    /// The arms of a robot.
    pub(super) fn of(robot: &Robot) -> Vec<Self> {
        let types: Vec<_> = robot.types.iter().map(|of| Arc::new(ChainType::new(of))).collect();
        let chain = |arm: &Arm| {
            let mut home = [S::zero(); MAX_JOINTS_PER_ARM];
            for (home, &angle) in home.iter_mut().zip(&arm.home) {
                *home = S::splat(angle);
            }
            let mount = Frame { rotation: matrix(arm.rotation), position: vector(arm.position) };
            Self { mount, home, arm_type: types[arm.arm_type].clone() }
        };
        robot.arms.iter().map(chain).collect()
    }

    /// Whether the other is an arm of the same type: lanes of the two can stand side by side.
    pub(super) fn is_of_same_type(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.arm_type, &other.arm_type)
    }

    /// Puts lane `from` of an arm of the same type into lane `to`.
    #[inline(always)]
    pub(super) fn put_lane(&mut self, to: usize, other: &Self, from: usize) {
        self.mount.put_lane(to, &other.mount, from);
        put_lane(&mut self.home, to, &other.home, from);
    }

    /// Number of its joints.
    #[inline(always)]
    pub(super) fn n_joints(&self) -> usize {
        self.arm_type.steps.len()
    }

    /// Where the hand is; leaves a point on each joint's axis and where it points in `axes`.
    #[inline(always)]
    fn forward(&self, q: &Angles<S>, axes: &mut Jacobian<S>) -> Frame<S> {
        let Frame { rotation: mut r, position: mut o } = self.mount;
        let mut hand = self.mount;
        for (j, step) in self.arm_type.steps.iter().enumerate() {
            let (sin, cos) = q[j].sin_cos();
            for row in &mut r {
                let [x, y, _] = *row;
                row[0] = cos.mul_add(x, sin * y);
                row[1] = sin.neg_mul_add(x, cos * y);
            }
            axes[j] = [o[0], o[1], o[2], r[0][2], r[1][2], r[2][2]];
            if j + 1 == self.n_joints() {
                hand = Frame {
                    rotation: mat_mat(&r, &self.arm_type.tool.rotation),
                    position: add(o, mat_vec(&r, self.arm_type.tool.position)),
                };
            } else {
                o = add(o, mat_vec(&r, step.shift));
                r = step.twisted(&r);
            }
        }
        hand
    }

    /// One step from `q` towards `target`: the angles after it, and the length of the residual before it (m and rad, together).
    #[inline(always)]
    pub(super) fn approach(&self, target: &Frame<S>, q: &Angles<S>) -> (Angles<S>, S) {
        self.approach_damped(target, q, LEAST_DAMPING)
    }

    /// [`Chain::approach`], where so much damping remains at the goal.
    #[inline(always)]
    pub(super) fn approach_damped(
        &self,
        target: &Frame<S>,
        q: &Angles<S>,
        damping: f64,
    ) -> (Angles<S>, S) {
        S::compiled(Approach { chain: self, target, q, damping })
    }

    /// The length of the residual at `q` (m and rad, together), as [`Chain::approach`] tells it, without its step.
    #[inline(always)]
    pub(super) fn miss(&self, target: &Frame<S>, q: &Angles<S>) -> S {
        S::compiled(Miss { chain: self, target, q })
    }

    #[inline(always)]
    fn step(&self, target: &Frame<S>, q: &Angles<S>, damping: f64) -> (Angles<S>, S) {
        let mut jacobian = [[S::zero(); 6]; MAX_JOINTS_PER_ARM];
        let hand = self.forward(q, &mut jacobian);
        for column in &mut jacobian[..self.n_joints()] {
            let [x, y, z, axis @ ..] = *column;
            let [x, y, z] = cross(axis, sub(hand.position, [x, y, z]));
            let [a, b, c] = axis;
            *column = [x, y, z, a, b, c];
        }
        let (error, square) = target.residual(&hand);
        let damping = square.mul_add(S::splat(DAMPING), S::splat(damping));
        let mut step = least_squares(&jacobian[..self.n_joints()], damping, error);
        let mut longest = S::splat(1e-9);
        for x in step {
            longest = longest.max(x.abs());
        }
        let shorten = (S::splat(LONGEST) / longest).min(S::one());
        for (slot, q) in step.iter_mut().zip(q) {
            *slot = shorten.mul_add(*slot, *q);
        }
        (step, square.sqrt())
    }

    /// How far joint `joint` has to turn from `from` to `to`, whole turns aside, on a way that leads through no stop (rad).
    #[inline(always)]
    pub(super) fn way(&self, joint: usize, from: S, to: S) -> S {
        match self.arm_type.stops[joint] {
            None => nearest_turn(to - from),
            Some([centre, _]) => {
                // Turns are counted from the stop on.
                let half = S::splat(PI);
                nearest_turn(to - centre - half) - nearest_turn(from - centre - half)
            }
        }
    }

    /// Whether a joint stands where it is stopped.
    #[inline(always)]
    pub(super) fn is_stopped(&self, q: &Angles<S>) -> S::Mask {
        let mut stopped = S::Mask::splat(false);
        for (q, stop) in q.iter().zip(&self.arm_type.stops) {
            if let Some([centre, half]) = stop {
                stopped = stopped | nearest_turn(*q - *centre).abs().lt(*half);
            }
        }
        stopped
    }
}

/// The arguments of [`Chain::approach`], which is large and asked for in many places.
struct Approach<'a, S> {
    chain: &'a Chain<S>,
    target: &'a Frame<S>,
    q: &'a Angles<S>,
    damping: f64,
}

impl<S: Real> Kernel<S> for Approach<'_, S> {
    type Output = (Angles<S>, S);
    #[inline(always)]
    fn run(self) -> Self::Output {
        self.chain.step(self.target, self.q, self.damping)
    }
}

/// The arguments of [`Chain::miss`].
struct Miss<'a, S> {
    chain: &'a Chain<S>,
    target: &'a Frame<S>,
    q: &'a Angles<S>,
}

impl<S: Real> Kernel<S> for Miss<'_, S> {
    type Output = S;
    #[inline(always)]
    fn run(self) -> S {
        let hand = self.chain.forward(self.q, &mut [[S::zero(); 6]; MAX_JOINTS_PER_ARM]);
        self.target.residual(&hand).1.sqrt()
    }
}

/// The angle less whole turns, in ±π.
#[inline(always)]
fn nearest_turn<S: Real>(angle: S) -> S {
    let turns = (angle * S::splat(1.0 / TAU)).round();
    turns.neg_mul_add(S::splat(TAU), angle)
}

/// Jᵀ (J Jᵀ + λ)⁻¹ e, by L D Lᵀ [Golub and Van Loan, section 4.1.2].
///
/// Columns outside, so that many sums are under way at a time.
#[inline(always)]
fn least_squares<S: Real>(jacobian: &[[S; 6]], damping: S, error: [S; 6]) -> Angles<S> {
    // The lower triangle of J Jᵀ + λ, then L below its diagonal.
    let mut l = [[S::zero(); 6]; 6];
    for (i, row) in l.iter_mut().enumerate() {
        row[i] = damping;
    }
    for column in jacobian {
        for i in 0..6 {
            for j in 0..=i {
                l[i][j] = column[i].mul_add(column[j], l[i][j]);
            }
        }
    }
    let mut d = [S::zero(); 6];
    let mut y = error;
    for k in 0..6 {
        // Rounding may eat a pivot that the damping makes positive.
        d[k] = l[k][k].max(damping);
        for i in k + 1..6 {
            l[i][k] = l[i][k] / d[k];
            y[i] = l[i][k].neg_mul_add(y[k], y[i]);
        }
        for i in k + 1..6 {
            let scaled = l[i][k] * d[k];
            for j in k + 1..=i {
                l[i][j] = scaled.neg_mul_add(l[j][k], l[i][j]);
            }
        }
    }
    for i in (0..6).rev() {
        y[i] = y[i] / d[i];
        for k in i + 1..6 {
            y[i] = l[k][i].neg_mul_add(y[k], y[i]);
        }
    }
    let mut step = [S::zero(); MAX_JOINTS_PER_ARM];
    for (sum, column) in step.iter_mut().zip(jacobian) {
        for (x, y) in column.iter().zip(y) {
            *sum = x.mul_add(y, *sum);
        }
    }
    step
}

/// A frame of the world seen from the base.
#[inline(always)]
pub(super) fn seen_from<S: Real>(
    (r_wb, base): (&Mat3<S>, Vec3<S>),
    rotation: &Mat3<S>,
    position: Vec3<S>,
) -> Frame<S> {
    let [x, y, z] = *r_wb;
    let transposed = [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]];
    Frame {
        rotation: mat_mat(&transposed, rotation),
        position: mat_vec(&transposed, sub(position, base)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_miss_is_that_of_a_step_and_twists_are_products() {
        let robot = Robot::builtin("paper").expect("built in");
        let chain = &Chain::<f32>::of(&robot)[1];
        let mut q = chain.home;
        for (number, angle) in q.iter_mut().enumerate() {
            *angle += 0.3 * number as f32 - 0.7;
        }
        let mut axes = [[0.0; 6]; MAX_JOINTS_PER_ARM];
        let target = chain.forward(&chain.home, &mut axes);
        let (_, left) = chain.approach(&target, &q);
        assert_eq!(chain.miss(&target, &q).to_bits(), left.to_bits());
        let r = chain.forward(&q, &mut axes).rotation;
        let mut by_right_angles = 0;
        for step in &chain.arm_type.steps {
            assert_eq!(step.twisted(&r), mat_mat(&r, &step.rotation), "{:?}", step.twist);
            by_right_angles += usize::from(step.twist != Twist::General);
        }
        assert!(by_right_angles > 3, "nothing was quick");
    }
}
