//! Layered merging: every layer is checked against the preset before it overrides anything.
//!
//! **An algorithm's settings are data.** What `--algorithm` changes in a preset stands in the preset's
//! `[for.ALGORITHM]`, beside the changes for a task, and any later layer overrides it.

use std::collections::BTreeMap;

use toml::{Table, Value};

use super::algorithm::AlgorithmName;
use super::preset::Preset;
use super::resolved::Config;
use super::tables::{found, hint, parse, wanted};
use super::typed::typed;
use crate::ConfigError;
use crate::tasks::TaskName;

/// What is wrong with `--set` of several keys.
const ONE_KEY: &str =
    "gives values to several keys, expected one KEY=VALUE; write --set once for each key";

/// A configuration in the making. Later layers win.
#[derive(Debug, Clone)]
pub struct Layers {
    preset: Preset,
    task: Option<TaskName>,
    overlays: Vec<(String, Table)>,
}

impl Layers {
    /// Starts from `preset`; a `task` given here wins over any layer's `task.name`.
    pub fn new(preset: Preset, task: Option<TaskName>) -> Self {
        Self { preset, task, overlays: Vec::new() }
    }

    /// Adds TOML text that came from `origin`.
    pub fn text(mut self, text: &str, origin: &str) -> Result<Self, ConfigError> {
        let table = parse(text, origin)?;
        self.overlays.push((origin.to_owned(), table));
        Ok(self)
    }

    /// Adds one `key=value`; the value is TOML, and a bare word is taken as a string. Where the key wants one, so is whatever is no
    /// TOML and does not begin as a string of it.
    pub fn set(mut self, assignment: &str) -> Result<Self, ConfigError> {
        let origin = format!("--set {assignment}");
        let Some((key, value)) = assignment.split_once('=') else {
            return Err(ConfigError::Assignment {
                origin,
                message: "wants KEY=VALUE, such as algorithm.gamma=0.97",
            });
        };
        let (key, value) = (key.trim(), value.trim());
        let wrapped = format!("value = {value}");
        // Of those that are no TOML: too large ones, and such as 007.
        let is_number =
            value.trim_start_matches(['+', '-']).starts_with(|c: char| c.is_ascii_digit())
                && value.chars().all(|c| c.is_ascii_digit() || "+-_.eE".contains(c));
        let is_word = value.chars().all(|c| c.is_alphanumeric() || "_-./:".contains(c));
        let parsed = match wrapped.parse::<Table>() {
            Ok(table) if table.len() == 1 => table["value"].clone(),
            Ok(_) => return Err(ConfigError::Assignment { origin, message: ONE_KEY }),
            // Also where the key wants a text, and would take all of it.
            Err(_) if self.names_another_key(value)? => {
                return Err(ConfigError::Assignment { origin, message: ONE_KEY });
            }
            Err(_) if is_word && !is_number => Value::String(value.to_owned()),
            Err(_) if !value.starts_with(['"', '\'']) && self.is_text(key)? => {
                Value::String(value.to_owned())
            }
            Err(_) if is_number => {
                let message = format!("{value} is no number, or one that is too large");
                return Err(ConfigError::Syntax { origin, message });
            }
            // The parser's words show the line, which nobody has written.
            Err(error) => {
                return Err(ConfigError::Syntax { origin, message: error.message().to_owned() });
            }
        };
        let nested = key
            .rsplit('.')
            .fold(parsed, |inner, part| Value::Table(Table::from_iter([(part.to_owned(), inner)])));
        let Value::Table(table) = nested else {
            unreachable!("a dotted key has at least one part, so the fold made a table");
        };
        self.overlays.push((origin, table));
        Ok(self)
    }

    /// Whether a key wants a string; one that there is not is found out when layers are merged.
    fn is_text(&self, key: &str) -> Result<bool, ConfigError> {
        let (base, _) = self.preset.tables()?;
        Ok(slot(&Value::Table(base), key).is_none_or(Value::is_str))
    }

    /// Whether a key that there is gets a value within what is written as the value of one. Groups get none.
    fn names_another_key(&self, value: &str) -> Result<bool, ConfigError> {
        let (base, _) = self.preset.tables()?;
        let base = Value::Table(base);
        let is_key = |key: &str| slot(&base, key).is_some_and(|there| !there.is_table());
        let mut parts = value.split(|c: char| c.is_whitespace() || ",;".contains(c));
        Ok(parts.any(|part| part.split_once('=').is_some_and(|(key, _)| is_key(key))))
    }

    /// Merges all layers and checks the result.
    pub fn resolve(&self) -> Result<Config, ConfigError> {
        let origin = self.preset.origin();
        let (mut base, conditional) = self.preset.tables()?;
        let task = self.chosen_task(&base)?;
        set_task(&mut base, &task);
        let chosen = [task.as_str(), self.chosen_algorithm(&base)];

        let mut layers = conditional_changes(conditional, &chosen, &origin)?;
        for (origin, overlay) in &self.overlays {
            let mut overlay = overlay.clone();
            let conditional = overlay.remove("for");
            layers.push((origin.clone(), overlay));
            layers.extend(conditional_changes(conditional, &chosen, origin)?);
        }
        let mut origins = BTreeMap::new();
        for (origin, layer) in &layers {
            merge(&mut base, layer, origin, "", &mut origins)?;
        }
        set_task(&mut base, &task);

        let origin_of = |key: &str| origins.get(key).copied().unwrap_or(&origin).to_owned();
        let config = typed(base, origin_of)?;
        config.validate()?;
        config.refuse_what_has_no_effect()?;
        Ok(config)
    }

    /// The last layer's algorithm that is one; whether all are is seen when they are merged.
    fn chosen_algorithm(&self, base: &Table) -> &'static str {
        let written = std::iter::once(base)
            .chain(self.overlays.iter().map(|(_, layer)| layer))
            .filter_map(|layer| layer.get("algorithm")?.get("name")?.as_str())
            .next_back();
        let named = AlgorithmName::ALL.iter().map(|name| name.as_str());
        named.into_iter().find(|name| Some(*name) == written).unwrap_or_default()
    }

    /// The command line's task, else the last layer's that names one, else the preset's.
    fn chosen_task(&self, base: &Table) -> Result<String, ConfigError> {
        if let Some(task) = self.task {
            return Ok(task.as_str().to_owned());
        }
        let preset = (String::new(), base.clone());
        let (origin, value) = std::iter::once(&preset)
            .chain(&self.overlays)
            .filter_map(|(origin, layer)| Some((origin, layer.get("task")?.get("name")?)))
            .next_back()
            .expect("a preset names its task");
        match value.as_str() {
            Some(name) if TaskName::named(name).is_some() => Ok(name.to_owned()),
            _ => Err(ConfigError::WrongType {
                origin: origin.clone(),
                key: "task.name".to_owned(),
                expected: TaskName::listed(),
                found: value.to_string(),
            }),
        }
    }
}

/// What a dotted key has in a table.
fn slot<'a>(base: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(base, |table, part| table.get(part))
}

/// What a layer's `[for.NAME]` tables change for the chosen task and algorithm, in this order.
fn conditional_changes(
    tables: Option<Value>,
    chosen: &[&str; 2],
    origin: &str,
) -> Result<Vec<(String, Table)>, ConfigError> {
    let Some(tables) = tables else { return Ok(Vec::new()) };
    let wrong = |key: String, found: &Value| ConfigError::WrongType {
        origin: origin.to_owned(),
        key,
        expected: "a table of groups such as [for.reorientation.task]".to_owned(),
        found: format!("the {} {found}", found.type_str()),
    };
    let Value::Table(tables) = tables else { return Err(wrong("for".to_owned(), &tables)) };
    let known: Table = TaskName::ALL
        .iter()
        .map(|task| task.as_str())
        .chain(AlgorithmName::ALL.map(AlgorithmName::as_str))
        .map(|name| (name.to_owned(), Value::Boolean(true)))
        .collect();
    for (name, changes) in &tables {
        let key = format!("for.{name}");
        if !known.contains_key(name) {
            let hint = hint("for.", name, known.keys().map(String::as_str));
            let origin = origin.to_owned();
            return Err(ConfigError::UnknownKey { origin, key, hint });
        }
        if !changes.is_table() {
            return Err(wrong(key, changes));
        }
    }
    let changes = chosen.iter().filter_map(|name| tables.get(*name)?.as_table());
    Ok(changes.map(|changes| (origin.to_owned(), changes.clone())).collect())
}

fn set_task(base: &mut Table, task: &str) {
    if let Some(Value::Table(group)) = base.get_mut("task") {
        group.insert("name".to_owned(), Value::String(task.to_owned()));
    }
}

/// Overrides `base` by `overlay`; `base` holds every key that exists, with a value of its type. `origins` gets to know
/// whose value a key has.
fn merge<'a>(
    base: &mut Table,
    overlay: &Table,
    origin: &'a str,
    prefix: &str,
    origins: &mut BTreeMap<String, &'a str>,
) -> Result<(), ConfigError> {
    for (name, value) in overlay {
        let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        let Some(slot) = base.get_mut(name) else {
            let group = key.strip_suffix(name.as_str()).unwrap_or_default();
            let hint = hint(group, name, base.keys().map(String::as_str));
            return Err(ConfigError::UnknownKey { origin: origin.to_owned(), key, hint });
        };
        if let (Value::Table(slot), Value::Table(value)) = (&mut *slot, value) {
            merge(slot, value, origin, &key, origins)?;
            continue;
        }
        let Some(taken) = taken(slot, value) else {
            return Err(ConfigError::WrongType {
                origin: origin.to_owned(),
                key,
                expected: wanted(slot),
                found: found(value),
            });
        };
        *slot = taken;
        origins.insert(key, origin);
    }
    Ok(())
}

/// The value as a key takes it that has one like `slot`, if it does.
fn taken(slot: &Value, value: &Value) -> Option<Value> {
    match (slot, value) {
        // TOML writes 1 where a person means 1.0.
        (Value::Float(_), Value::Integer(value)) => Some(Value::Float(*value as f64)),
        // No key counts below zero.
        (Value::Integer(_), Value::Integer(value)) if *value < 0 => None,
        // Large budgets are written as 2e6.
        (Value::Integer(_), Value::Float(value))
            if value.fract() == 0.0 && (0.0..9e15).contains(value) =>
        {
            Some(Value::Integer(*value as i64))
        }
        // All lists are of counts.
        (Value::Array(_), Value::Array(values)) => values
            .iter()
            .map(|value| taken(&Value::Integer(0), value))
            .collect::<Option<_>>()
            .map(Value::Array),
        (slot, value) => slot.same_type(value).then(|| value.clone()),
    }
}
