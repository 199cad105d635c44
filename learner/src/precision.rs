//! Which arithmetic the matrix products use.

use proto::config::Precision;
use tch::Kind;

use crate::LearnerError;

/// The arithmetic in force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arithmetic {
    /// Single precision throughout.
    F32,
    /// Products of bfloat16; parameters, sums outside products and moments in f32.
    Bf16,
}

impl Arithmetic {
    /// The one that a configuration names. `auto` is none: `octopus` decides it when a run begins, so that the run's
    /// `config.toml` says what it is trained with, on whatever machine it goes on.
    pub fn of(precision: Precision) -> Result<Self, LearnerError> {
        match precision {
            Precision::F32 => Ok(Self::F32),
            Precision::Bf16 => Ok(Self::Bf16),
            Precision::Auto => Err(LearnerError::Undecided),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learner_takes_what_is_decided_and_decides_nothing() {
        assert_eq!(Arithmetic::of(Precision::F32).ok(), Some(Arithmetic::F32));
        assert_eq!(Arithmetic::of(Precision::Bf16).ok(), Some(Arithmetic::Bf16));
        let error = Arithmetic::of(Precision::Auto).expect_err("nothing is decided");
        assert!(error.to_string().contains("`octopus resume`"), "{error}");
    }
}
