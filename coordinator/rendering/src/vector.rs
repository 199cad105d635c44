//! Points and directions.

/// A point or a direction (m, world).
pub type Vector = nalgebra::Vector3<f64>;
