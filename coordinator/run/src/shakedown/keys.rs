//! Where the parts of an arm stand in a robot's description, for messages.

use simulator::robot::Robot;

/// What stands before the keys of an arm's type in the description.
pub(super) fn type_prefix(robot: &Robot, arm: usize) -> String {
    let named = &robot.description().arms[arm].arm_type;
    named.as_ref().map_or_else(String::new, |name| format!("arm_types.{name}."))
}
