//! Room in shared memory.

use std::path::Path;

use channels::{ChannelSizes, SHARED_MEMORY};
use proto::config::Config;
use proto::layout::Dimensions;
use proto::mib;
use store::files::free_space;
use store::provenance;

use super::check::Check;
use super::smaller;

/// What helps where shared memory is full and no run's needs are known.
pub const MAKE_ROOM: &str = "`octopus clean` removes what killed runs left, `ls -l /dev/shm` shows what \
                             others have there, `mount -o remount,size=SIZE /dev/shm` enlarges it";

/// Free shared memory against what the channels of the run reserve, whose blocks come from its workers and from
/// `gateways` to other machines.
pub fn shared_memory(
    config: &Config,
    dimensions: &Dimensions,
    gateways: usize,
    flags: &[&str],
) -> Check {
    const NAME: &str = "shared memory";
    let directory = Path::new(SHARED_MEMORY);
    let free = match free_space(directory) {
        Ok(free) => free,
        Err(error) => return unmounted(NAME, directory, &error),
    };
    let senders = config.run.workers + gateways;
    let budget = ChannelSizes::new(config, dimensions).shared_memory(senders);
    let needed: u64 = budget.iter().map(|(_, bytes)| bytes).sum();
    if needed <= free {
        let found = format!("{} free, {} needed", mib(free), mib(needed));
        return Check::good(NAME, found);
    }
    let parts: Vec<_> =
        budget.iter().map(|(name, bytes)| format!("{name} {}", mib(*bytes))).collect();
    let shown = directory.display();
    Check::failure(
        NAME,
        format!(
            "this run needs {} ({}) and {shown} has {} free",
            mib(needed),
            parts.join(", "),
            mib(free)
        ),
        cures(needed, &smaller::fitting(config, dimensions, gateways, free, flags), directory),
    )
}

/// What helps where shared memory is too small; only what would be enough.
fn cures(needed: u64, less: &[String], directory: &Path) -> String {
    let shown = directory.display();
    let mut cures = Vec::new();
    if round_up(needed) << 20 <= provenance::memory() {
        let size = round_up(needed);
        cures.push(format!(
            "enlarge it: `mount -o remount,size={size}M {shown}` (in a container start it with \
             --shm-size={size}m)"
        ));
    }
    if !less.is_empty() {
        cures.push(format!("need less: {}", less.join(" or ")));
    }
    if cures.is_empty() {
        cures.push(
            "need less: smaller networks and episodes, or a machine with more memory".to_owned(),
        );
    }
    cures.push("`octopus clean` removes what killed runs left".to_owned());
    cures.join("; ")
}

fn unmounted(name: &'static str, directory: &Path, error: &std::io::Error) -> Check {
    let shown = directory.display();
    Check::failure(
        name,
        format!("{shown} cannot be measured: {error}"),
        format!("mount it: `mount -t tmpfs -o size=1024M tmpfs {shown}`"),
    )
}

/// Whether there is shared memory for `to` workers where `from` are now.
pub fn scale(sizes: &ChannelSizes, from: usize, to: usize) -> Result<(), String> {
    let total = |workers| sizes.shared_memory(workers).iter().map(|(_, bytes)| bytes).sum::<u64>();
    let more = total(to).saturating_sub(total(from));
    let free =
        free_space(Path::new(SHARED_MEMORY)).map_err(|error| format!("shared memory: {error}"))?;
    if more <= free {
        return Ok(());
    }
    Err(format!(
        "{to} workers need {} more of shared memory, {} are free; ask for fewer workers",
        mib(more),
        mib(free)
    ))
}

/// Whether there is not even room for what a process needs to come up.
pub fn shared_memory_is_full() -> bool {
    free_space(Path::new(SHARED_MEMORY)).is_ok_and(|free| free < 1 << 20)
}

/// A size in MiB with some reserve, in whole 64 MiB.
fn round_up(bytes: u64) -> u64 {
    (bytes + bytes / 8).div_ceil(64 << 20) * 64
}

#[cfg(test)]
mod tests {
    use super::super::check::Verdict;
    use super::super::tests::config;
    use proto::agents::Joints;

    use super::*;

    #[test]
    fn a_run_that_needs_too_much_names_the_cures() {
        let config = config("env.n_envs=65536");
        let config =
            Config { run: proto::config::Run { workers: 256, ..config.run.clone() }, ..config };
        let flags = ["--workers", "--envs"];
        let check =
            shared_memory(&config, &Dimensions::new(&config, Joints::of_sixes(4)), 0, &flags);
        assert_eq!(check.verdict, Verdict::Failure);
        let cure = check.cure.expect("a failure has a cure");
        assert!(cure.contains("need less: --") && cure.ends_with("killed runs left"), "{cure}");
        let enlarged = cures(1 << 20, &[], Path::new("/dev/shm"));
        assert!(
            enlarged.starts_with("enlarge it: `mount -o remount,size=64M /dev/shm`"),
            "{enlarged}"
        );
        let nothing = cures(u64::MAX >> 1, &[], Path::new("/dev/shm"));
        assert!(nothing.starts_with("need less: smaller networks"), "{nothing}");
    }

    #[test]
    fn sizes_for_people() {
        assert_eq!(mib(600 << 20), "600 MiB");
        assert_eq!(mib(64 << 30), "64.0 GiB");
        assert_eq!(round_up(1 << 20), 64);
    }
}
