//! Which arithmetic the matrix products use.

use std::time::Instant;

use proto::config::Precision;
use tch::{Device, Kind, Tensor};

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
    /// bf16 if the processor (or the GPU) multiplies it natively and a measurement finds it faster.
    ///
    /// The run's state records the choice, and a resume keeps it: a machine that is busy at the wrong moment may choose otherwise, but never midway. Before there
    /// is a state, the coordinator tells a learner that takes another's place what that one chose.
    pub fn choose(wanted: Precision, resumed: Option<Self>, device: Device) -> Self {
        match (wanted, resumed) {
            (Precision::Auto, Some(resumed)) => resumed,
            (Precision::Auto, None)
                if (device.is_cuda() || has_native_bf16()) && bf16_is_faster(device) =>
            {
                Self::Bf16
            }
            (Precision::Bf16, _) => Self::Bf16,
            (Precision::F32 | Precision::Auto, _) => Self::F32,
        }
    }

    /// By its name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::F32, Self::Bf16].into_iter().find(|arithmetic| arithmetic.as_str() == name)
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

/// How much faster a product must be for its loss of digits.
const WORTHWHILE: f64 = 1.2;

/// Whether products of a hidden layer's size are clearly faster in bf16; takes some 20 ms.
fn bf16_is_faster(device: Device) -> bool {
    let seconds = |kind: Kind| {
        let samples = Tensor::ones([400, 512], (kind, device));
        let weights = Tensor::ones([512, 512], (kind, device));
        // The first one also compiles the kernel.
        let times = (0..6).map(|_| {
            let start = Instant::now();
            // Reading a number waits for a GPU.
            let _ = samples.mm(&weights).double_value(&[0, 0]);
            start.elapsed().as_secs_f64()
        });
        times.fold(f64::INFINITY, f64::min)
    };
    let (f32, bf16) = (seconds(Kind::Float), seconds(Kind::BFloat16));
    tracing::info!(
        "products of 400 × 512 × 512: {:.0} µs in f32, {:.0} in bf16",
        1e6 * f32,
        1e6 * bf16
    );
    f32 > WORTHWHILE * bf16
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
    use super::*;

    #[test]
    fn the_configuration_wins_then_the_resumed_state() {
        let choose = |wanted, resumed| Arithmetic::choose(wanted, resumed, Device::Cpu);
        assert_eq!(choose(Precision::F32, Some(Arithmetic::Bf16)), Arithmetic::F32);
        assert_eq!(choose(Precision::Auto, Some(Arithmetic::F32)), Arithmetic::F32);
        assert_eq!(choose(Precision::Auto, Some(Arithmetic::Bf16)), Arithmetic::Bf16);
    }
}
