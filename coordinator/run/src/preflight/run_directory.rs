//! Room for a run's directory.

use std::path::Path;

use channels::ChannelSizes;
use proto::config::Config;
use proto::layout::{Dimensions, replay_bytes};
use proto::mib;
use store::files::free_space;

use super::check::Check;

/// What helps where a machine is not enough, in the words of the command that asks: not all have the same
/// flags.
#[derive(Debug, Clone, Copy)]
pub struct Remedy {
    /// How to use another directory.
    pub elsewhere: &'static str,
    /// How to need less of a disk.
    pub less: Option<&'static str>,
    /// Which of `--workers` and `--envs` it has, with which a run needs less of everything else.
    pub flags: &'static [&'static str],
}

/// Room for a run's directory: checkpoints, metrics and logs. `there` checkpoints lie in it already.
pub fn disk(
    directory: &Path,
    config: &Config,
    dimensions: &Dimensions,
    there: usize,
    remedy: &Remedy,
) -> Check {
    const NAME: &str = "disk";
    let existing = directory.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    let existing = if existing.as_os_str().is_empty() { Path::new(".") } else { existing };
    if let Err(error) = rustix::fs::access(existing, rustix::fs::Access::WRITE_OK) {
        let found = format!("{} cannot be written to: {error}", existing.display());
        return Check::failure(NAME, found, remedy.elsewhere);
    }
    // One checkpoint more than is kept while the newest is written.
    let checkpoint = checkpoint_size(config, dimensions);
    let kept = config.run.checkpoints_kept;
    let with = |kept: usize| checkpoint * ((kept - there.min(kept)) as u64 + 1) + (16 << 20);
    let needed = with(kept);
    match free_space(existing) {
        Err(error) => Check::failure(
            NAME,
            format!("{} cannot be measured: {error}", existing.display()),
            remedy.elsewhere,
        ),
        Ok(free) if free < needed => Check::failure(
            NAME,
            format!(
                "{} has {} free and the run needs about {}",
                existing.display(),
                mib(free),
                mib(needed)
            ),
            match remedy.less.filter(|_| with(1) <= free) {
                Some(less) => format!("make room, {}, or {less}", remedy.elsewhere),
                None => format!("make room, or {}", remedy.elsewhere),
            },
        ),
        Ok(free) => Check::good(NAME, format!("{} free, {} needed", mib(free), mib(needed))),
    }
}

/// Size of a checkpoint, about (bytes): actors and critics of the same size, parameters and two moments
/// of each, the actors apart, and a replay.
pub(crate) fn checkpoint_size(config: &Config, dimensions: &Dimensions) -> u64 {
    let policy = ChannelSizes::new(config, dimensions).policy_len as u64;
    4 * policy * 7 + replay_bytes(config, dimensions)
}

#[cfg(test)]
mod tests {
    use super::super::tests::config;
    use proto::agents::Joints;

    use super::*;

    #[test]
    fn what_lies_on_the_disk_already_is_not_asked_for_again() {
        let config = config("run.checkpoints_kept=3");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let remedy = Remedy { elsewhere: "elsewhere", less: None, flags: &[] };
        let dir = tempfile::tempdir().expect("tempdir");
        let wanted = |there| {
            let found = disk(dir.path(), &config, &dimensions, there, &remedy).found;
            found.rsplit(" free ").next().map(str::to_owned)
        };
        assert_ne!(wanted(0), wanted(3));
        // More than are kept: milestones, or what the user pinned.
        assert_eq!(wanted(3), wanted(9));
        // No file is written there, whoever asks, and it has no free space.
        let check = disk(Path::new("/proc/1"), &config, &dimensions, 0, &remedy);
        assert!(check.cure.as_ref().is_some_and(|cure| cure.contains("elsewhere")), "{check:?}");
    }
}
