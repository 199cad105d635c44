//! The wheel of the module for Python, built and installed once a process.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use crate::guide::repository;
use crate::{program, python as tests_python, stderr};

/// Python of a virtual environment that holds the wheel, and beside it what the tests' Python has.
pub fn python() -> &'static Path {
    static PYTHON: OnceLock<PathBuf> = OnceLock::new();
    PYTHON.get_or_init(|| {
        // Beside what was built: it is as large, and made anew by every process.
        let dir = target().join("tmp/wheel");
        match std::fs::remove_dir_all(&dir) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                panic!("{}: {error}", dir.display())
            }
            _ => std::fs::create_dir_all(&dir).expect("a directory"),
        }
        install(&build(&dir), &dir)
    })
}

/// Where cargo builds.
fn target() -> PathBuf {
    let octopus = program("octopus");
    let target = octopus.parent().and_then(Path::parent).expect("target/<profile>/octopus");
    target.to_owned()
}

/// The wheel, built as the other programs were and into the same place, so that little is left to do.
fn build(dir: &Path) -> PathBuf {
    let root = repository();
    let maturin = root.join(".venv-wheel/bin/maturin");
    assert!(maturin.is_file(), "{} is missing: run `make test`", maturin.display());
    let wheels = dir.join("wheels");
    let mut build = Command::new(maturin);
    build.args(["build", "--quiet", "--locked", "--profile"]);
    build.arg(if cfg!(debug_assertions) { "dev" } else { "release" });
    build.arg("--manifest-path").arg(root.join("sim-worker/python/Cargo.toml"));
    build.arg("--target-dir").arg(target()).arg("--out").arg(&wheels);
    succeeds(build.current_dir(root));
    let built = std::fs::read_dir(wheels).expect("wheels");
    let built: Vec<_> = built.map(|entry| entry.expect("a wheel").path()).collect();
    let [wheel] = built.as_slice() else { panic!("one wheel, not {built:?}") };
    let name = wheel.file_name().unwrap_or_default().to_string_lossy();
    assert!(name.contains("-cp310-abi3-"), "one wheel for every Python from 3.10 on: {name}");
    wheel.clone()
}

/// Installs it into an empty virtual environment, and fetches nothing: NumPy and the checkers are those of the tests' Python.
fn install(wheel: &Path, dir: &Path) -> PathBuf {
    let venv = dir.join("venv");
    succeeds(Command::new(tests_python()).args(["-m", "venv", "--without-pip"]).arg(&venv));
    let python = venv.join("bin/python");
    let mut install = Command::new(tests_python());
    install.args(["-m", "pip", "--python"]).arg(&python);
    install.args(["install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]);
    succeeds(install.arg(wheel));
    let place = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let place_of = |python: &Path| {
        let said = succeeds(Command::new(python).args(["-c", place])).stdout;
        String::from_utf8(said).expect("a path").trim().to_owned()
    };
    let beside = Path::new(&place_of(&python)).join("tests.pth");
    std::fs::write(beside, place_of(&tests_python())).expect("written");
    python
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
