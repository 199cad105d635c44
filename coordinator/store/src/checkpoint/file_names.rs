//! Names of the files of a checkpoint, and the version of their format.

/// The format that this version writes.
pub const FORMAT: u32 = 1;

/// Name of the file that makes a directory a checkpoint.
pub const MANIFEST: &str = "manifest.json";

/// Name of the training state.
pub const STATE: &str = "state.safetensors";

/// Name of the actors.
pub const POLICY: &str = "policy.safetensors";

/// Name of the resolved configuration.
pub const CONFIG: &str = "config.toml";

/// Name of the robot's description.
pub const ROBOT: &str = "robot.toml";

/// Name of the file; beside the manifest, and not listed in it, because it changes.
pub const LABELS: &str = "labels.json";
