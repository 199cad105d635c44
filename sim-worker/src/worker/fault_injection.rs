//! Faults on purpose, so that tests can see what a run does about them.
//!
//! The variable [`VARIABLE`] holds `KIND@ITERATION/SHARD`: it happens to whoever makes that block. `*` stands for any
//! iteration or shard, `K+` for iteration K and all after it.

/// Name of the variable. Tests set it; nobody else should.
const VARIABLE: &str = "SPACEOCTOPUS_TEST_FAULT";

/// Lets the fault happen that is set for this block, if one is.
pub(super) fn inject_fault(iteration: u64, shard: u32) {
    match fault(iteration, shard).as_deref() {
        Some("crash") => std::process::abort(),
        Some("hang") => loop {
            std::thread::park();
        },
        _ => {}
    }
}

/// Makes a block another one, as a processor would that computes otherwise, if that is set for it.
pub(super) fn distort(iteration: u64, shard: u32, block: &mut [f32]) {
    if fault(iteration, shard).as_deref() == Some("distort") {
        block[0] = f32::from_bits(block[0].to_bits() ^ 1);
    }
}

/// The kind of fault that is set for this block.
fn fault(iteration: u64, shard: u32) -> Option<String> {
    let text = std::env::var(VARIABLE).ok()?;
    let (kind, address) = text.split_once('@')?;
    let (wanted_iteration, wanted_shard) = address.split_once('/')?;
    let is_it = |wanted: &str, number: u64| match wanted.strip_suffix('+') {
        Some(first) => first.parse().is_ok_and(|first: u64| first <= number),
        None => wanted == "*" || wanted == number.to_string(),
    };
    let is_meant = is_it(wanted_iteration, iteration) && is_it(wanted_shard, shard.into());
    is_meant.then(|| kind.to_owned())
}
