//! What the kernel allows a process: files, and memory maps.

use channels::ChannelSizes;
use proto::config::Config;
use proto::layout::Dimensions;
use proto::mib;
use rustix::process::{Resource, getrlimit};

use super::check::Check;
use super::run_directory::checkpoint_size;
use super::smaller;

/// How large a file may become, against the largest segment of shared memory and the largest file of a
/// checkpoint.
pub fn file_size(config: &Config, dimensions: &Dimensions) -> Check {
    const NAME: &str = "file size";
    let Some(limit) = getrlimit(Resource::Fsize).current else {
        return Check::good(NAME, "no limit");
    };
    let segments = ChannelSizes::new(config, dimensions).shared_memory(1);
    let segment = segments.iter().map(|(_, bytes)| *bytes).max().unwrap_or(0);
    let needed = segment.max(checkpoint_size(config, dimensions));
    if limit < needed {
        let found =
            format!("a file may have {} and this run makes one of {}", mib(limit), mib(needed));
        return Check::failure(NAME, found, "`ulimit -f unlimited`");
    }
    Check::good(NAME, format!("{} allowed, {} needed", mib(limit), mib(needed)))
}

/// Open files that a process of the run may have, against what the transport opens.
pub fn descriptors(workers: usize, flags: &[&str]) -> Check {
    const NAME: &str = "file descriptors";
    // With two workers a learner has 80 open, a worker 69, a coordinator 65 (/proc/PID/fd); each
    // further worker adds a few connections to all of them, and this leaves room for that.
    let needed = 128 + 32 * (workers as u64 + 2);
    let limits = getrlimit(Resource::Nofile);
    match limits.current {
        Some(limit) if limit < needed => Check::failure(
            NAME,
            format!("a process may open {limit} files and {workers} workers need {needed}"),
            smaller::open_files(needed, limit, limits.maximum, flags),
        ),
        Some(limit) => Check::good(NAME, format!("{limit} allowed, {needed} needed")),
        None => Check::good(NAME, "no limit"),
    }
}

/// Memory maps that a process may have.
pub fn memory_maps(workers: usize) -> Check {
    const NAME: &str = "memory maps";
    let needed = 4096 + 256 * workers as u64;
    let text = std::fs::read_to_string("/proc/sys/vm/max_map_count").unwrap_or_default();
    match text.trim().parse::<u64>() {
        Ok(limit) if limit < needed => Check::failure(
            NAME,
            format!("a process may have {limit} and {needed} are needed"),
            format!("`sysctl -w vm.max_map_count={}`", needed.max(65_530)),
        ),
        Ok(limit) => Check::good(NAME, format!("{limit} allowed, {needed} needed")),
        Err(_) => Check::good(NAME, "no limit known"),
    }
}
