//! Faults on purpose, so that tests can see what a run does about them.
//!
//! The variable [`VARIABLE`] holds `KIND@ITERATION/SHARD`: whoever makes that block meets the fault.

/// Name of the variable. Tests set it; nobody else should.
pub(super) const VARIABLE: &str = "SPACEOCTOPUS_TEST_FAULT";

/// Meets the fault if one is set for this block.
pub(super) fn meet(iteration: u64, shard: u32) {
    let Ok(text) = std::env::var(VARIABLE) else { return };
    let Some((kind, address)) = text.split_once('@') else { return };
    if address != format!("{iteration}/{shard}") {
        return;
    }
    match kind {
        "crash" => std::process::abort(),
        "hang" => loop {
            std::thread::park();
        },
        _ => {}
    }
}
