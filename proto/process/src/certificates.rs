//! Which hosts have certificates.

use std::path::Path;

use proto::certificates::host_of;

/// Names of the hosts whose certificates lie in the directory `path`, in order.
pub fn hosts(path: &Path) -> std::io::Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(path)? {
        // What is no text is no name.
        names.extend(entry?.file_name().to_str().and_then(host_of).map(str::to_owned));
    }
    names.sort();
    Ok(names)
}
