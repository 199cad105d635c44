//! Values that have names: an enumeration of another crate as the command line takes it.
//!
//! The enumeration exists once, where it means something. Here it gets only what a person reads of it.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use lab::identity::ControllerName;
use proto::config::{AlgorithmName, Preset, TaskName};
use simulator::simulate::Precision;
use simulator::step::Integrator;

/// An enumeration whose values the command line takes by their names.
pub trait Names: Copy + 'static {
    /// All values, in the order of the help.
    const ALL: &'static [Named<Self>];

    /// As it is written.
    fn name(self) -> &'static str;

    /// What the help says of it.
    fn help(self) -> &'static str;
}

/// A value that is taken by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Named<T>(pub T);

impl<T: Names> ValueEnum for Named<T> {
    fn value_variants<'a>() -> &'a [Self] {
        T::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()).help(self.0.help()))
    }
}

impl Names for TaskName {
    const ALL: &'static [Named<Self>] = &{
        let mut all = [Named(Self::ALL[0]); Self::ALL.len()];
        let mut index = 0;
        while index < all.len() {
            all[index] = Named(Self::ALL[index]);
            index += 1;
        }
        all
    };

    fn name(self) -> &'static str {
        self.as_str()
    }

    fn help(self) -> &'static str {
        self.definition().about()
    }
}

impl Names for ControllerName {
    const ALL: &'static [Named<Self>] = &[Named(Self::Jacobian), Named(Self::Postures)];

    fn name(self) -> &'static str {
        self.as_str()
    }

    fn help(self) -> &'static str {
        self.about()
    }
}

impl Names for Preset {
    const ALL: &'static [Named<Self>] = &[
        Named(Self::Guided),
        Named(Self::Tuned),
        Named(Self::Paper),
        Named(Self::Release),
        Named(Self::Robust),
    ];

    fn name(self) -> &'static str {
        self.as_str()
    }

    fn help(self) -> &'static str {
        match self {
            Self::Guided => {
                "The paper's robot with whatever learns fastest: agents know a way to their goals"
            }
            Self::Tuned => "The same with policies that find everything themselves",
            Self::Paper => "The paper's text; where it is silent, the released code",
            Self::Release => "The authors' released code",
            Self::Robust => "Preset `guided`, trained with a robot whose sensors err, too",
        }
    }
}

impl Names for AlgorithmName {
    const ALL: &'static [Named<Self>] =
        &[Named(Self::Mappo), Named(Self::Ippo), Named(Self::Ppo), Named(Self::Maddpg)];

    fn name(self) -> &'static str {
        self.as_str()
    }

    fn help(self) -> &'static str {
        match self {
            Self::Mappo => {
                "An actor for each agent, or for all of one role; critics see everything"
            }
            Self::Ippo => "Likewise, but each critic sees what its agent sees",
            Self::Ppo => "One actor and one critic for all agents together",
            Self::Maddpg => {
                "Deterministic actors, critics that see everything and all actions, a replay"
            }
        }
    }
}

impl Names for Precision {
    const ALL: &'static [Named<Self>] = &[Named(Self::F32), Named(Self::F64)];

    fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::F32 => "Single precision, as training computes",
            Self::F64 => "Double precision",
        }
    }
}

impl Names for Integrator {
    const ALL: &'static [Named<Self>] = &[Named(Self::Rk4), Named(Self::Rk3), Named(Self::Euler)];

    fn name(self) -> &'static str {
        match self {
            Self::Rk4 => "rk4",
            Self::Rk3 => "rk3",
            Self::Euler => "euler",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::Rk4 => "Classical Runge and Kutta",
            Self::Rk3 => "Runge–Kutta of third order, as training integrates",
            Self::Euler => "Semi-implicit Euler, as the robot's authors do",
        }
    }
}
