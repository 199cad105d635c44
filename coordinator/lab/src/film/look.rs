//! How a film looks.

use rendering::View;

/// How a film looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// Columns and rows (px).
    pub size: [usize; 2],
    /// Pictures a second.
    pub fps: u32,
    /// Seconds of the episode in a second of the film.
    pub speed: f64,
    /// From where it is seen (rad).
    pub view: View,
    /// How far the camera goes around the robot while the film lasts (rad).
    pub orbit: f64,
    /// How much larger everything is than if all of it just fits.
    pub zoom: f64,
    /// Whether time and errors are written below.
    pub caption: bool,
}
