//! The module for Python, installed once a process.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use crate::guide::repository;
use crate::{program, python as tests_python, stderr};

/// Names a wheel that is tested instead of the module that was built with the tests: `make wheel-test`.
pub const WHEEL: &str = "SPACEOCTOPUS_WHEEL";

/// Python of a virtual environment that holds the module alone, and beside it what the tests' Python has.
pub fn python() -> &'static Path {
    static PYTHON: OnceLock<PathBuf> = OnceLock::new();
    PYTHON.get_or_init(|| {
        // Beside what was built, and made anew by every process.
        let octopus = program("octopus");
        let profile = octopus.parent().expect("target/<profile>/octopus");
        let venv = profile.join("python-module");
        match fs::remove_dir_all(&venv) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                panic!("{}: {error}", venv.display());
            }
            _ => {}
        }
        succeeds(Command::new(tests_python()).args(["-m", "venv", "--without-pip"]).arg(&venv));
        let python = venv.join("bin/python");
        let packages = packages_of(&python);
        match std::env::var_os(WHEEL) {
            Some(wheel) => install(&python, &PathBuf::from(wheel)),
            None => lay_out(&packages.join("spaceoctopus"), profile),
        }
        // Nothing is fetched: NumPy and the checkers are those of the tests' Python.
        let beside = packages_of(&tests_python());
        fs::write(packages.join("tests.pth"), beside.as_os_str().as_encoded_bytes())
            .expect("written");
        python
    })
}

/// Where a Python has its packages.
fn packages_of(python: &Path) -> PathBuf {
    let place = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let said = succeeds(Command::new(python).args(["-I", "-c", place])).stdout;
    String::from_utf8(said).expect("a path").trim().into()
}

/// Installs a wheel as a person does.
fn install(python: &Path, wheel: &Path) {
    let name = wheel.file_name().unwrap_or_default().to_string_lossy();
    assert!(name.contains("-cp310-abi3-"), "one wheel for every Python from 3.10 on: {name}");
    let mut pip = Command::new(tests_python());
    pip.args(["-m", "pip", "--python"]).arg(python);
    pip.args(["install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]);
    succeeds(pip.arg(wheel));
}

/// Puts the files together that the wheel holds.
fn lay_out(package: &Path, profile: &Path) {
    fs::create_dir(package).expect("a directory");
    let sources = repository().join("sim-worker/python/python/spaceoctopus");
    for entry in fs::read_dir(sources).expect("sources") {
        let path = entry.expect("a source").path();
        if path.is_file() {
            fs::copy(&path, package.join(path.file_name().expect("a name"))).expect("copied");
        }
    }
    let library = profile.join("deps/lib_native.so");
    fs::copy(&library, package.join("_native.abi3.so"))
        .unwrap_or_else(|error| panic!("{}: {error}", library.display()));
}

/// Runs a command to its end, which must be a good one.
///
/// # Panics
/// With all that it said, if it is not.
pub fn succeeds(command: &mut Command) -> Output {
    let output = command.stdin(Stdio::null()).output().expect("it can be started");
    assert!(
        output.status.success(),
        "{command:?}\n{}{}",
        String::from_utf8_lossy(&output.stdout),
        stderr(&output)
    );
    output
}
