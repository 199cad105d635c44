//! The presets: configurations that are built in.

use toml::{Table, Value};

use super::tables::parse;
use crate::ConfigError;

/// The built-in configurations, in `deploy/presets`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// The paper's robot with whatever learns fastest: agents know joint angles that bring the hand to its
    /// goal, and act beside them.
    Guided,
    /// The same with policies that find everything themselves.
    Tuned,
    /// The paper's text; where it is silent, the released code.
    Paper,
    /// The authors' released code.
    Release,
    /// Preset `guided`, trained with a robot whose sensors err, too.
    Robust,
}

impl Preset {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Guided, Self::Tuned, Self::Paper, Self::Release, Self::Robust];

    /// What is trained unless something else is said.
    pub const DEFAULT: Self = Self::Guided;

    /// The preset that this one only changes, if there is one.
    fn base(self) -> Option<Self> {
        match self {
            Self::Robust => Some(Self::Guided),
            Self::Guided => Some(Self::Tuned),
            Self::Tuned | Self::Paper | Self::Release => None,
        }
    }

    /// The preset of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.as_str() == name)
    }

    fn text(self) -> &'static str {
        match self {
            Self::Tuned => include_str!("../../../deploy/presets/tuned.toml"),
            Self::Paper => include_str!("../../../deploy/presets/paper.toml"),
            Self::Release => include_str!("../../../deploy/presets/release.toml"),
            Self::Robust => include_str!("../../../deploy/presets/robust.toml"),
            Self::Guided => include_str!("../../../deploy/presets/guided.toml"),
        }
    }

    /// The name as it is written on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Tuned => "tuned",
            Self::Paper => "paper",
            Self::Release => "release",
            Self::Robust => "robust",
            Self::Guided => "guided",
        }
    }

    /// Its table, with every key that exists, and its changes for a task or an algorithm.
    pub(super) fn tables(self) -> Result<(Table, Option<Value>), ConfigError> {
        let mut table = parse(self.text(), &self.origin())?;
        let mut above = self;
        while let Some(base) = above.base() {
            table = laid_over(parse(base.text(), &base.origin())?, table);
            above = base;
        }
        let conditional = table.remove("for");
        Ok((table, conditional))
    }

    /// Where values of it come from, as messages name it.
    pub(super) fn origin(self) -> String {
        format!("preset {}", self.as_str())
    }
}

/// `base`, with the values of `changes` where it has some.
fn laid_over(mut base: Table, changes: Table) -> Table {
    for (key, change) in changes {
        let value = match (base.remove(&key), change) {
            (Some(Value::Table(base)), Value::Table(changes)) => {
                Value::Table(laid_over(base, changes))
            }
            (_, change) => change,
        };
        base.insert(key, value);
    }
    base
}
