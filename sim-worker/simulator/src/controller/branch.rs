//! Which of an arm's ways to its goal.

use std::f64::consts::{PI, TAU};

use nalgebra::Isometry3;

use super::{JacobianController, SOLVED};
use crate::collision::count_contacts;
use crate::inverse_kinematics::{Angles, approach, candidates, padded};
use crate::state::State;
use crate::workspace::Workspace;

/// Places between where an arm stands and the branch's angles at which contacts are looked for.
const PLACES: usize = 6;

impl JacobianController {
    /// Sets of angles of arm `arm` that bring its hand to `target` (base axes) or near it and touch nothing there, with the other arms where they are in
    /// `now`. The best is last: one that is exact, that touches nothing on the straight way through the joints either, and of these the nearest.
    pub(super) fn branches(
        &self,
        now: &State<f64>,
        arm: usize,
        target: &Isometry3<f64>,
    ) -> Vec<Angles> {
        let joints = self.robot.joints.of_arm(arm);
        let stands = padded(&now.q[joints.clone()]);
        let nearest_turn =
            |angle: f64, stands: f64| stands + (angle - stands + PI).rem_euclid(TAU) - PI;
        let mut workspace = Workspace::new(&self.model);
        let mut state = now.clone();
        let mut touches = |way: &Angles, place: usize| {
            let part = place as f64 / PLACES as f64;
            for (j, q) in state.q[joints.clone()].iter_mut().enumerate() {
                *q = stands[j] + part * (way[j] - stands[j]);
            }
            count_contacts(&self.model, &mut workspace, &state) > 0.0
        };
        let mut ways = Vec::new();
        for way in candidates(&self.robot, arm, target) {
            let way: Angles = std::array::from_fn(|j| nearest_turn(way[j], stands[j]));
            if touches(&way, PLACES) {
                continue;
            }
            let (_, miss) = approach(&self.robot, arm, target, way, 1);
            let on_the_way = (1..PLACES).any(|place| touches(&way, place));
            let turns = way.iter().zip(&stands).map(|(way, stands)| (way - stands).abs());
            ways.push((miss > SOLVED, on_the_way, turns.fold(0.0, f64::max), way));
        }
        ways.sort_by(|a, b| (b.0, b.1).cmp(&(a.0, a.1)).then(b.2.total_cmp(&a.2)));
        ways.into_iter().map(|(.., way)| way).collect()
    }
}
