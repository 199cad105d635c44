//! Groups `robot` and `env`: who moves and how that is simulated.

use serde::{Deserialize, Serialize};

/// Group `robot`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSection {
    /// `paper`, `release`, or the path of a robot file.
    pub description: String,
}

/// How the equations of motion are integrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// Classical Runge and Kutta, fourth order.
    Rk4,
    /// Runge–Kutta of third order: fewer evaluations for contacts as stiff.
    Rk3,
    /// Semi-implicit Euler, the scheme of the authors' simulator.
    Euler,
}

/// Group `env`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// Environments of the whole run; every one plays one episode an iteration.
    pub n_envs: usize,
    /// Shards that the environments are split into; the unit of work and of accounting.
    pub n_shards: usize,
    /// Duration of a control step (s).
    pub control_period: f64,
    /// Duration of an integration step (s); divides the control period.
    pub substep: f64,
    /// Integration scheme.
    pub integrator: Integrator,
    /// Whether touching bodies push each other.
    pub contacts: bool,
}
