//! `capture`: hands take hold of a body that drifts and tumbles, and keep hold of it.
//!
//! The body carries a ring, as spent upper stages and many satellites do: the adapter by which they once sat on a launcher. The robot comes from
//! before it, its base on the ring's axis, its arms reaching outward from within. Each hand has a grasp point, that of the ring nearest to it at home,
//! and shall be there as at home it stands to the base. The body is symmetric about the ring's axis and free of forces, so it spins about that axis
//! while the axis itself circles.
//!
//! Until hands hold it nothing touches the body: no contact with it is simulated, and after the grasp neither is its weight. What is
//! measured is the approach: whether all hands stay at their points, moving as these move, for [`Target::hold_steps`].

use super::{Aim, EpisodeGoals, FreeBody, GoalAddress, GoalRanges, Hold, Target, TaskDefinition};

/// See the file.
pub(super) struct Capture;

impl TaskDefinition for Capture {
    fn about(&self) -> &'static str {
        "Every hand to its grasp point on a body that tumbles, to hold it"
    }

    fn aim(&self, _: usize, _: usize) -> Aim {
        Aim::Hand
    }

    fn goals(&self, ranges: &GoalRanges, address: GoalAddress) -> EpisodeGoals {
        let Target { radius, ahead, offset, tilt, drift, spin, wobble, inertia_ratio, .. } =
            ranges.target;
        let centred = |u: [f64; 4]| u.map(|u| 2.0 * u - 1.0);
        let [place, turn, velocity, rates] = [0, 1, 2, 3].map(|i| centred(address.uniforms(i)));
        let three = |u: [f64; 4], scale: f64| [u[0] * scale, u[1] * scale, u[2] * scale];

        let base = ranges.home.base_position;
        let moved = three(place, offset);
        let centre = [base[0] + ahead + moved[0], base[1] + moved[1], base[2] + moved[2]];
        let body = FreeBody {
            position: centre,
            turned: three(turn, tilt),
            linear: three(velocity, drift),
            // The ring's axis is the body's first.
            angular: [rates[0] * spin, rates[1] * wobble, rates[2] * wobble],
            inertia: [inertia_ratio, 1.0, 1.0],
        };
        let grasp = |arm: &super::HomeArm| {
            // Outward in the ring's plane, towards the hand at home.
            let [y, z] = [1, 2].map(|i| arm.position[i] - base[i]);
            let length = libm::sqrt(y * y + z * z).max(1e-9);
            let point = [0.0, radius * y / length, radius * z / length];
            Some(body.carried(point, arm.euler))
        };
        EpisodeGoals {
            hands: ranges.home.arms.iter().map(grasp).collect(),
            base: None,
            body: Some(body),
        }
    }

    fn moves(&self) -> bool {
        true
    }

    fn hold(&self, target: &Target) -> Option<Hold> {
        let Target { position, orientation, hold_steps, .. } = *target;
        Some(Hold { position, orientation, base: f64::INFINITY, steps: hold_steps })
    }
}
