//! Faults on purpose, so that tests can see what a run does about them.
//!
//! The variable [`VARIABLE`] holds `KIND@ITERATION/SHARD`: it happens to whoever makes that block.

/// Name of the variable. Tests set it; nobody else should.
const VARIABLE: &str = "SPACEOCTOPUS_TEST_FAULT";

/// Lets the fault happen that is set for this block, if one is.
pub(super) fn inject_fault(iteration: u64, shard: u32) {
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
