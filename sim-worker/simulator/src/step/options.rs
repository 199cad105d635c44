//! How a control period is integrated.
//!
//! **Why Runge–Kutta of third order at 16 ms.** For the stiffness of contacts that a scheme keeps stable the
//! third order needs fewer evaluations than the fourth, and both are far more accurate than what they are
//! compared with. The start of a period is cut finer, because that is where the servos answer.

/// Scheme that advances the state by one substep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Classical Runge–Kutta of fourth order; the quaternion is integrated as four numbers and normalised after each substep. At the end of a period
    /// momentum and centre of mass are put right (see `invariants`).
    Rk4,
    /// Heun's Runge–Kutta of third order, otherwise as [`Integrator::Rk4`]: with as many evaluations, contacts a fifth stiffer.
    Rk3,
    /// Semi-implicit Euler: velocities first, positions with the new velocities, the quaternion by the exponential map. MuJoCo's `Euler`.
    Euler,
}

/// How a control period is integrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOptions {
    /// Time a command is held (s).
    pub control_period: f64,
    /// Length of a substep (s); the period is cut into the nearest whole number of equal ones. Runge–Kutta cuts the first one, in which the servos
    /// answer a new command, in a quarter, a quarter and a half.
    pub substep: f64,
    /// Scheme.
    pub integrator: Integrator,
    /// Whether contacts push.
    pub contacts: bool,
}

impl Default for StepOptions {
    /// What training runs: 0.4 s in Runge–Kutta substeps of 16 ms, with contacts.
    ///
    /// Over 20 s of random commands the mean distance to the converged solution is a tenth of what semi-implicit Euler at 1 ms leaves. Two things do
    /// it: the start of a period is cut finer, where torques leave their limits and the servos' fastest mode, 100 /s, decays; and the base is put
    /// right by the invariants. Contacts and that mode, not accuracy, ask for the 16 ms.
    fn default() -> Self {
        Self { control_period: 0.4, substep: 0.016, integrator: Integrator::Rk3, contacts: true }
    }
}

impl StepOptions {
    /// Number of whole substeps in a control period, at least one.
    pub(super) fn n_whole(&self) -> usize {
        (self.control_period / self.substep).round().max(1.0) as usize
    }

    /// Parts of the first whole substep.
    fn start(&self) -> &'static [f64] {
        match self.integrator {
            Integrator::Rk4 | Integrator::Rk3 => &[0.25, 0.25, 0.5],
            Integrator::Euler => &[1.0],
        }
    }

    /// Lengths of the substeps of a period (s).
    pub(super) fn substeps(&self) -> impl Iterator<Item = f64> + use<> {
        let (n, start) = (self.n_whole(), self.start());
        let whole = self.control_period / n as f64;
        start.iter().copied().chain(std::iter::repeat_n(1.0, n - 1)).map(move |part| part * whole)
    }

    /// Frequency of contacts (rad/s) up to which substeps of length `h` (s) are stable.
    ///
    /// The largest for which |R(λ h)| < 1 for the modes of a contact, λ² + (2 ζ ω r + c) λ + ω² r = 0, whatever the servo damps on top, c up to 100 /s, and
    /// however wrong the mass is, r from 0.3 to 1.6; with R the scheme's stability function. Semi-implicit Euler ends at ω h = 2 without any of that.
    pub(super) fn stable_frequency(&self, h: f64) -> f64 {
        let reach = match self.integrator {
            Integrator::Rk4 => 2.0,
            Integrator::Rk3 => 1.8,
            Integrator::Euler => 1.0,
        };
        reach / h
    }
}
