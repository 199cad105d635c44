//! The environment of a run's processes.
//!
//! What learner and workers compute shall depend on nothing but their input, and what the numerical
//! libraries read from the environment changes which kernels they choose, how many threads they take,
//! or ends them where they cannot read it. So their variables are removed, by the prefixes that they
//! reserve, and what the promise of equal bits needs is set. Secrets are for the coordinator alone.

use std::ffi::OsStr;
use std::process::Command;

use service::http::TOKEN_VARIABLE;

/// Prefixes of variables that the libraries of the learner read: libtorch, MKL, OpenBLAS, oneDNN by its
/// names of all times, both kinds of OpenMP, and CUDA's where they choose the arithmetic. Which GPUs there
/// are (`CUDA_`, `NVIDIA_VISIBLE_DEVICES`) stays a matter of the machine.
const FOREIGN_PREFIXES: [&str; 17] = [
    "ATEN_",
    "C10_",
    "CUBLAS_",
    "DNNL_",
    "GOMP_",
    "IDEEP_",
    "KMP_",
    "LIBOMP_",
    "LRU_CACHE_",
    "MKLDNN_",
    "MKL_",
    "NVIDIA_TF32_",
    "OMP_",
    "ONEDNN_",
    "OPENBLAS_",
    "PYTORCH_",
    "TORCH_",
];

/// Other variables that change what a process computes or whether it lives. The first chooses variants
/// of the C library's functions, the second how deep a thread of ours may call.
const FOREIGN: [&str; 2] = ["GLIBC_TUNABLES", "RUST_MIN_STACK"];

/// Whether a child shall not see the variable.
fn is_removed(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name == TOKEN_VARIABLE.as_bytes()
        || FOREIGN.iter().any(|foreign| name == foreign.as_bytes())
        || FOREIGN_PREFIXES.iter().any(|prefix| name.starts_with(prefix.as_bytes()))
}

/// Takes from a child what is not for it. Call it before anything is set.
pub fn clean(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        if is_removed(&name) {
            command.env_remove(name);
        }
    }
}

/// Gives a learner the environment in which what it computes depends on nothing but its input.
pub fn set_numerical(command: &mut Command, threads: usize) {
    clean(command);
    let threads = threads.to_string();
    for (variable, value) in [
        ("OMP_NUM_THREADS", threads.as_str()),
        ("MKL_NUM_THREADS", &threads),
        // The libraries shall not choose another number by themselves.
        ("OMP_DYNAMIC", "FALSE"),
        ("MKL_DYNAMIC", "FALSE"),
        // Products that do not depend on how their operands happen to be aligned.
        ("MKL_CBWR", "AUTO,STRICT"),
    ] {
        command.env(variable, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_libraries_read_is_removed_and_what_people_need_stays() {
        let removed = [
            "OMP_CANCELLATION",
            "OMP_STACKSIZE",
            "KMP_AFFINITY",
            "GOMP_SPINCOUNT",
            "MKL_DEBUG_CPU_TYPE",
            "DNNL_VERBOSE",
            "ONEDNN_JIT_DUMP",
            "MKLDNN_VERBOSE",
            "IDEEP_CACHE_CAPACITY",
            "LRU_CACHE_CAPACITY",
            "ATEN_CPU_CAPABILITY",
            "TORCH_SHOW_CPP_STACKTRACES",
            "PYTORCH_CUDA_ALLOC_CONF",
            "C10_LOG_LEVEL",
            "OPENBLAS_NUM_THREADS",
            "NVIDIA_TF32_OVERRIDE",
            "CUBLAS_WORKSPACE_CONFIG",
            "GLIBC_TUNABLES",
            "RUST_MIN_STACK",
            TOKEN_VARIABLE,
        ];
        for name in removed {
            assert!(is_removed(OsStr::new(name)), "{name}");
        }
        for name in [
            "PATH",
            "HOME",
            "LD_LIBRARY_PATH",
            "LD_PRELOAD",
            "RUST_LOG",
            "CUDA_VISIBLE_DEVICES",
            "NVIDIA_VISIBLE_DEVICES",
        ] {
            assert!(!is_removed(OsStr::new(name)), "{name}");
        }
    }
}
