//! Which arithmetic the matrix products use.

use proto::config::Precision;
use tch::Kind;

/// The arithmetic in force, once `auto` is decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arithmetic {
    /// Single precision throughout.
    F32,
    /// Products of bfloat16; parameters, sums outside products and moments in f32.
    Bf16,
}

impl Arithmetic {
    /// Decides: what the configuration asks for, else what a resumed state was trained with, else
    /// bf16 if the processor (or the GPU) multiplies it natively.
    pub fn choose(wanted: Precision, resumed: Option<Self>, device: tch::Device) -> Self {
        match (wanted, resumed) {
            (Precision::Auto, Some(resumed)) => resumed,
            (Precision::Auto, None) if device.is_cuda() || has_native_bf16() => Self::Bf16,
            (Precision::Bf16, _) => Self::Bf16,
            (Precision::F32 | Precision::Auto, _) => Self::F32,
        }
    }

    /// Its name in configurations and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }

    /// libtorch's name.
    pub fn kind(self) -> Kind {
        match self {
            Self::F32 => Kind::Float,
            Self::Bf16 => Kind::BFloat16,
        }
    }
}

/// Whether the processor has AVX-512 BF16.
#[cfg(target_arch = "x86_64")]
fn has_native_bf16() -> bool {
    std::arch::is_x86_feature_detected!("avx512bf16")
}

/// Other processors are not known to.
#[cfg(not(target_arch = "x86_64"))]
fn has_native_bf16() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn the_configuration_wins_then_the_resumed_state() {
        let choose = |wanted, resumed| Arithmetic::choose(wanted, resumed, Device::Cpu);
        assert_eq!(choose(Precision::F32, Some(Arithmetic::Bf16)), Arithmetic::F32);
        assert_eq!(choose(Precision::Auto, Some(Arithmetic::F32)), Arithmetic::F32);
        assert_eq!(choose(Precision::Auto, Some(Arithmetic::Bf16)), Arithmetic::Bf16);
    }
}
