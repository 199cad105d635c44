#![expect(clippy::approx_constant, reason = "the servos' limit is 3.14 rad/s, not π")]

use super::distance::{rounded_box, rounded_rounded};
use super::*;
use crate::dynamics::reference_dynamics::momentum;
use crate::model::{ContactKind, Core, FixedBox, Model, Rounded};
use crate::robot::Robot;
use crate::scalar::{LaneFn, Real, dispatch};
use crate::spatial::{Vec3, mul_add, sub};
use crate::state::State;
use crate::step::{StepOptions, step};
use crate::workspace::Workspace;
use std::f64::consts::{PI, TAU};

/// Uniform numbers in ±1, the same on every machine.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
    fn point(&mut self, size: f64) -> Vec3<f64> {
        [size * self.next(), size * self.next(), size * self.next()]
    }
}

const EYE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn capsule(from: Vec3<f64>, to: Vec3<f64>, radius: f64) -> Rounded<f64> {
    Rounded { core: Core::Segment { from, to }, radius }
}

fn distance_to_box(p: Vec3<f64>, half: Vec3<f64>) -> f64 {
    (0..3).map(|i| (p[i].abs() - half[i]).max(0.0).powi(2)).sum::<f64>().sqrt()
}

/// Closed forms against a fine search along the segments.
#[test]
fn distances_agree_with_a_search() {
    let mut noise = Noise(1);
    let along = |from: Vec3<f64>, to: Vec3<f64>, t: f64| mul_add(t, sub(to, from), from);
    for case in 0..300 {
        let (p0, mut p1) = (noise.point(1.0), noise.point(1.0));
        if case % 7 == 0 {
            // Parallel to a face of the box and to the other segment.
            p1 = [p0[0] + 0.5, p0[1], p0[2]];
        }
        let half = [0.3, 0.2, 0.4];
        let block = FixedBox { centre: [0.0; 3], rotation: EYE, half };
        let found = rounded_box(&capsule(p0, p1, 0.05), &block).gap + 0.05;
        let searched = (0..=10000)
            .map(|i| distance_to_box(along(p0, p1, f64::from(i) / 10000.0), half))
            .fold(f64::INFINITY, f64::min);
        if searched > 1e-3 {
            assert!((found - searched).abs() < 2e-4, "box, case {case}: {found} {searched}");
        } else {
            assert!(found < 2e-3, "box, case {case}: {found} {searched}");
        }

        let (q0, mut q1) = (noise.point(1.0), noise.point(1.0));
        if case % 7 == 0 {
            q1 = [q0[0] + 0.8, q0[1], q0[2]];
        }
        let found = rounded_rounded(&capsule(p0, p1, 0.1), &capsule(q0, q1, 0.2)).gap + 0.3;
        let mut searched = f64::INFINITY;
        for i in 0..=400 {
            let p = along(p0, p1, f64::from(i) / 400.0);
            let d = sub(q1, q0);
            let r = sub(p, q0);
            let dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let t = ((r[0] * d[0] + r[1] * d[1] + r[2] * d[2]) / dd).clamp(0.0, 1.0);
            let e = sub(p, along(q0, q1, t));
            searched = searched.min((e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).sqrt());
        }
        assert!((found - searched).abs() < 5e-3, "segments, case {case}: {found} {searched}");
    }
}

#[test]
fn a_cylinder_on_a_face_and_beside_a_capsule() {
    let disc = |z: f64| Rounded {
        core: Core::Cylinder {
            centre: [0.0, 0.0, z],
            axis: [0.0, 0.0, 1.0],
            radius: 0.03,
            half: 0.01,
        },
        radius: 0.005,
    };
    let block = FixedBox { centre: [0.0, 0.0, -1.0], rotation: EYE, half: [1.0; 3] };
    let p = rounded_box(&disc(0.05), &block);
    assert!((p.gap - 0.035).abs() < 1e-12 && p.normal == [0.0, 0.0, 1.0], "{p:?}");
    let c = capsule([0.1, -1.0, 0.0], [0.1, 1.0, 0.0], 0.02);
    let p = rounded_rounded(&disc(0.0), &c);
    assert!((p.gap - 0.045).abs() < 1e-9, "{p:?}");
    assert!((p.normal[0] + 1.0).abs() < 1e-9);
    // Overlapping a little keeps the direction and the sign.
    let p = rounded_box(&disc(0.012), &block);
    assert!((p.gap + 0.003).abs() < 1e-12 && p.normal == [0.0, 0.0, 1.0], "{p:?}");
}

/// A segment whose axis has sunk into a box is pushed out of the nearest face.
#[test]
fn a_deep_capsule_leaves_by_the_nearest_face() {
    let block = FixedBox { centre: [0.0; 3], rotation: EYE, half: [1.0; 3] };
    let p = rounded_box(&capsule([-0.2, 0.1, 0.95], [0.3, 0.1, 0.95], 0.1), &block);
    assert_eq!(p.normal, [0.0, 0.0, 1.0]);
    assert!((p.gap + 0.15).abs() < 1e-12);
}

#[test]
fn nothing_touches_at_home() {
    for name in Robot::builtin_names() {
        let robot = Robot::builtin(name).unwrap();
        let model = Model::<f64>::new(&robot);
        let mut ws = Workspace::new(&model);
        let t = touching(&model, &mut ws, &State::home(&robot));
        assert_eq!((t.pairs, t.penetration), (0.0, 0.0), "{name}");
        // Per arm: five links with the cube, with three other mounts and pedestals, four with the own ones, eight pairs of links; then arm by arm.
        assert_eq!(model.collision.pairs.len(), 4 * (5 + 3 * 10 + 8 + 8) + 6 * 36);
    }
}

/// Joints driven at full speed in random combinations, held for long enough to hit the cube, the mounts and other arms; a combination a lane.
struct Rams {
    seed: u64,
    /// Longest time a combination is held (control steps of 50 ms).
    hold: usize,
}

struct Impact {
    penetration: f64,
    fastest: f64,
    touches: f64,
}

impl LaneFn for Rams {
    type Output = Impact;
    #[inline(always)]
    fn call<S: Real>(self) -> Impact {
        let robot = Robot::builtin("paper").unwrap();
        let model = Model::<S>::new(&robot);
        let mut ws = Workspace::new(&model);
        let mut state = State::<S>::home(&robot);
        let mut noise = Noise(self.seed);
        let mut command = vec![S::zero(); 24];
        let options = StepOptions { control_period: 0.05, ..StepOptions::default() };
        let mut impact = Impact { penetration: 0.0, fastest: 0.0, touches: 0.0 };
        for t in 0..240 {
            if t % self.hold == 0 {
                for (j, c) in command.iter_mut().enumerate() {
                    let rate = if j % 6 < 3 { 2.0942 } else { 3.14 };
                    for i in 0..S::LANES {
                        // Full speed one way, the other, or still.
                        c.set_lane(i, rate * (1.5 * noise.next()).round().clamp(-1.0, 1.0));
                    }
                }
            }
            step(&model, &mut ws, &mut state, &command, &options);
            let touch = touching(&model, &mut ws, &state);
            for i in 0..S::LANES {
                impact.penetration = impact.penetration.max(touch.penetration.lane(i));
                impact.touches += touch.pairs.lane(i) / (240 * S::LANES) as f64;
                for qd in &state.qd {
                    impact.fastest = impact.fastest.max(qd.lane(i).abs());
                    assert!(qd.lane(i).is_finite(), "diverged");
                }
            }
        }
        impact
    }
}

#[test]
fn arms_at_full_speed_sink_in_by_millimetres() {
    for (seed, hold) in [(1, 40), (2, 80), (3, 20), (4, 240)] {
        let impact = dispatch(Rams { seed, hold });
        eprintln!(
            "seed {seed}: {:.2} mm deep, {:.1} rad/s, {:.2} pairs touching",
            1e3 * impact.penetration,
            impact.fastest,
            impact.touches
        );
        assert!(impact.penetration < 0.015, "{} m deep", impact.penetration);
        // The servos command up to 3.14 rad/s; what a push adds stays of that order.
        assert!(impact.fastest < 8.0, "{} rad/s", impact.fastest);
        assert!(impact.touches > 0.0, "nothing was hit");
    }
}

/// Joints driven into the intervals of pushing contacts by angle come as far as the end and no further: a servo that asks for 1 rad/s pushes with 100 N m against
/// armature · ω² = 12.5 kN m/rad, 8 mrad.
#[test]
fn contacts_by_angle_hold_joints() {
    let robot = Robot::builtin("paper").unwrap();
    let model = Model::<f64>::new(&robot);
    for contact in robot.types[0].angle_contacts.iter().filter(|contact| contact.push) {
        let mut ws = Workspace::new(&model);
        let mut state = State::<f64>::home(&robot);
        let from_centre = |q: f64| (q - contact.centre + PI).rem_euclid(TAU) - PI;
        let side = from_centre(state.q[contact.joint]).signum();
        let mut command = vec![0.0; robot.n_joints()];
        command[contact.joint] = -side;
        let mut nearest = f64::INFINITY;
        for _ in 0..30 {
            step(&model, &mut ws, &mut state, &command, &StepOptions::default());
            nearest = nearest.min(side * from_centre(state.q[contact.joint]));
        }
        let joint = contact.joint + 1;
        assert!(
            nearest > contact.half - contact.narrowing - 0.02,
            "joint {joint} went in: {nearest}"
        );
        assert!(nearest < contact.half + 0.02, "joint {joint} never came there: {nearest}");
    }
}

/// Forces come in pairs along one line: momentum stays although arms push on the base and on each other.
#[test]
fn contacts_conserve_momentum() {
    let robot = Robot::builtin("paper").unwrap();
    let model = Model::<f64>::new(&robot);
    let mut ws = Workspace::new(&model);
    let mut state = State::<f64>::home(&robot);
    let mut noise = Noise(9);
    let options = StepOptions::default();
    let mut touched = 0.0;
    let (mut scale, mut worst) = (0.0_f64, 0.0_f64);
    for _ in 0..6 {
        let command: Vec<f64> = (0..24).map(|_| 2.0 * noise.next().signum()).collect();
        for _ in 0..2 {
            step(&model, &mut ws, &mut state, &command, &options);
            touched += count_contacts(&model, &mut ws, &state);
            let m = momentum(&robot, &state);
            scale = scale.max(m.linear_scale).max(m.angular_scale);
            worst = worst.max(m.linear.norm()).max(m.angular.norm());
        }
    }
    assert!(touched > 0.0);
    assert!(worst < 1e-9 * scale, "{worst:e} of {scale:e}");
}

/// Where nothing touches nor is about to, contacts change nothing.
#[test]
fn free_motion_is_the_same_with_and_without_contacts() {
    let robot = Robot::builtin("paper").unwrap();
    let model = Model::<f64>::new(&robot);
    let mut ws = Workspace::new(&model);
    let (mut with, mut without) = (State::<f64>::home(&robot), State::<f64>::home(&robot));
    for k in 0..10 {
        let command: Vec<f64> =
            (0..24).map(|j| 0.3 * (0.7 * f64::from(j) + 0.9 * f64::from(k)).sin()).collect();
        let on = StepOptions::default();
        step(&model, &mut ws, &mut with, &command, &on);
        step(&model, &mut ws, &mut without, &command, &StepOptions { contacts: false, ..on });
    }
    assert_eq!(with, without);
}

/// The counts by kind are those of the pairs; what is told by joint angle is told apart too.
#[test]
fn kinds_of_contacts_add_up() {
    let robot = Robot::builtin("paper").unwrap();
    let model = Model::<f64>::new(&robot);
    let mut ws = Workspace::new(&model);
    let mut of = |state: &State<f64>| touching(&model, &mut ws, state);
    // An upper arm in its mount (q2 from 0.278 to 2.858); an elbow folded onto the wrist (|q3| from 2.87 on).
    let mut state = State::<f64>::home(&robot);
    state.q[1] = 0.35;
    assert!(of(&state).by_kind[ContactKind::Mount as usize] >= 1.0);
    let mut state = State::<f64>::home(&robot);
    state.q[2] = 3.0;
    assert!(of(&state).by_kind[ContactKind::Own as usize] >= 1.0);
    let mut state = State::<f64>::home(&robot);
    state.q[2 * 6 + 2] = 3.0;
    let t = of(&state);
    assert!(t.by_arm[2] >= 1.0 && t.by_arm[2] == t.pairs, "arm 2 alone: {:?}", t.by_arm);
    let mut noise = Noise(9);
    let mut seen = [0.0; ContactKind::COUNT];
    for _ in 0..500 {
        let mut state = State::<f64>::home(&robot);
        state.q.iter_mut().for_each(|q| *q += 2.0 * noise.next());
        let t = of(&state);
        assert_eq!(t.by_kind.iter().sum::<f64>(), t.pairs);
        let twice = t.by_kind[ContactKind::Arms as usize];
        assert_eq!(t.by_arm.iter().sum::<f64>(), t.pairs + twice);
        for kind in ContactKind::ALL {
            seen[kind as usize] += t.by_kind[kind as usize];
        }
    }
    assert!(seen.iter().all(|count| *count > 0.0), "{seen:?}");
    // At home nothing touches.
    let home = of(&State::home(&robot));
    assert_eq!(home.by_kind, [0.0; ContactKind::COUNT]);
}
