//! Values that have names: an enumeration of another crate as the command line takes it.
//!
//! The enumeration exists once, where it means something. Here it gets only what a person reads of it.

use clap::ValueEnum;
use clap::builder::PossibleValue;

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
