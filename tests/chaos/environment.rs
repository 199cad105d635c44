//! Foreign environments: a run that is started from a shell with variables and limits of somebody else
//! ends with the bits of one that was left alone, or says which of them it cannot live with.

use anyhow::{Context as _, Result, bail, ensure};
use run::signals::StopRequests;

use super::Watch;
use super::dice::Dice;
use super::observe::{domain_of, iterations};
use super::verdict::{Report, Verdict};
use crate::{Run, assert_nothing_left};

/// Variables that a library of ours, the system's own or a shell may read.
const NAMES: &[&str] = &[
    "ATEN_CPU_CAPABILITY",
    "ATEN_NUM_THREADS",
    "C10_LOG_LEVEL",
    "CLICOLOR_FORCE",
    "COLUMNS",
    "CUBLAS_WORKSPACE_CONFIG",
    "CUDA_VISIBLE_DEVICES",
    "DNNL_DEFAULT_FPMATH_MODE",
    "DNNL_MAX_CPU_ISA",
    "DNNL_VERBOSE",
    "GLIBC_TUNABLES",
    "GOMP_CPU_AFFINITY",
    "GOMP_SPINCOUNT",
    "HOME",
    "IDEEP_CACHE_CAPACITY",
    "KMP_AFFINITY",
    "KMP_STACKSIZE",
    "LANG",
    "LC_ALL",
    "LD_BIND_NOW",
    "LRU_CACHE_CAPACITY",
    "MALLOC_ARENA_MAX",
    "MALLOC_PERTURB_",
    "MKLDNN_VERBOSE",
    "MKL_CBWR",
    "MKL_DYNAMIC",
    "MKL_NUM_THREADS",
    "NO_COLOR",
    "NVIDIA_TF32_OVERRIDE",
    "OMP_CANCELLATION",
    "OMP_DYNAMIC",
    "OMP_NUM_THREADS",
    "OMP_PROC_BIND",
    "OMP_SCHEDULE",
    "OMP_STACKSIZE",
    "OMP_THREAD_LIMIT",
    "ONEDNN_DEFAULT_FPMATH_MODE",
    "ONEDNN_MAX_CPU_ISA",
    "OPENBLAS_NUM_THREADS",
    "PYTORCH_NVML_BASED_CUDA_CHECK",
    "RUST_BACKTRACE",
    "RUST_LOG",
    "RUST_MIN_STACK",
    "SPACEOCTOPUS_TOKEN",
    "TERM",
    "TORCH_CPP_LOG_LEVEL",
    "TZ",
];
/// Good and bad values for any of them.
const VALUES: &[&str] = &[
    "",
    "0",
    "1",
    "-1",
    "3",
    "64",
    "1000000000000000000000",
    "TRUE",
    "false",
    "close",
    "dynamic,1",
    "BF16",
    "AVX2",
    "default",
    "garbage-7f3a",
    "tr_TR.UTF-8",
    "/nowhere/at all",
    "\u{1b}[2J",
    "a=b:c=d",
];
/// Limits, and what else a shell may have done.
const LIMITS: &[&str] = &[
    "ulimit -S -s 256",
    "ulimit -s 1024",
    "ulimit -S -s unlimited",
    "ulimit -n 1024",
    "ulimit -S -n 64",
    "ulimit -n 64",
    "ulimit -n 24",
    "ulimit -f 64",
    "ulimit -f 4096",
    "ulimit -c 0",
    "ulimit -l 0",
    "ulimit -i 64",
    "ulimit -q 0",
    "ulimit -e 0",
    "umask 0",
    "umask 077",
    "trap '' PIPE",
    "trap '' USR1 USR2 CHLD",
    "exec <&-",
    "cd /",
];
/// Iterations of every run.
const ITERATIONS: usize = 4;
const FLAGS: &[&str] = &["--workers=2", "--iterations=4", "--quiet"];

/// Variables with their values, and what a shell did before.
#[derive(Debug)]
struct Environment {
    variables: Vec<(&'static str, &'static str)>,
    limit: Option<&'static str>,
}

impl Environment {
    fn drawn(dice: &mut Dice) -> Self {
        let variables =
            (0..dice.between(0, 8)).map(|_| (dice.one_of(NAMES), dice.one_of(VALUES))).collect();
        let limit = (dice.between(0, 1) == 0).then(|| dice.one_of(LIMITS));
        Self { variables, limit }
    }

    /// Whether a message names one of its parts.
    fn is_named(&self, said: &str) -> bool {
        self.variables.iter().any(|(name, _)| said.contains(name))
            || self.limit.is_some_and(|limit| limit.contains("ulimit") && said.contains("ulimit"))
    }
}

/// Trains `times` times from environments that `seed` says.
pub fn run(
    times: usize,
    seed: u64,
    stop: &StopRequests,
    narrate: &mut dyn FnMut(&str),
) -> Result<Report> {
    let mut calm = Run::train(FLAGS);
    calm.succeed();
    let expected = calm.digests();
    ensure!(expected.len() == ITERATIONS, "{} iterations", expected.len());
    let mut report = Report::default();
    for time in 0..times {
        let environment = Environment::drawn(&mut Dice::of(seed, time as u32));
        let verdict = try_in(&environment, &expected, stop)
            .with_context(|| format!("environment {} of seed {seed}: {environment:?}", time + 1))?;
        report.count(verdict);
        narrate(&format!("{:3}/{times} {environment:?}: {verdict:?}", time + 1));
    }
    Ok(report)
}

/// How a run ends: with the bits that are expected, or refused in words.
fn try_in(environment: &Environment, expected: &[String], stop: &StopRequests) -> Result<Verdict> {
    let mut run = Run::with_variables(&environment.variables);
    if let Some(limit) = environment.limit {
        run.start_behind(&["bash", "-c", &format!("{limit} && exec \"$@\""), "bash"]);
    }
    run.start_training(FLAGS);
    let pid = run.pid();
    let mut domain = None;
    let mut watch = Watch::new(stop);
    let code = loop {
        domain = domain_of(&run, pid).or(domain);
        if let Some(code) = run.ended() {
            break code;
        }
        watch.pause(iterations(&run) as u64, &run)?;
    };
    if let Some(domain) = &domain {
        assert_nothing_left(domain);
    }
    let said = run.log();
    ensure!(!said.contains("panicked"), "it panicked:\n{said}");
    match code {
        Some(0) => {
            ensure!(run.digests() == expected, "other bits");
            ensure!(domain.is_some(), "its domain was never seen, so it was not checked");
            Ok(Verdict::Survived)
        }
        // A usage, a value or the machine; the message says of which variable or limit.
        Some(2..=4) => {
            ensure!(environment.is_named(&said), "nothing of it is named:\n{said}");
            Ok(Verdict::Refused)
        }
        code => bail!("it ended with {code:?}:\n{said}"),
    }
}
