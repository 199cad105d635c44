//! What a core of this processor cannot exceed, whatever is measured.

use std::path::Path;

use store::provenance;

/// Highest clock of any processor that is sold (Hz), for machines that do not tell theirs: virtual ones mostly. A bound is
/// better too high than wrong.
const FASTEST: f64 = 6.2e9;

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
        // No x86 core has more than two ports for fused multiply-adds.
        const PORTS: f64 = 2.0;
        let has = |name: &str| self.instructions.contains(&name);
        // AVX2, or four ports of 128 bits each, as other architectures have them.
        let lanes = if has("avx512f") { 16.0 } else { 8.0 };
        let single = PORTS * lanes * 2.0;
        let per_cycle = if bf16 && has("amx_bf16") {
            // A product of tiles, 16 × 16 × 32, takes 16 cycles.
            1024.0
        } else if bf16 {
            // Pairs in the place of numbers; where there are no instructions for them less.
            2.0 * single
        } else {
            single
        };
        per_cycle * self.clock
    }
}

/// The highest clock that the kernel names for any core (Hz).
fn clock(processors: &Path) -> f64 {
    let entries = std::fs::read_dir(processors).into_iter().flatten().flatten();
    let khz = entries.filter_map(|entry| {
        let text = std::fs::read_to_string(entry.path().join("cpufreq/cpuinfo_max_freq")).ok()?;
        text.trim().parse::<f64>().ok()
    });
    let highest = khz.fold(0.0, f64::max);
    if highest > 0.0 { 1e3 * highest } else { FASTEST }
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
    }

    #[test]
    fn the_fastest_core_counts_and_one_that_is_not_told_is_the_fastest_there_is() {
        let dir = tempfile::tempdir().expect("a directory");
        assert_eq!(clock(dir.path()), FASTEST);
        for (core, khz) in [("cpu0", "3700000\n"), ("cpu1", "4100000\n"), ("cpuidle", "none")] {
            let place = dir.path().join(core).join("cpufreq");
            std::fs::create_dir_all(&place).expect("writable");
            std::fs::write(place.join("cpuinfo_max_freq"), khz).expect("writable");
        }
        assert_eq!(clock(dir.path()), 4.1e9);
    }
}
