//! TODO
use super::Robot;
/// Options of an exported model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MjcfOptions { /// Whether shapes collide.
 pub contacts: bool }
/// MJCF.
pub fn mjcf(_robot: &Robot, _options: MjcfOptions) -> String { String::new() }
