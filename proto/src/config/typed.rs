//! From a table to a [`Config`]. What does not fit is said with its key and what is allowed there.
//!
//! **The culprit is found by trial.** A deserialiser knows types of this program and no key of the user's. So each
//! value of a table that is refused is put alone into a table that is complete, and what is refused then is at fault.

use toml::{Table, Value};

use super::preset::Preset;
use super::resolved::Config;
use super::tables::{found, hint, parse, wanted};
use crate::ConfigError;

impl Config {
    /// Reads a resolved configuration, as `config.toml` of a run directory holds it.
    pub fn from_resolved_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let config = typed(parse(text, origin)?, |_| origin.to_owned())?;
        config.validate()?;
        Ok(config)
    }
}

/// The configuration that `table` holds. `origin_of` says where a dotted key's value came from.
pub(super) fn typed(
    table: Table,
    origin_of: impl Fn(&str) -> String,
) -> Result<Config, ConfigError> {
    let kept = table.clone();
    Value::Table(table).try_into().map_err(|error: toml::de::Error| {
        let found = Preset::Tuned.tables().and_then(|(complete, _)| {
            let mut path = Vec::new();
            check(&kept, &complete, &complete, &mut path, &origin_of)
        });
        let said = || error.message().replace('\n', " ");
        found
            .err()
            .unwrap_or_else(|| ConfigError::Syntax { origin: origin_of(""), message: said() })
    })
}

/// Looks in `table`, the group of this `path`, for what a configuration cannot have. `group` is the same group of
/// `complete`.
fn check(
    table: &Table,
    group: &Table,
    complete: &Table,
    path: &mut Vec<String>,
    origin_of: &impl Fn(&str) -> String,
) -> Result<(), ConfigError> {
    for (name, value) in table {
        path.push(name.clone());
        let key = path.join(".");
        let origin = origin_of(&key);
        match (group.get(name), value) {
            (None, _) => {
                let prefix = key.strip_suffix(name.as_str()).unwrap_or_default();
                let hint = hint(prefix, name, group.keys().map(String::as_str));
                return Err(ConfigError::UnknownKey { origin, key, hint });
            }
            (Some(Value::Table(group)), Value::Table(table)) => {
                check(table, group, complete, path, origin_of)?;
            }
            (Some(example), value) => {
                if let Err(error) = trial(complete, path, Some(value)) {
                    let expected = words_of(&error).unwrap_or_else(|| wanted(example));
                    let found = found(value);
                    return Err(ConfigError::WrongType { origin, key, expected, found });
                }
            }
        }
        path.pop();
    }
    for name in group.keys().filter(|name| !table.contains_key(*name)) {
        path.push(name.clone());
        if trial(complete, path, None).is_err() {
            let key = path.join(".");
            return Err(ConfigError::Missing { origin: origin_of(&key), key });
        }
        path.pop();
    }
    Ok(())
}

/// Whether `complete` is a configuration with another value of a key, or without it.
fn trial(complete: &Table, path: &[String], value: Option<&Value>) -> Result<(), toml::de::Error> {
    let mut tried = complete.clone();
    let mut group = &mut tried;
    let (name, groups) = path.split_last().expect("a key has a name");
    for outer in groups {
        let Some(Value::Table(inner)) = group.get_mut(outer) else { return Ok(()) };
        group = inner;
    }
    match value {
        Some(value) => group.insert(name.clone(), value.clone()),
        None => group.remove(name),
    };
    Value::Table(tried).try_into::<Config>().map(|_| ())
}

/// What a deserialiser says of what it would have taken, if that is words or a number's limit.
fn words_of(error: &toml::de::Error) -> Option<String> {
    let (_, expected) = error.message().split_once("expected ")?;
    let expected = expected.trim();
    if expected.starts_with("u32") {
        return Some(format!("a whole number, not below 0, and at most {}", u32::MAX));
    }
    expected.contains('`').then(|| expected.to_owned())
}
