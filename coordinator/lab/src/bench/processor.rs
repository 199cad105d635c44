//! What a core of this processor cannot exceed, whatever is measured.

use std::path::Path;

use store::provenance;

/// Highest clock of any processor that is sold (Hz), for machines that do not tell theirs: virtual ones mostly. A bound is
/// better too high than wrong.
const FASTEST: f64 = 6.2e9;

/// Drivers whose highest clock is that of the boost, by the beginnings of their names.
const BOOST_TOLD: [&str; 4] = ["intel_pstate", "intel_cpufreq", "amd-pstate", "amd_pstate"];

/// What bounds products.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Processor {
    instructions: Vec<&'static str>,
    /// Highest clock (Hz).
    clock: f64,
}

impl Processor {
    /// That of this machine.
    pub(super) fn here() -> Self {
        Self {
            instructions: provenance::vector_extensions(),
            clock: clock(Path::new("/sys/devices/system/cpu")),
        }
    }

    /// Floating-point operations a second of one core: ports × lanes × multiplication and addition × clock.
    pub(super) fn peak(&self, bf16: bool) -> f64 {
        if bf16 && self.instructions.contains(&"amx_bf16") {
            // A product of tiles, 16 × 16 × 32, takes 16 cycles.
            return 1024.0 * self.clock;
        }
        // Pairs in the place of numbers; where there are no instructions for them less.
        if bf16 { self.pair_peak() } else { self.single_per_cycle() * self.clock }
    }

    /// The same of products of bfloat16 pairs in vectors.
    pub(super) fn pair_peak(&self) -> f64 {
        2.0 * self.single_per_cycle() * self.clock
    }

    fn single_per_cycle(&self) -> f64 {
        // No x86 core has more than two ports for fused multiply-adds.
        const PORTS: f64 = 2.0;
        // AVX2, or four ports of 128 bits each, as other architectures have them.
        let lanes = if self.instructions.contains(&"avx512f") { 16.0 } else { 8.0 };
        PORTS * lanes * 2.0
    }
}

/// The highest clock that the kernel names for any core (Hz), if it is the highest: of some drivers it is the one without boost.
fn clock(processors: &Path) -> f64 {
    let read = |path: &Path| std::fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let never_boosts = read(&processors.join("cpufreq/boost")) == "0";
    let entries = std::fs::read_dir(processors).into_iter().flatten().flatten();
    let hz = entries.filter_map(|entry| {
        let of_core = entry.path().join("cpufreq");
        let khz = read(&of_core.join("cpuinfo_max_freq")).parse::<f64>().ok()?;
        let driver = read(&of_core.join("scaling_driver"));
        let tells_boost = BOOST_TOLD.iter().any(|name| driver.starts_with(name));
        Some(if tells_boost || never_boosts { 1e3 * khz } else { FASTEST })
    });
    let highest = hz.fold(0.0, f64::max);
    if highest > 0.0 { highest } else { FASTEST }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_are_those_of_the_manuals() {
        let peak = |instructions: &[&'static str], bf16| {
            Processor { instructions: instructions.to_vec(), clock: 1e9 }.peak(bf16) * 1e-9
        };
        // Operations a cycle and core.
        assert_eq!(peak(&["avx2", "fma"], false), 32.0);
        assert_eq!(peak(&["avx2", "fma", "avx512f"], false), 64.0);
        assert_eq!(peak(&["avx2", "fma", "avx512f", "avx512_bf16"], true), 128.0);
        assert_eq!(peak(&["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"], true), 1024.0);
        assert_eq!(peak(&["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"], false), 64.0);
        let tiles = Processor { instructions: vec!["avx512f", "amx_bf16"], clock: 1.0 };
        assert_eq!(tiles.pair_peak(), 128.0, "tiles are not what multiplies pairs");
    }

    #[test]
    fn the_fastest_core_counts_and_one_that_is_not_told_is_the_fastest_there_is() {
        let dir = tempfile::tempdir().expect("a directory");
        assert_eq!(clock(dir.path()), FASTEST);
        let write = |name: &str, text: &str| {
            let path = dir.path().join(name);
            std::fs::create_dir_all(path.parent().expect("below")).expect("writable");
            std::fs::write(path, text).expect("writable");
        };
        for (core, khz) in [("cpu0", "3700000\n"), ("cpu1", "4100000\n"), ("cpuidle", "none")] {
            write(&format!("{core}/cpufreq/cpuinfo_max_freq"), khz);
            write(&format!("{core}/cpufreq/scaling_driver"), "intel_pstate\n");
        }
        assert_eq!(clock(dir.path()), 4.1e9);
        // Of this driver it is the clock without boost, unless there is none.
        write("cpu0/cpufreq/scaling_driver", "acpi-cpufreq\n");
        assert_eq!(clock(dir.path()), FASTEST);
        write("cpufreq/boost", "1\n");
        assert_eq!(clock(dir.path()), FASTEST);
        write("cpufreq/boost", "0\n");
        assert_eq!(clock(dir.path()), 4.1e9);
    }
}
