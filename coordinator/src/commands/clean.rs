//! `octopus clean`: removes what killed runs left in shared memory.
//!
//! A run's processes have its domain on their command line, except for the coordinator, which
//! has the janitor beside it for as long as it lives. So a domain that no process of this machine
//! names is dead, and what lies there under its name belongs to nobody.

use anyhow::Context as _;
use proto::channel::Domain;
use serde_json::json;

use crate::cli::CleanArgs;
use crate::output;

/// Cleans.
pub fn run(args: CleanArgs) -> anyhow::Result<()> {
    let mut cleaned = Vec::new();
    for domain in leftovers().context("/dev/shm and /tmp cannot be searched")? {
        let removed = if args.dry_run {
            None
        } else {
            let removed = domain.remove_leftovers();
            Some(removed.with_context(|| format!("domain {} cannot be removed", domain.as_str()))?)
        };
        cleaned.push((domain, removed));
    }
    if args.json {
        let entries = cleaned
            .iter()
            .map(|(domain, removed)| json!({ "domain": domain.as_str(), "removed": removed }));
        return output::json(&entries.collect::<Vec<_>>());
    }
    if cleaned.is_empty() {
        return output::line("nothing to remove");
    }
    for (domain, removed) in cleaned {
        output::line(&match removed {
            Some(files) => format!("removed {} ({files} files)", domain.as_str()),
            None => format!("would remove {}", domain.as_str()),
        })?;
    }
    Ok(())
}

/// Domains of this user that no process belongs to.
pub fn leftovers() -> std::io::Result<Vec<Domain>> {
    // Listed before the processes: a run that starts in between is seen as alive.
    let domains = Domain::list()?;
    if domains.is_empty() {
        return Ok(domains);
    }
    let command_lines = command_lines()?;
    let alive = |domain: &Domain| command_lines.iter().any(|line| line.contains(domain.as_str()));
    Ok(domains.into_iter().filter(|domain| !alive(domain)).collect())
}

/// Command lines of all processes. One that ends while it is read is as good as dead.
fn command_lines() -> std::io::Result<Vec<String>> {
    let mut lines = Vec::new();
    for entry in std::fs::read_dir("/proc")? {
        let Ok(bytes) = std::fs::read(entry?.path().join("cmdline")) else { continue };
        lines.push(String::from_utf8_lossy(&bytes).into_owned());
    }
    Ok(lines)
}
