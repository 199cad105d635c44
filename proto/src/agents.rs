//! How an arm is divided among agents.

/// Joints that one agent moves.
pub const JOINTS_PER_AGENT: usize = 3;

/// Agents of one arm: shoulder joints, wrist joints.
pub const AGENTS_PER_ARM: usize = 2;

/// Joints of one arm.
pub const JOINTS_PER_ARM: usize = AGENTS_PER_ARM * JOINTS_PER_AGENT;
