//! Names that always select a checkpoint, and so can be none's own.

/// The tag of the run's own checkpoint with the lowest score. Only scores move it.
pub const BEST: &str = "best";

/// The tag of the one that others shall use. Users move it, and the page does.
pub(super) const PROMOTED: &str = "promoted";

/// What selects the newest checkpoint; no tag, because it always moves.
pub const LATEST: &str = "latest";
