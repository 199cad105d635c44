//! Processors, their instructions, and memory.

use proto::config::{Config, Precision};
use proto::mib;
use store::provenance;

use super::check::Check;
use super::smaller;
use crate::precision;

/// Processors against the threads of a run.
pub fn processors(workers: usize, learner_threads: usize, flags: &[&str]) -> Check {
    const NAME: &str = "processors";
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let extensions = provenance::vector_extensions();
    let name = provenance::processor_name();
    let found = format!("{processors} of {name} ({})", extensions.join(", "));
    let mut crowd = Vec::new();
    let mut faster = Vec::new();
    if workers > processors {
        crowd.push(format!("{workers} workers"));
        if flags.contains(&smaller::WORKERS) {
            faster.push(format!("{} {processors}", smaller::WORKERS));
        }
    }
    if learner_threads > processors {
        crowd.push(format!("{learner_threads} learner threads"));
        faster.push(format!("a new run with --set run.learner_threads={processors}"));
    }
    if !crowd.is_empty() {
        let found = format!("{found}, shared by {}", crowd.join(" and by "));
        let cure = match faster.as_slice() {
            [] => "a machine with more processors is faster".to_owned(),
            some => format!("{} is faster", some.join(", ")),
        };
        return Check::warning(NAME, found, cure);
    }
    if cfg!(target_arch = "x86_64")
        && !(extensions.contains(&"avx2") && extensions.contains(&"fma"))
    {
        return Check::warning(
            NAME,
            format!("{found}; without AVX2 and FMA rollouts are several times slower"),
            "use a processor of 2013 or later",
        );
    }
    Check::good(NAME, found)
}

/// Whether a processor with these `instructions` has one for the products that are asked for. It computes them
/// without, all the same.
pub fn arithmetic(config: &Config, instructions: &[&str]) -> Check {
    const NAME: &str = "precision";
    let best = precision::decide(&config.run.device, instructions);
    let wanted = match config.run.precision {
        Precision::Auto => best,
        wanted => wanted,
    };
    if wanted == Precision::Bf16 && best == Precision::F32 {
        return Check::warning(
            NAME,
            "bf16, which this processor has no instructions for; libtorch computes it slowly by others, which may \
             round sums otherwise than where a run began",
            "a new run with --set run.precision=f32 is faster here",
        );
    }
    let name = precision::name(wanted);
    Check::good(
        NAME,
        match config.run.precision {
            Precision::Auto => format!("the learner multiplies in {name} unless told otherwise"),
            _ => name.to_owned(),
        },
    )
}

/// Memory of the machine.
pub fn memory() -> Check {
    const NAME: &str = "memory";
    let memory = provenance::memory();
    if memory < 2 << 30 {
        return Check::warning(
            NAME,
            mib(memory),
            "the default run needs about 2 GiB: `octopus train` with fewer --workers and --envs",
        );
    }
    Check::good(NAME, mib(memory))
}

#[cfg(test)]
mod tests {
    use super::super::check::Verdict;
    use super::super::tests::config;
    use super::*;

    #[test]
    fn a_precision_without_instructions_is_said_to_be_slow() {
        let verdict =
            |set: &str, instructions: &[&str]| arithmetic(&config(set), instructions).verdict;
        assert_eq!(verdict("run.precision=bf16", &["avx2"]), Verdict::Warning);
        for (set, instructions) in [
            ("run.precision=bf16", &["avx512_bf16"][..]),
            ("run.precision=f32", &["avx2"]),
            ("run.precision=auto", &["avx2"]),
        ] {
            assert_eq!(verdict(set, instructions), Verdict::Good, "{set}");
        }
    }
}
