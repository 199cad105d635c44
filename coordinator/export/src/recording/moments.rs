//! A motion, moment by moment.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use simulator::experiment::Motion;
use simulator::robot::Robot;
use simulator::spatial::{Mat3, euler_xyz_to_rotation};

use super::commanded::{Commanded, numbers_of};
use crate::error::ExportError;

/// A frame in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) origin: Vector3<f64>,
    pub(super) rotation: Matrix3<f64>,
}

impl Frame {
    fn new(rotation: &Mat3<f32>, origin: [f32; 3]) -> Self {
        let rotation = Matrix3::from_fn(|i, j| f64::from(rotation[i][j]));
        Self { origin: Vector3::from(origin.map(f64::from)), rotation }
    }

    /// This frame as `parent` sees it.
    pub(super) fn seen_from(&self, parent: &Self) -> Self {
        let back = parent.rotation.transpose();
        Self { origin: back * (self.origin - parent.origin), rotation: back * self.rotation }
    }

    /// Its attitude.
    pub(super) fn quaternion(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation))
    }
}

/// A contact that pushes: the bodies' names, the point (m) and the force (N), world.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pushed {
    pub(super) on: String,
    pub(super) by: String,
    pub(super) point: [f64; 3],
    pub(super) force: [f64; 3],
}

/// Everything at the beginning or after a control step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Moment {
    /// Base, then all links, arm after arm.
    pub(super) bodies: Vec<Frame>,
    pub(super) hands: Vec<Frame>,
    /// Position (m), quaternion (w, x, y, z), velocity (m/s, world), angular velocity (rad/s, base).
    pub(super) base: [f32; 13],
    pub(super) q: Vec<f32>,
    pub(super) qd: Vec<f32>,
    /// Commands (rad/s) and torques (N m) of the step that led here.
    pub(super) commands: Vec<f32>,
    pub(super) torques: Vec<f32>,
    pub(super) position_errors: Vec<f32>,
    pub(super) orientation_errors: Vec<f32>,
    pub(super) base_error: f32,
    pub(super) pushes: Vec<Pushed>,
}

/// Names of bodies as `octopus urdf` has them: the base, then all links, arm after arm.
pub(super) fn body_names(robot: &Robot) -> Vec<String> {
    let links = robot.arms.iter().flat_map(|arm| {
        robot.types[arm.arm_type]
            .links
            .iter()
            .map(move |link| format!("{}_{}", arm.name, link.name))
    });
    std::iter::once("base".to_owned()).chain(links).collect()
}

/// The moments of a motion, one more than there are steps, and the numbers of its states.
///
/// # Errors
/// If the simulation diverges.
pub(super) fn moments(commanded: &Commanded) -> Result<(Vec<Moment>, Vec<Vec<f32>>), ExportError> {
    let names = body_names(&commanded.robot);
    let mut motion = commanded.begin();
    let mut moments = vec![moment(&names, &motion)];
    let mut states = vec![numbers_of(motion.state())];
    for step in 0..commanded.commands.len() {
        commanded.step(step, &mut motion)?;
        moments.push(moment(&names, &motion));
        states.push(numbers_of(motion.state()));
    }
    Ok((moments, states))
}

/// A goal of a hand.
pub(super) fn hand_goal(goal: [f64; 6]) -> Frame {
    let [x, y, z, a, b, c] = goal.map(|x| x as f32);
    Frame::new(&euler_xyz_to_rotation([a, b, c]), [x, y, z])
}

/// A goal of the base, which has no place.
pub(super) fn base_goal(attitude: [f64; 3]) -> Frame {
    Frame::new(&euler_xyz_to_rotation(attitude.map(|x| x as f32)), [0.0; 3])
}

fn moment(names: &[String], motion: &Motion) -> Moment {
    let state = motion.state();
    let bodies = 0..=motion.robot().n_joints();
    let name = |link: Option<usize>| names[link.map_or(0, |link| link + 1)].clone();
    let pushed = motion.pushes().iter().map(|push| Pushed {
        on: name(Some(push.on)),
        by: name(push.by),
        point: push.point.map(f64::from),
        force: push.force.map(f64::from),
    });
    let [position, quaternion, linear, angular, q, qd] = state.parts();
    let base = [position, quaternion, linear, angular];
    let errors = motion.errors();
    Moment {
        bodies: bodies
            .map(|body| {
                let (rotation, origin) = motion.body(body);
                Frame::new(&rotation, origin)
            })
            .collect(),
        hands: motion
            .hands()
            .iter()
            .map(|hand| Frame::new(&hand.rotation, hand.position))
            .collect(),
        base: base.concat().try_into().expect("thirteen numbers"),
        q: q.to_vec(),
        qd: qd.to_vec(),
        commands: motion.commands().to_vec(),
        torques: motion.torques().to_vec(),
        position_errors: errors.position_norm.clone(),
        orientation_errors: errors.orientation_norm.clone(),
        base_error: errors.base_norm,
        pushes: pushed.collect(),
    }
}
