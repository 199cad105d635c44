//! Links the learner to libtorch: the loader finds it where the build found it, and CUDA is not dropped.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=LIBTORCH");

    let Some(libtorch) = env::var_os("LIBTORCH").map(PathBuf::from) else {
        fail(
            "LIBTORCH is not set: build from within the repository, whose .cargo/config.toml sets it",
        );
    };
    let lib = libtorch.join("lib");
    // A set-up later on creates this file, and the build script runs again.
    println!("cargo:rerun-if-changed={}", lib.join("libtorch_cpu.so").display());
    if !lib.join("libtorch_cpu.so").exists() {
        fail(&format!("no libtorch in {}: run `make setup`", libtorch.display()));
    }
    let lib = match lib.canonicalize() {
        Ok(lib) => lib,
        Err(error) => fail(&format!("{}: {error}", lib.display())),
    };

    // Programs, tests, examples and benchmarks of this package start without LD_LIBRARY_PATH.
    println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());

    if env::var_os("CARGO_FEATURE_CUDA").is_some() {
        if !lib.join("libtorch_cuda.so").exists() {
            fail(&format!(
                "feature `cuda` needs libtorch_cuda.so, and {} has none: run `deploy/setup.py --device cuda`",
                lib.display()
            ));
        }
        // Nothing refers to a symbol of libtorch_cuda.so. Without these flags the linker drops it, and with it, silently, CUDA.
        for argument in [
            format!("-L{}", lib.display()),
            "-Wl,--no-as-needed".into(),
            "-ltorch".into(),
            "-ltorch_cuda".into(),
        ] {
            println!("cargo:rustc-link-arg={argument}");
        }
        println!("cargo:rustc-link-arg=-Wl,--as-needed");
    } else if lib.join("libtorch_cuda.so").exists() {
        println!(
            "cargo::warning={} has CUDA, this build leaves it out; add `--features learner/cuda` to use the GPU",
            libtorch.display()
        );
    }
}

/// Ends the build with one sentence instead of a panic and its back-trace.
#[expect(clippy::exit, reason = "a build script fails by its exit status")]
fn fail(message: &str) -> ! {
    println!("cargo::error={message}");
    std::process::exit(1)
}
