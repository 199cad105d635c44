#![expect(clippy::approx_constant, reason = "fixtures are quoted with six digits")]

use nalgebra::DVector;

use super::reference_dynamics::{inertia_matrix, kinetic_energy, momentum, rnea};
use super::*;
use crate::model::Model;
use crate::robot::Robot;
use crate::scalar::{Backend, LANES, LaneFn, Real, dispatch_on};
use crate::spatial::{euler_xyz, quaternion_normalised, quaternion_to_rotation};
use crate::state::State;
use crate::step::{Integrator, StepOptions, step};
use crate::workspace::Workspace;

/// Uniform numbers in ±1, the same on every machine.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn robots() -> Vec<Robot> {
    let two_arm = include_str!("../../robots/two-arm.toml");
    let skew = two_arm
        .replace("alpha_deg = 90.0", "alpha_deg = 73.0")
        .replace("a = -0.425, d = 0.0", "a = -0.425, d = 0.05")
        .replace("mount_euler_deg = [90.0, 0.0, 0.0]", "mount_euler_deg = [70.0, 20.0, -15.0]");
    let path = std::path::Path::new("test");
    vec![
        Robot::builtin("release").unwrap(),
        Robot::builtin("paper").unwrap(),
        Robot::from_toml(two_arm, path).unwrap(),
        Robot::from_toml(&skew, path).unwrap(),
        Robot::from_toml(include_str!("../../robots/seven-joints.toml"), path).unwrap(),
    ]
}

fn random_state(robot: &Robot, noise: &mut Noise) -> State<f64> {
    let mut s = State::<f64>::home(robot);
    for x in s.base_position.iter_mut().chain(&mut s.base_linear_velocity) {
        *x += noise.next();
    }
    s.base_angular_velocity = [noise.next(), noise.next(), noise.next()];
    s.base_quaternion =
        quaternion_normalised(&[noise.next(), noise.next(), noise.next(), noise.next()]);
    for x in &mut s.q {
        *x = 3.0 * noise.next();
    }
    for x in &mut s.qd {
        *x = 2.0 * noise.next();
    }
    s
}

fn torques(robot: &Robot, noise: &mut Noise) -> Vec<f64> {
    (0..robot.n_joints()).map(|_| 50.0 * noise.next()).collect()
}

/// Inverse dynamics of the forward dynamics' acceleration gives the torques back, and no force on the base.
#[test]
fn rnea_undoes_aba() {
    let mut noise = Noise(1);
    for robot in robots() {
        let model = Model::<f64>::new(&robot);
        let mut ws = Workspace::new(&model);
        for _ in 0..20 {
            let state = random_state(&robot, &mut noise);
            let tau = torques(&robot, &mut noise);
            let a = forward_dynamics(&model, &mut ws, &state, &tau);
            let back = rnea(&robot, &state, &a);
            let mut wanted = DVector::zeros(6 + tau.len());
            wanted.rows_mut(6, tau.len()).copy_from_slice(&tau);
            let error = (back - wanted).amax();
            assert!(error < 1e-10 * 500.0, "{}: {error:e}", robot.name);
        }
    }
}

#[test]
fn the_inertia_matrix_is_symmetric_positive_definite_and_agrees_with_rnea() {
    let mut noise = Noise(2);
    for robot in robots() {
        for _ in 0..5 {
            let mut state = random_state(&robot, &mut noise);
            let m = inertia_matrix(&robot, &state);
            assert!((&m - m.transpose()).amax() < 1e-12 * m.amax());
            assert!(m.clone().cholesky().is_some(), "not positive definite");
            // At rest inverse dynamics is M times the acceleration.
            state.base_linear_velocity = [0.0; 3];
            state.base_angular_velocity = [0.0; 3];
            state.qd.fill(0.0);
            let a = random_state(&robot, &mut noise);
            let acceleration = Acceleration {
                base_linear: a.base_linear_velocity,
                base_angular: a.base_angular_velocity,
                joints: a.qd.clone(),
            };
            let f = rnea(&robot, &state, &acceleration);
            let g = &m * reference_dynamics::generalised_velocity(&a);
            assert!((f - &g).amax() < 1e-12 * g.amax().max(1.0) * 10.0);
        }
    }
}

fn run(robot: &Robot, state: &mut State<f64>, command: &[f64], options: &StepOptions) {
    let model = Model::<f64>::new(robot);
    let mut ws = Workspace::new(&model);
    step(&model, &mut ws, state, command, options);
}

fn exact() -> StepOptions {
    StepOptions { substep: 0.0005, contacts: false, ..StepOptions::default() }
}

fn authors() -> StepOptions {
    StepOptions {
        substep: 0.001,
        integrator: Integrator::Euler,
        contacts: false,
        ..StepOptions::default()
    }
}

fn close(what: &str, values: &[f64], wanted: &[f64], tolerance: f64) {
    assert_eq!(values.len(), wanted.len(), "{what}");
    for (v, w) in values.iter().zip(wanted) {
        assert!((v - w).abs() < tolerance, "{what}: {values:?}, wanted {wanted:?}");
    }
}

fn tips(robot: &Robot, state: &State<f64>) -> Vec<Hand<f64>> {
    let model = Model::<f64>::new(robot);
    let mut ws = Workspace::new(&model);
    let mut out = vec![Hand::default(); robot.n_arms];
    hands(&model, &mut ws, state, &mut out);
    out
}

/// Numbers measured on the released model in MuJoCo; its file rounds π, which costs 1e-7.
#[test]
fn home_of_the_released_model() {
    let robot = Robot::builtin("release").unwrap();
    let state = State::<f64>::home(&robot);
    assert!((robot.total_mass() - 523.9756).abs() < 1e-4);
    close("base com", robot.base.com.as_slice(), &[0.03687123, 0.0, 0.00491228], 1e-8);
    let i = robot.base.inertia;
    close(
        "base inertia",
        &[i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 2)], i[(0, 1)], i[(1, 2)]],
        &[75.43198, 72.15597, 71.98778, -0.58994, 0.0, 0.0],
        6e-6,
    );
    let m = inertia_matrix(&robot, &state);
    let angular = [(3, 3), (4, 4), (5, 5), (3, 4), (3, 5)].map(|at| m[at]);
    close("angular", &angular, &[148.920142, 116.004919, 115.194093, -0.761755, -2.278758], 2e-6);
    let wanted = [
        [1.165205, -0.489645, -0.144876, -0.017104, 0.005641, 0.0],
        [-0.489645, 4.910341, 1.525639, 0.138069, -0.030244, 0.000139],
        [-0.144876, 1.525639, 1.760459, 0.073942, -0.016132, 0.000139],
        [-0.017104, 0.138069, 0.073942, 1.014756, -0.003107, 0.000139],
        [0.005641, -0.030244, -0.016132, -0.003107, 1.002553, 0.0],
        [0.0, 0.000139, 0.000139, 0.000139, 0.0, 1.000139],
    ];
    for (r, row) in wanted.iter().enumerate() {
        let got: Vec<f64> = (0..6).map(|c| m[(6 + r, 6 + c)]).collect();
        close("arm block", &got, row, 1e-6);
    }
    let coupling: Vec<f64> = (0..6).map(|c| m[(5, 6 + c)]).collect();
    close(
        "coupling",
        &coupling,
        &[-1.319937, 7.545673, 2.680608, 0.234830, -0.051537, 0.000139],
        1e-6,
    );
    close("com", momentum(&robot, &state).com.as_slice(), &[0.070999, 0.004939, 4.014404], 1e-6);
    let poses = [
        ([0.298824, 1.553659, 4.315298], [0.0, -0.001593, 0.0]),
        ([0.300802, -1.553659, 4.315300], [0.0, 0.0, 0.001593]),
        ([0.300802, 0.235300, 5.553659], [-1.570796, 0.0, 0.001593]),
        ([0.298824, 0.235298, 2.446341], [-1.570796, -0.001593, 0.0]),
    ];
    for (hand, (p, e)) in tips(&robot, &state).iter().zip(poses) {
        close("tip", &hand.position, &p, 1e-6);
        close("tip Euler", &euler_xyz(&hand.rotation), &e, 1.5e-6);
    }
}

/// One joint moves for one control step.
#[test]
fn fixture_a() {
    let robot = Robot::builtin("release").unwrap();
    let mut command = vec![0.0; 24];
    command[1] = 0.8;
    for (options, base, euler, omega, q, rate, tip) in [
        (
            exact(),
            [0.0028709, 0.0016829, 4.0001451],
            [-0.00043914, 0.00217158, -0.01852057],
            [-0.00191236, 0.00592379, -0.05021022],
            [3.14300082, -1.28492884, -0.01066168, -1.57193808, 0.00042420, 3.13999793],
            0.79890354,
            [0.07999842, 1.51880039, 4.31496683],
        ),
        (
            authors(),
            [0.0028790, 0.0016876, 4.0001455],
            [-0.00044026, 0.00217752, -0.01857187],
            [-0.00191223, 0.00592325, -0.05020854],
            [3.14300006, -1.28413090, -0.01066240, -1.57193824, 0.00042423, 3.13999793],
            0.79892170,
            [0.07938354, 1.51861332, 4.31496732],
        ),
    ] {
        let mut s = State::<f64>::home(&robot);
        run(&robot, &mut s, &command, &options);
        let tolerance = 1e-6;
        close("base", &s.base_position, &base, tolerance);
        let r = quaternion_to_rotation(&s.base_quaternion);
        close("Euler", &euler_xyz(&r), &euler, tolerance);
        close("omega", &s.base_angular_velocity, &omega, tolerance);
        close("q", &s.q[..6], &q, tolerance);
        close("rate", &s.qd[1..2], &[rate], tolerance);
        close("tip", &tips(&robot, &s)[0].position, &tip, tolerance);
    }
}

/// All joints move for five control steps.
#[test]
fn fixture_b() {
    let robot = Robot::builtin("release").unwrap();
    let mut s = State::<f64>::home(&robot);
    let mut e = s.clone();
    for k in 0..5 {
        let command: Vec<f64> =
            (0..24).map(|j| 0.5 * (0.7 * f64::from(j) + 0.9 * f64::from(k)).sin()).collect();
        run(&robot, &mut s, &command, &exact());
        run(&robot, &mut e, &command, &authors());
    }
    let t = 1e-6;
    close("base", &s.base_position, &[0.0040308, -0.0000050, 4.0014243], t);
    close("quat", &s.base_quaternion, &[0.999876, -0.00123491, 0.00642349, -0.01432491], t);
    close("v", &s.base_linear_velocity, &[-0.01685749, -0.00092887, 0.00276699], t);
    close("w", &s.base_angular_velocity, &[0.03394749, 0.01269610, 0.01634080], t);
    let q = [
        [3.48851927, -1.32653100, -0.00589378, -1.80874223, -0.35701286, 2.83495778],
        [-0.10461851, -1.44572083, 0.31325115, -1.21991323, 0.21883587, -0.01734580],
        [-0.24615077, -1.93997451, -0.30315478, -1.67481466, 0.14250827, 0.32204958],
        [3.48515154, -1.33651214, -0.01796186, -1.81758833, -0.35850835, 2.84156866],
    ];
    close("q", &s.q, &q.concat(), t);
    let tip = [
        [0.19899455, 1.52595693, 4.37166127],
        [0.55192381, -1.52278586, 4.28084446],
        [-0.07506668, 0.34949662, 5.40014265],
        [0.15227094, 0.28225183, 2.46435470],
    ];
    for (hand, p) in tips(&robot, &s).iter().zip(tip) {
        close("tip", &hand.position, &p, t);
    }
    close("Euler's base", &e.base_position, &[0.0040113, -0.0000022, 4.0014322], t);
    close("Euler's w", &e.base_angular_velocity, &[0.03394839, 0.01269258, 0.01635460], t);
    close("Euler's tip", &tips(&robot, &e)[3].position, &[0.15279913, 0.28204051, 2.46418611], t);
}

fn random_commands(robot: &Robot, steps: usize, noise: &mut Noise) -> Vec<Vec<f64>> {
    (0..steps).map(|_| (0..robot.n_joints()).map(|_| 0.8 * noise.next()).collect()).collect()
}

/// Without a force from outside momentum stays with training's scheme: to 1e-9 of its scale in `f64`, to 1e-4 in lanes of `f32`.
#[test]
fn momentum_is_conserved() {
    let robot = Robot::builtin("paper").unwrap();
    let actions = random_commands(&robot, 50, &mut Noise(3));
    let training = StepOptions { contacts: false, ..StepOptions::default() };
    for (precision, options, limit) in [
        (crate::simulate::Precision::F64, training, 1e-9),
        (crate::simulate::Precision::F32, training, 1e-4),
    ] {
        let com = momentum(&robot, &State::home(&robot)).com;
        let (mut worst, mut linear_scale, mut angular_scale) = (0.0_f64, 0.0_f64, 0.0_f64);
        let rows = crate::simulate::simulate(&robot, &actions, precision, &options);
        for row in &rows {
            let m = momentum(&robot, &row.state);
            linear_scale = linear_scale.max(m.linear_scale);
            angular_scale = angular_scale.max(m.angular_scale);
        }
        for row in &rows {
            let m = momentum(&robot, &row.state);
            worst = worst.max(m.linear.norm() / linear_scale).max(m.angular.norm() / angular_scale);
            // Metres, the integral of the velocity that is left.
            assert!(
                (m.com - com).norm() < 10.0 * limit,
                "centre of mass moved {}",
                (m.com - com).norm()
            );
        }
        eprintln!("{precision:?}: {worst:e} of its scale");
        assert!(worst < limit, "{precision:?}: {worst:e} of its scale");
    }
}

/// The servos' work is the gain of kinetic energy.
#[test]
fn energy_is_the_servos_work() {
    let robot = Robot::builtin("paper").unwrap();
    let mut s = State::<f64>::home(&robot);
    let command: Vec<f64> = random_commands(&robot, 1, &mut Noise(4)).remove(0);
    // Work by Simpson's rule over pairs of millisecond steps.
    let options = StepOptions { control_period: 0.001, substep: 0.00025, ..exact() };
    let power = |s: &State<f64>| -> f64 {
        (0..24)
            .map(|j| {
                let l = robot.link(j);
                let tau = (l.gain * (command[j] - s.qd[j])).clamp(-l.max_torque, l.max_torque);
                tau * s.qd[j]
            })
            .sum()
    };
    let mut work = 0.0;
    for _ in 0..100 {
        let a = power(&s);
        run(&robot, &mut s, &command, &options);
        let b = power(&s);
        run(&robot, &mut s, &command, &options);
        work += 0.001 / 3.0 * (a + 4.0 * b + power(&s));
    }
    let energy = kinetic_energy(&robot, &s);
    assert!((work - energy).abs() < 1e-4 * energy, "work {work} J, energy {energy} J");
}

/// Rates of arm 1 a moment after a step of the command, as MuJoCo has them.
#[test]
fn step_response_of_the_servos() {
    let robot = Robot::builtin("release").unwrap();
    for (joint, wanted) in
        [(0, [0.487, 0.676, 0.790]), (1, [0.202, 0.334, 0.558]), (3, [0.277, 0.485, 0.731])]
    {
        let mut s = State::<f64>::home(&robot);
        let mut command = vec![0.0; 24];
        command[joint] = 0.8;
        let mut t = 0.0;
        for (at, rate) in [0.010, 0.020, 0.050].iter().zip(wanted) {
            let options = StepOptions { control_period: at - t, ..authors() };
            run(&robot, &mut s, &command, &options);
            t = *at;
            assert!((s.qd[joint] - rate).abs() < 1e-3, "joint {joint} at {at}: {}", s.qd[joint]);
        }
    }
}

/// Five control steps with contacts from sixteen random states; lane 3 as given, the others optionally replaced.
struct Lanes {
    replace_others: bool,
}

impl LaneFn for Lanes {
    type Output = Vec<State<f64>>;
    #[inline(always)]
    fn call<S: Real>(self) -> Vec<State<f64>> {
        const STEPS: usize = 5;
        let robot = Robot::builtin("paper").unwrap();
        let model = Model::<S>::new(&robot);
        let mut ws = Workspace::new(&model);
        let mut out = Vec::new();
        for first in (0..LANES).step_by(S::LANES) {
            let mut state = State::<S>::home(&robot);
            let mut commands = vec![vec![S::zero(); 24]; STEPS];
            for lane in 0..S::LANES {
                let env = first + lane;
                let given = env == 3 || !self.replace_others;
                let mut noise = Noise(5 + env as u64);
                if given {
                    state.set_lane(lane, &random_state(&robot, &mut noise));
                }
                for command in commands.iter_mut().flatten() {
                    command.set_lane(lane, if given { noise.next() } else { 0.1 * noise_of(env) });
                }
            }
            for command in &commands {
                step(&model, &mut ws, &mut state, command, &StepOptions::default());
            }
            out.extend((0..S::LANES).map(|lane| state.lane(lane)));
        }
        out
    }
}

fn noise_of(i: usize) -> f64 {
    Noise(i as u64).next()
}

/// Every environment has its own bits whatever stands beside it, on every processor.
#[test]
fn lanes_do_not_depend_on_each_other_nor_on_the_back_end() {
    let portable = dispatch_on(Backend::Portable, Lanes { replace_others: false });
    let others = dispatch_on(Backend::Portable, Lanes { replace_others: true });
    assert!(portable.iter().all(State::is_finite));
    assert_eq!(portable[3], others[3], "lane 3 depends on its neighbours");
    assert_ne!(portable[4], others[4]);
    for backend in [Backend::Avx2, Backend::Avx512] {
        if backend.is_available() {
            let lanes = dispatch_on(backend, Lanes { replace_others: false });
            assert!(lanes == portable, "{backend:?} differs from portable");
            let others = dispatch_on(backend, Lanes { replace_others: true });
            assert_eq!(lanes[3], others[3], "{backend:?}: lane 3 depends on its neighbours");
        }
    }
    assert_eq!(portable.len(), LANES);
}
