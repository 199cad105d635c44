//! The body that hands take hold of, as a configuration describes it.

use serde::{Deserialize, Serialize};

/// Table `task.target`: the body that hands take hold of (task `capture`). Everything about it is drawn uniformly within what is said.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Radius of the body's ring, on which the grasp points lie (m).
    pub radius: f64,
    /// How far before the base the ring's centre is, along the base's x (m).
    pub ahead: f64,
    /// The centre is off that place by up to this, each axis (m).
    pub offset: f64,
    /// The ring is turned by up to this about each axis (rad).
    pub tilt: f64,
    /// The body drifts at up to this, each axis (m/s).
    pub drift: f64,
    /// The body spins about the ring's axis at up to this (rad/s).
    pub spin: f64,
    /// The body turns about each axis across the ring's at up to this (rad/s).
    pub wobble: f64,
    /// The body's moment of inertia about the ring's axis, in parts of that about an axis across it.
    pub inertia_ratio: f64,
    /// A hand holds its grasp point when it is nearer than this (m), and turned as `orientation` says.
    pub position: f64,
    /// A hand that holds its grasp point is turned away from it by less than this: norm of the Euler-angle difference (rad).
    pub orientation: f64,
    /// An episode counts when all hands hold their grasp points at once for so many control steps in a row.
    pub hold_steps: usize,
}

impl Default for Target {
    /// A ring of 2,624 mm in diameter, as the largest payload adapters have (Arianespace, Ariane 5 User's Manual, issue 5, annex on adapters), on a body that is longer than it is wide.
    fn default() -> Self {
        Self {
            radius: 1.312,
            ahead: 0.35,
            offset: 0.05,
            tilt: 0.05,
            drift: 1e-3,
            spin: 4e-3,
            wobble: 1e-3,
            inertia_ratio: 0.6,
            position: 0.015,
            orientation: 0.05,
            hold_steps: 10,
        }
    }
}
