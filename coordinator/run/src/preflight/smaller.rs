//! What a run can do with less of: remedies that are enough, or none.

use channels::ChannelSizes;
use proto::config::Config;
use proto::layout::Dimensions;

/// Files that a process of a run opens beside those for its workers, as [`descriptors`](super::limits::descriptors) counts.
const FILES: u64 = 128 + 2 * FILES_OF_A_WORKER;
const FILES_OF_A_WORKER: u64 = 32;

/// The flag for the number of simulator processes.
pub(super) const WORKERS: &str = "--workers";
/// The flag for the number of environments.
const ENVS: &str = "--envs";

/// Those of `flags` with which the run would do with `free` bytes of shared memory, each alone.
pub(super) fn fitting(
    config: &Config,
    dimensions: &Dimensions,
    gateways: usize,
    free: u64,
    flags: &[&str],
) -> Vec<String> {
    let fits = |config: &Config| {
        let sizes = ChannelSizes::new(config, &Dimensions::new(config, dimensions.joints));
        let budget = sizes.shared_memory(config.run.workers + gateways);
        budget.iter().map(|(_, bytes)| bytes).sum::<u64>() <= free
    };
    let with_workers = |workers: &usize| {
        let mut config = config.clone();
        config.run.workers = *workers;
        fits(&config)
    };
    let workers = (1..config.run.workers).rev().find(with_workers);
    // As `--envs` alone is taken: with as many shards as before, if that divides them.
    let with_envs = |n_envs: usize| {
        let mut config = config.clone();
        config.env.n_envs = n_envs;
        let most = config.env.n_shards.min(n_envs);
        config.env.n_shards =
            (1..=most).rev().find(|shards| n_envs.is_multiple_of(*shards)).unwrap_or(1);
        fits(&config)
    };
    let whole = |n_envs: usize| match n_envs / config.env.n_shards {
        0 => n_envs,
        envs_per_shard => envs_per_shard * config.env.n_shards,
    };
    let halves = std::iter::successors(Some(config.env.n_envs / 2), |n_envs| Some(n_envs / 2));
    let envs = halves
        .take_while(|n_envs| *n_envs > 0)
        .map(whole)
        .find(|n_envs| *n_envs < config.env.n_envs && with_envs(*n_envs));
    [(WORKERS, workers), (ENVS, envs)]
        .into_iter()
        .filter(|(flag, _)| flags.contains(flag))
        .filter_map(|(flag, number)| Some(format!("{flag} {}", number?)))
        .collect()
}

/// What helps where a process may open `limit` files and needs more.
pub(super) fn open_files(
    needed: u64,
    limit: u64,
    hard_limit: Option<u64>,
    flags: &[&str],
) -> String {
    let wanted = needed.next_power_of_two();
    let mut cures = vec![match hard_limit {
        Some(hard) if hard < needed => format!("`ulimit -n {wanted}` as root"),
        Some(hard) => format!("`ulimit -n {}`", wanted.min(hard)),
        None => format!("`ulimit -n {wanted}`"),
    }];
    let workers = limit.saturating_sub(FILES) / FILES_OF_A_WORKER;
    if workers > 0 && flags.contains(&WORKERS) {
        cures.push(format!("{WORKERS} {workers}"));
    }
    cures.join(", or ")
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;
    use crate::preflight::{Verdict, shared_memory};

    const BOTH: [&str; 2] = [WORKERS, ENVS];

    fn of(sets: &[&str]) -> (Config, Dimensions) {
        let layers = Layers::new(Preset::Tuned, None);
        let layers = sets.iter().try_fold(layers, |layers, set| layers.set(set));
        let config = layers.and_then(|layers| layers.resolve()).expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        (config, dimensions)
    }

    fn needed(config: &Config, dimensions: &Dimensions) -> u64 {
        let budget = ChannelSizes::new(config, dimensions).shared_memory(config.run.workers);
        budget.iter().map(|(_, bytes)| bytes).sum()
    }

    /// The flags of a remedy, in the words of the configuration.
    fn applied(sets: &[&str], remedy: &str) -> (Config, Dimensions) {
        let (flag, value) = remedy.split_once(' ').expect("a flag and its value");
        let key = if flag == "--envs" { "env.n_envs" } else { "run.workers" };
        let set = format!("{key}={value}");
        of(&[sets, &[&set]].concat())
    }

    #[test]
    fn every_remedy_is_enough() {
        let sets = ["run.workers=8", "env.n_envs=1000000", "env.n_shards=16"];
        let (config, dimensions) = of(&sets);
        let all = needed(&config, &dimensions);
        for free in [all - 1, all / 2, all / 1000] {
            let remedies = fitting(&config, &dimensions, 0, free, &BOTH);
            assert!(!remedies.is_empty(), "{free} of {all}");
            for remedy in &remedies {
                let (config, dimensions) = applied(&sets, remedy);
                assert!(needed(&config, &dimensions) <= free, "{remedy} for {free} of {all}");
            }
        }
        assert!(
            fitting(&config, &dimensions, 0, 1000, &BOTH).is_empty(),
            "nothing is small enough"
        );
    }

    /// It sends blocks as a worker does, and so has as much room for them.
    #[test]
    fn a_gateway_needs_what_a_worker_needs() {
        let fit = |workers: &str, gateways| {
            let (config, dimensions) = of(&[workers, "env.n_envs=1000000", "env.n_shards=16"]);
            let free = needed(&config, &dimensions) / 2;
            fitting(&config, &dimensions, gateways, free, &[WORKERS])
        };
        let [alone, open] = [0, 1].map(|gateways| fit("run.workers=8", gateways));
        let number = |fits: &[String]| fits[0].split(' ').nth(1)?.parse::<usize>().ok();
        let alone = number(&alone).expect("some fit");
        assert_eq!(number(&open), Some(alone - 1));
    }

    #[test]
    fn nothing_is_proposed_that_a_command_does_not_take() {
        let (config, dimensions) = of(&["run.workers=8", "env.n_envs=1000000", "env.n_shards=16"]);
        let free = needed(&config, &dimensions) / 2;
        for flags in [&BOTH[..], &[WORKERS], &[]] {
            let mut proposed = fitting(&config, &dimensions, 0, free, flags);
            let files = open_files(300, 256, Some(256), flags);
            proposed.extend(files.split(", or ").skip(1).map(str::to_owned));
            assert_eq!(proposed.is_empty(), flags.is_empty(), "{proposed:?}");
            let taken = |remedy: &String| flags.iter().any(|flag| remedy.starts_with(flag));
            assert!(proposed.iter().all(taken), "{proposed:?}");
        }
    }

    #[test]
    fn what_this_machine_cannot_hold_is_not_made_room_for() {
        let (config, dimensions) = of(&["env.n_envs=1000000", "env.n_shards=1"]);
        let check = shared_memory(&config, &dimensions, 0, &BOTH);
        assert_eq!(check.verdict, Verdict::Failure);
        let cure = check.cure.expect("there is one");
        assert!(!cure.contains("remount") && cure.contains("--envs "), "{cure}");
    }

    #[test]
    fn open_files_are_allowed_by_who_can() {
        let cure = |needed, limit, hard| open_files(needed, limit, Some(hard), &BOTH);
        assert_eq!(cure(256, 192, 4096), "`ulimit -n 256`");
        assert_eq!(cure(300, 256, 400), "`ulimit -n 400`, or --workers 2");
        assert_eq!(cure(300, 256, 256), "`ulimit -n 512` as root, or --workers 2");
    }
}
