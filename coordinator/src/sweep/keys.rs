//! A table of a file, read key by key: what is wrong is said with the file's name and the key.

use clap::ValueEnum;
use proto::config::hint;
use proto::{ConfigError, ExitCode, ExitError};
use toml::{Table, Value};

use crate::names::{Named, Names};
use crate::values::MAX_COUNT;

/// The keys of a table that have not been read yet.
pub(super) struct Keys<'a> {
    pub(super) origin: &'a str,
    prefix: &'a str,
    table: Table,
}

impl<'a> Keys<'a> {
    pub(super) fn new(origin: &'a str, prefix: &'a str, table: Table) -> Self {
        Self { origin, prefix, table }
    }

    pub(super) fn take(&mut self, key: &str) -> Option<Value> {
        self.table.remove(key)
    }

    pub(super) fn wrong(&self, key: &str, expected: &str, found: impl Into<String>) -> ConfigError {
        ConfigError::WrongType {
            origin: self.origin.to_owned(),
            key: format!("{}{key}", self.prefix),
            expected: expected.to_owned(),
            found: found.into(),
        }
    }

    pub(super) fn refuse(&self, what: &str) -> ExitError {
        ExitError::new(ExitCode::BadInput, format!("{}: {what}", self.origin))
    }

    pub(super) fn text(&mut self, key: &str) -> Result<Option<String>, ConfigError> {
        match self.take(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(self.wrong(key, "a string", other.to_string())),
        }
    }

    pub(super) fn whole(&mut self, key: &str, least: u64) -> Result<Option<u64>, ConfigError> {
        let Some(value) = self.take(key) else { return Ok(None) };
        let expected = match &value {
            value if number(value).is_some_and(|value| value > MAX_COUNT as f64) => {
                format!("a whole number, {MAX_COUNT} at most")
            }
            _ => format!("a whole number, {least} or more"),
        };
        let whole = whole(&value).filter(|whole| *whole >= least);
        whole.map(Some).ok_or_else(|| self.wrong(key, &expected, value.to_string()))
    }

    pub(super) fn table(&mut self, key: &str) -> Result<Option<Table>, ConfigError> {
        match self.take(key) {
            None => Ok(None),
            Some(Value::Table(table)) => Ok(Some(table)),
            Some(other) => Err(self.wrong(key, &format!("a table, [{key}]"), other.to_string())),
        }
    }

    /// A value that has a name.
    pub(super) fn named<T: Names>(&mut self, key: &str) -> Result<Option<Named<T>>, ConfigError> {
        let Some(value) = self.take(key) else { return Ok(None) };
        let all = Named::<T>::value_variants();
        let found = all.iter().find(|named| value.as_str() == Some(named.0.name()));
        found.copied().map(Some).ok_or_else(|| {
            let names: Vec<String> =
                all.iter().map(|named| format!("`{}`", named.0.name())).collect();
            self.wrong(key, &format!("one of {}", names.join(", ")), value.to_string())
        })
    }

    /// Refuses what has not been read.
    pub(super) fn end(self, known: &[&str]) -> Result<(), ConfigError> {
        let Some(name) = self.table.keys().next() else { return Ok(()) };
        Err(ConfigError::UnknownKey {
            origin: self.origin.to_owned(),
            key: format!("{}{name}", self.prefix),
            hint: hint(self.prefix, name, known.iter().copied()),
        })
    }
}

/// A number.
pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(value) => Some(*value as f64),
        Value::Float(value) => Some(*value),
        _ => None,
    }
}

/// A whole number; large ones may be written as 2e6.
pub(super) fn whole(value: &Value) -> Option<u64> {
    match value {
        Value::Integer(value) => u64::try_from(*value).ok().filter(|value| *value <= MAX_COUNT),
        Value::Float(value) if value.fract() == 0.0 && (0.0..=MAX_COUNT as f64).contains(value) => {
            Some(*value as u64)
        }
        _ => None,
    }
}
