//! The simulator as a Python module, `spaceoctopus._native`: batches of environments, policies, robots.
//!
//! The package around it is in `python/`: environments for PettingZoo and Gymnasium, types, and what else is more at home in Python.
//!
//! **Memory.** Arrays that a batch shows are NumPy's own. A step borrows them, by the checked borrows of the crate `numpy`, and fills
//! them in place, so nothing is copied and nothing here is unsafe.
//!
//! **Threads** live for one call, so that nothing is left to a process that forks. They hold no lock of Python's meanwhile. The caller's
//! own thread takes part, and looks for signals between two chunks of work (`threads`, `signals`).
//!
//! **Errors.** What is wrong with what was given is a `ValueError` or `TypeError` with the words of the command line; what is wrong with
//! when it was called a `RuntimeError`. No panic crosses the border (`errors::guarded`).
#![expect(
    clippy::needless_pass_by_value,
    reason = "arguments of functions that Python calls are values"
)]

mod batch;
mod checkpoint;
mod config;
mod directories;
mod errors;
mod labels;
mod manifest;
mod newest;
mod numbers;
mod policy;
mod postures;
mod robot;
mod signals;
mod simulate;
mod threads;

use pyo3::prelude::*;

/// The native part of `spaceoctopus`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<config::Config>()?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<postures::Postures>()?;
    module.add_class::<robot::Robot>()?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    Ok(())
}
