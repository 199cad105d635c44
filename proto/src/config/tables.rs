//! TOML's tables as people write them: read from text, and in words for messages.

use toml::{Table, Value};

use crate::ConfigError;

/// The table that `text` from `origin` holds.
///
/// # Errors
/// If it is no TOML.
pub fn parse(text: &str, origin: &str) -> Result<Table, ConfigError> {
    text.parse::<Table>().map_err(|error| ConfigError::Syntax {
        origin: origin.to_owned(),
        message: in_line(&error, text, &error.message().replace('\n', " ")),
    })
}

/// What is `said` about `text`, after the line of it that the parser finds at fault.
pub fn in_line(error: &toml::de::Error, text: &str, said: &str) -> String {
    let at = error.span().and_then(|span| text.get(..span.start));
    let Some(before) = at else { return said.to_owned() };
    let number = before.matches('\n').count();
    let line = text.lines().nth(number).unwrap_or_default().trim();
    format!("line {}, `{line}`: {said}", number + 1)
}

/// What a key wants whose value is like `example`.
pub(super) fn wanted(example: &Value) -> String {
    let kind = match example {
        Value::Integer(_) => "a whole number",
        Value::Float(_) => "a number",
        Value::Boolean(_) => return "true or false".to_owned(),
        Value::String(_) => "a string",
        Value::Array(_) => "a list of whole numbers",
        Value::Table(_) => return "a table".to_owned(),
        Value::Datetime(_) => "a time",
    };
    let limit = match example {
        Value::Integer(_) | Value::Array(_) => ", none below 0, such as ",
        _ => " such as ",
    };
    let example = match example {
        Value::Array(values) if values.is_empty() => "[256, 256]".to_owned(),
        other => other.to_string(),
    };
    format!("{kind}{limit}{example}").replace("number, none", "number, not")
}

/// A value with what it is.
pub(super) fn found(value: &Value) -> String {
    let kind = match value {
        Value::Integer(_) => "the whole number",
        Value::Float(_) => "the number",
        Value::Boolean(_) => return value.to_string(),
        Value::String(_) => "the string",
        Value::Array(_) => "the list",
        Value::Table(_) => "the table",
        Value::Datetime(_) => "the time",
    };
    format!("{kind} {value}")
}

/// The end of a message about an unknown name: the nearest known one, as it is typed behind `prefix`, or all of them.
pub fn hint<'a>(prefix: &str, name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.collect();
    let distances = known.iter().map(|key| (strsim::levenshtein(name, key), key));
    let near = distances.filter(|(distance, _)| *distance <= 2.max(name.len() / 3)).min();
    match near {
        Some((_, key)) => format!("; did you mean `{prefix}{key}`?"),
        None => format!("; known here: {}", known.join(", ")),
    }
}
