//! Where shared memory lives.

/// Where shared memory lives.
pub const SHARED_MEMORY: &str = "/dev/shm";
