//! The presets: configurations that are built in.

use toml::{Table, Value};

use super::tables::parse;
use crate::ConfigError;

/// The built-in configurations, in `deploy/presets`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// The paper's robot, tasks and measures with whatever learns them fastest.
    Tuned,
    /// The paper's text; where it is silent, the released code.
    Paper,
    /// The authors' released code.
    Release,
}

impl Preset {
    fn text(self) -> &'static str {
        match self {
            Self::Tuned => include_str!("../../../deploy/presets/tuned.toml"),
            Self::Paper => include_str!("../../../deploy/presets/paper.toml"),
            Self::Release => include_str!("../../../deploy/presets/release.toml"),
        }
    }

    /// The name as it is written on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Tuned => "tuned",
            Self::Paper => "paper",
            Self::Release => "release",
        }
    }

    /// Its table, with every key that exists, and its changes for a task or an algorithm.
    pub(super) fn tables(self) -> Result<(Table, Option<Value>), ConfigError> {
        let mut table = parse(self.text(), &self.origin())?;
        let conditional = table.remove("for");
        Ok((table, conditional))
    }

    /// Where values of it come from, as messages name it.
    pub(super) fn origin(self) -> String {
        format!("preset {}", self.as_str())
    }
}
