//! What `run.precision = "auto"` means: decided by what the processor is.
//!
//! The choice changes bits, so it must not depend on a clock: a measurement on a busy machine would give the
//! same command other bits the next time. It follows from the device and the instructions that
//! [`provenance`] records, is made once, when a run begins, and stands in the run's `config.toml` from
//! then on, which never says `auto`.

use proto::config::{Config, Precision};
use store::provenance;

/// The first row of which the processor has all instructions decides.
///
/// Measured with libtorch's products, which ours have replaced since (`learner/src/product`). AVX-512 BF16: on a Zen 4 libtorch multiplies at 423 GFLOP/s in bf16
/// and 187 in f32, and the update of preset `paper` does 2,190 instead of 956 env-steps/s (BENCHMARKS.md, "Speed"); both learn alike. AMX: on a Xeon 5,840
/// instead of 3,350 with preset `tuned`, on two threads ("With a GPU"); with its tiles hidden it does 2,670 in bf16, which the second row takes all the
/// same, as it cannot tell a Zen 4 from that. Without such instructions bf16 is converted to f32 before it is multiplied: on a Xeon of that kind the update of preset
/// `guided` does 3,700 to 4,400 in bf16 and 6,800 to 9,300 in f32 ("The default preset").
const TABLE: [(&[&str], Precision); 3] = [
    (&["avx512_bf16", "amx_bf16"], Precision::Bf16),
    (&["avx512_bf16"], Precision::Bf16),
    (&[], Precision::F32),
];

/// What `auto` means on `device` of a machine whose processor has these `instructions`.
pub fn decide(device: &str, instructions: &[&str]) -> Precision {
    if device != "cpu" {
        // Every GPU that libtorch's present builds for CUDA support well multiplies bf16 on units of their own;
        // for an older one there is run.precision=f32.
        return Precision::Bf16;
    }
    let row = TABLE.iter().find(|(needed, _)| needed.iter().all(|one| instructions.contains(one)));
    row.map_or(Precision::F32, |(_, precision)| *precision)
}

/// The configuration of a run that begins here: with `auto` decided.
#[must_use]
pub fn resolve(mut config: Config) -> Config {
    if config.run.precision == Precision::Auto {
        config.run.precision = decide(&config.run.device, &provenance::vector_extensions());
    }
    config
}

/// Its name in configurations and messages.
pub fn name(precision: Precision) -> &'static str {
    match precision {
        Precision::Auto => "auto",
        Precision::F32 => "f32",
        Precision::Bf16 => "bf16",
    }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    fn config(set: &str) -> Config {
        let layers = Layers::new(Preset::Tuned, None).set(set).expect("valid");
        layers.resolve().expect("valid")
    }

    #[test]
    fn the_processors_instructions_decide() {
        for (processor, instructions, expected) in [
            ("none known", &[][..], Precision::F32),
            ("Haswell", &["avx2", "fma"], Precision::F32),
            ("Skylake-SP", &["avx2", "fma", "avx512f"], Precision::F32),
            ("Cooper Lake, Zen 4", &["avx2", "fma", "avx512f", "avx512_bf16"], Precision::Bf16),
            (
                "Sapphire Rapids",
                &["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"],
                Precision::Bf16,
            ),
            // libtorch uses the tiles only where it finds the rest, too.
            ("tiles alone", &["avx2", "fma", "avx512f", "amx_bf16"], Precision::F32),
        ] {
            assert_eq!(decide("cpu", instructions), expected, "{processor}");
            assert_eq!(decide("cuda:0", instructions), Precision::Bf16, "{processor} and a GPU");
        }
    }

    #[test]
    fn a_run_begins_with_a_decision_and_keeps_what_was_asked_for() {
        let auto = resolve(config("run.precision=auto"));
        assert_ne!(auto.run.precision, Precision::Auto);
        assert_eq!(resolve(auto.clone()), auto);
        for wanted in ["f32", "bf16"] {
            let config = resolve(config(&format!("run.precision={wanted}")));
            assert_eq!(name(config.run.precision), wanted);
        }
    }

    /// The kernel's names, which the table uses, against the processor's own word.
    #[cfg(target_arch = "x86_64")]
    #[test]
    fn the_kernel_and_the_processor_name_the_same_instructions() {
        use std::arch::is_x86_feature_detected as has;
        let named = provenance::vector_extensions();
        for (name, there) in [
            ("avx2", has!("avx2")),
            ("fma", has!("fma")),
            ("avx512f", has!("avx512f")),
            ("avx512_bf16", has!("avx512bf16")),
        ] {
            assert_eq!(named.contains(&name), there, "{name}");
        }
    }
}
