//! Rows of a table of measured numbers, as files of curves keep them.

/// A place on a curve: so many env-steps and so much time after its beginning, and what was measured there.
pub trait Row: Copy {
    /// Names of its numbers; the first two are `env_steps` and `wall_s`.
    const NAMES: [&'static str; 8];

    /// Its numbers, in the order of their [names](Self::NAMES).
    fn numbers(&self) -> [f64; 8];

    /// The row with these [numbers](Self::numbers).
    fn from_numbers(numbers: [f64; 8]) -> Self;
}
