//! Writes what the guide has from the program: `make guide`.

use anyhow::{Context as _, Result};
use tests::worked_example::Example;

fn main() -> Result<()> {
    let path = tests::reference::path();
    let page = tests::reference::page()?;
    std::fs::write(&path, page).with_context(|| path.display().to_string())?;
    Example::compute()?.write()
}
