//! A rigid body that no force acts on, and what it carries.
//!
//! Its centre of mass goes straight on; its angular velocity follows Euler's equations, I ω̇ = (I ω) × ω in its own axes, by classical Runge and
//! Kutta, and its attitude the rate of the middle of each step.

use proto::tasks::FreeBody;

use crate::scalar::{Kernel, Real};
use crate::spatial::{
    Mat3, Vec3, add, cross, euler_xyz, euler_xyz_to_rotation, mat_mat, mat_t_vec, mat_vec, mul_add,
    quaternion_exp, quaternion_normalised, quaternion_product, quaternion_to_rotation, scale, sub,
};

/// Steps of a control period: bodies that hands can follow turn by hundredths of a radian in it.
const STEPS: usize = 4;

/// Where a hand takes hold, in the body's axes from its centre of mass.
#[derive(Debug, Clone, Copy)]
struct Grasp<S> {
    point: Vec3<S>,
    rotation: Mat3<S>,
}

/// The bodies of one lane group.
#[derive(Debug, Clone)]
pub(crate) struct Tumbling<S> {
    position: Vec3<S>,
    quaternion: [S; 4],
    linear: Vec3<S>,
    /// In its own axes.
    angular: Vec3<S>,
    inertia: Vec3<S>,
    /// One an arm.
    grasps: Vec<Grasp<S>>,
}

impl<S: Real> Tumbling<S> {
    /// At rest at the world's origin.
    pub(super) fn new(n_arms: usize) -> Self {
        let (zero, one) = (S::zero(), S::one());
        let rotation = [[one, zero, zero], [zero, one, zero], [zero, zero, one]];
        Self {
            position: [zero; 3],
            quaternion: [one, zero, zero, zero],
            linear: [zero; 3],
            angular: [zero; 3],
            inertia: [one; 3],
            grasps: vec![Grasp { point: [zero; 3], rotation }; n_arms],
        }
    }

    /// Sets the body of one environment.
    pub(super) fn set_lane(&mut self, lane: usize, body: &FreeBody) {
        let FreeBody { position, turned, linear, angular, inertia } = *body;
        let quaternion = quaternion_exp(turned);
        let set = |slots: &mut [S], values: &[f64]| {
            for (slot, value) in slots.iter_mut().zip(values) {
                slot.set_lane(lane, *value);
            }
        };
        set(&mut self.position, &position);
        set(&mut self.quaternion, &quaternion);
        set(&mut self.linear, &linear);
        set(&mut self.angular, &angular);
        set(&mut self.inertia, &inertia);
    }

    /// Has that of one environment rest.
    pub(super) fn rest_lane(&mut self, lane: usize) {
        let zero = [0.0; 3];
        let rest = FreeBody {
            position: zero,
            turned: zero,
            linear: zero,
            angular: zero,
            inertia: [1.0; 3],
        };
        self.set_lane(lane, &rest);
    }

    /// Whether all rest: nothing moves then.
    pub(super) fn rests(&self) -> bool {
        let mut rates = self.linear.iter().chain(&self.angular);
        rates.all(|rate| (0..S::LANES).all(|lane| rate.lane(lane) == 0.0))
    }

    /// Carries from now on the hand of `arm` from where it is: position (m) and Euler angles (rad), world.
    pub(super) fn attach(&mut self, arm: usize, [x, y, z, a, b, c]: &[S; 6]) {
        let body = quaternion_to_rotation(&self.quaternion);
        let hand = euler_xyz_to_rotation([*a, *b, *c]);
        let [u, v, w] = body;
        let transposed = [[u[0], v[0], w[0]], [u[1], v[1], w[1]], [u[2], v[2], w[2]]];
        self.grasps[arm] = Grasp {
            point: mat_t_vec(&body, sub([*x, *y, *z], self.position)),
            rotation: mat_mat(&transposed, &hand),
        };
    }

    /// Where the hand of `arm` is carried to: position (m) and Euler angles (rad), world.
    #[inline(always)]
    pub(super) fn carried(&self, arm: usize) -> [S; 6] {
        let Grasp { point, rotation } = &self.grasps[arm];
        let body = quaternion_to_rotation(&self.quaternion);
        let [x, y, z] = add(self.position, mat_vec(&body, *point));
        let [a, b, c] = euler_xyz(&mat_mat(&body, rotation));
        [x, y, z, a, b, c]
    }

    /// How fast: linear (m/s) and angular (rad/s), world.
    #[inline(always)]
    pub(super) fn rates(&self, arm: usize) -> [Vec3<S>; 2] {
        let body = quaternion_to_rotation(&self.quaternion);
        let swung = mat_vec(&body, cross(self.angular, self.grasps[arm].point));
        [add(self.linear, swung), mat_vec(&body, self.angular)]
    }

    /// Moves on by `time` (s).
    #[inline(always)]
    pub(super) fn advance(&mut self, time: f64) {
        S::compiled(Advance { body: self, time });
    }

    /// I ω̇ = (I ω) × ω.
    #[inline(always)]
    fn acceleration(&self, rates: Vec3<S>) -> Vec3<S> {
        let i = self.inertia;
        let momentum = [i[0] * rates[0], i[1] * rates[1], i[2] * rates[2]];
        let torque = cross(momentum, rates);
        [torque[0] / i[0], torque[1] / i[1], torque[2] / i[2]]
    }
}

/// The arguments of [`Tumbling::advance`].
struct Advance<'a, S> {
    body: &'a mut Tumbling<S>,
    time: f64,
}

impl<S: Real> Kernel<S> for Advance<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { body, time } = self;
        body.position = mul_add(S::splat(time), body.linear, body.position);
        let h = S::splat(time / STEPS as f64);
        let half = S::splat(0.5 * time / STEPS as f64);
        for _ in 0..STEPS {
            let start = body.angular;
            let k1 = body.acceleration(start);
            let k2 = body.acceleration(mul_add(half, k1, start));
            let middle = mul_add(half, k2, start);
            let k3 = body.acceleration(middle);
            let k4 = body.acceleration(mul_add(h, k3, start));
            let sum = add(add(k1, k4), scale(S::splat(2.0), add(k2, k3)));
            body.angular = mul_add(h * S::splat(1.0 / 6.0), sum, start);
            let turned = quaternion_exp(scale(h, middle));
            body.quaternion = quaternion_normalised(&quaternion_product(&body.quaternion, &turned));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body() -> FreeBody {
        FreeBody {
            position: [1.0, 2.0, 3.0],
            turned: [0.3, -0.2, 0.1],
            linear: [0.01, -0.02, 0.03],
            angular: [0.05, 0.03, -0.02],
            inertia: [0.6, 1.0, 1.0],
        }
    }

    /// A body that is symmetric about its first axis keeps its spin, and its rates across turn with (I₁/I − 1) ω₁: the
    /// closed solution of Euler's equations.
    #[test]
    fn a_symmetric_body_tumbles_as_the_closed_solution_says() {
        let FreeBody { angular, inertia, position, linear, .. } = body();
        let mut tumbling = Tumbling::<f64>::new(1);
        tumbling.set_lane(0, &body());
        let momentum = |body: &Tumbling<f64>| {
            let [a, b, c] = body.angular;
            let [i, j, k] = body.inertia;
            mat_vec(&quaternion_to_rotation(&body.quaternion), [i * a, j * b, k * c])
        };
        let before = momentum(&tumbling);
        let (period, n) = (0.4, 200);
        for _ in 0..n {
            tumbling.advance(period);
        }
        let time = period * f64::from(n);
        let phase = (inertia[0] / inertia[1] - 1.0) * angular[0] * time;
        let (sin, cos) = (-phase).sin_cos();
        let wanted =
            [angular[0], cos * angular[1] + sin * angular[2], cos * angular[2] - sin * angular[1]];
        for (found, wanted) in tumbling.angular.iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
        }
        for i in 0..3 {
            assert!((tumbling.position[i] - (position[i] + time * linear[i])).abs() < 1e-12);
            // Nothing acts on it: what the attitude is off shows in its angular momentum, which stays.
            assert!((momentum(&tumbling)[i] - before[i]).abs() < 1e-7);
        }
    }

    #[test]
    fn hands_are_carried_from_where_they_were() {
        let mut tumbling = Tumbling::<f64>::new(2);
        tumbling.set_lane(0, &body());
        let hands = [[1.5, 2.5, 2.0, 0.4, -0.3, 0.2], [0.0, 1.0, 2.0, -1.5, 0.1, 0.0]];
        for (arm, hand) in hands.iter().enumerate() {
            tumbling.attach(arm, hand);
            for (found, wanted) in tumbling.carried(arm).iter().zip(hand) {
                assert!((found - wanted).abs() < 1e-12);
            }
        }
        // Rates by differences.
        let mut later = tumbling.clone();
        let h = 1e-5;
        later.advance(h);
        for arm in 0..2 {
            let [linear, angular] = tumbling.rates(arm);
            let (now, then) = (tumbling.carried(arm), later.carried(arm));
            for i in 0..3 {
                assert!(((then[i] - now[i]) / h - linear[i]).abs() < 1e-6);
            }
            let [was, is] =
                [now, then].map(|pose| euler_xyz_to_rotation([pose[3], pose[4], pose[5]]));
            let turned = crate::spatial::rotation_difference(&is, &was);
            for i in 0..3 {
                assert!((turned[i] / h - angular[i]).abs() < 1e-6);
            }
        }
    }
}
