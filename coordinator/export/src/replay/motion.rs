//! A recorded motion, made again.

use super::comparison::Replay;
use crate::error::ExportError;
use crate::recording::{Recorded, numbers_of};

/// Makes a recorded motion again, up to the first state that differs.
///
/// # Errors
/// If the simulation diverges.
pub fn replay_motion(recorded: &Recorded) -> Result<Replay, ExportError> {
    let Recorded { commanded, states } = recorded;
    let mut motion = commanded.begin();
    let n_joints = commanded.robot.n_joints();
    let mut replay = Replay::new(states.len());
    for (step, state) in (0..commanded.commands.len()).zip(states) {
        commanded.step(step, &mut motion)?;
        let now = numbers_of(motion.state());
        if !replay.compare(motion.steps(), state, &now, |index| name(index, n_joints)) {
            break;
        }
    }
    Ok(replay)
}

/// What a number of a state is.
fn name(index: usize, n_joints: usize) -> String {
    const BASE: [&str; 13] = [
        "base position x (m)",
        "base position y (m)",
        "base position z (m)",
        "base quaternion w",
        "base quaternion x",
        "base quaternion y",
        "base quaternion z",
        "base velocity x (m/s)",
        "base velocity y (m/s)",
        "base velocity z (m/s)",
        "base angular velocity x (rad/s)",
        "base angular velocity y (rad/s)",
        "base angular velocity z (rad/s)",
    ];
    match index.checked_sub(BASE.len()) {
        None => BASE[index].to_owned(),
        Some(joint) if joint < n_joints => format!("angle of joint {} (rad)", joint + 1),
        Some(joint) => format!("rate of joint {} (rad/s)", joint - n_joints + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_names() {
        assert_eq!(name(3, 24), "base quaternion w");
        assert_eq!(name(13, 24), "angle of joint 1 (rad)");
        assert_eq!(name(13 + 24, 24), "rate of joint 1 (rad/s)");
        assert_eq!(name(12 + 48, 24), "rate of joint 24 (rad/s)");
    }
}
