//! `octopus clean`: removes what killed runs left in shared memory, and killed commands among the temporary files.
//!
//! A domain is dead when no coordinator holds its lock, which also one in another container does that
//! shares `/dev/shm` and no processes, and no process of this machine names it on its command line (as
//! workers, learner and janitor do) or maps its memory. What lies there under its name then belongs to
//! nobody. A directory among the temporary files is left over when nobody holds its lock, and nobody names it.

use anyhow::Context as _;
use channels::Domain;
use clap::Args;
use serde_json::json;
use store::scratch::{self, Leftover};

const CLEAN_EXAMPLES: &str = "\
Examples:
  octopus clean --dry-run
  octopus clean

A run that is killed is cleaned up after by its janitor; this is for what is left when that was \
killed, too, and for the temporary directories of killed commands (in TMPDIR, or else /tmp). What a \
living process uses is never touched.";

/// Options of `octopus clean`.
#[derive(Debug, Clone, Copy, Args)]
#[command(after_help = CLEAN_EXAMPLES)]
pub struct CleanArgs {
    /// Only say what would be removed.
    #[arg(long)]
    pub dry_run: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Cleans.
pub fn run(args: CleanArgs) -> anyhow::Result<()> {
    let domains = leftovers().context("/dev/shm cannot be searched")?;
    // Where it cannot be looked for them, the others go all the same.
    let (directories, unsearched) = match left_directories() {
        Ok(directories) => (directories, None),
        Err(error) => (Vec::new(), Some(error)),
    };
    let mut cleaned = Vec::new();
    for domain in domains {
        let removed = if args.dry_run {
            None
        } else {
            let removed = domain.remove_leftovers();
            Some(removed.with_context(|| format!("domain {} cannot be removed", domain.as_str()))?)
        };
        let words = match removed {
            // Its janitor, or another `octopus clean`, was faster.
            Some(0) => continue,
            Some(files) => {
                format!("removed {} ({})", domain.as_str(), output::counted(files as u64, "file"))
            }
            None => format!("would remove {}", domain.as_str()),
        };
        cleaned.push((words, json!({ "domain": domain.as_str(), "removed": removed })));
    }
    for directory in directories {
        let path = directory.path().to_owned();
        let (verb, removed) = if args.dry_run {
            ("would remove", None)
        } else {
            directory.remove().with_context(|| format!("{}: cannot be removed", path.display()))?;
            ("removed", Some(1))
        };
        let words = format!("{verb} {}", path.display());
        cleaned.push((words, json!({ "directory": path, "removed": removed })));
    }
    if args.json {
        output::json(&cleaned.iter().map(|(_, entry)| entry).collect::<Vec<_>>())?;
    } else if cleaned.is_empty() && unsearched.is_none() {
        output::line("nothing to remove")?;
    } else {
        cleaned.iter().try_for_each(|(words, _)| output::line(words))?;
    }
    unsearched.map_or(Ok(()), Err)
}

/// Temporary directories of this user's commands that no process uses. What a killed one had started may still
/// do, and names it.
fn left_directories() -> anyhow::Result<Vec<Leftover>> {
    let place = scratch::place();
    let mut found =
        scratch::leftovers().with_context(|| format!("{}: cannot be searched", place.display()))?;
    if !found.is_empty() {
        let traces = traces().context("/proc cannot be searched")?;
        found.retain(|leftover| {
            // Its name, which nothing else has: the way to it may be spelled otherwise.
            let name = leftover.path().file_name().unwrap_or_default().to_string_lossy();
            !traces.iter().any(|trace| trace.contains(&*name))
        });
    }
    Ok(found)
}

/// Domains of this user that no process belongs to.
pub fn leftovers() -> std::io::Result<Vec<Domain>> {
    // Listed before the processes: a run that starts in between is seen as alive.
    let domains = Domain::list()?;
    if domains.is_empty() {
        return Ok(domains);
    }
    let traces = traces()?;
    let alive = |domain: &Domain| {
        domain.is_held() || traces.iter().any(|trace| trace.contains(domain.as_str()))
    };
    Ok(domains.into_iter().filter(|domain| !alive(domain)).collect())
}

/// Command lines and memory maps of all processes. One that ends while it is read is as good as
/// dead; one that may not be read is another user's, and so are its domains.
fn traces() -> std::io::Result<Vec<String>> {
    let mut traces = Vec::new();
    for entry in std::fs::read_dir("/proc")? {
        let process = entry?.path();
        for file in ["cmdline", "maps"] {
            if let Ok(bytes) = std::fs::read(process.join(file)) {
                traces.push(String::from_utf8_lossy(&bytes).into_owned());
            }
        }
    }
    Ok(traces)
}

#[cfg(test)]
mod tests {
    use channels::{ChannelSizes, Channels};
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};
    use proto::layout::Dimensions;

    use super::*;

    #[test]
    fn what_a_process_uses_is_no_leftover_and_what_it_left_is() {
        let layers = Layers::new(Preset::Tuned, None).set("env.n_envs=16");
        let config = layers.and_then(|layers| layers.set("env.n_shards=4")?.resolve());
        let config = config.expect("valid");
        let sizes = ChannelSizes::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)));
        let domain = Domain::fresh();
        let channels = Channels::create(&domain, sizes).expect("shared memory");
        assert!(!leftovers().expect("searchable").contains(&domain), "it is in use");
        // As if the process had been killed: nobody maps the file any more.
        drop(channels);
        let stump = std::path::Path::new("/dev/shm").join(format!("{}_stump", domain.as_str()));
        std::fs::write(&stump, "left").expect("writable");
        assert!(leftovers().expect("searchable").contains(&domain), "nobody uses it");
        domain.remove_leftovers().expect("removable");
        assert!(!stump.exists());
    }
}
